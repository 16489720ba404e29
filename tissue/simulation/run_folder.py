"""Folder of a run: writing of the folder during the run, and reading of its files."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from meshes.base.errors import InputError, counted, is_file
from meshes.base.file_limits import require_regular
from meshes.base.hints import closest, did_you_mean
from meshes.base.placement import Placement
from meshes.base.text_tables import read_json
from meshes.base.whole_file import package_version, require_version, whole_file, write_text
from tissue.models.tissue_model import TICK_S
from tissue.scene.anatomy import BlockImage, Tooth
from tissue.scene.load import full_key, load_scene, saved_text
from tissue.scene.registry import ANATOMIES, TABLES
from tissue.scene.scene import Scene
from tissue.simulation.trace import FORMATS, Table, TraceWriter, read_trace
from tissue.system.owned_folder import (
    LOCK,
    OwnedFolder,
    identity,
    is_alive,
    listed_files,
    require_folder,
)
from tissue.system.stopping import Terminated, signal_behind

Summary = dict[str, Any]
"""Contents of ``summary.json``; see docs/files.md."""
FORMAT = 1
"""Version of the format of run folders."""
AGAIN = "run the scene again"
PICTURE_FORMATS = ("png", "svg", "pdf")
FILES = (
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
    "carving/poses.npz",
    "carving/rest.vtp",
    f"carving/frame_{4 * '[0-9]'}.vtp",
    "fields.pvd",
    f"fields/frame_{4 * '[0-9]'}.vtu",
    "band.csv",
    "band/samples.csv",
    *(f"band/sample_{digits * '[0-9]'}.toml" for digits in range(1, 7)),
    "report.html",
)
"""Names of the files of a run in its folder, without the pictures."""
PICTURES = (
    "band",
    "band_sobol",
    "bone_before_after",
    "force_depth",
    "force_torque",
    "held",
    "insertion",
    "played",
    "press",
    "removed_depth",
    "section",
    "wall",
)
"""Names of pictures that any run may write; an anatomy may have additional pictures."""


class _Entries(BaseModel):
    """Base class for the validation of a part of a summary."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class _Event(_Entries):
    """Event of a run in a summary."""

    time_s: float
    what: str


class _Load(_Entries):
    """Peak and mean of force or torque in a summary."""

    peak: float


class _WrittenSummary(_Entries):
    """Entries of every summary, and optional entries with default values."""

    scene: str
    status: Literal["running", "complete", "interrupted", "failed"]
    layers: list[str] = []
    events: list[_Event] = []

    @field_validator("layers")
    @classmethod
    def _differ(cls, layers: list[str]) -> list[str]:
        if len(set(layers)) < len(layers):
            raise ValueError("equal names")
        return layers


class _CompleteSummary(_WrittenSummary):
    """Additional entries in the summary of a complete run."""

    simulated_s: float
    force_N: _Load
    torque_Nm: _Load


def run_file_names() -> tuple[str, ...]:
    """Return the names of all files that a run may write; ``[0-9]`` stands for a digit."""
    added = {Path(name).stem for kind in ANATOMIES.known for name in ANATOMIES[kind].pictures}
    stems = sorted({*PICTURES, *added})
    return (*FILES, *(f"pictures/{stem}.{kind}" for stem in stems for kind in PICTURE_FORMATS))


def picture_format(pictures: bool | str) -> str | None:
    """Return the format of pictures: the given format, PNG if `pictures` is True, None if False.

    Raises
    ------
    InputError
        If the format is not one of `PICTURE_FORMATS`.
    """
    if isinstance(pictures, bool):
        return PICTURE_FORMATS[0] if pictures else None
    if pictures not in PICTURE_FORMATS:
        raise InputError(
            "pictures", f"be one of {', '.join(PICTURE_FORMATS)}", pictures, "choose one of these"
        )
    return pictures


