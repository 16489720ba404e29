"""A command that is killed leaves no process and no anatomy behind."""

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not sys.platform.startswith("linux"), reason="processes are found by their command lines"
    ),
]
ROOT = Path(__file__).resolve().parents[2]
MAIN = [sys.executable, "-c", "from tissue.cli.main import main; main()"]
MESH_BYTES = 5_000
"""Less than the smallest mesh that is drawn has: its 100 points would fill it."""


def started(place, *arguments):
    """Start the command with a temporary folder of its own."""
    (place / "temporary").mkdir()
    return subprocess.Popen(
        [*MAIN, *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(place / "temporary")},
        cwd=place,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def command_line(process):
    """Command line of a process, empty of one that has ended."""
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


def children(process, word, count):
    """Return the child processes whose command lines hold a word, as soon as there are `count`."""
    until = time.monotonic() + 120.0
    while time.monotonic() < until and process.poll() is None:
        found = psutil.Process(process.pid).children(recursive=True)
        if sum(word in command_line(each) for each in found) >= count:
            return [each for each in found if word in command_line(each)]
        time.sleep(0.01)
    raise AssertionError(f"{word} did not start")


def gone(processes, within_s):
    """Return True if all processes have ended."""
    _, alive = psutil.wait_procs(processes, timeout=within_s)
    alive = [each for each in alive if command_line(each)]  # a zombie has none
    for each in alive:
        each.kill()
    return not alive


@pytest.mark.parametrize("later_s", [0.0, 4.0])
def test_the_workers_of_a_sweep_end_with_it(tmp_path, later_s):
    values = ("--set", "voxels.spacing_mm=0.2,0.21", "--set", "duration_s=8")
    process = started(
        tmp_path, "sweep", "milling", *values, "--workers", 2, "--out", tmp_path / "out"
    )
    workers = children(process, "multiprocessing-fork", 2)
    time.sleep(later_s)
    workers += psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.wait()
    assert gone(workers, within_s=10.0)


def files(place):
    """Sizes of temporary files, without the picture that was drawn."""
    found = [each for each in (place / "temporary").rglob("*") if each.name != "pictures.npz"]
    return {each.name: each.stat().st_size for each in found if each.is_file()}


def test_a_drawing_leaves_no_mesh_behind(tmp_path):
    changes = (
        "--set",
        "voxels.spacing_mm=0.3",
        "--set",
        "motion.feed_mm_s=50",
        "--duration-s",
        0.1,
    )
    process = started(tmp_path, "run", "milling", *changes, "--out", tmp_path / "out")
    drawing = children(process, "tissue.show.figures.rendering", 1)
    while (
        drawing[0].is_running() and not (tmp_path / "out/pictures/bone_before_after.png").exists()
    ):
        left = files(tmp_path)  # a kill at any moment of the drawing would leave these
        assert max(left.values(), default=0) < MESH_BYTES, left
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert gone(drawing, within_s=10.0)
