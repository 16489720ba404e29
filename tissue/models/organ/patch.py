"""The part of an organ's surface that a tool touches along its path."""

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.fem.space import Space
from tissue.models.organ.probe import ProbeShape

__all__ = ["linear_triangles", "touchable_patch"]

MARGIN_EDGES = 0.25
"""Edges of the mesh beyond the tool's path within which the surface may be touched."""


def touchable_patch(space: Space, probe: ProbeShape, tips_m: Array, rotations: Array) -> tuple[Ints, Ints]:
    """Surface nodes near a tool's path, shape (t,), and the triangles between them, shape (f, 3), by their places.

    Parameters
    ----------
    space
        The organ's nodes and cells.
    probe
        The tool.
    tips_m, rotations
        Poses along the path: tips [m], shape (p, 3), and tool to world, shape (p, 3, 3).

    Raises
    ------
    InputError
        If the tool touches nothing along the path.
    """
    triangles = linear_triangles(space.faces)
    centres = space.nodes_m[triangles].mean(axis=1)
    reach = np.linalg.norm(space.nodes_m[triangles] - centres[:, None], axis=2).max(axis=1)
    nearest = np.full(len(triangles), np.inf)
    for tip, turn in zip(tips_m, rotations, strict=True):
        nearest = np.minimum(nearest, probe.distance((centres - tip) @ turn)[0])
    if not (nearest < reach).any():
        low, high = (
            ", ".join(f"{1e3 * v:.4g}" for v in corner) for corner in (centres.min(axis=0), centres.max(axis=0))
        )
        raise InputError(
            "motion",
            "bring the tool to the organ",
            "a tool that never touches it",
            f"move it to the organ between ({low}) and ({high}) mm",
        )
    chosen = triangles[nearest < reach * (1.0 + 2.0 * MARGIN_EDGES)]
    nodes, places = np.unique(chosen, return_inverse=True)
    return nodes.astype(np.int64), places.reshape(-1, 3).astype(np.int64)


def linear_triangles(faces: Ints) -> Ints:
    """Faces of three nodes as they are, of six (corners, then middles of edges 01, 12, 02) as four triangles each."""
    if faces.shape[1] == 3:
        return faces
    parts = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    return faces[:, parts].reshape(-1, 3)
