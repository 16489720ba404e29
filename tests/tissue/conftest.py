"""The `tissue` command run within the tests' process, and a display for windows."""

import os
import shutil
import subprocess
import sys

import pytest


@pytest.fixture
def command(monkeypatch, capfd):
    """Run the command; return exit code, standard output and standard error."""
    from tissue.cli import main

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["tissue", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        said = capfd.readouterr()
        return ended.value.code, said.out, said.err

    return run


@pytest.fixture
def refused(command):
    """Run the command with bad input; return the one sentence that it says."""

    def run(*arguments):
        code, _, said = command(*arguments)
        assert code == 2, said
        assert said.startswith("error: ") and said.endswith("\n") and said.count("\n") == 1, said
        return said.removeprefix("error: ").removesuffix("\n")

    return run


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    assert not os.listdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def display():
    """Name of a display to open windows on: a virtual one, or else the real one."""
    from tissue.offscreen import display_problem

    if shutil.which("Xvfb") is None:
        problem = display_problem()
        if problem is not None:
            pytest.skip(f"{problem}, and there is no Xvfb: apt-get install xvfb")
        yield os.environ["DISPLAY"]
        return
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1600x1100x24", "-nolisten", "tcp", "-noreset"]
    with subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as server:
        os.close(write)
        with os.fdopen(read) as told:
            number = told.readline().strip()
        if not number:
            pytest.skip("Xvfb does not start here")
        yield f":{number}"
        server.terminate()
