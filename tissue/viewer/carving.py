"""The bone of a saved run at any moment, as surfaces: carved again along the tool's poses."""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.placement import Placement
from meshes.voxels.volume import VoxelVolume
from tissue.builders.cutting import milled_voxels
from tissue.motion.pose_file import poses_of_trace, read_poses
from tissue.scene.anatomy import CutAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool
from tissue.simulation.bone_surface import smooth_normals
from tissue.simulation.carved_surface import Box, CarvedSurface, changed_box
from tissue.simulation.depth_map import facing, tool_axes
from tissue.simulation.run_folder import SavedRun, saved_placement
from tissue.simulation.trace import Table
from tissue.simulation.vtk_files import image_in_scene

if TYPE_CHECKING:
    import pyvista

    from tissue.models.bone.replay import CarvingReplay

__all__ = ["BoneOverTime", "bone_of", "read_voxels"]

COARSE_MM = 0.4
"""Spacing at which the bone of an incomplete run is built and cut again."""


class BoneOverTime:
    """A bone that is carved, or one that stays as it is.

    Parameters
    ----------
    volume
        The bone before the first cut.
    end
        Bone left in every voxel at the end, 255 = full, shape of the volume.
    replay
        The carving once more; without it the bone is that of the end at every moment.
    axis
        World axis closest to the tool's, 0 to 2.

    Attributes
    ----------
    layer_names, layers
        Names of all layers, and indices of those that the bone has.
    deepest_mm
        Greatest removed depth of the whole run [mm].
    """

    def __init__(
        self, volume: VoxelVolume, end: NDArray[np.uint8], replay: "CarvingReplay | None" = None, *, axis: int = 2
    ) -> None:
        self._volume, self._replay, self._axis = volume, replay, axis
        self.layer_names = volume.layer_names
        self.layers: list[int] = np.unique(volume.layer[volume.fraction > 0]).tolist()
        box = changed_box(volume.fraction, end)
        nowhere = np.zeros(3, dtype=np.intp)
        self._box: Box = (nowhere, nowhere) if box is None else box
        self._shown: frozenset[int] | None = None
        self._carved: CarvedSurface | None = None
        self._tick = -1
        self._left = end if replay is None else replay.at(-1)
        self.deepest_mm = 0.0
        if box is not None:
            carved = CarvedSurface(volume, box, axis=axis)
            cut = carved.of(end[carved.part])
            self.deepest_mm = float(cut.point_data["removed_depth_mm"].max()) if cut.n_cells else 0.0

    def at(self, tick: int) -> bool:
        """Bring the bone to the end of a tick; whether that can have changed it."""
        if self._replay is None or self.deepest_mm == 0.0 or tick == self._tick:
            return False
        self._tick, self._left = tick, self._replay.at(tick)
        return True

    def rest(self, shown: Collection[int]) -> "pyvista.PolyData":
        """Surface [mm] of what no cut changes, of some of the layers."""
        return _smooth(self._of(shown).rest())

    def cut(self, shown: Collection[int]) -> "pyvista.PolyData":
        """Surface [mm] of what is carved, at the moment and of some of the layers."""
        carved = self._of(shown)
        left, layer = self._left[carved.part], self._volume.layer[carved.part]
        return _smooth(carved.of(np.where(np.isin(layer, list(shown)), left, np.uint8(0))))

    def _of(self, shown: Collection[int]) -> CarvedSurface:
        if self._carved is None or self._shown != frozenset(shown):
            self._shown, volume = frozenset(shown), self._volume
            fraction = volume.fraction
            if not self._shown >= set(self.layers):
                fraction = np.where(np.isin(volume.layer, list(shown)), fraction, np.uint8(0))
            self._carved = CarvedSurface(replace(volume, fraction=fraction), self._box, axis=self._axis)
        return self._carved


