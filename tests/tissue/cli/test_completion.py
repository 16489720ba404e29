"""`tissue --install-completion`."""

import os
import shutil
import subprocess
import sys

import pytest

PLACES = {
    "bash": ".local/share/bash-completion/completions/tissue",
    "fish": ".config/fish/completions/tissue.fish",
}


@pytest.fixture
def home(monkeypatch, tmp_path):
    """A home folder of the test's own, as both kinds of systems name it."""
    for name in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(name, str(tmp_path))
    for name in ("ZSH", "ZSH_CUSTOM"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_installed_in_a_shell(command, home, shell):
    code, output, problems = command("--install-completion", "--shell", shell)
    written = [path for path in home.rglob("*") if path.is_file() and "tissue" in path.name]
    assert (code, problems, len(written)) == (0, "", 1) and str(written[0]) in output
    if shell in PLACES:
        assert written[0] == home / PLACES[shell]
    script = written[0].read_text("utf-8")
    for word in ("stability", "calibrate", "schema", "overwrite"):
        assert word in script


@pytest.mark.skipif(not shutil.which("bash") or sys.platform == "win32", reason="needs bash")
def test_bash_completes_commands_and_options(command, home):
    command("--install-completion", "--shell", "bash")
    code = """
    . "$HOME/.local/share/bash-completion/completions/tissue"
    call=$(complete -p tissue | sed 's/.*-F \\([^ ]*\\).*/\\1/')
    completed() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=(); $call; echo "${COMPREPLY[@]}"; }
    completed tissue sche
    completed tissue schema --o
    """
    path = os.pathsep.join((os.path.dirname(sys.executable), os.environ["PATH"]))
    ended = subprocess.run(
        ["bash", "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PATH": path},
    )
    assert (ended.returncode, ended.stdout.split("\n")[:2]) == (
        0,
        ["schema", "--out --overwrite"],
    ), ended.stderr


def test_a_shell_that_is_none_is_refused(refused, home):
    message = refused("--install-completion", "--shell", "bsh")
    assert message.startswith("--shell must be") and "got bsh" in message
    assert not list(home.iterdir())
