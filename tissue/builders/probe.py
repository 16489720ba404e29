"""The probe that a scene's tool describes, and the surface of an organ that it touches along its motion."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, names_of_caller
from meshes.shapes.polyline import arc_length, points_along
from meshes.tets.tetrahedra import TetMesh
from tissue.builders.parts import FILE_WORDS
from tissue.models.organ.probe import CylinderProbe, ProbeShape, ShellProbe, SphereProbe
from tissue.motion.motion import Motion
from tissue.scene.tool import Probe

if TYPE_CHECKING:
    from tissue.fem.space import Space

__all__ = ["cylinder", "require_outside", "shell", "shell_note", "sphere", "touchable_surface"]

POSES_TRIED = 200
"""Poses along a motion at which the organ is looked for."""
MARGIN_EDGES = 0.25
"""Edges of the mesh beyond the tool's path within which the surface may be touched."""


def sphere(tool: Probe) -> SphereProbe:
    """A ball."""
    return SphereProbe(0.5e-3 * tool.diameter_mm)


def cylinder(tool: Probe) -> CylinderProbe:
    """The flat end of a cylinder, its edge rounded."""
    radius = 0.5e-3 * tool.diameter_mm
    return CylinderProbe(radius, min(0.1 * radius, 5e-4))


def shell(tool: Probe) -> ShellProbe:
    """A closed surface from a file.

    Raises
    ------
    InputError
        If its file is missing, or holds no closed surface.
    """
    file = Path(tool.file or "")
    if not file.is_file():
        raise InputError(f"tool.file must exist, got {file}: check the path")
    try:
        with names_of_caller(dict.fromkeys(("mesh", *FILE_WORDS), "tool.file")):
            return ShellProbe.from_mesh(file, scale=1e-3 * tool.scale_mm)
    except InputError:
        raise
    except Exception as problem:  # trimesh's readers raise whatever their format's parser does
        raise InputError(
            f"tool.file must be a surface that can be read, got {file.name} (damaged or cut off): export it as STL"
        ) from problem


def shell_note(tool: Probe, probe: ShellProbe) -> str:
    """The unit in which a probe's file was taken, and the size that gives."""
    sides = " x ".join(f"{1e3 * side:.3g}" for side in np.ptp(probe.points_m, axis=0))
    return f"{Path(tool.file or '').name} taken at {tool.scale_mm:g} mm per unit: {sides} mm"


def touchable_surface(space: "Space", probe: ProbeShape, motion: Motion) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
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
