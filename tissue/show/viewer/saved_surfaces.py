"""Surfaces of a saved run: bone at any time, and faces that a tool touches."""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array, Bytes
from meshes.base.errors import InputError
from meshes.voxels.volume import VoxelVolume
from tissue.motion.replay import poses_of_trace, read_poses
from tissue.scene.anatomy import CutAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool
from tissue.simulation.bone_files import read_voxels
from tissue.simulation.bone_surface import (
    Box,
    CarvedSurface,
    changed_box,
    facing,
    smooth_normals,
    tool_axes,
)
from tissue.simulation.builders.cutting import milled_voxels
from tissue.simulation.run_folder import SavedRun, saved_placement
from tissue.simulation.saved_fields import SavedFields
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pyvista

    from tissue.models.bone.carver import CarvingReplay

Plane = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Normal and point [mm] of a plane. The part of a mesh on the side of the normal is not drawn."""
INSIDE_MM = 1e-4
"""Distance between a cutting plane and the deepest point of the tool [mm].

With this distance, the plane does not lie in a face of the mesh.
"""


def saved_fields(saved: SavedRun) -> SavedFields | None:
    """Return the fields of a run over time, or None for a run without fields."""
    if not (saved.path / "fields.pvd").is_file():
        return None
    fields = SavedFields(saved.path)
    # a run that was stopped early may have written neither frames nor fields
    return fields if len(fields.times_s) and fields.names else None


def cut_plane(saved: SavedRun, fields: SavedFields) -> Plane:
    """Return the plane at which the mesh of a run is cut open.

    The plane is perpendicular to y and contains the deepest point of the tool. The part of the mesh
    towards the viewer is not drawn.
    """
    x, y, z = map(float, fields.frames[0].center)
    if saved.trace is not None and len(saved.trace.rows):
        y = float(saved.trace["tool_y_mm"][saved.trace["tool_z_mm"].argmin()])
    return (0.0, -1.0, 0.0), (x, y + INSIDE_MM, z)


def tool_force(trace: Table) -> Array:
    """Return the force of the tissue on the tool [N], shape (rows, 3)."""
    return trace.vectors("model_force" if "model_force_x_N" in trace else "force", "N")


COARSE_MM = 0.4
"""Voxel spacing with which the bone of an incomplete run is built and cut again [mm].