class RunFolder:
    """Folder into which a run is written; other processes cannot write into it during the run.

    An error is raised for a folder that holds another run, unless `overwrite` is set. The marker
    file of a folder lists the files that a run wrote. Only these files are replaced or removed. An
    error is also raised if the run would overwrite another file. `begin` is the first method that
    changes the folder.

    Parameters
    ----------
    path
        The folder.
    overwrite
        Whether to replace a run that the folder already holds.

    Raises
    ------
    InputError
        If the folder holds another run, holds files that no run wrote, or is locked by another
        process.
    """

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        self._owned = OwnedFolder(path, "run", run_file_names(), overwrite=overwrite)
        self.path = path
        self._writers: list[TraceWriter] = []
        self._summary: Summary = {}

    @staticmethod
    def check(path: Path, *, overwrite: bool) -> None:
        """Raise an error if a run cannot be written into a folder."""
        require_folder(path, "run", run_file_names(), overwrite=overwrite)

    def begin(self, scene: Scene, placement: Placement | None = None) -> None:
        """Remove the files of a replaced run, and record in the folder that a run has begun."""
        self._owned.begin()
        placed = {} if placement is None else {"placement": placement.to_record()}
        written = {
            "format": FORMAT,
            "tissue": package_version(),
            "status": "running",
            "process": identity(),
        }
        self._write_summary(written | {"scene": scene.name} | placed)
        write_text(self.path / "scene.toml", saved_text(scene) + _remark(scene, placement))

    @contextmanager
    def ending(self) -> Iterator[None]:
        """Enter a ``with`` block; if an error ends it, write the cause to the summary.

        After an error, the folder is also released.
        """
        try:
            yield
        except BaseException as error:
            # If this fails, for example on a full disk, the run later counts as a run without a
            # process.
            with suppress(OSError):
                self.close_tables()
                self._stopped(signal_behind(error))
            self._owned.release()
            raise

    def _stopped(self, error: BaseException) -> None:
        """Mark the run as interrupted or failed, if it has begun."""
        if not self._summary:
            return
        if isinstance(error, KeyboardInterrupt):
            self._end("interrupted", error.name if isinstance(error, Terminated) else "Ctrl-C")
        else:
            kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
            self._end("failed", kind + " ".join(str(error).split()))

    def _end(self, status: str, problem: str) -> None:
        """Write the cause of an early end to the summary."""
        summary = {name: value for name, value in self._summary.items() if name != "process"}
        self._write_summary(summary | {"status": status, "problem": problem})

    def open_tables(self, trace: Table, timing: Table) -> None:
        """Start to write trace and timing."""
        self._write_summary(self._summary | {"layers": trace.layer_names})
        self._writers = [
            TraceWriter(self.path / "trace.csv", trace),
            TraceWriter(self.path / "timing.csv", timing),
        ]

    def flush(self, row_count: int, *, force: bool = False) -> None:
        """Write the rows so far to disk; do nothing if the last write was recent."""
        for writer in self._writers:
            writer.flush(row_count, force=force)

    def close_tables(self) -> None:
        """Close the trace and the timing."""
        for writer in self._writers:
            writer.close()
        self._writers = []

    def interrupt(self, problem: str) -> None:
        """Mark a discarded run as interrupted and release the folder."""
        self.close_tables()
        self._end("interrupted", problem)
        self._owned.release()

    def complete(self, summary: Summary) -> None:
        """Write the summary of a complete run and release the folder."""
        self._write_summary(summary)
        self._owned.release()

    def _write_summary(self, summary: Summary) -> None:
        """Write ``summary.json`` atomically."""
        self._summary = summary
        write_text(self.path / "summary.json", json.dumps(summary, indent=2) + "\n")


