"""What a saved run holds for the window of `tissue view`: its scene, its bone, the faces that a tool meets."""

from typing import TYPE_CHECKING, Any

from meshes.errors import InputError
from meshes.progress import silent
from meshes.volume import VoxelVolume
from tissue.run_folder import SavedRun
from tissue.scene import Scene
from tissue.scene_anatomy import BlockAnatomy, GlenoidAnatomy, MolarAnatomy
from tissue.scene_coupling import WallAnatomy
from tissue.scene_soft import LayersAnatomy
from tissue.scene_tool import Tool
from tissue.surface import bone_surface, with_layers
from tissue.viewer_bone import read_voxels

if TYPE_CHECKING:
    import pyvista

__all__ = ["bone_of", "faces_of", "scene_of"]

COARSE_MM = 0.4
"""Spacing at which the starting bone of an incomplete run is built again."""
FACE_MM = 30.0
"""Edge of a drawn piece of a face that goes on, and what of a wall goes beyond the way on it."""
WALL_MESH_MM = 5.0
"""Width of the squares of a drawn wall."""


def scene_of(saved: SavedRun) -> Scene | None:
    """The scene of a run, if its file is there and whole."""
    from tissue.load import load_scene

    try:
        return load_scene(saved.path / "scene.toml")
    except (InputError, OSError, ValueError):
        return None


def bone_of(saved: SavedRun) -> "tuple[pyvista.PolyData | None, VoxelVolume | None]":
    """The carved bone, surface and voxels; of an incomplete run the bone it started from, coarse; None without."""
    import pyvista

    file = saved.path / "bone.vtp"
    if saved.complete:
        surface: Any = pyvista.read(file) if file.is_file() else pyvista.PolyData()
        return (surface, read_voxels(saved.path / "bone.vti")) if surface.n_cells else (None, None)
    scene = scene_of(saved)
    if scene is None or not isinstance(scene.tool, Tool):
        return None, None
    anatomy = scene.anatomy
    if not isinstance(anatomy, GlenoidAnatomy | BlockAnatomy | MolarAnatomy) or anatomy.file is not None:
        return None, None
    from tissue.anatomies import volume_of
    from tissue.build import cutter_of, motion_of

    spacing = max(COARSE_MM, scene.voxels.spacing_mm)
    coarse = scene.model_copy(update={"voxels": scene.voxels.model_copy(update={"spacing_mm": spacing})})
    try:
        volume = volume_of(coarse, cutter_of(scene.tool), motion_of(scene, step_s=1e-3), notes={}, tell=silent)
    except InputError:
        return None, None
    return with_layers(bone_surface(volume, volume.fraction), volume), volume


def faces_of(scene: Scene | None) -> "dict[str, pyvista.PolyData]":
    """Pieces of the faces that a needle goes through or a ball presses [mm], by layer; none of an organ that is meshed.

    A wall is drawn under all of the way that the tool can go.
    """
    import pyvista

    anatomy = scene.anatomy if scene is not None else None
    if scene is not None and isinstance(anatomy, WallAnatomy):
        from tissue.build import motion_of

        way = 1e3 * motion_of(scene, step_s=1e-3).sweep_m()[:, :2]
        low, high = way.min(axis=0), way.max(axis=0)
        middle, (wide, deep) = 0.5 * (low + high), high - low + max(FACE_MM, 2.0 * (scene.coupling.roam_mm or 0.0))
        return {
            "wall": pyvista.Plane(
                center=(*middle, 0.0),
                direction=(0.0, 0.0, 1.0),
                i_size=wide,
                j_size=deep,
                i_resolution=max(round(wide / WALL_MESH_MM), 1),
                j_resolution=max(round(deep / WALL_MESH_MM), 1),
            )
        }
    if not isinstance(anatomy, LayersAnatomy):
        return {}
    depths = {"capsule": 0.0, "vessel wall": anatomy.vessel_wall_depth_mm}
    return {
        name: pyvista.Plane(center=(0.0, 0.0, -depth), direction=(0.0, 0.0, 1.0), i_size=FACE_MM, j_size=FACE_MM)
        for name, depth in depths.items()
        if depth is not None
    }
