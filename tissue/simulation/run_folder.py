"""The folder a run lives in: made ready, filled while the run goes on, read back."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from meshes.base.file_version import package_version
from meshes.base.placement import Placement
from meshes.base.whole_file import whole_file
from tissue.models.tissue_model import TICK_S
from tissue.scene.load import load_scene, saved_text
from tissue.scene.scene import Scene
from tissue.simulation.run_summary import FORMAT, Summary, read_summary, summary_of
from tissue.simulation.trace import Table, TraceWriter
from tissue.simulation.trace_files import FORMATS, read_trace
from tissue.system.outputs import OutputLock, identity, is_alive
from tissue.system.stopping import Terminated

__all__ = ["FORMAT", "RunFolder", "SavedRun", "saved_placement"]

OWN_FILES = (
    "trace.csv",
    *(f"trace.{kind}" for kind in FORMATS),
    "recording.hdf5",
    "timing.csv",
    "scene.toml",
    "summary.json",
    "bone.vti",
    "bone.nrrd",
    "bone.stl",
    "bone.vtp",
    "carving.pvd",
    "carving",
    "fields.pvd",
    "fields",
    "pictures",
    "band.csv",
    "band",
    "report.html",
)
"""Names in a run's folder."""


class RunFolder:
    """A folder that takes a run while it goes on, held against other processes until the run has ended.

    It never replaces files that it did not write: a folder that holds a run is kept unless asked to overwrite it, and
    one that holds other files of the same names is always kept. Nothing in it changes before `begin`.

    Parameters
    ----------
    path
        The folder.
    overwrite
        Replace a run that it holds.

    Raises
    ------
    InputError
        If it holds another run or files of other origin, or another process writes to it.
    """

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        self.check(path, overwrite=overwrite)
        self.path, self._overwrite = path, overwrite
        self._writers: list[TraceWriter] = []
        self._summary: Summary = {}
        self._lock = OutputLock(path, folder=True)

    @staticmethod
    def check(path: Path, *, overwrite: bool) -> None:
        """Refuse a folder that cannot take a run."""
        if path.exists() and not path.is_dir():
            raise InputError(f"out must be a folder, got the file {path}: choose another --out")
        existing = next(each for each in (path, *path.absolute().parents) if each.exists())
        if not existing.is_dir():
            raise InputError(f"out must lie in a folder, got {path} under the file {existing}: choose another --out")
        if not os.access(existing, os.W_OK | os.X_OK):
            raise InputError(f"out must be writable, got permission denied at {existing}: choose another --out")
        taken = _run_files(path)
        if not taken:
            return
        if not summary_of(path).get("format"):
            raise InputError(
                f"out must not hold files of other origin, got {path} with {taken[0]}: choose another --out"
            )
        if not overwrite:
            raise InputError(
                f"out must not hold another run, got {path}: pass --overwrite to replace it or choose another --out"
            )

    def begin(self, scene: Scene, placement: Placement | None = None) -> None:
        """Take away what is replaced, and mark the folder as that of a run which goes on."""
        self.check(self.path, overwrite=self._overwrite)  # another process may have ended a run here in between
        placed = {} if placement is None else {"placement": placement.to_record()}
        written = {"format": FORMAT, "tissue": package_version(), "status": "running", "process": identity()}
        self._write_summary(written | {"scene": scene.name} | placed)
        for name in _run_files(self.path):
            if name != "summary.json":
                entry = self.path / name
                shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
        with whole_file(self.path / "scene.toml") as temporary:
            temporary.write_text(saved_text(scene) + _remark(placement), "utf-8")

    @contextmanager
    def ending(self) -> Iterator[None]:
        """Write to the summary what ended a block before its end, and let go of the folder then."""
        try:
            yield
        except BaseException as error:
            with suppress(OSError):  # such as a full disk: the run is then reported as one whose process is gone
                self.close_tables()
                self._stopped(error)
            self._lock.release()
            raise

    def _stopped(self, error: BaseException) -> None:
        """Mark a run that was begun as interrupted or failed."""
        if not self._summary:
            return
        if isinstance(error, KeyboardInterrupt):
            status, problem = "interrupted", error.name if isinstance(error, Terminated) else "Ctrl-C"
        else:
            kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
            status, problem = "failed", kind + " ".join(str(error).split())
        summary = {name: value for name, value in self._summary.items() if name != "process"}
        self._write_summary(summary | {"status": status, "problem": problem})

    def open_tables(self, trace: Table, timing: Table) -> None:
        """Start to write the trace and the timing."""
        self._write_summary(self._summary | {"layers": trace.layer_names})
        self._writers = [
            TraceWriter(self.path / "trace.csv", trace),
            TraceWriter(self.path / "timing.csv", timing),
        ]

    def flush(self, row_count: int, *, force: bool = False) -> None:
        """Bring the rows so far to disk if it is time."""
        for writer in self._writers:
            writer.flush(row_count, force=force)

    def close_tables(self) -> None:
        """Close the trace and the timing."""
        for writer in self._writers:
            writer.close()
        self._writers = []

    def interrupt(self, problem: str) -> None:
        """Mark a run that nobody wants to end as interrupted, and let go of the folder."""
        self.close_tables()
        summary = {name: value for name, value in self._summary.items() if name != "process"}
        self._write_summary(summary | {"status": "interrupted", "problem": problem})
        self._lock.release()

    def complete(self, summary: Summary) -> None:
        """Write the summary of a run whose files are all there, and let go of the folder."""
        self._write_summary(summary)
        self._lock.release()

    def _write_summary(self, summary: Summary) -> None:
        """Write ``summary.json`` at once: it is either the old one or the new one."""
        self._summary = summary
        with whole_file(self.path / "summary.json") as temporary:
            temporary.write_text(json.dumps(summary, indent=2) + "\n", "utf-8")


