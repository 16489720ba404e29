"""Output folder of `tissue run`.

Existing files are kept, and a folder or disk that cannot be written is refused.
"""

import errno
import os
from pathlib import Path

import pytest
from coarse_run import COARSE

from tissue.simulation.run_folder import SavedRun
from tissue.simulation.trace import TraceWriter


def test_a_folder_with_another_run_is_kept_without_force(refused, command, here):
    quick = ("run", "milling", *COARSE, "--duration-s", 0.02)
    assert command(*quick, "--out", "first", "--format", "npz")[0] == 0
    (here / "first" / "trace.txt").write_text("notes of a person")
    before = {path: path.read_bytes() for path in (here / "first").rglob("*") if path.is_file()}
    assert refused(*quick, "--out", "first") == (
        "out must not contain another run, got first. Pass --overwrite (overwrite=True in Python) to "
        "replace it or choose another --out"
    )
    assert {
        path: path.read_bytes() for path in (here / "first").rglob("*") if path.is_file()
    } == before
    assert (
        command("run", "milling", *COARSE, "--duration-s", 0.03, "--out", "first", "--overwrite")[0]
        == 0
    )
    after = {path: path.read_bytes() for path in (here / "first").rglob("*") if path.is_file()}
    assert set(before) - set(after) == {here / "first" / "trace.npz"}
    assert after[here / "first" / "trace.txt"] == b"notes of a person"
    assert after[here / "first" / "trace.csv"].count(b"\n") == 31


@pytest.mark.parametrize("arguments", [(), ("--overwrite",)], ids=["plain", "overwrite"])
def test_files_of_other_origin_are_always_kept(refused, here, arguments):
    (here / "mine").mkdir()
    (here / "mine" / "trace.csv").write_text("my own")
    assert refused("run", "milling", *COARSE, "--out", "mine", *arguments) == (
        "out must not contain files of other origin, got mine with the file trace.csv. Choose another --out"
    )
    assert (here / "mine" / "trace.csv").read_text() == "my own"
    assert len(list((here / "mine").iterdir())) == 1


def test_a_file_in_the_place_of_the_folder_is_refused(refused, here):
    (here / "taken").touch()
    assert refused("run", "milling", "--out", "taken") == (
        "out must be a folder, got the file taken. Choose another --out"
    )
    assert refused("run", "milling", "--out", "taken/below/it") == (
        f"out must lie in a folder, got taken/below/it, but {here / 'taken'} is a file. "
        "Choose another --out"
    )


def test_a_folder_that_cannot_be_written_is_refused(refused, here, monkeypatch):
    (here / "shut").mkdir()
    monkeypatch.setattr(
        "meshes.base.whole_file.os.access", lambda path, mode: Path(path) != here / "shut"
    )
    assert refused("run", "milling", "--out", "shut/run") == (
        f"out must be writable, got permission denied at {here / 'shut'}. Choose another --out"
    )
    monkeypatch.setattr("meshes.base.whole_file.os.access", lambda path, mode: True)

    def read_only(self, *_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(self))

    monkeypatch.setattr(Path, "mkdir", read_only)
    assert refused("run", "milling", *COARSE, "--out", "shut/run") == (
        f"out must be writable, got read-only file system at {here / 'shut' / 'run'}. Choose "
        "another --out"
    )


class FullDisk:
    """A file that takes nothing more."""

    def __init__(self, file):
        self.close = file.close

    def write(self, text):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_is_refused_and_the_run_is_incomplete(refused, here, monkeypatch):
    start = TraceWriter.__init__

    def full(self, path, table):
        start(self, path, table)
        self._file = FullDisk(self._file)

    monkeypatch.setattr(TraceWriter, "__init__", full)
    assert refused("run", "milling", *COARSE, "--duration-s", 0.1) == (
        "out must have free space, got no space left on device at runs/milling/trace.csv. Free "
        "some space or choose another "
        "--out"
    )
    saved = SavedRun("runs/milling")
    assert not saved.complete and len(saved.trace.rows) == 0
