"""A mesh of facets within a curved surface given the volume that the surface encloses."""

from dataclasses import replace

import numpy as np

from meshes.tets.checks import signed_volumes
from meshes.tets.tetrahedra import TetMesh

__all__ = ["with_volume"]

_STEPS = 8
"""Moves at most: each leaves the square of what was off, or holds nodes of tetrahedra that it would flatten."""
_OFF = 1e-6
"""Share of the volume that may be missing after them, else nothing is moved."""
_LEAST_KEPT = 0.2
"""Share of its volume that every tetrahedron must keep."""


def with_volume(mesh: TetMesh, volume_m3: float, *, within_m: float) -> TetMesh:
    """The mesh with its surface moved along the normals by one distance, so that it encloses a volume.

    Nodes of tetrahedra too small to follow stay where they are.

    Parameters
    ----------
    mesh
        A mesh whose facets cut the corners of what it stands for.
    volume_m3
        Volume to enclose [m3].
    within_m
        Farthest that the surface may move [m]; where it would move farther, it stays.
    """
    moved, free = mesh, np.ones(len(mesh.nodes_m))
    for _ in range(_STEPS):
        corners = moved.nodes_m[moved.surface]
        areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros_like(mesh.nodes_m)
        np.add.at(normals, moved.surface.ravel(), np.repeat(areas, 3, axis=0))
        normals *= (free / (np.linalg.norm(normals, axis=1) + 1e-300))[:, None]
        gained = float((areas * normals[moved.surface].mean(axis=1)).sum())
        off = volume_m3 - float(moved.volumes_m3.sum())
        nodes = moved.nodes_m + off / (gained + 1e-300) * normals
        if np.linalg.norm(nodes - mesh.nodes_m, axis=1).max() > within_m:
            return mesh
        flat = signed_volumes(nodes, mesh.cells) < _LEAST_KEPT * mesh.volumes_m3
        if flat.any():
            free[mesh.cells[flat]] = 0.0
        else:
            moved = replace(moved, nodes_m=nodes)
    return moved if abs(off) < _OFF * volume_m3 else mesh
