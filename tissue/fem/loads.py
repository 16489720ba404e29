"""Nodal loads that are work-equivalent to gravity and traction."""

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.fem.shapes import mean_shape
from tissue.fem.space import Space

__all__ = ["STANDARD_GRAVITY_M_S2", "gravity", "traction"]


STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard acceleration of free fall [m/s2]."""


def gravity(
    space: Space,
    *,
    density_kg_m3: ArrayLike,
    acceleration_m_s2: ArrayLike = (0.0, 0.0, -STANDARD_GRAVITY_M_S2),
) -> Array:
    """Return the weight of the cells on the nodes [N], shape (n, 3).

    Parameters
    ----------
    space
        Nodes and cells.
    density_kg_m3
        Density [kg/m3], one or one a cell, shape (m,).
    acceleration_m_s2
        Acceleration [m/s2], shape (3,).

    Raises
    ------
    InputError
        If the acceleration is not finite.
    """
    mass = np.asarray(density_kg_m3, dtype=np.float64) * space.volumes_m3
    force = mass[:, None] * _vectors("acceleration_m_s2", acceleration_m_s2, 1)
    return _spread(space, space.cell_nodes, force, mean_shape(4, space.order))


def traction(space: Space, traction_Pa: ArrayLike, *, faces: Ints | None = None) -> Array:
    """Return traction on faces of the surface as forces on nodes [N], shape (n, 3).

    Parameters
    ----------
    space
        Nodes and cells.
    traction_Pa
        Force per area [Pa], shape (3,) or one a face, shape (f, 3).
    faces
        Nodes of the faces, shape (f, 3) or (f, 6); default all of `Space.faces`.

    Raises
    ------
    InputError
        If the traction is not finite or has another shape.
    """
    nodes = space.faces if faces is None else faces
    a, b, c = (space.nodes_m[nodes[:, i]] for i in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    force = area[:, None] * _vectors("traction_Pa", traction_Pa, len(nodes))
    return _spread(space, nodes, force, mean_shape(3, space.order))


def _spread(space: Space, nodes: Ints, force: Array, share: Array) -> Array:
    """Sum each row's force, shape (r, 3), times the share of each of its nodes, shape (k,)."""
    each = (force[:, None, :] * share[:, None]).reshape(-1, 3)
    rows = nodes.ravel()
    return np.stack(
        [np.bincount(rows, weights=each[:, i], minlength=space.node_count) for i in range(3)],
        axis=1,
    )


def _vectors(name: str, value: ArrayLike, count: int) -> Array:
    vectors = np.asarray(value, dtype=np.float64)
    if vectors.shape not in ((3,), (count, 3)) or not np.isfinite(vectors).all():
        raise InputError(name, "be finite, shape (3,)", vectors.tolist(), "give x, y, z")
    return np.broadcast_to(vectors, (count, 3))
