"""The `tissue` command run within the tests' process."""

import os
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
