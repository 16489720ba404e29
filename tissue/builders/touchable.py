"""The surface of an organ that a tool touches along its motion."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.shapes.polyline import arc_length, points_along
from meshes.tets.tetrahedra import TetMesh
from tissue.motion.motion import Motion

if TYPE_CHECKING:
    from tissue.fem.space import Space
    from tissue.models.organ.probe import Probe

__all__ = ["require_outside", "touchable_surface"]

POSES_TRIED = 200
"""Poses along a motion at which the organ is looked for."""
MARGIN_EDGES = 0.25
"""Edges of the mesh beyond the tool's path within which the surface may be touched."""


def touchable_surface(space: "Space", probe: "Probe", motion: Motion) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Surface nodes near the tool's path, shape (t,), and the triangles between them, shape (f, 3), by their places."""
    triangles = _linear_triangles(space.faces)
    centres = space.nodes_m[triangles].mean(axis=1)
    reach = np.linalg.norm(space.nodes_m[triangles] - centres[:, None], axis=2).max(axis=1)
    corners, turns = motion.sweep_m(), motion.rotations()
    along = arc_length(corners)
    wanted = np.unique(np.concatenate([np.linspace(0.0, along[-1], POSES_TRIED), along]))
    tips = points_along(corners, wanted)
    nearest = np.full(len(triangles), np.inf)
    for tip, turn in zip(tips, turns[np.searchsorted(along, wanted).clip(max=len(turns) - 1)], strict=True):
        nearest = np.minimum(nearest, probe.distance((centres - tip) @ turn)[0])
    if not (nearest < reach).any():
        low, high = (
            ", ".join(f"{1e3 * v:.4g}" for v in corner) for corner in (centres.min(axis=0), centres.max(axis=0))
        )
        raise InputError(
            "motion must bring the tool to the organ, got a tool that never touches it: move it to the organ between "
            f"({low}) and ({high}) mm"
        )
    chosen = triangles[nearest < reach * (1.0 + 2.0 * MARGIN_EDGES)]
    nodes, places = np.unique(chosen, return_inverse=True)
    return nodes.astype(np.int64), places.reshape(-1, 3).astype(np.int64)


def require_outside(mesh: TetMesh, motion: Motion) -> None:
    """Refuse a tool whose tip starts inside the organ; a probe that only overlaps it is refused by the contact."""
    tip = motion.sweep_m()[0]
    corners = mesh.nodes_m[mesh.cells]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    weights = np.linalg.solve(edges, (tip - corners[:, 0])[:, :, None])[:, :, 0]
    if ((weights >= 0.0).all(axis=1) & (weights.sum(axis=1) <= 1.0)).any():
        at = ", ".join(f"{1e3 * value:.4g}" for value in tip)
        raise InputError(f"motion must start outside the organ, got a tip inside it at ({at}) mm: start higher")


def _linear_triangles(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Faces of three nodes as they are, of six (corners, then middles of edges 01, 12, 02) as four triangles each."""
    if faces.shape[1] == 3:
        return faces
    parts = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    return faces[:, parts].reshape(-1, 3)
