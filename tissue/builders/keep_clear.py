"""Build what a tool's distance from structures is measured by: their surfaces from files, or shapes of the anatomy."""

from collections.abc import Mapping
from math import prod
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, names_of_caller
from meshes.base.placement import Placement
from meshes.base.progress import Progress
from meshes.shapes.sdf import Shape
from meshes.surfaces.surface import read_surface
from meshes.voxels.mesh_sampling import triangle_distance
from tissue.builders.parts import FILE_WORDS
from tissue.builders.voxels import swept_box
from tissue.cutters.body import body_points
from tissue.cutters.cutter import Cutter
from tissue.models.keep_clear import Distance, DistanceField, KeepClear
from tissue.motion.motion import Motion
from tissue.scene.keep_clear import KeepClear as Wanted

__all__ = ["SPACING_M", "distance_field", "keep_clear"]

SPACING_M = 0.4e-3
"""Of the lattice: interpolation between its points is off by 0.005 mm on a canal of 4 mm radius."""
MOST_POINTS = 1.5e6
MARGIN_M = 1e-3
POINTS_ACROSS = 12.0
"""Points of the tool's surface over its radius: between them a ball is off by 0.1 % of its radius."""


def keep_clear(
    wanted: Wanted,
    shapes: Mapping[str, Shape],
    cutter: Cutter,
    motion: Motion,
    *,
    placement: Placement | None,
    compute: str,
    notes: dict[str, str],
    report: Progress,
) -> KeepClear:
    """What measures a cutter's distance from the structures that a scene names.

    Parameters
    ----------
    shapes
        Structures that the anatomy knows, in the frame of the scene, by name.
    placement
        Where the scene lies in the frame of the anatomy's file; None where both are one.

    Raises
    ------
    InputError
        If the anatomy knows no such structure, or a file cannot be used.
    """
    points = body_points(cutter.profile, spacing_m=cutter.profile.radius_m / POINTS_ACROSS)
    low, high = swept_box(points, motion, MARGIN_M)
    distances: dict[str, Distance] = {}
    for name in wanted.names:
        if name not in shapes:
            known = f"must be one of {', '.join(shapes)}" if shapes else "must be left out for an anatomy without any"
            raise InputError(f"keep_clear.names {known}, got {name}: give its surface in [keep_clear.files]")
        distances[name] = shapes[name].distance
    for name, file in wanted.files.items():
        report(f"measuring the distance from {name}", 0.0)
        distances[name], repairs = _of_file(name, file, placement)
        if repairs:
            notes[f"surface of {name}"] = repairs
    fields = {name: distance_field(distance, low, high) for name, distance in distances.items()}
    for name, field in fields.items():
        least = 1e3 * float(field.values_m.min())
        notes[f"keep clear of {name}"] = (
            f"at least {least:.3g} mm from all that the tool can reach"
            if least > 0.0
            else "the tool can reach it; its distance is in the trace"
        )
    return KeepClear(points, fields, distances, device=compute)


def _of_file(name: str, file: str, placement: Placement | None) -> tuple[Distance, str]:
    """Signed distance from all pieces of a surface in a file, in the frame of the scene, and what was mended."""
    unit = 1.0 if placement is None else placement.unit_mm
    with names_of_caller(dict.fromkeys(FILE_WORDS, f"keep_clear.files.{name}")):
        surface = read_surface(Path(file), scale_mm=unit, cut_off=True, every_piece=True)
    vertices = surface.vertices_m
    if placement is not None:
        vertices = 1e-3 * placement.to_scene(1e3 * vertices / unit)
    faces = surface.faces
    return lambda points: triangle_distance(vertices, faces, points), " ".join(surface.report.repairs)


def distance_field(distance: Distance, low_m: Array, high_m: Array) -> DistanceField:
    """Distance on a lattice over a box [m], as fine as `SPACING_M` where that is at most `MOST_POINTS` points."""
    sides = high_m - low_m
    spacing = max(SPACING_M, (prod(sides.tolist()) / MOST_POINTS) ** (1.0 / 3.0))
    count = np.ceil(sides / spacing).astype(int) + 1
    grid = np.moveaxis(np.indices(count), 0, -1).reshape(-1, 3) * spacing + low_m
    values = np.asarray(distance(grid), dtype=np.float32).reshape(count)
    return DistanceField(np.asarray(low_m), spacing, values)
