"""Measurement of a tool's distance from structures: surfaces of files, or anatomy shapes."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kernels.tool_distance import TOLERANCE_M
from meshes.base.arrays import Array
from meshes.base.errors import InputError, names_of_caller
from meshes.base.placement import Placement
from meshes.base.progress import Progress
from meshes.shapes.sdf import Shape, shape_triangles
from meshes.surfaces.surface import read_surface
from meshes.voxels.mesh_sampling import triangle_distance
from tissue.cutters.body import body_points
from tissue.cutters.cutter import Cutter
from tissue.models.keep_clear import Distance, KeepClear, Structure
from tissue.motion.motion import Motion
from tissue.scene.scene import KeepClear as Wanted
from tissue.simulation.builders.parts import FILE_WORDS
from tissue.simulation.builders.voxels import swept_box

__all__ = ["distance_from", "keep_clear", "slack_note", "structure_of_file"]

MARGIN_M = 10e-3
"""Margin beyond the scripted motion, since a hand may leave it [m]."""
POINTS_ACROSS = 12.0
"""Number of points of the tool's surface over its radius, for pictures."""


def keep_clear(
    wanted: Wanted,
    shapes: Mapping[str, Shape],
    cutter: Cutter,
    motion: Motion,
    *,
    placement: Placement | None,
    notes: dict[str, str],
    report: Progress,
) -> KeepClear:
    """Build the measurement of a cutter's distance from the structures that a scene names.

    Parameters
    ----------
    shapes
        Structures that the anatomy knows, in the frame of the scene, by name.
    placement
        Pose of the scene in the frame of the anatomy's file; None where both frames are the same.

    Raises
    ------
    InputError
        If the anatomy has no such structure, or a file cannot be used.
    """
    points = body_points(cutter.profile, spacing_m=cutter.profile.radius_m / POINTS_ACROSS)
    low, high = swept_box(points, motion, MARGIN_M)
    distances: dict[str, Distance] = {}
    found: dict[str, Structure] = {}
    for name in wanted.names:
        if name not in shapes:
            known = (
                f"must be one of {', '.join(shapes)}"
                if shapes
                else "must be left out for an anatomy without any"
            )
            raise InputError(
                f"keep_clear.names {known}, got {name}: give its surface in [keep_clear.files]"
            )
        report(f"meshing the surface of {name}", 0.0)
        distances[name] = shapes[name].distance
        found[name] = Structure(*shape_triangles(shapes[name], low, high))
    for name, file in wanted.files.items():
        report(f"reading the surface of {name}", 0.0)
        found[name], repairs = _of_file(name, file, placement)
        distances[name] = distance_from(found[name])
        if repairs:
            notes[f"surface of {name}"] = repairs
    notes |= {f"keep clear of {name}": slack_note(structure) for name, structure in found.items()}
    return KeepClear(cutter.profile, found, distances, points_m=points, box_m=np.array([low, high]))


def slack_note(structure: Structure) -> str:
    """Return a note on the accuracy of the distances from a structure."""
    below_mm = 1e3 * (structure.slack_m + float(TOLERANCE_M))
    return f"its distance is in the trace, exact or up to {below_mm:.2g} mm too small"


def structure_of_file(file: Path, *, scale_mm: float) -> tuple[Structure, str]:
    """Read a closed surface with all its pieces; also return the repairs made."""
    surface = read_surface(file, scale_mm=scale_mm, cut_off=True, every_piece=True)
    return Structure(surface.vertices_m, surface.faces), " ".join(surface.report.repairs)


def distance_from(structure: Structure) -> Distance:
    """Return a function for the signed distance from a structure anywhere, for pictures."""
    return lambda points: triangle_distance(structure.vertices_m, structure.faces, points)


def _of_file(name: str, file: str, placement: Placement | None) -> tuple[Structure, str]:
    """Read a structure from a file, in the scene's frame; also return the repairs made."""
    unit = 1.0 if placement is None else placement.unit_mm
    with names_of_caller(dict.fromkeys(FILE_WORDS, f"keep_clear.files.{name}")):
        structure, repairs = structure_of_file(Path(file), scale_mm=unit)
    if placement is not None:
        vertices: Array = 1e-3 * placement.to_scene(1e3 * structure.vertices_m / unit)
        structure = Structure(vertices, structure.faces)
    return structure, repairs