def bone_of(saved: SavedRun, scene: Scene | None) -> BoneOverTime | None:
    """The bone of a run over time; of an incomplete run one in coarse voxels; None without."""
    if saved.complete:
        file = saved.path / "bone.vti"
        if not file.is_file():
            return None
        volume, end = read_voxels(file, saved_placement(saved.path))
        poses = saved.path / "carving" / "poses.npz"
        if saved.trace is None or scene is None or not isinstance(scene.tool, Tool):
            return BoneOverTime(volume, end)
        if not poses.is_file():
            return _over_time(volume, saved.trace, scene, end=end)
        cut, origin_m, spacing_m = read_poses(poses)
        # Not as the image states them, rounded: the bits of the carving depend on them.
        exact = replace(volume, origin_m=origin_m, spacing_m=spacing_m)
        if not np.allclose(origin_m, volume.origin_m, atol=1e-3 * spacing_m):
            raise InputError(f"poses must be of the bone in {file}, got those of other voxels: run the scene again")
        return _over_time(exact, saved.trace, scene, end=end, poses=cut, compute=str(saved.summary.get("compute")))
    if scene is None or saved.trace is None or (coarse := _coarse(scene)) is None:
        return None
    return _over_time(coarse, saved.trace, scene)


def _over_time(
    volume: VoxelVolume,
    trace: Table,
    scene: Scene,
    *,
    end: NDArray[np.uint8] | None = None,
    poses: NDArray[np.float64] | None = None,
    compute: str = "cpu",
) -> BoneOverTime:
    """The bone along poses, or else along those of the trace, which is right within 20 µm."""
    from tissue.builders.cutting import cutter_of

    uncut = end is not None and np.array_equal(end, volume.fraction)
    if not isinstance(scene.tool, Tool) or scene.tool.spin_rpm == 0.0 or uncut or not len(trace.rows):
        return BoneOverTime(volume, volume.fraction if end is None else end)
    if poses is None:
        axes = tool_axes(np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"]))
        velocities = np.hstack([1e-3 * trace.vectors("velocity", "mm_s"), trace.vectors("angular_velocity", "rad_s")])
        poses = poses_of_trace(1e-3 * trace.vectors("tool", "mm"), axes, velocities)
    import warp as wp

    from tissue.models.bone.replay import CarvingReplay

    known = [str(one) for one in wp.get_devices()]
    replay = CarvingReplay(
        volume,
        cutter_of(scene.tool),
        poses,
        removal=scene.voxels.removal,
        device=compute if compute in known else "cpu",
    )
    axis, _ = facing(trace)
    return BoneOverTime(volume, replay.at(len(trace.rows) - 1).copy() if end is None else end, replay, axis=axis)


def _coarse(scene: Scene) -> VoxelVolume | None:
    """The bone that a scene starts from, in coarse voxels; None of one that comes from a file, or of none."""
    if not isinstance(scene.anatomy, CutAnatomy) or scene.anatomy.from_file is not None:
        return None
    spacing = max(COARSE_MM, scene.voxels.spacing_mm)
    with suppress(InputError):
        return milled_voxels(
            scene.model_copy(update={"voxels": scene.voxels.model_copy(update={"spacing_mm": spacing})})
        )
    return None


def read_voxels(file: Path, placement: Placement | None = None) -> tuple[VoxelVolume, NDArray[np.uint8]]:
    """Voxels of a run's ``bone.vti`` in the scene's frame, before the first cut, and what is left in them at the end.

    Raises
    ------
    InputError
        If the file is not one that a run wrote.
    """
    import pyvista

    try:
        image = image_in_scene(pyvista.read(file), placement)
        shape = tuple(np.array(image.dimensions) - 1)
        start, left, layer, density = (
            np.ascontiguousarray(image.cell_data[name].reshape(shape, order="F"))
            for name in ("start", "remaining", "layer", "density_kg_m3")
        )
        names = tuple(str(name) for name in image.field_data["layer_names"])
    except (KeyError, ValueError, AttributeError, OSError):
        raise InputError(f"bone.vti must be a file that a run wrote, got {file}: run the scene again") from None
    return VoxelVolume(
        1e-3 * np.array(image.origin), 1e-3 * float(image.spacing[0]), start, layer, density, names, placement
    ), left


def _smooth(surface: "pyvista.PolyData") -> "pyvista.PolyData":
    if surface.n_cells:
        surface.point_data["Normals"] = smooth_normals(surface)
        surface.point_data.active_normals_name = "Normals"  # without it the steps of the voxels are drawn
    return surface
