"""What a run's folder holds, under the names that the engine's run has for it."""

import shutil
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.progress import Progress
from meshes.base.whole_file import whole_file
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool
from tissue.simulation.picture_format import picture_format
from tissue.simulation.recording import write_formats
from tissue.simulation.run_folder import SavedRun, added_to_run, copied_run, files_of_run, saved_placement
from tissue.simulation.run_summary import Summary
from tissue.simulation.saved_fields import SavedFields, field_names
from tissue.simulation.trace import Table
from tissue.simulation.trace_files import check_format, read_table

if TYPE_CHECKING:
    import pyvista

    from tissue.models.bone.replay import CarvingReplay

__all__ = ["SavedFolder"]


class SavedFolder:
    """A run in its folder; each part is read when it is asked for first.

    Parameters
    ----------
    path
        Folder that a run wrote.

    Raises
    ------
    InputError
        If it holds no run, or a damaged one. A part that is missing raises where it is asked for.
    """

    def __init__(self, path: str | Path) -> None:
        self._saved = SavedRun(path)
        self.path = self._saved.path

    @property
    def scene(self) -> Scene:
        """What was simulated."""
        if self._saved.scene is None:
            raise self._missing("scene.toml")
        return self._saved.scene

    @property
    def trace(self) -> Table:
        """One row a tick."""
        if self._saved.trace is None:
            raise self._missing("trace.csv")
        return self._saved.trace

    @cached_property
    def timing(self) -> Table:
        """What each tick took."""
        if not (self.path / "timing.csv").is_file():
            raise self._missing("timing.csv")
        return read_table(self.path / "timing.csv", ())

    @property
    def summary(self) -> Summary:
        """Contents of ``summary.json``; a run whose process is gone was interrupted."""
        return self._saved.summary | {"status": self._saved.status}

    @property
    def events(self) -> list[tuple[float, str]]:
        """What happened: time [s] and a sentence each."""
        return [(float(each["time_s"]), each["what"]) for each in self._saved.summary.get("events", ())]

    @property
    def volume(self) -> VoxelVolume:
        """The voxels before the first cut; those of the poses, where there are any, to the last bit."""
        return self._voxels[0]

    @property
    def remaining(self) -> NDArray[np.uint8]:
        """Bone left in every voxel, 255 = full."""
        return self._voxels[1]

    @property
    def poses(self) -> NDArray[np.float64] | None:
        """Poses of a tool that cuts; None of one that does not, or cut nothing."""
        return self._voxels[2] if (self.path / "bone.vti").is_file() else None

    @property
    def cutter(self) -> Cutter:
        """The cutter of the scene's tool."""
        from tissue.builders.cutting import cutter_of

        if not isinstance(self.scene.tool, Tool):
            raise InputError(f"run must have a cutter, got a {self.scene.tool.kind}: see its trace and fields")
        return cutter_of(self.scene.tool)

    def replay(self) -> "CarvingReplay":
        """The carving once more."""
        import warp

        from tissue.models.bone.replay import CarvingReplay

        if self.poses is None:
            raise InputError(f"run must have cut something, got {self.path} without poses: see its trace and fields")
        wanted, known = str(self.summary.get("compute")), [str(one) for one in warp.get_devices()]
        return CarvingReplay(
            self.volume,
            self.cutter,
            self.poses,
            removal=self.scene.voxels.removal,
            device=wanted if wanted in known else "cpu",
        )

    def dataset(self) -> "pyvista.ImageData | pyvista.UnstructuredGrid":
        """What was simulated, as pyvista shows it, in the scene's frame in mm."""
        from tissue.simulation.bone_files import voxel_image
        from tissue.viewer.saved_surfaces import require_whole

        if (self.path / "bone.vti").is_file() or not field_names(self.path):
            return voxel_image(self.volume, self.remaining)
        require_whole(self._saved)
        mesh: pyvista.UnstructuredGrid = SavedFields(self.path).frames[-1]
        return mesh

    def save(
        self,
        out: str | Path,
        *,
        formats: Iterable[str] = (),
        pictures: bool | str = True,
        overwrite: bool = False,
        progress: Progress | None = None,
    ) -> Path:
        """Copy the folder, with further formats of the trace; into itself only those are written."""
        out, formats = Path(out), tuple(formats)
        for kind in formats:
            check_format(kind)
        drawn = picture_format(pictures)
        if isinstance(pictures, str) and not list((self.path / "pictures").glob(f"*.{drawn}")):
            raise InputError(
                f"pictures must be those that the folder has, got {drawn} for {self.path}, which is not drawn again: "
                f"use tissue run SCENE --pictures {drawn}"
            )
        if not (out.exists() and out.samefile(self.path)):
            if self.summary["status"] == "running":
                raise InputError(f"run must have ended to be copied, got {self.path}, which goes on: wait for it")
            names = files_of_run(self.path)
            with copied_run(out, overwrite=overwrite):
                for name in names:
                    if drawn is not None or not name.startswith("pictures/"):
                        _copy(self.path / name, out / name)
        if formats:
            with added_to_run(out):
                write_formats(self, out, formats)
        return out

    @cached_property
    def _voxels(self) -> tuple[VoxelVolume, NDArray[np.uint8], NDArray[np.float64] | None]:
        """Voxels before the first cut, what is left in them, and poses of the tool that cut."""
        from dataclasses import replace

        from tissue.motion.pose_file import read_poses
        from tissue.viewer.saved_surfaces import read_voxels, require_whole

        file, poses = self.path / "bone.vti", self.path / "carving" / "poses.npz"
        if not file.is_file():
            raise InputError(f"run must have voxels, got {self.path} without bone.vti: see its trace and fields")
        require_whole(self._saved)
        volume, left = read_voxels(file, saved_placement(self.path))
        if not poses.is_file():
            return volume, left, None
        cut, origin_m, spacing_m = read_poses(poses)
        # Not as the image states them, rounded: the bits of the carving depend on them.
        return replace(volume, origin_m=origin_m, spacing_m=spacing_m), left, cut

    def _missing(self, name: str) -> InputError:
        return InputError(f"run must hold {name}, got {self.path} without it: run the scene again")


def _copy(source: Path, target: Path) -> None:
    """Copy a file into a folder that may not be there yet."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(target) as temporary:
        shutil.copyfile(source, temporary)