class SavedRun:
    """Files of a run, read from its folder.

    Attributes
    ----------
    path
        The folder.
    summary
        Contents of ``summary.json``.
    status
        ``complete``, ``failed``, ``interrupted`` or ``running``. A running run whose process no
        longer exists counts as interrupted.
    problem
        Cause of a failed or interrupted run; empty if it is not known.
    scene
        Scene of the run; None if its file is missing.
    trace
        Trace with all rows that were written completely; None if its file is missing.

    Raises
    ------
    InputError
        If the folder holds no run, a run of another version, or a damaged summary, scene or trace.
        The error is also raised if the run used a user-defined object that is not registered, such
        as a hand. The trace of a complete run counts as damaged if its number of rows does not
        agree with the duration of the run.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.summary: Summary = read_summary(self.path)
        self.status = str(self.summary.get("status", "interrupted"))
        if self.status == "running" and not is_alive(self.summary.get("process")):
            self.status = "interrupted"
        self.problem = str(self.summary.get("problem", ""))
        kept = self.path / "scene.toml"
        table = self.path / "trace.csv"
        self.scene = _saved_scene(kept) if kept.is_file() else None
        self.trace = (
            read_trace(table, tuple(self.summary.get("layers", ()))) if table.is_file() else None
        )
        if self.complete and self.trace is not None:
            stated = round(self.summary["simulated_s"] / TICK_S)
            found = len(self.trace.rows)
            if found != stated:
                raise InputError(
                    "trace.csv",
                    f"have {stated} rows, the ticks that summary.json states",
                    f"{found} in {table}",
                    "run the scene again",
                )

    @property
    def complete(self) -> bool:
        """True if the run is complete."""
        return self.status == "complete"


def _saved_scene(file: Path) -> Scene:
    """Load the scene of a saved run.

    If a user-defined object in the scene is not registered, the error names the object and the run.
    """
    try:
        return load_scene(file)
    except InputError as error:
        keys = {full_key(part.key, "name") for parts in TABLES.values() for part in parts}
        if error.argument not in keys or not error.requirement.startswith("be one of"):
            raise
        raise InputError(
            f"{error.argument} = {error.value} of the run in {file.parent} is not registered here. "
            "Register it in the same script, or install the package that provides it"
        ) from error


def saved_placement(path: Path) -> Placement | None:
    """Return the pose of the scene in the frame in which a run wrote its bone and field files.

    The result is None if the files are in the frame of the scene.

    Raises
    ------
    InputError
        If the placement in the summary is not a rigid motion.
    """
    record = summary_of(path).get("placement")
    return None if record is None else Placement.from_record(record)


def _remark(scene: Scene, placement: Placement | None) -> str:
    """Return TOML comments with the pose of the scene in the frame of the anatomy's file.

    If the anatomy has keys for its site, a user can copy three of the comments into the scene to
    keep this site.
    """
    if placement is None:
        return ""
    values = {
        "centre_mm": placement.origin_mm,
        "normal": placement.rotation[:, 2],
        "along": placement.rotation[:, 0],
        "file_to_scene_mm": placement.file_to_scene_mm,
    }
    use = "No keys of [anatomy] set this pose."
    is_whole = isinstance(scene.anatomy, BlockImage) and scene.anatomy.is_whole
    if "centre_mm" in type(scene.anatomy).model_fields and not is_whole:
        use = "As keys of [anatomy], the first three fix this pose."
    elif isinstance(scene.anatomy, Tooth):
        use = "It follows from the tooth, and no keys of [anatomy] set it."
    title = f"# Pose of the scene in the anatomy's file. {use}\n"
    return (
        "\n" + title + "".join(f"# {name} = {array.tolist()}\n" for name, array in values.items())
    )


def added_to_run(path: Path) -> OwnedFolder:
    """Return a context manager that allows changes of the files of a finished run.

    The folder is locked during the ``with`` block.
    """
    return OwnedFolder(path, "run", (), shared=run_file_names())


def copy_run(saved: SavedRun, out: Path, *, pictures: bool, overwrite: bool) -> None:
    """Copy the files of a finished run into another folder.

    If the target is the folder of the run itself, nothing is copied.

    Raises
    ------
    InputError
        If the run is still running, or the folder holds another run.
    """
    if out.exists() and out.samefile(saved.path):
        return
    if saved.status == "running":
        raise InputError(
            "run",
            "be finished before it is copied",
            f"{saved.path}, which is still running",
            "wait until the run ends",
        )
    written = listed_files(saved.path).get("run")
    if written is None:
        # In a folder without a marker file, the files are recognised by their names.
        there = [each for name in run_file_names() for each in saved.path.glob(name)]
        written = {
            each.relative_to(saved.path).as_posix() for each in there if not each.is_symlink()
        }
    with OwnedFolder(out, "run", run_file_names(), overwrite=overwrite):
        for name in sorted(written):
            is_left_out = not pictures and name.startswith("pictures/")
            if is_left_out or not (saved.path / name).is_file():
                continue
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            with whole_file(out / name) as temporary:
                shutil.copyfile(saved.path / name, temporary)


def summary_of(folder: Path) -> Summary:
    """Return the summary in a folder without validating it; empty if it is missing or invalid."""
    return _table_of(folder) or {}


def _no_run(folder: Path) -> InputError:
    """Return the error for a folder that holds no run."""
    try:
        inside = sorted(each.parent for each in folder.glob("*/summary.json"))
        near = [each.name for each in folder.parent.iterdir()]
    except OSError:
        inside = []
        near = []
    if inside:
        got = f"{folder}, which contains {counted(len(inside), 'run')}"
        return InputError("run", "be the folder of one run", got, f"use {inside[0]}")
    if not folder.exists():
        got = f"{folder}{did_you_mean(closest(folder.name, near))}"
        return InputError("run", "be an existing folder", got, "check the path")
    if (folder / LOCK).exists():
        return InputError(
            f"the run in {folder} has not begun: `tissue run` is preparing it, or was ended before "
            "the first tick. Wait for it, or run the scene again"
        )
    return InputError(
        "run", "be a folder that `tissue run` wrote", folder, "give for example runs/glenoid"
    )


def read_summary(folder: Path) -> Summary:
    """Read the summary of a run and validate its version and entries.

    Raises
    ------
    InputError
        If the folder holds no run, or the summary is damaged or of another version.
    """
    path = folder / "summary.json"
    if not is_file(path):
        raise _no_run(folder)
    held = _table_of(folder)
    if not held:
        got = "other content" if held is None else "an empty table"
        raise InputError("summary.json", "be a table in JSON", f"{got} in {path}", AGAIN)
    require_version("summary.json", held, FORMAT, where=path, remedy=AGAIN)
    kind = _CompleteSummary if held.get("status") == "complete" else _WrittenSummary
    try:
        kind.model_validate(held)
    except ValidationError as error:
        name = str(error.errors()[0]["loc"][0])
        raise InputError(
            "summary.json",
            f"have a valid entry {name}",
            # A wrong entry may be long, so the message is cut.
            f"{str(held.get(name, 'no such entry'))[:60]} in {path}",
            AGAIN,
        ) from None
    return held


def _table_of(folder: Path) -> Summary | None:
    """Return the summary of a folder without checks; None if it is missing or invalid."""
    try:
        held = read_json(require_regular(folder / "summary.json").read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return held if isinstance(held, dict) else None
