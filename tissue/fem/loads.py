"""Loads on nodes that do the same work as gravity, pressure, traction and point forces do on the displacement."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import InputError
from tissue.fem.shapes import mean_shape, shape_values
from tissue.fem.space import Space

__all__ = ["STANDARD_GRAVITY_M_S2", "gravity", "point_force", "pressure", "traction"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard acceleration of free fall [m/s2]."""


def gravity(
    space: Space,
    *,
    density_kg_m3: ArrayLike,
    acceleration_m_s2: ArrayLike = (0.0, 0.0, -STANDARD_GRAVITY_M_S2),
) -> Array:
    """Weight of the cells on the nodes [N], shape (n, 3).

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
        If a density or the acceleration is not finite, or a density is negative.
    """
    density = np.asarray(density_kg_m3, dtype=np.float64)
    if not (np.isfinite(density) & (density >= 0.0)).all():
        raise InputError(f"density_kg_m3 must be finite and not negative, got {density.min()}: use 1060 for liver")
    mass = density * space.volumes_m3
    force = mass[:, None] * _vectors("acceleration_m_s2", acceleration_m_s2, 1)
    return _spread(space, space.cell_nodes, force, mean_shape(4, space.order))


def traction(space: Space, traction_Pa: ArrayLike, *, faces: Integers | None = None) -> Array:
    """Traction on faces of the surface as forces on nodes [N], shape (n, 3).

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
    force = np.linalg.norm(_area_vectors(space, nodes), axis=1)[:, None] * _vectors(
        "traction_Pa", traction_Pa, len(nodes)
    )
    return _spread(space, nodes, force, mean_shape(3, space.order))


def pressure(space: Space, pressure_Pa: ArrayLike, *, faces: Integers | None = None) -> Array:
    """Pressure [Pa], one or one a face, that pushes faces of the surface inwards, as forces on nodes [N], shape (n, 3).

    Raises
    ------
    InputError
        If the pressure is not finite.
    """
    nodes = space.faces if faces is None else faces
    value = np.asarray(pressure_Pa, dtype=np.float64)
    if not np.isfinite(value).all():
        raise InputError("pressure_Pa must be finite, got NaN or infinity: leave such faces out")
    force = -np.broadcast_to(value, len(nodes))[:, None] * _area_vectors(space, nodes)
    return _spread(space, nodes, force, mean_shape(3, space.order))


def point_force(space: Space, position_m: ArrayLike, force_N: ArrayLike) -> Array:
    """Force on the point of the surface nearest to a position, as forces on nodes [N], shape (n, 3).

    Parameters
    ----------
    space
        Nodes and cells.
    position_m, force_N
        Position [m] and force [N], shapes (3,).

    Raises
    ------
    InputError
        If either is not finite.
    """
    at, force = _vectors("position_m", position_m, 1)[0], _vectors("force_N", force_N, 1)
    triangles = space.nodes_m[space.faces[:, :3]]
    from trimesh.triangles import closest_point, points_to_barycentric

    near = closest_point(triangles, np.broadcast_to(at, (len(triangles), 3)))
    face = int(np.linalg.norm(near - at, axis=1).argmin())
    share = shape_values(points_to_barycentric(triangles[face][None], near[face][None])[0], space.order)
    return _spread(space, space.faces[face][None], force, share)


def _area_vectors(space: Space, faces: Integers) -> Array:
    """Outward normals as long as the faces are large [m2], shape (f, 3)."""
    a, b, c = (space.nodes_m[faces[:, i]] for i in range(3))
    return np.asarray(0.5 * np.cross(b - a, c - a))


def _spread(space: Space, nodes: Integers, force: Array, share: Array) -> Array:
    """Sum of each row's force, shape (r, 3), times the share of each of its nodes, shape (k,)."""
    each = (force[:, None, :] * share[:, None]).reshape(-1, 3)
    rows = nodes.ravel()
    return np.stack([np.bincount(rows, weights=each[:, i], minlength=space.node_count) for i in range(3)], axis=1)


def _vectors(name: str, value: ArrayLike, count: int) -> Array:
    vectors = np.asarray(value, dtype=np.float64)
    if vectors.shape not in ((3,), (count, 3)) or not np.isfinite(vectors).all():
        raise InputError(f"{name} must be finite, shape (3,), got {vectors.tolist()}: give x, y, z")
    return np.broadcast_to(vectors, (count, 3))
