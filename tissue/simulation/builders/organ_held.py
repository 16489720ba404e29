"""Supports of an organ that a caller describes: a side, a height, a part, or points."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import InputError
from meshes.tets.regions import Nodes, faces_of, nodes_behind_plane, nodes_facing, nodes_of_part
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import nearest_on_triangles

__all__ = ["Hold", "hold_of"]

SIDES = {
    "bottom": (0.0, 0.0, -1.0),
    "top": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "+x": (1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
    "+z": (0.0, 0.0, 1.0),
}
"""Outward directions of the sides of the surface that may be held, by name."""
COINCIDE = 1e-6
"""Distance within which a node coincides with a named point, over the mesh's size."""
Hold = Callable[[TetMesh], Nodes]
"""Function that returns the held nodes of a mesh."""


def hold_of(
    held: "str | ArrayLike",
    held_below_mm: float | None,
    mesh: TetMesh,
    points_mm: NDArray[np.float64],
) -> tuple[Hold, str]:
    """Return a function that finds the held nodes of a mesh, and a note on them.

    Parameters
    ----------
    held
        A side of the surface (``bottom``, ``top``, ``-x`` to ``+z``: faces within 60 degrees of
        that direction), the name of a part, or points: a mask, shape (n,), or their numbers.
    held_below_mm
        Height below which the surface is held instead [mm].
    mesh, points_mm
        The mesh, and the points that masks and numbers refer to [mm], shape (n, 3).

    Raises
    ------
    InputError
        If there is no such side or part, or points do not exist.
    """
    if held_below_mm is not None:
        height = 1e-3 * float(held_below_mm)
        return (
            lambda mesh: nodes_behind_plane(
                mesh, point_m=(0.0, 0.0, height), normal=(0.0, 0.0, 1.0)
            ),
            f"the surface below z = {held_below_mm:g} mm",
        )
    if isinstance(held, str):
        if held in SIDES:
            return lambda mesh: nodes_facing(
                mesh, direction=SIDES[held]
            ), f"the surface that faces {held}"
        if held in mesh.part_names:
            return lambda mesh: nodes_of_part(mesh, held), f"the part {held}"
        raise InputError(
            "held",
            f"be one of {', '.join((*SIDES, *mesh.part_names))} or points",
            f"{held!r}",
            "use bottom",
        )
    nodes = _named(np.asarray(held), mesh, points_mm)
    points_m = mesh.nodes_m
    triangles = faces_of(mesh, nodes)

    def hold(other: TetMesh) -> Nodes:
        if other is mesh:
            return nodes
        near = COINCIDE * float(np.ptp(points_m, axis=0).max())
        away = _distance_m(points_m[nodes], other.nodes_m)
        if len(triangles):
            surface = other.surface_nodes
            on = nearest_on_triangles(points_m, triangles, other.nodes_m[surface])
            away[surface] = np.minimum(
                away[surface], np.linalg.norm(on - other.nodes_m[surface], axis=1)
            )
        return np.flatnonzero(away <= near)

    return hold, f"{len(nodes)} points that were named"


def _named(held: NDArray[Any], mesh: TetMesh, points_mm: NDArray[np.float64]) -> Nodes:
    """Return the mesh nodes selected by a mask or by numbers of the caller's points."""
    count = len(points_mm)
    if held.dtype == np.bool_ and held.shape == (count,):
        held = np.flatnonzero(held)
    whole = held.dtype.kind in "iu" and held.ndim == 1
    if not whole or (len(held) and not (held.min() >= 0 and held.max() < count)):
        raise InputError(
            "held",
            f"be a side, a part, a mask of the {count} points or their numbers",
            f"an array of {held.dtype} and shape {held.shape}",
            "number points from 0",
        )
    if not len(held):
        raise InputError(
            "held", "name at least three points", "none", "name the points that do not move"
        )
    from scipy.spatial import cKDTree

    near = COINCIDE * 1e3 * float(np.ptp(mesh.nodes_m, axis=0).max())
    away, nodes = cKDTree(1e3 * mesh.nodes_m).query(points_mm[held])
    return np.unique(nodes[away <= near])


def _distance_m(
    points_m: NDArray[np.float64], others_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distance of each of `others_m` from the nearest of `points_m` [m]."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(points_m).query(others_m)[0], dtype=np.float64)