class SavedRun:
    """A run read back from its folder.

    Attributes
    ----------
    path
        The folder.
    summary
        Contents of ``summary.json``.
    status
        ``complete``, ``failed``, ``interrupted`` or ``running``; a run whose process is gone was interrupted.
    problem
        What ended a run that failed or was interrupted, empty where that is not known.
    scene
        The scene, None where its file is missing.
    trace
        The trace, up to the last whole row; None where its file is missing.

    Raises
    ------
    InputError
        If the folder holds no run, one of another version, or a damaged summary, scene or trace; a trace of a complete
        run that is shorter or longer than the run was is damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.summary: Summary = read_summary(self.path)
        self.status = _status_of(self.summary)
        self.problem = str(self.summary.get("problem", ""))
        kept, table = self.path / "scene.toml", self.path / "trace.csv"
        self.scene = load_scene(kept) if kept.is_file() else None
        self.trace = read_trace(table, tuple(self.summary.get("layers", ()))) if table.is_file() else None
        if self.complete and self.trace is not None:
            stated, found = round(self.summary["simulated_s"] / TICK_S), len(self.trace.rows)
            if found != stated:
                raise InputError(
                    f"trace.csv must hold {stated} ticks as in summary.json, got {found} in {table}: run the scene "
                    "again"
                )

    @property
    def complete(self) -> bool:
        """Whether the run came to its end."""
        return self.status == "complete"


def saved_placement(path: Path) -> Placement | None:
    """Where the frame of a run's scene lies in that of its bone and field files; None where they are the same.

    Raises
    ------
    InputError
        If the summary's placement is no rigid motion.
    """
    try:
        record = json.loads(require_regular(path / "summary.json").read_text("utf-8")).get("placement")
    except (OSError, ValueError, AttributeError):
        return None
    return None if record is None else Placement.from_record(record)


def _remark(placement: Placement | None) -> str:
    """Where the scene lies in the anatomy's file, as comments of TOML that pin the site where they are copied."""
    if placement is None:
        return ""
    values = {
        "centre_mm": placement.origin_mm,
        "normal": placement.rotation[:, 2],
        "along": placement.rotation[:, 0],
        "file_to_scene_mm": placement.file_to_scene_mm,
    }
    title = "# Where the scene lies in the anatomy's file; as keys of anatomy, the first three would fix it there:\n"
    return "\n" + title + "".join(f"# {name} = {array.tolist()}\n" for name, array in values.items())


def _run_files(path: Path) -> list[str]:
    """Entries of a folder that carry the names of a run's files."""
    if not path.is_dir():
        return []
    return sorted(entry.name for entry in path.iterdir() if entry.name in OWN_FILES)


def _status_of(summary: Summary) -> str:
    """Status of a run: that of its summary, but one that goes on has to have its process."""
    status = str(summary.get("status", "interrupted"))
    return status if status != "running" or is_alive(summary.get("process")) else "interrupted"
