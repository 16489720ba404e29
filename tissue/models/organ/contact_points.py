"""Points of an organ's surface at which a tool is felt."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError

__all__ = ["contact_points"]

MOST_DIVISIONS = 16
"""Contact points along the edge of a triangle."""


def contact_points(nodes_m: Array, faces: Ints, spacing_m: float) -> tuple[NDArray[np.int32], Array, Array]:
    """Contact points on triangles: their corners, and inside those with longer edges a lattice.

    A triangle whose longest edge spans n spacings, n > 1, has the centres of its n^2 equal parts.

    Parameters
    ----------
    nodes_m
        Node positions [m], shape (s, 3).
    faces
        Triangles, shape (f, 3).
    spacing_m
        Widest spacing wanted [m].

    Returns
    -------
    face
        Triangle of each point, shape (p,), rising; every node is a point of one of its triangles.
    weights
        Barycentric weights, shape (p, 3).
    areas_m2
        Area that a point stands for [m2], shape (p,); 0 for corners of divided triangles.

    Raises
    ------
    InputError
        If an edge spans more than 16 spacings.
    """
    corners = nodes_m[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    if longest.max() > MOST_DIVISIONS * spacing_m:
        raise InputError(
            "touch_edge_m",
            "be shorter under this tool",
            f"an edge of {1e3 * longest.max():.4g} mm, more than {MOST_DIVISIONS} times {1e3 * spacing_m:.4g} mm",
            "mesh the touchable surface finer, or take a larger tool",
        )
    division = np.maximum(np.ceil(longest / spacing_m - 1e-9), 1).astype(int)
    node_area = np.zeros(len(nodes_m))
    np.add.at(node_area, faces[division == 1], area[division == 1, None] / 3.0)
    named, first = np.unique(faces, return_index=True)
    face, weights, areas = [first // 3], [np.eye(3)[first % 3]], [node_area[named]]
    for n in np.unique(division[division > 1]):
        i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        up = np.column_stack([i, j])[i + j < n] + 1.0 / 3.0
        down = np.column_stack([i, j])[i + j < n - 1] + 2.0 / 3.0
        inner = np.vstack([up, down]) / n
        inner = np.column_stack([1.0 - inner.sum(axis=1), inner])
        wide = np.flatnonzero(division == n)
        face.append(np.repeat(wide, n * n))
        weights.append(np.tile(inner, (len(wide), 1)))
        areas.append(np.repeat(area[wide] / n**2, n * n))
    order = np.argsort(np.concatenate(face), kind="stable")
    return (
        np.concatenate(face)[order].astype(np.int32), np.concatenate(weights)[order], np.concatenate(areas)[order]
    )  # fmt: skip
