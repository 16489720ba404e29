"""Probe that a scene's tool describes, and its poses along the motion."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, is_file, names_of_caller
from meshes.paths.toolpath import arc_length, kept_corners, points_along
from meshes.tets.tetrahedra import TetMesh
from tissue.models.organ.probe import CylinderProbe, ProbeShape, ShellProbe, SphereProbe
from tissue.motion.motion import Motion
from tissue.scene.registry import PROBES
from tissue.scene.tool import Probe
from tissue.simulation.builders.parts import FILE_WORDS

__all__ = [
    "cylinder",
    "poses_along",
    "probe_of",
    "require_outside",
    "shell",
    "shell_note",
    "sphere",
]

POSES_TRIED = 200
"""Number of poses along a motion at which contact with the organ is searched for."""


def sphere(tool: Probe) -> SphereProbe:
    """Return a ball."""
    return SphereProbe(0.5e-3 * tool.size_mm)


def cylinder(tool: Probe) -> CylinderProbe:
    """Return the flat end of a cylinder with a rounded edge."""
    radius = 0.5e-3 * tool.size_mm
    return CylinderProbe(radius, min(0.1 * radius, 5e-4))


def shell(tool: Probe) -> ShellProbe:
    """Read a closed surface from a file.

    Raises
    ------
    InputError
        If its file is missing, or holds no closed surface.
    """
    file = Path(tool.file_name)
    if not is_file(file):
        raise InputError("tool.file", "exist", file, "check the path")
    try:
        with names_of_caller(dict.fromkeys(("mesh", *FILE_WORDS), "tool.file")):
            return ShellProbe.from_mesh(file, scale=1e-3 * tool.scale)
    except InputError:
        raise
    except Exception as problem:  # trimesh's readers raise whatever their format's parser does
        raise InputError(
            "tool.file",
            "be a surface that can be read",
            f"{file.name} (damaged or cut off)",
            "export it as STL",
        ) from problem


def shell_note(tool: Probe, probe: ShellProbe) -> str:
    """Return a note on the unit assumed for a probe's file, and the resulting size."""
    sides = " x ".join(f"{1e3 * side:.3g}" for side in np.ptp(probe.points_m, axis=0))
    return f"{Path(tool.file_name).name} taken at {tool.scale:g} mm per unit: {sides} mm"


def probe_of(tool: Probe) -> ProbeShape:
    """Return the shape that a scene's tool describes."""
    make = PROBES[tool.kind].make
    if make is not None:
        shape: ProbeShape = make(tool)
        return shape
    return {"sphere-probe": sphere, "cylinder-probe": cylinder, "shell-probe": shell}[tool.kind](
        tool
    )


def poses_along(
    motion: Motion, within_m: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return poses along a motion at which contact with the organ is searched for.

    They are tips [m], shape (p, 3), and turns, shape (p, 3, 3).

    Parameters
    ----------
    motion
        Motion of the tool.
    within_m
        Largest distance of an omitted corner of the track from the remaining track [m]. A log has
        one corner each tick.
    """
    corners = motion.sweep_m()
    turns = motion.rotations()
    along = arc_length(corners)
    corner = along[kept_corners(corners, within_m)]
    wanted = np.unique(np.concatenate([np.linspace(0.0, along[-1], POSES_TRIED), corner]))
    return points_along(corners, wanted), turns[
        np.searchsorted(along, wanted).clip(max=len(turns) - 1)
    ]


def require_outside(mesh: TetMesh, motion: Motion) -> None:
    """Refuse a tool whose tip starts inside the organ.

    The contact refuses a probe that only overlaps the organ.
    """
    tip = motion.sweep_m()[0]
    corners = mesh.nodes_m[mesh.cells]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    weights = np.linalg.solve(edges, (tip - corners[:, 0])[:, :, None])[:, :, 0]
    if ((weights >= 0.0).all(axis=1) & (weights.sum(axis=1) <= 1.0)).any():
        at = ", ".join(f"{1e3 * value:.4g}" for value in tip)
        raise InputError(
            "motion", "start outside the organ", f"a tip inside it at ({at}) mm", "start higher"
        )
