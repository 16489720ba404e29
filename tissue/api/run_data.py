"""What a run holds: simulated just now or read back from its folder."""

from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.progress import Progress
from meshes.voxels.volume import VoxelVolume
from tissue.api.saved_folder import SavedFolder
from tissue.api.trace import Trace
from tissue.builders.parts import Parts
from tissue.cutters.cutter import Cutter
from tissue.scene.scene import Scene
from tissue.simulation import run as engine
from tissue.simulation.picture_format import picture_format
from tissue.simulation.run_summary import Summary, summary_of

if TYPE_CHECKING:
    import pyvista

    from tissue.models.bone.replay import CarvingReplay
    from tissue.uncertainty.band import Band

__all__ = ["RunData"]


class RunData:
    """Scene, trace, figures and bone of a run; see `tissue.api.run.Run`."""

    def __init__(self, held: engine.Run | SavedFolder) -> None:
        self._held = held
        self.path: Path | None = held.path if isinstance(held, SavedFolder) else None
        self._shown: TemporaryDirectory[str] | None = None
        self._band: Band | None = None

    @property
    def scene(self) -> Scene:
        """What was simulated."""
        return self._held.scene

    @cached_property
    def trace(self) -> Trace:
        """One row a tick, columns by name: ``run.trace["force_z_N"]``."""
        return Trace(self._held.trace)

    @cached_property
    def timing(self) -> Trace:
        """What each tick took, and its stages [µs], columns by name: ``run.timing["tick_us"]``."""
        return Trace(self._held.timing)

    @property
    def events(self) -> list[tuple[float, str]]:
        """What happened in the run: time [s] and a sentence each."""
        return self._held.events

    @property
    def summary(self) -> Summary:
        """Figures of the run by name, as ``summary.json`` has them: volumes by layer, forces, cost of the ticks."""
        return self._held.summary | ({} if self._band is None else {"band": self._band.summary})

    @property
    def status(self) -> str:
        """``complete``, ``failed``, ``interrupted`` or ``running``."""
        return str(self.summary["status"])

    @property
    def problem(self) -> str:
        """What ended a run that failed or was interrupted; empty where nothing did, or it is not known."""
        return str(self.summary.get("problem", ""))

    @property
    def volume(self) -> VoxelVolume:
        """The voxels before the first cut.

        Raises
        ------
        InputError
            If the tissue has none.
        """
        return self._held.volume

    @property
    def remaining(self) -> NDArray[np.uint8]:
        """Bone left in every voxel, 255 = full, uint8, shape (nx, ny, nz); raises as `volume`."""
        return self._held.remaining

    @property
    def poses(self) -> NDArray[np.float64] | None:
        """Poses of a tool that cuts, see `tissue.simulation.tick.PoseLog`; None of one that does not."""
        return self._held.poses

    @property
    def cutter(self) -> Cutter:
        """The cutter.

        Raises
        ------
        InputError
            If the tool is none.
        """
        return self._held.cutter

    @property
    def parts(self) -> Parts:
        """The engine's tissue, motion and voxels.

        Raises
        ------
        InputError
            If the run was read back: a folder does not keep them.
        """
        if isinstance(self._held, SavedFolder):
            raise InputError(f"run must be simulated here to have its parts, got {self.path}: run the scene again")
        return self._held.parts

    def replay(self) -> "CarvingReplay":
        """The carving once more, for the bone at any tick: ``run.replay().at(tick)``.

        Raises
        ------
        InputError
            If nothing was cut.
        """
        return self._held.replay()

    def dataset(self) -> "pyvista.ImageData | pyvista.UnstructuredGrid":
        """What was simulated, as pyvista shows it, in the scene's frame in mm.

        Voxels: an image with the cell arrays start and remaining (255 = full), layer, density_kg_m3. Those that are
        less than half full are hidden, so that ``run.dataset().plot()`` shows the bone; the cell array ``vtkGhostType``
        does that, and without it all are there. Elements: the mesh of the last frame with its fields.

        Raises
        ------
        InputError
            If the tissue has neither.
        """
        from tissue.api.show import with_empty_hidden

        return with_empty_hidden(self._held.dataset())

    def surface(self) -> "pyvista.PolyData":
        """Surface of the carved bone [mm]: point array ``removed_depth_mm``, cell array ``layer``.

        Raises
        ------
        InputError
            If the tissue has no voxels.
        """
        from tissue.simulation.bone_files import carved_surface

        return carved_surface(self)

    def save(
        self,
        out: str | Path,
        *,
        formats: Iterable[str] = (),
        pictures: bool | str = True,
        overwrite: bool = False,
        progress: Progress | None = None,
    ) -> Path:
        """Write the run's folder; see docs/files.md for its files. One that was read back is copied.

        Parameters
        ----------
        out
            Folder to write.
        formats
            Further formats: parquet, npz, mat or h5 of the trace; recording, the run in volumetric_drilling's layout.
        pictures
            Whether the folder holds pictures, or their format, png, svg or pdf; of one that was read back those it has.
        overwrite
            Replace a run that the folder already holds.
        progress
            Called with what is being done.

        Raises
        ------
        InputError
            If the folder holds another run or a format is unknown.
        """
        self.path = self._held.save(out, formats=formats, pictures=pictures, overwrite=overwrite, progress=progress)
        self._save_band(pictures)
        return self.path

    def _save_band(self, pictures: bool | str) -> None:
        """Write a band that was made of the run into its folder, where there are both."""
        if self._band is not None and self.path is not None:
            from tissue.uncertainty.band_files import save_band

            save_band(self._band, self.path, kind=picture_format(pictures))

    def _folder(self) -> Path:
        """A folder with this run's files, a temporary one where it was not saved or its folder holds another by now."""
        if isinstance(self._held, SavedFolder):
            return self._held.path
        if self.path is not None and summary_of(self.path) == self.summary:
            return self.path
        if self._shown is None:
            self._shown = TemporaryDirectory(prefix="tissue-", ignore_cleanup_errors=True)
            self._held.save(self._shown.name, pictures=False)
        return Path(self._shown.name)
