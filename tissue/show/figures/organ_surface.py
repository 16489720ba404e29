"""Smooth boundaries of meshes with field values, for pictures."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Floats, Singles
from tissue.simulation.saved_fields import field_values

if TYPE_CHECKING:
    import pyvista

SHOWN = "shown"
"""Name of the point array with the values that are drawn."""
SHARP_DEG = 40.0
"""Angle [degrees] between two triangles above which their edge is drawn sharp."""


def drawn_surface(mesh: "pyvista.DataSet", values: Singles) -> "pyvista.PolyData":
    """Return the boundary of a mesh with normals for smooth shading.

    Parameters
    ----------
    mesh
        Mesh of three-dimensional cells [mm].
    values
        Values at the nodes, shape (nodes,) or (nodes, k). The returned boundary contains the values
        as the point array `SHOWN`.
    """
    body = mesh.copy(deep=False)
    body.clear_data()
    body.point_data[SHOWN] = values
    return with_normals(body.extract_surface(algorithm="dataset_surface").triangulate())


def with_normals(surface: "pyvista.PolyData") -> "pyvista.PolyData":
    """Return a surface with normals at its points, for smooth shading.

    At a sharp edge, the points are duplicated, so that each side has its own normals.
    """
    return surface.compute_normals(
        cell_normals=False, split_vertices=True, feature_angle=SHARP_DEG, consistent_normals=False
    )


def at_nodes(mesh: "pyvista.DataSet", name: str) -> Singles:
    """Return the values of a field at the nodes.

    If the field is defined in the cells, its values are averaged over the cells around each node.
    """
    values = field_values(mesh if name in mesh.point_data else mesh.cell_data_to_point_data(), name)
    assert values is not None
    return np.asarray(values)


def inclusions(corners: Floats, layer: NDArray[np.integer]) -> NDArray[np.intp]:
    """Return the indices of the cells of an inclusion, such as a nodule.

    An inclusion is a layer whose bounding box lies strictly inside the bounding box of the mesh. Of
    several inclusions, the one with the fewest cells is returned. Without an inclusion, the result
    is empty.

    Parameters
    ----------
    corners
        Positions of the corners of each cell, shape (cells, corners, 3).
    layer
        Layer of each cell, shape (cells,).
    """
    low = corners.min(axis=1)
    high = corners.max(axis=1)
    found = []
    for index in np.unique(layer):
        here = layer == index
        is_above = (low[here].min(axis=0) > low.min(axis=0)).all()
        is_below = (high[here].max(axis=0) < high.max(axis=0)).all()
        if is_above and is_below:
            found.append(np.flatnonzero(here))
    return min(found, key=len, default=np.zeros(0, dtype=np.intp))
