"""A finished run."""

import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.file_version import package_version
from meshes.base.progress import Progress, silent
from meshes.voxels.volume import VoxelVolume
from tissue.builders.parts import Parts
from tissue.cutters.cutter import Cutter
from tissue.models.tissue_model import TICK_S, HasHeat, HasSummary, HasVoxels
from tissue.scene.scene import Scene
from tissue.simulation.break_through import BreakThrough
from tissue.simulation.run_folder import RunFolder
from tissue.simulation.run_summary import FORMAT, Summary
from tissue.simulation.scheduling import Scheduling
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pyvista

    from tissue.models.bone.replay import CarvingReplay

__all__ = ["DEADLINE_US", "Run"]

DEADLINE_US = 1000.0
"""A tick that takes longer misses its deadline [us]."""


class Run:
    """A simulated run in memory.

    Attributes
    ----------
    scene
        What was simulated.
    trace, timing
        One row a tick; columns by name, ``run.trace["force_z_N"]``.
    events
        What happened in the run: time [s] and a sentence each.
    poses
        Poses of a tool that cuts, see `tissue.simulation.tick.PoseLog`; None of one that does not.
    scheduling
        What was chosen for launches and background work, and how late the machine was; None where nobody recorded it.
    draw
        Draws the run's pictures into a folder in a format and returns a sentence for each that could not be drawn; the
        engine by itself draws nothing, `tissue.simulate` sets it.
    """

    def __init__(
        self,
        scene: Scene,
        parts: Parts,
        trace: Table,
        timing: Table,
        *,
        events: list[tuple[float, str]],
        compute: str,
        folder: RunFolder | None,
        poses: NDArray[np.float64] | None = None,
    ) -> None:
        self.scene, self.parts, self.trace, self.timing, self.events = scene, parts, trace, timing, events
        self._compute, self._folder, self.poses = compute, folder, poses
        self._fraction: NDArray[np.uint8] | None = None
        self.scheduling: Scheduling | None = None
        self.break_throughs: list[BreakThrough] = []
        self.draw: Callable[[Run, Path, str], list[str]] | None = None

    @property
    def volume(self) -> VoxelVolume:
        """The voxels before the first cut.

        Raises
        ------
        InputError
            If the tissue has none.
        """
        if self.parts.volume is None:
            raise InputError(f"run must have voxels, got a {self.scene.anatomy.kind}: see its trace and fields")
        return self.parts.volume

    @property
    def cutter(self) -> Cutter:
        """The cutter; raises as `volume`."""
        if self.parts.cutter is None:
            raise InputError(f"run must have a cutter, got a {self.scene.tool.kind}: see its trace and fields")
        return self.parts.cutter

    @property
    def remaining(self) -> NDArray[np.uint8]:
        """Bone left in every voxel, 255 = full, uint8, shape (nx, ny, nz); raises as `volume`."""
        if self._fraction is None:
            tissue = self.parts.tissue
            self._fraction = tissue.remaining() if isinstance(tissue, HasVoxels) else self.volume.fraction
        return self._fraction

    def discard(self, why: str) -> None:
        """Let go of a run that is not to be saved; the folder that took its rows holds them as an interrupted one."""
        if self._folder is not None:
            self._folder.interrupt(why)

    def replay(self) -> "CarvingReplay":
        """The carving once more, for the bone at any tick: ``run.replay().at(tick)``.

        Raises
        ------
        InputError
            If nothing was cut.
        """
        from tissue.models.bone.replay import CarvingReplay

        if self.poses is None:
            raise InputError(f"run must have a tool that cuts, got {self.scene.tool.kind}: see its trace and fields")
        removal = self.scene.voxels.removal
        return CarvingReplay(self.volume, self.cutter, self.poses, removal=removal, device=self._compute)

    @property
    def summary(self) -> Summary:
        """Figures of the run: volumes per layer, forces, tick cost, deadlines, scheduling, notes, machine."""
        trace, tissue, limit = self.trace, self.parts.tissue, self.parts.motion.feed_limit
        heat_J = tissue.heat_balance_J if isinstance(tissue, HasHeat) else None
        contact = trace["contact_mm2"] > 0.0
        force = np.linalg.norm(trace.vectors("model_force", "N"), axis=1)
        torque = np.linalg.norm(trace.vectors("model_torque", "Nm"), axis=1)
        mean = lambda values: float(values[contact].mean()) if contact.any() else 0.0  # noqa: E731
        ticks = self.timing["tick_us"]
        late, by_clock, exposed_s = np.zeros(len(ticks)), {}, 1e-6 * float(ticks.sum())
        if "late_us" in self.timing:
            late, exposed_s = self.timing["late_us"], len(ticks) * TICK_S
            by_clock = {"late_us": _spread(late), "skipped_ms": 1e-3 * float(self.timing["skipped_us"].sum())}
        return {
            "format": FORMAT,
            "tissue": package_version(),
            "status": "complete",
            "scene": self.scene.name,
            "layers": list(trace.layer_names),
            "simulated_s": len(trace.rows) * 1e-3,
            "cuts": self.parts.cutter is not None,
            "start_mm3": dict(zip(trace.layer_names, (tissue.start_m3 * 1e9).tolist(), strict=True)),
            "removed_mm3": dict(zip(trace.layer_names, (tissue.removed_m3 * 1e9).tolist(), strict=True)),
            "force_N": {"peak": float(force.max()), "mean_in_contact": mean(force)},
            "torque_Nm": {"peak": float(torque.max()), "mean_in_contact": mean(torque)},
            "tick_us": _spread(ticks),
            "missed_deadlines": int((ticks + late > DEADLINE_US).sum()),
            **by_clock,
            **(self.scheduling.summary(ticks_s=exposed_s) if self.scheduling is not None else {}),
            **({} if self.parts.keep_clear is None else {"keep_clear": self.parts.keep_clear.summary()}),
            **({} if heat_J is None else {"heat_J": heat_J}),
            **({} if limit is None else {"feed_limit": asdict(limit)}),
            **({"break_through": list(map(asdict, self.break_throughs))} if self.break_throughs else {}),
            **(tissue.summary() if isinstance(tissue, HasSummary) else {}),
            "events": [{"time_s": time, "what": what} for time, what in self.events],
            "compute": self._compute,
            **self.parts.placement_record,
            "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, Python "
            f"{platform.python_version()}",
            "notes": self.parts.notes,
        }

    def dataset(self) -> "pyvista.ImageData | pyvista.UnstructuredGrid":
        """What was simulated, as pyvista shows it, in the scene's frame in mm.

        Voxels: an image with the cell arrays start and remaining (255 = full), layer, density_kg_m3. Elements: the mesh
        of the last frame with its fields.

        Raises
        ------
        InputError
            If the tissue has neither.
        """
        fields = self.parts.fields
        if self.parts.volume is None and fields is not None and fields.frames:
            from tissue.simulation.series import frame_mesh

            return frame_mesh(fields, fields.frames[-1])
        from tissue.simulation.bone_files import voxel_image

        return voxel_image(self.volume, self.remaining)

    def save(
        self,
        out: str | Path,
        *,
        formats: Iterable[str] = (),
        pictures: bool | str = True,
        overwrite: bool = False,
        progress: Progress | None = None,
    ) -> Path:
        """Write the run's folder; see docs/files.md for its files.

        Parameters
        ----------
        out
            Folder to write.
        formats
            Further formats: parquet, npz, mat or h5 of the trace; recording, the run in volumetric_drilling's layout.
        pictures
            Whether to draw pictures, or their format, png, svg or pdf; where `draw` is given.
        overwrite
            Replace a run that the folder already holds.
        progress
            Called with what is being done.

        Raises
        ------
        InputError
            If the folder holds another run or a format is unknown.
        """
        from tissue.simulation.bone_files import write_bone
        from tissue.simulation.carving_series import write_carving
        from tissue.simulation.picture_format import picture_format
        from tissue.simulation.recording import write_formats
        from tissue.simulation.series import write_fields
        from tissue.simulation.trace_files import check_format

        report = progress or silent
        formats = tuple(formats)
        for kind in formats:
            check_format(kind)
        drawn = picture_format(pictures)
        out = Path(out)
        begun = self._folder is not None and self._folder.path == out
        if begun and self._folder is not None:
            folder, self._folder = self._folder, None  # what is saved once is another's to replace
        else:
            folder = RunFolder(out, overwrite=overwrite)
        with folder.ending():
            if not begun:
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
            if drawn is not None and self.draw is not None:
                report("drawing pictures", 0.0)
                notes = self.draw(self, out / "pictures", drawn)
                if notes:
                    self.parts.notes["pictures"] = "; ".join(notes)
            folder.complete(self.summary)
        return out


def _spread(values: NDArray[np.float64]) -> dict[str, float]:
    """Median, 99th percentile and maximum."""
    return {
        "median": float(np.median(values)),
        "p99": float(np.percentile(values, 99)),
        "max": float(values.max()),
    }
