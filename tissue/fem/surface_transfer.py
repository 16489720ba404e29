"""Transfer from the nodes of one mesh to points on the surface of another mesh of one body."""

import numpy as np
from scipy.sparse import csr_array

from meshes.base.arrays import Array
from tissue.fem.shapes import TRIANGLE_EDGES
from tissue.fem.space import Space

__all__ = ["surface_transfer"]

NONE = 1e-9
"""Shares below this are rounding errors."""


def surface_transfer(space: Space, points_m: Array) -> csr_array:
    """Return the shares of the nodes in points of the surface, shape (k, n).

    The matrix times nodal displacements gives the displacements of the points. Its transpose turns
    forces on the points into work-equivalent forces on the nodes.

    Parameters
    ----------
    space
        Nodes and cells.
    points_m
        Points [m], shape (k, 3). Each point is replaced by the nearest point of the surface.
    """
    import pyvista

    corners = space.mesh.surface
    surface = pyvista.PolyData.from_regular_faces(space.mesh.nodes_m, corners.astype(int))
    face, nearest = surface.find_closest_cell(
        np.ascontiguousarray(points_m), return_closest_point=True
    )
    origin, first, second = space.mesh.nodes_m[corners[face]].transpose(1, 0, 2)
    sides = np.stack([first - origin, second - origin], axis=1)
    along = np.einsum("kai,ki->ka", sides, nearest - origin)
    share = np.linalg.solve(sides @ sides.transpose(0, 2, 1), along[..., None])[..., 0]
    corner = np.column_stack([1.0 - share.sum(axis=1), share])
    shape = corner
    if space.order == 2:
        middle = [4.0 * corner[:, a] * corner[:, b] for a, b in TRIANGLE_EDGES]
        shape = np.column_stack([corner * (2.0 * corner - 1.0), *middle])
    nodes = space.faces[face]
    shape = np.where(np.abs(shape) < NONE, 0.0, shape)
    rows = np.repeat(np.arange(len(points_m)), nodes.shape[1])
    shares = csr_array(
        (shape.ravel(), (rows, nodes.ravel())), shape=(len(points_m), space.node_count)
    )
    shares.eliminate_zeros()
    return shares
