"""Fixtures of all tests.

They give real anatomy where it is available, and run the `tissue` command within the tests'
process.
"""

import gc
import os
import sys
from pathlib import Path

import pytest

# Before anything loads NumPy: tests run side by side, and threads that wait for a core cost
# more than they save.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
# Some two hundred tests start Python anew; without compiled modules each would compile all that it
# imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
ANATOMY = Path(__file__).resolve().parents[2] / "shared" / "anatomy"


def pytest_collection_finish():
    """Freeze the objects of imports and collection for the garbage collector.

    They stay for the whole session, and freezing them saves a tenth of the tests' time.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def anatomy() -> Path:
    """Return the folder of real anatomical data next to the checkout; skip tests without it."""
    if not ANATOMY.is_dir():
        pytest.skip("real anatomy is not there: ../shared/anatomy next to the checkout")
    return ANATOMY


@pytest.fixture
def command(monkeypatch, capfd):
    """Run the command; return exit code, standard output and standard error."""
    from tissue.cli.main import main

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["tissue", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        message = capfd.readouterr()
        return ended.value.code, message.out, message.err

    return run


@pytest.fixture
def refused(command):
    """Run the command with bad input; return the one sentence that it prints."""

    def run(*arguments):
        code, _, message = command(*arguments)
        assert code == 2, message
        assert (
            message.startswith("error: ") and message.endswith("\n") and message.count("\n") == 1
        ), message
        return message.removeprefix("error: ").removesuffix("\n")

    return run
