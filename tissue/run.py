"""A finished run, and the folder it lives in."""

import json
import os
import platform
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.errors import InputError
from tissue.build import Parts
from tissue.formats import FORMATS
from tissue.scene import Scene
from tissue.trace import Table, TraceWriter, read_table

if TYPE_CHECKING:
    import pyvista

__all__ = ["DEADLINE_US", "Run", "RunFolder", "SavedRun"]

DEADLINE_US = 1000.0
"""A tick that takes longer misses its deadline [us]."""
FORMAT = 1
"""Version of the run folder."""
OWN_FILES = (
    "trace.csv",
    *(f"trace.{kind}" for kind in FORMATS),
    "timing.csv",
    "scene.toml",
    "summary.json",
    "summary.json.part",
    "bone.vti",
    "bone.nrrd",
    "bone.stl",
    "bone.vtp",
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
        part = self.path / "summary.json.part"
        part.write_text(json.dumps(summary, indent=2) + "\n", "utf-8")
        os.replace(part, self.path / "summary.json")


class Run:
    """A simulated run in memory.

    Attributes
    ----------
    scene
        What was simulated.
    trace, timing
        One row a tick; columns by name, ``run.trace["force_z_N"]``.
    """

    def __init__(
        self, scene: Scene, parts: Parts, trace: Table, timing: Table, *, compute: str, folder: RunFolder | None
    ) -> None:
        self.scene, self.parts, self.trace, self.timing = scene, parts, trace, timing
        self._compute, self._folder = compute, folder
        self._fraction: NDArray[np.uint8] | None = None

    @property
    def remaining(self) -> NDArray[np.uint8]:
        """Bone left in every voxel, 255 = full, uint8, shape (nx, ny, nz)."""
        if self._fraction is None:
            left = self.parts.tissue.remaining()
            self._fraction = self.parts.volume.fraction if left is None else left
        return self._fraction

    def summary(self) -> dict[str, Any]:
        """Figures of the run: volumes per layer, forces, tick cost, deadlines, notes, machine."""
        trace, tissue = self.trace, self.parts.tissue
        contact = trace["contact_mm2"] > 0.0
        force = np.linalg.norm(trace.vectors("model_force", "N"), axis=1)
        torque = np.linalg.norm(trace.vectors("model_torque", "Nm"), axis=1)
        mean = lambda values: float(values[contact].mean()) if contact.any() else 0.0  # noqa: E731
        ticks = self.timing["tick_us"]
        return {
            "format": FORMAT,
            "status": "complete",
            "scene": self.scene.name,
            "layers": list(trace.layer_names),
            "simulated_s": len(trace.rows) * 1e-3,
            "start_mm3": dict(zip(trace.layer_names, (tissue.start_m3 * 1e9).tolist(), strict=True)),
            "removed_mm3": dict(zip(trace.layer_names, (tissue.removed_m3 * 1e9).tolist(), strict=True)),
            "force_N": {"peak": float(force.max()), "mean_in_contact": mean(force)},
            "torque_Nm": {"peak": float(torque.max()), "mean_in_contact": mean(torque)},
            "tick_us": {
                "median": float(np.median(ticks)),
                "p99": float(np.percentile(ticks, 99)),
                "max": float(ticks.max()),
            },
            "missed_deadlines": int((ticks > DEADLINE_US).sum()),
            "compute": self._compute,
            "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, Python "
            f"{platform.python_version()}",
            "notes": self.parts.notes,
        }

    def dataset(self) -> "pyvista.ImageData":
        """The bone as a pyvista image in mm: cell arrays start and remaining (255 = full), layer, density_kg_m3."""
        import pyvista

        volume = self.parts.volume
        image = pyvista.ImageData(
            dimensions=np.array(volume.shape) + 1,
            spacing=(volume.spacing_m * 1e3,) * 3,
            origin=volume.origin_m * 1e3,
        )
        image.cell_data["start"] = volume.fraction.ravel(order="F")
        image.cell_data["remaining"] = self.remaining.ravel(order="F")
        image.cell_data["layer"] = volume.layer.ravel(order="F")
        image.cell_data["density_kg_m3"] = volume.density_kg_m3.ravel(order="F")
        image.field_data["layer_names"] = list(volume.layer_names)
        return image

    def save(
        self,
        out: str | Path,
        *,
        formats: Iterable[str] = (),
        pictures: bool = True,
        overwrite: bool = False,
        progress: Any = None,
    ) -> Path:
        """Write the run's folder; see the README for its files.

        Parameters
        ----------
        out
            Folder to write.
        formats
            Further formats of the trace: parquet, npz, mat, h5.
        pictures
            Whether to draw pictures.
        overwrite
            Replace a run that the folder already holds.
        progress
            Told what is being done.

        Raises
        ------
        InputError
            If the folder holds another run or a format is unknown.
        """
        from tissue.formats import check_formats, write_trace
        from tissue.report import draw_pictures, write_bone

        tell = progress or (lambda doing, share: None)
        formats = tuple(formats)
        check_formats(formats)
        out = Path(out)
        folder = self._folder
        if folder is None or folder.path != out:
            folder = RunFolder.begin(out, self.scene, overwrite=overwrite)
            folder.open_tables(self.trace, self.timing)
            folder.flush(len(self.trace.rows), force=True)
        folder.close()
        for kind in formats:
            write_trace(self.trace, out, kind)
        tell("writing the bone", 0.0)
        write_bone(self, out)
        if pictures:
            tell("drawing pictures", 0.0)
            for note in draw_pictures(self, out / "pictures"):
                self.parts.notes["pictures"] = note
        folder.write_summary(self.summary())
        return out


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
