"""Result of a simulation, or of reading a folder of a run, with the same interface."""

import os
import platform
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from meshes.base.arrays import Array, Bytes
from meshes.base.errors import InputError
from meshes.base.hints import suggests_arguments
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import package_version
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.models.tissue_model import TICK_S, HasHeat, HasSummary, HasVoxels
from tissue.motion.motion import Events
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.builders.parts import Parts
from tissue.simulation.run_folder import (
    FORMAT,
    RunFolder,
    SavedRun,
    Summary,
    added_to_run,
    copy_run,
    picture_format,
)
from tissue.simulation.scheduling import Scheduling
from tissue.simulation.trace import Table, check_format, read_table

if TYPE_CHECKING:
    import pyvista

    from tissue.models.bone.carver import CarvingReplay

DEADLINE_US = 1000.0
"""Duration of a tick above which it misses its deadline [us]."""
Part = TypeVar("Part")


@suggests_arguments
class Run:
    """Run that was just simulated, or read from a folder by `load`.

    If a run is read from a folder, its data are read when they are first used. If the folder does
    not contain the data, an `InputError` is raised.

    Parameters
    ----------
    scene
        Simulated scene.
    parts
        Objects that simulated the scene, such as the motion and the tissue model.
    trace, timing
        Tables with one row per tick; columns are keyed by name: ``run.trace["force_z_N"]``.
    events
        Events of the run, each with a time [s] and a sentence.
    poses
        Poses of a cutting tool, see `tissue.simulation.loop.PoseLog`; None for other tools.
    compute
        Warp device.

    Attributes
    ----------
    path
        Folder of the run; None before it is saved.
    scheduling
        Data on kernel launches, background work and scheduling gaps (times in which the system did
        not run the thread); None if these data were not recorded.
    draw
        Function that draws the pictures of the run into a folder in a given format, and returns a
        sentence for each picture that could not be drawn. `tissue.simulate` sets this attribute.
    findings
        Findings of the run, as entries of its summary, see `tissue.simulation.findings`.
    """

    path: Path | None = None
    scheduling: Scheduling | None = None
    draw: "Callable[[Run, Path, str], list[str]] | None" = None
    begun: RunFolder | None = None
    """Folder that received the trace during the run; None after the run was saved there."""
    _saved: SavedRun | None = None
    _compute = "cpu"

    def __init__(
        self,
        scene: Scene,
        parts: Parts,
        trace: Table,
        timing: Table,
        *,
        events: Events,
        poses: Array | None = None,
        compute: str = "cpu",
    ) -> None:
        self.scene = scene
        self.parts = parts
        self.trace = trace
        self.timing = timing
        self.events = events
        self.poses = poses
        self.findings: Summary = {}
        self._compute = compute

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a run from its folder.

        Parameters
        ----------
        path
            Folder of a run, which may have been stopped early.

        Raises
        ------
        InputError
            If the folder holds no run, a run of another version, or a damaged run.
        """
        run = cls.__new__(cls)
        run._saved = SavedRun(path)
        run.path = run._saved.path
        return run

    @cached_property
    def scene(self) -> Scene:
        """Simulated scene."""
        return self._required(self._files.scene, "scene.toml")

    @cached_property
    def trace(self) -> Table:
        """Trace with one row per tick; columns are keyed by name: ``run.trace["force_z_N"]``."""
        return self._required(self._files.trace, "trace.csv")

    @cached_property
    def timing(self) -> Table:
        """Duration of each tick and its stages [µs], keyed by name: ``run.timing["tick_us"]``."""
        file = self._files.path / "timing.csv"
        return self._required(read_table(file, ()) if file.is_file() else None, file.name)

    @cached_property
    def events(self) -> Events:
        """Events of the run, each with a time [s] and a sentence."""
        return [
            (float(each["time_s"]), each["what"]) for each in self._files.summary.get("events", ())
        ]

    @cached_property
    def parts(self) -> Parts:
        """Objects that simulated the scene; not available for a run that was read from a folder."""
        raise InputError(
            "run",
            "be simulated in this process, because a folder does not contain its parts",
            f"the folder {self._files.path}",
            "run the scene again",
        )

    @cached_property
    def poses(self) -> Array | None:
        """Poses of a cutting tool, see `tissue.simulation.loop.PoseLog`; None for other tools."""
        return self._voxels[2] if (self._files.path / "bone.vti").is_file() else None

    @property
    def status(self) -> str:
        """Status of the run: ``complete``, ``failed``, ``interrupted`` or ``running``."""
        return str(self.summary["status"])

    @property
    def problem(self) -> str:
        """Cause of a failed or interrupted run; empty for a complete run or an unknown cause."""
        return str(self.summary.get("problem", ""))

    @property
    def volume(self) -> VoxelVolume:
        """Voxels before the first cut; `InputError` if the tissue has no voxels."""
        if self._saved is not None:
            return self._voxels[0]
        if self.parts.volume is None:
            raise InputError(
                "run",
                "have voxels",
                f"a run with anatomy.kind = {self.scene.anatomy.kind}",
                "use the trace and the fields of this run",
            )
        return self.parts.volume

    @cached_property
    def remaining(self) -> Bytes:
        """Bone left in each voxel (255 = full), uint8, shape (nx, ny, nz); see `volume`."""
        if self._saved is not None:
            return self._voxels[1]
        tissue = self.parts.tissue
        return tissue.remaining() if isinstance(tissue, HasVoxels) else self.volume.fraction

    @property
    def cutter(self) -> Cutter:
        """Cutter of the run; `InputError` if the tool cuts nothing."""
        from tissue.simulation.builders.cutting import cutter_of

        tool = self.scene.tool
        if not isinstance(tool, Tool):
            raise InputError(
                "run",
                "have a cutter",
                f"a run with a {tool.kind}",
                "use the trace and the fields of this run",
            )
        return cutter_of(tool)

    def replay(self) -> "CarvingReplay":
        """Return a replay of the carving, which gives the bone at any tick.

        The method raises `InputError` if the tool cuts nothing.
        """
        import warp

        from tissue.models.bone.carver import CarvingReplay

        if self.poses is None:
            got = f"{self.path} without poses" if self._saved is not None else self.scene.tool.kind
            raise InputError(
                "run", "have a tool that cuts", got, "use the trace and the fields of this run"
            )
        device = self._compute
        if self._saved is not None:
            recorded = str(self.summary.get("compute"))
            # This machine may not have the Warp device of the run.
            device = recorded if recorded in map(str, warp.get_devices()) else "cpu"
        removal = self.scene.voxels.removal
        return CarvingReplay(self.volume, self.cutter, self.poses, removal=removal, device=device)

    @property
    def summary(self) -> Summary:
        """Results of the run, with the same entries as ``summary.json``.

        The entries include removed volumes, forces, durations of ticks, missed deadlines,
        scheduling and notes.
        """
        if self._saved is not None:
            return self._saved.summary | {"status": self._saved.status}
        trace = self.trace
        tissue = self.parts.tissue
        found: Summary = {
            "format": FORMAT,
            "tissue": package_version(),
            "status": "complete",
            "scene": self.scene.name,
            "layers": list(trace.layer_names),
            "simulated_s": len(trace.rows) * 1e-3,
            "cuts": self.parts.cutter is not None,
        }
        for name, volumes_m3 in (
            ("start_mm3", tissue.start_m3),
            ("removed_mm3", tissue.removed_m3),
        ):
            found[name] = dict(zip(trace.layer_names, (volumes_m3 * 1e9).tolist(), strict=True))
        found |= load_figures(trace)
        found |= self._timing_figures()
        if self.parts.keep_clear is not None:
            found["keep_clear"] = self.parts.keep_clear.summary()
        end = self.parts.region_end
        if end is not None and end.left_s is not None:
            found["left_region_s"] = end.left_s
        found |= self.findings
        if isinstance(tissue, HasHeat) and (heat_J := tissue.heat_balance_J) is not None:
            found["heat_J"] = heat_J
        if limit := self.parts.motion.feed_limit:
            found["feed_limit"] = limit
        if isinstance(tissue, HasSummary):
            found |= tissue.summary()
        found["events"] = [{"time_s": time, "what": what} for time, what in self.events]
        found["compute"] = self._compute
        scale = chosen_scale(self.scene)
        if self.scene.device is not None:
            found["force_scale"] = scale.factor
        if scale.d_prime is not None:
            found["expected_d_prime"] = scale.d_prime
        if self.parts.placement is not None:
            found["placement"] = self.parts.placement.to_record()
        machine = f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}"
        found["machine"] = f"{machine}, Python {platform.python_version()}"
        found["notes"] = self.parts.notes
        return found

    def _timing_figures(self) -> Summary:
        """Return the summary's entries about tick times, missed deadlines and scheduling."""
        ticks = self.timing["tick_us"]
        late = np.zeros(len(ticks))
        exposed_s = 1e-6 * float(ticks.sum())
        by_clock: Summary = {}
        if "late_us" in self.timing:
            # Only runs that follow the wall clock have lateness.
            late = self.timing["late_us"]
            exposed_s = len(ticks) * TICK_S
            by_clock = {
                "late_us": _spread(late),
                "skipped_ms": 1e-3 * float(self.timing["skipped_us"].sum()),
            }
        missed = int((ticks + late > DEADLINE_US).sum())
        scheduling = {} if self.scheduling is None else self.scheduling.summary(ticks_s=exposed_s)
        return {"tick_us": _spread(ticks), "missed_deadlines": missed, **by_clock, **scheduling}

    def dataset(self) -> "pyvista.ImageData | pyvista.UnstructuredGrid":
        """Return the tissue as a pyvista data set, in the frame of the scene [mm].

        For a tissue of voxels, the data set is an image with the cell arrays ``start`` and
        ``remaining`` (255 = full), ``layer`` and ``density_kg_m3``. For a tissue of finite
        elements, the data set is the mesh of the last frame with its fields.

        Raises
        ------
        InputError
            If the tissue has neither voxels nor finite elements.
        """
        from tissue.simulation.bone_files import voxel_image
        from tissue.simulation.saved_fields import SavedFields, field_names, require_whole
        from tissue.simulation.vtk_files import frame_mesh

        if self._saved is not None:
            path = self._saved.path
            if not (path / "bone.vti").is_file() and field_names(path):
                require_whole(self._saved)
                mesh: pyvista.UnstructuredGrid = SavedFields(path).frames[-1]
                return mesh
        elif (
            self.parts.volume is None and self.parts.fields is not None and self.parts.fields.frames
        ):
            return frame_mesh(self.parts.fields, self.parts.fields.frames[-1])
        return voxel_image(self.volume, self.remaining)

    def discard(self, why: str) -> None:
        """Release a run that will not be saved, and mark the run in its folder as interrupted."""
        if self.begun is not None:
            self.begun.interrupt(why)

    def save(
        self,
        out: str | Path,
        *,
        formats: Iterable[str] = (),
        pictures: bool | str = True,
        overwrite: bool = False,
        progress: Progress | None = None,
    ) -> Path:
        """Write the run into a folder.

        The page docs/files.md describes the files. If the run was read from a folder, its files are
        copied.

        Parameters
        ----------
        out
            Folder into which the run is written.
        formats
            Additional formats: ``parquet``, ``npz``, ``mat`` or ``h5`` for the trace; ``recording``
            for the run in the layout of volumetric_drilling.
        pictures
            Whether to write pictures, or their format: png, svg or pdf. For a run that was read
            from a folder, the existing pictures are copied.
        overwrite
            Whether to replace a run that the folder already holds.
        progress
            Function that is called with the name of the current work.

        Raises
        ------
        InputError
            If the folder holds another run, or a format is unknown.
        """
        formats = tuple(formats)
        for kind in formats:
            check_format(kind)
        picture_kind = picture_format(pictures)
        if self._saved is None:
            self._write(
                Path(out), formats, picture_kind, overwrite=overwrite, report=progress or silent
            )
            return Path(out)
        if isinstance(pictures, str) and not list(
            (self._saved.path / "pictures").glob(f"*.{picture_kind}")
        ):
            raise InputError(
                "pictures",
                "have the format of the saved pictures, because a saved run is not drawn again",
                f"{picture_kind} for {self._saved.path}",
                f"use `tissue run SCENE --pictures {picture_kind}`",
            )
        copy_run(self._saved, Path(out), pictures=picture_kind is not None, overwrite=overwrite)
        if formats:
            from tissue.simulation.recording import write_formats

            with added_to_run(Path(out)):
                write_formats(self, Path(out), formats)
        return Path(out)

    def _write(
        self,
        out: Path,
        formats: tuple[str, ...],
        picture_kind: str | None,
        *,
        overwrite: bool,
        report: Progress,
    ) -> None:
        """Write the folder of a simulated run, or complete the folder that the run has begun."""
        from tissue.simulation.bone_files import write_bone, write_carving
        from tissue.simulation.recording import write_formats
        from tissue.simulation.vtk_files import write_fields

        folder = self.begun
        goes_on = folder is not None and folder.path.resolve() == out.resolve()
        if folder is None or not goes_on:
            folder = RunFolder(out, overwrite=overwrite)
        else:
            self.begun = None  # a folder that was saved once may be replaced by another run
        with folder.ending():
            if not goes_on:
                folder.begin(self.scene, self.parts.placement)
                folder.open_tables(self.trace, self.timing)
                folder.flush(len(self.trace.rows), force=True)
            folder.close_tables()
            write_formats(self, out, formats)
            report("writing the bone", 0.0)
            write_bone(self, out)
            write_carving(self, out, report=report)
            fields = self.parts.fields
            if fields is not None and fields.frames:
                report("writing the fields", 0.0)
                write_fields(fields, out, self.parts.placement)
            if picture_kind is not None and self.draw is not None:
                report("drawing pictures", 0.0)
                notes = self.draw(self, out / "pictures", picture_kind)
                if notes:
                    self.parts.notes["pictures"] = "; ".join(notes)
            folder.complete(self.summary)

    @property
    def _files(self) -> SavedRun:
        assert self._saved is not None
        return self._saved

    @cached_property
    def _voxels(self) -> tuple[VoxelVolume, Bytes, Array | None]:
        from tissue.simulation.bone_files import saved_voxels

        return saved_voxels(self._files)

    def _required(self, part: Part | None, name: str) -> Part:
        """Return data that were read from the folder; raise an error if the data are missing."""
        if part is None:
            raise InputError(
                "run", f"contain {name}", f"{self._files.path} without it", "run the scene again"
            )
        return part


def load_figures(trace: Table) -> dict[str, dict[str, float]]:
    """Return the peak of force [N] and torque [N m], and the mean of both during contact.

    The trace must have at least one row.
    """
    found = {}
    contact = trace["contact_mm2"] > 0.0
    for name, unit in (("force", "N"), ("torque", "Nm")):
        size = np.linalg.norm(trace.vectors(f"model_{name}", unit), axis=1)
        mean = float(size[contact].mean()) if contact.any() else 0.0
        found[f"{name}_{unit}"] = {"peak": float(size.max()), "mean_in_contact": mean}
    return found


def _spread(values: Array) -> dict[str, Any]:
    """Return median, 99th percentile and maximum of values."""
    return {
        "median": float(np.median(values)),
        "p99": float(np.percentile(values, 99)),
        "max": float(values.max()),
    }
