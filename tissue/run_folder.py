"""The folder a run lives in: made ready, filled while the run goes on, read back."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

from meshes.errors import InputError
from meshes.whole_file import whole_file
from tissue.formats import FORMATS
from tissue.scene import Scene
from tissue.trace import Table, TraceWriter, read_table

__all__ = ["FORMAT", "RunFolder", "SavedRun"]

FORMAT = 1
"""Version of the run folder."""
OWN_FILES = (
    "trace.csv",
    *(f"trace.{kind}" for kind in FORMATS),
    "timing.csv",
    "scene.toml",
    "summary.json",
    "bone.vti",
    "bone.nrrd",
    "bone.stl",
    "bone.vtp",
    "fields.pvd",
    "fields",
    "pictures",
)
"""Names in a run's folder."""


class RunFolder:
    """A folder that takes a run while it goes on.

    It never replaces files that it did not write: a folder that holds a run is kept unless told to overwrite it, and
    one that holds other files of the same names is always kept.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writers: list[TraceWriter] = []

    @staticmethod
    def check(path: Path, *, overwrite: bool) -> None:
        """Refuse a folder that cannot take a run."""
        if path.exists() and not path.is_dir():
            raise InputError(f"out must be a folder, got the file {path}: choose another --out")
        standing = next(each for each in (path, *path.absolute().parents) if each.exists())
        if not standing.is_dir():
            raise InputError(f"out must lie in a folder, got {path} under the file {standing}: choose another --out")
        if not os.access(standing, os.W_OK | os.X_OK):
            raise InputError(f"out must be writable, got permission denied at {standing}: choose another --out")
        taken = _own_files(path)
        if not taken:
            return
        if not _holds_run(path):
            raise InputError(
                f"out must not hold files of other origin, got {path} with {taken[0]}: choose another --out"
            )
        if not overwrite:
            raise InputError(
                f"out must not hold another run, got {path}: pass --overwrite to replace it or choose another --out"
            )

    @classmethod
    def begin(cls, path: Path, scene: Scene, *, overwrite: bool) -> "RunFolder":
        """Make the folder ready and mark it as running.

        Raises
        ------
        InputError
            If it holds another run, or files of other origin.
        """
        cls.check(path, overwrite=overwrite)
        path.mkdir(parents=True, exist_ok=True)
        folder = cls(path)
        folder.write_summary({"format": FORMAT, "status": "running", "scene": scene.name})
        for name in _own_files(path):
            if name != "summary.json":
                entry = path / name
                shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
        (path / "scene.toml").write_text(scene.to_toml(), "utf-8")
        return folder

    def open_tables(self, trace: Table, timing: Table) -> None:
        """Start to write the trace and the timing."""
        self.write_summary(json.loads((self.path / "summary.json").read_text("utf-8")) | {"layers": trace.layer_names})
        self._writers = [
            TraceWriter(self.path / "trace.csv", trace),
            TraceWriter(self.path / "timing.csv", timing),
        ]

    def flush(self, row_count: int, *, force: bool = False) -> None:
        """Bring the rows so far to disk if it is time."""
        for writer in self._writers:
            writer.flush(row_count, force=force)

    def close(self) -> None:
        """Close the tables."""
        for writer in self._writers:
            writer.close()
        self._writers = []

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write ``summary.json`` at once: it is either the old one or the new one."""
        with whole_file(self.path / "summary.json") as beside:
            beside.write_text(json.dumps(summary, indent=2) + "\n", "utf-8")


class SavedRun:
    """A run read back from its folder.

    Attributes
    ----------
    path
        The folder.
    summary
        Contents of ``summary.json``.
    trace
        The trace, up to the last whole row.

    Raises
    ------
    InputError
        If the folder holds no run.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not _holds_run(self.path):
            raise InputError(
                f"run must be a folder that `tissue run` wrote, got {self.path}: give for example runs/glenoid"
            )
        self.summary: dict[str, Any] = json.loads((self.path / "summary.json").read_text("utf-8"))
        table = self.path / "trace.csv"
        self.trace = read_table(table, tuple(self.summary.get("layers", ()))) if table.is_file() else None

    @property
    def complete(self) -> bool:
        """Whether the run came to its end."""
        return bool(self.summary["status"] == "complete")


def _own_files(path: Path) -> list[str]:
    """Entries of a folder that carry the names of a run's files."""
    if not path.is_dir():
        return []
    return sorted(entry.name for entry in path.iterdir() if entry.name in OWN_FILES)


def _holds_run(path: Path) -> bool:
    """Whether a folder holds a run."""
    try:
        return bool(json.loads((path / "summary.json").read_text("utf-8")).get("format"))
    except (OSError, ValueError, AttributeError):
        return False