An incomplete run saved no voxels, so they are built again while the user waits.
"""


class BoneOverTime:
    """Bone at any time of a run, whether or not it was carved.

    Parameters
    ----------
    volume
        Bone before the first cut.
    end
        Filled fraction of each voxel at the end (255 = full), same shape as `volume.fraction`.
    replay
        Replay of the cuts over time. Without a replay, the bone is shown as it is at the end.
    axis
        World axis closest to the tool's axis, 0 to 2.

    Attributes
    ----------
    layer_names, layers
        Names of all layers, and indices of the layers that the bone contains.
    deepest_mm
        Largest removed depth in the whole run [mm].
    """

    def __init__(
        self,
        volume: VoxelVolume,
        end: Bytes,
        replay: "CarvingReplay | None" = None,
        *,
        axis: int = 2,
    ) -> None:
        self._volume = volume
        self._replay = replay
        self._axis = axis
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
            if cut.n_cells:
                self.deepest_mm = float(cut.point_data["removed_depth_mm"].max())

    def at(self, tick: int) -> bool:
        """Set the bone to its state at the end of a tick; return False if it is unchanged."""
        if self._replay is None or self.deepest_mm == 0.0 or tick == self._tick:
            return False
        self._tick = tick
        self._left = self._replay.at(tick)
        return True

    def rest(self, shown: Collection[int]) -> "pyvista.PolyData":
        """Return the surface [mm] of the layers `shown`, without the part that cuts change."""
        return _smooth(self._of(shown).rest())

    def cut(self, shown: Collection[int]) -> "pyvista.PolyData":
        """Return the part of the surface [mm] of the layers `shown` that cuts change.

        It is the surface at the end of the tick that was set with `at`.
        """
        carved = self._of(shown)
        left = self._left[carved.part]
        layer = self._volume.layer[carved.part]
        return _smooth(carved.of(np.where(np.isin(layer, list(shown)), left, np.uint8(0))))

    def _of(self, shown: Collection[int]) -> CarvedSurface:
        if self._carved is None or self._shown != frozenset(shown):
            self._shown = frozenset(shown)
            volume = self._volume
            fraction = volume.fraction
            # voxels of hidden layers count as empty
            if not self._shown >= set(self.layers):
                fraction = np.where(np.isin(volume.layer, list(shown)), fraction, np.uint8(0))
            self._carved = CarvedSurface(
                replace(volume, fraction=fraction), self._box, axis=self._axis
            )
        return self._carved


def bone_of(saved: SavedRun, scene: Scene | None) -> BoneOverTime | None:
    """Return the bone of a run at all times, or None for a run without voxels.

    The voxels of an incomplete run are built again from its scene, with a larger spacing. If the
    voxels cannot be built, the result is None.
    """
    if saved.complete:
        file = saved.path / "bone.vti"
        if not file.is_file():
            return None
        volume, end = read_voxels(file, saved_placement(saved.path))
        poses = saved.path / "carving" / "poses.npz"
        if saved.trace is None or scene is None:
            return BoneOverTime(volume, end)
        if not poses.is_file():
            return _over_time(volume, saved.trace, scene, end=end)
        cut, origin_m, spacing_m = read_poses(poses)
        # The rounded values of the image are not used, because the exact carving depends on their
        # last bits.
        exact = replace(volume, origin_m=origin_m, spacing_m=spacing_m)
        # the image states its origin in digits that are far finer than a thousandth of a voxel
        if not np.allclose(origin_m, volume.origin_m, atol=1e-3 * spacing_m):
            raise InputError(
                "poses",
                f"belong to the bone in {file}",
                "poses for other voxels",
                "run the scene again",
            )
        return _over_time(
            exact, saved.trace, scene, end=end, poses=cut, compute=str(saved.summary.get("compute"))
        )
    if scene is None or saved.trace is None or (coarse := _coarse(scene)) is None:
        return None
    return _over_time(coarse, saved.trace, scene)


def _over_time(
    volume: VoxelVolume,
    trace: Table,
    scene: Scene,
    *,
    end: Bytes | None = None,
    poses: Array | None = None,
    compute: str = "cpu",
) -> BoneOverTime:
    """Return the bone carved along poses, by default the poses of the trace.

    With the poses of the trace, the bone is accurate to about 20 µm.
    """
    from tissue.simulation.builders.cutting import cutter_of

    uncut = end is not None and np.array_equal(end, volume.fraction)
    cuts = isinstance(scene.tool, Tool) and scene.tool.spin_rpm != 0.0
    if uncut or not cuts or not len(trace.rows):
        return BoneOverTime(volume, volume.fraction if end is None else end)
    assert isinstance(scene.tool, Tool)
    if poses is None:
        axes = tool_axes(trace.quaternions())
        poses = poses_of_trace(1e-3 * trace.vectors("tool", "mm"), axes)
    import warp as wp

    from tissue.models.bone.carver import CarvingReplay

    # this machine may not have the accelerator of the run
    device = compute if compute in map(str, wp.get_devices()) else "cpu"
    removal = scene.voxels.removal
    replay = CarvingReplay(volume, cutter_of(scene.tool), poses, removal=removal, device=device)
    axis, _ = facing(trace)
    if end is None:
        end = replay.at(len(trace.rows) - 1).copy()
    return BoneOverTime(volume, end, replay, axis=axis)


def is_bone_from_file(scene: Scene) -> bool:
    """Return True if the bone of a scene is read from a file.

    Such a file may have changed since the run.
    """
    return isinstance(scene.anatomy, CutAnatomy) and scene.anatomy.from_file is not None


def _coarse(scene: Scene) -> VoxelVolume | None:
    """Return the initial bone of a scene in coarse voxels; None for bone from a file."""
    if not isinstance(scene.anatomy, CutAnatomy) or is_bone_from_file(scene):
        return None
    spacing = max(COARSE_MM, scene.voxels.spacing_mm)
    coarse = scene.voxels.model_copy(update={"spacing_mm": spacing})
    with suppress(InputError):
        return milled_voxels(scene.model_copy(update={"voxels": coarse}))
    return None


def _smooth(surface: "pyvista.PolyData") -> "pyvista.PolyData":
    if surface.n_cells:
        surface.point_data["Normals"] = smooth_normals(surface)
        # without it the steps of the voxels are drawn
        surface.point_data.active_normals_name = "Normals"
    return surface
