"""Data of VTK moved between the scene's frame and that of the file that the anatomy came from.

Coordinates take the file's unit; quantities with a unit in their name keep it. Arrays of three numbers a point are
vectors and turn along; arrays of cells are not (principal stresses are three numbers, and no vector).
"""

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from meshes.base.placement import Placement

if TYPE_CHECKING:
    import pyvista

Mesh = TypeVar("Mesh", bound="pyvista.PointSet")

__all__ = ["image_in_file", "image_in_scene", "mesh_in_file", "mesh_in_scene"]


def mesh_in_file(mesh: Mesh, placement: Placement | None) -> Mesh:
    """A mesh of the scene [mm] in the file's frame and unit; itself where there is no file."""
    return mesh if placement is None else _moved(mesh, placement.to_file(_points(mesh)), placement.rotation.T)


def mesh_in_scene(mesh: Any, placement: Placement | None) -> Any:
    """A mesh in the file's frame and unit as the scene has it [mm]; itself where there is no file."""
    return mesh if placement is None else _moved(mesh, placement.to_scene(_points(mesh)), placement.rotation)


def image_in_file(image: "pyvista.ImageData", placement: Placement | None) -> "pyvista.ImageData":
    """Voxels of the scene [mm] in the file's frame and unit, with a direction matrix; themselves without a file."""
    if placement is None:
        return image
    moved: pyvista.ImageData = image.copy(deep=False)
    moved.origin = placement.to_file(np.array([image.origin]))[0].tolist()
    moved.spacing = [size / placement.unit_mm for size in image.spacing]
    moved.direction_matrix = placement.rotation
    return moved


def image_in_scene(image: Any, placement: Placement | None) -> "pyvista.ImageData":
    """Voxels in the file's frame and unit as the scene has them [mm]; themselves without a file."""
    if placement is None:
        return image
    moved: pyvista.ImageData = image.copy(deep=False)
    moved.origin = placement.to_scene(np.array([image.origin]))[0].tolist()
    moved.spacing = [size * placement.unit_mm for size in image.spacing]
    moved.direction_matrix = placement.rotation.T @ np.array(image.direction_matrix)
    return moved


def _points(mesh: "pyvista.PointSet") -> NDArray[np.float64]:
    return np.asarray(mesh.points, dtype=np.float64)


def _moved(mesh: Mesh, points: NDArray[np.float64], turn: NDArray[np.float64]) -> Mesh:
    """A copy of a mesh at other points, its vectors turned (rows times `turn`)."""
    import pyvista

    moved, single = mesh.copy(deep=False), np.ascontiguousarray(points, dtype=np.float32)
    moved.SetPoints(pyvista.vtk_points(single))  # type: ignore[arg-type]  # moved.points = would change the original
    for name, values in mesh.point_data.items():
        if values.ndim == 2 and values.shape[1] == 3:
            moved.point_data[name] = (np.asarray(values, dtype=np.float64) @ turn).astype(values.dtype)
    return moved
