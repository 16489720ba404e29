"""Vendors' own Python packages, where they are installed.

Their libraries are compiled here as replacements.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from vendor_libraries import HD, drd_with

ROOT = Path(__file__).resolve().parents[4]
pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None, reason="needs Linux and a C compiler"
)
QUARTER = [0.0, 0.0, 0.5**0.5, 0.5**0.5]
TESTED = """
import ctypes, json, sys, time
import numpy as np
{imports}
place = Adapter.find()[0]
library = ctypes.CDLL(sys.argv[1])
with Adapter() as adapter:
    ends = time.perf_counter() + 60.0
    while (sample := adapter.poll()) is None and time.perf_counter() < ends:
        time.sleep(1e-3)
    for _ in range(50):
        adapter.push(np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]))
        time.sleep(1e-3)
{found}
print(json.dumps([place.where, place.detail, sample, found]))
"""


def compiled(tmp_path, source, name):
    """A shared library of C."""
    (tmp_path / "library.c").write_text(source)
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    subprocess.run(
        [
            "cc",
            "-shared",
            "-fPIC",
            "-w",
            "-o",
            tmp_path / name,
            tmp_path / "library.c",
            "-lpthread",
        ],
        check=True,
    )
    return tmp_path / name


def package(name):
    """Return the folder of an installed package; skip the test without the package."""
    spec = find_spec(name)
    if spec is None:
        pytest.skip(f"{name} is not installed")
    return Path(spec.origin).parent


def outcome_of(code, library, **environment):
    """Run code in a process of its own with the library's path.

    Returns the address and the detail of the device, its sample, and the value found by the code.
    """
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    ended = subprocess.run(
        [sys.executable, "-c", code, str(library)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": paths} | environment,
    )
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


def test_forcedimension_core_calls_the_vendors_library_as_it_should(tmp_path):
    source = drd_with(package("forcedimension_core"))
    library = compiled(tmp_path, source, f"lib/release/lin-{platform.machine()}-gcc/libdrd.so.3")
    code = TESTED.format(
        imports="from tissue.haptics.real.forcedimension import ForceDimensionAdapter as Adapter",
        found="library.kept.restype = ctypes.c_char_p\nfound = library.kept().decode()",
    )
    where, detail, sample, calls = outcome_of(code, library, FDSDK=str(tmp_path))
    assert (where, detail) == ("7", "omega.6")
    assert sample[:2] == [[0.01, -0.02, 0.03], [0.1, 0.2, 0.3]]
    assert sample[2] == pytest.approx(QUARTER)
    assert sample[3:] == [[1.0, 2.0, 3.0], 5]
    assert (
        calls
        == "close;open;most 12;force 1;"
        + 50 * "set 1 2 3 0 0 0;"
        + "set 0 0 0 0 0 0;force 0;close;"
    )


def test_pyopenhaptics_calls_the_vendors_library_as_it_should(tmp_path):
    package("pyOpenHaptics")
    library = compiled(tmp_path, HD, "libHD.so")
    code = TESTED.format(
        imports="from tissue.haptics.real.openhaptics import OpenHapticsAdapter as Adapter",
        found=(
            "library.last.restype = library.most.restype = ctypes.c_double\nfound = "
            "[library.most(), library.last()]"
        ),
    )
    where, detail, sample, squares = outcome_of(code, library, LD_LIBRARY_PATH=str(tmp_path))
    assert (where, detail) == ("Default Device", "3D Systems Touch")
    assert (
        sample[0] == pytest.approx([0.01, -0.02, 0.03])
        and sample[2] == pytest.approx(QUARTER)
        and sample[4] == 2
    )
    assert squares == [14.0, 0.0]  # 1, 2 and 3 N were played, and zero at last
