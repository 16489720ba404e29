"""An empty working directory, and a display for windows."""

import os
import shutil
import subprocess

import pytest


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
    from tissue.system.offscreen import display_problem

    if shutil.which("Xvfb") is None:
        problem = display_problem()
        if problem is not None:
            pytest.skip(f"{problem}, and there is no Xvfb: apt-get install xvfb")
        yield os.environ["DISPLAY"]
        return
    read, write = os.pipe()
    command = [
        "Xvfb",
        "-displayfd",
        str(write),
        "-screen",
        "0",
        "1600x1100x24",
        "-nolisten",
        "tcp",
        "-noreset",
    ]
    with subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as server:
        os.close(write)
        with os.fdopen(read) as stream:
            number = stream.readline().strip()
        if not number:
            pytest.skip("Xvfb does not start here")
        yield f":{number}"
        server.terminate()
