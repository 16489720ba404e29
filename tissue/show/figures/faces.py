"""Faces that a tool passes or presses in tissue without voxels and mesh."""

from typing import TYPE_CHECKING

from tissue.models.tissue_model import TICK_S
from tissue.scene.organ import LayersAnatomy
from tissue.scene.registry import ANATOMIES
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import motion_of

if TYPE_CHECKING:
    import pyvista

__all__ = ["faces_of", "layer_faces", "wall_face"]

FACE_MM = 30.0
"""Edge of a drawn piece of an infinite face, and length of a wall beyond the path on it [mm]."""
WALL_MESH_MM = 5.0
"""Width of the squares of a drawn wall."""


def faces_of(scene: Scene | None) -> "dict[str, pyvista.PolyData]":
    """Return pieces of the faces that a tool passes or presses [mm], by name.

    Voxels and meshes have no such faces.
    """
    if scene is None:
        return {}
    make = ANATOMIES[scene.anatomy.kind].faces or {"layers": layer_faces, "wall": wall_face}.get(
        scene.anatomy.kind
    )
    return {} if make is None else make(scene)


def wall_face(scene: Scene) -> "dict[str, pyvista.PolyData]":
    """Return a wall under all of the path that the tool can go."""
    import pyvista

    path_mm = 1e3 * motion_of(scene, step_s=TICK_S).sweep_m()[:, :2]
    low = path_mm.min(axis=0)
    high = path_mm.max(axis=0)
    roam_mm = (scene.device and scene.device.coupling.roam_mm) or 0.0
    middle = 0.5 * (low + high)
    (wide, deep) = high - low + max(FACE_MM, 2.0 * roam_mm)
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


def layer_faces(scene: Scene) -> "dict[str, pyvista.PolyData]":
    """Return pieces of the faces that a needle passes, by layer."""
    import pyvista

    assert isinstance(scene.anatomy, LayersAnatomy)
    depths = {"capsule": 0.0} | dict(scene.anatomy.membranes)
    return {
        name: pyvista.Plane(
            center=(0.0, 0.0, -depth), direction=(0.0, 0.0, 1.0), i_size=FACE_MM, j_size=FACE_MM
        )
        for name, depth in depths.items()
    }
