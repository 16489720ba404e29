"""Damaged entries of Warp's kernel cache.

They are compiled anew instead of breaking every later process.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import warp as wp

import kernels.bricks
from kernels.cache_check import BUILDING, MANIFEST, remove_damaged

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import warp as wp
import kernels.bricks
wp.load_module(kernels.bricks, device="cpu")
print("loaded")
"""


@pytest.fixture
def cache(tmp_path):
    """Cache with one compiled module, copied from the cache of the tests, with its checksums."""
    wp.load_module(kernels.bricks, device="cpu")
    whole = Path(wp.config.kernel_cache_dir)
    entries = [each for each in whole.glob("wp_kernels.bricks_*") if not BUILDING.search(each.name)]
    entry = max(entries, key=lambda each: each.stat().st_mtime)
    copied = tmp_path / whole.name  # Warp adds its version to the folder that it is given
    shutil.copytree(entry, copied / entry.name)
    assert remove_damaged(copied) == []
    assert (copied / entry.name / MANIFEST).is_file()
    return copied


def truncate(content):
    return content[: len(content) // 3]


def flip(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 0xFF]) + content[middle + 1 :]


DAMAGE = {
    "empty": lambda content: b"",
    "truncated": truncate,
    "zeros": lambda content: bytes(len(content)),
    "one byte": flip,
}
STRUCTURAL = ("empty", "truncated", "zeros")
"""Damage that shows without a checksum."""


@pytest.mark.parametrize(
    ("damage", "recorded"),
    [(name, True) for name in DAMAGE] + [(name, False) for name in STRUCTURAL],
)
@pytest.mark.parametrize("ending", [".o", ".meta"])
def test_a_damaged_entry_is_found(cache, ending, damage, recorded):
    (file,) = cache.rglob(f"*{ending}")
    if not recorded:
        (file.parent / MANIFEST).unlink()
    file.write_bytes(DAMAGE[damage](file.read_bytes()))
    assert remove_damaged(cache) == [file.parent.name]
    assert not file.parent.exists()


def test_whole_entries_are_kept(cache):
    (file,) = cache.rglob("*.o")
    before = {path: path.read_bytes() for path in file.parent.iterdir()}
    assert remove_damaged(cache) == []
    assert {path: path.read_bytes() for path in file.parent.iterdir()} == before


def test_a_folder_that_another_process_compiles_into_is_kept(cache):
    building = cache / "wp_kernels.bricks_0123abc_p14489_t139888621759360"
    building.mkdir()
    (building / "wp_kernels.bricks_0123abc.o").write_bytes(b"")
    assert remove_damaged(cache) == []
    assert building.is_dir()


@pytest.mark.slow
def test_a_process_recompiles_a_damaged_entry(cache):
    (file,) = cache.rglob("*.o")
    whole = file.stat().st_size
    file.write_bytes(truncate(file.read_bytes()))
    environment = os.environ | {"WARP_CACHE_PATH": str(cache.parent), "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stdout.split("\n")[0]) == (0, "loaded"), ended.stderr
    assert file.stat().st_size == whole
