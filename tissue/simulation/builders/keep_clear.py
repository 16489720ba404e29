"""Build the objects that watch the tool's distance to structures and its exit from the region."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress
from meshes.base.text_tables import shown
from meshes.shapes.sdf import Shape, shape_triangles
from meshes.voxels.mesh_sampling import triangle_distance
from tissue.models.bone.region_end import RegionEnd
from tissue.models.keep_clear import (
    DEEP_OVERLAP_ERROR_M,
    DISTANCE_ERROR_M,
    MANY_TRIANGLES,
    OVERLAP_ERROR_M,
    Distance,
    KeepClear,
    Structure,
)
from tissue.models.tissue_model import StopsReporting
from tissue.scene.anatomy import BlockImage, CutAnatomy, MolarSurfaces
from tissue.scene.scene import KeepClear as Wanted
from tissue.scene.scene import Scene
from tissue.simulation.builders.arguments import surface_of
from tissue.simulation.builders.parts import Parts, swept_box
from tissue.simulation.builders.voxels import is_procedural, solid_of, structures

MARGIN_M = 10e-3
"""Assumed margin around the scripted motion [m], because a hand may leave the path."""


def watch(scene: Scene, parts: Parts, *, report: Progress) -> None:
    """Add to the parts of a milling scene the two objects that watch the tool.

    The first object measures the distance from the structures that the scene names. The second
    object reports when the tool leaves the simulated region.

    Raises
    ------
    InputError
        If the anatomy does not have a named structure, or a file cannot be used.
    """
    if scene.keep_clear is not None:
        parts.keep_clear = _keep_clear(scene.keep_clear, scene.bone, parts, report=report)
    whole = isinstance(scene.anatomy, BlockImage) and scene.anatomy.is_whole
    # The region contains all of a scripted motion, and all of an image that is not cut out.
    if scene.device is None or whole:
        return
    assert parts.volume is not None
    assert parts.cutter is not None
    tissue = None
    if is_procedural(scene.bone):
        anatomy, hole = solid_of(scene, parts.motion)
        tissue = anatomy.shape if hole is None else anatomy.shape - hole
    reporters = (parts.tissue, parts.keep_clear)
    parts.region_end = RegionEnd(
        parts.volume,
        parts.cutter,
        margin_mm=scene.voxels.margin_mm,
        tissue=tissue,
        reporters=tuple(each for each in reporters if isinstance(each, StopsReporting)),
    )


def _keep_clear(
    wanted: Wanted, anatomy: CutAnatomy, parts: Parts, *, report: Progress
) -> KeepClear:
    """Build the object that measures a cutter's distance from the structures that a scene names."""
    assert parts.cutter is not None
    profile = parts.cutter.profile
    placement = parts.placement
    low, high = swept_box(parts.cutter.coarse_surface_m(), parts.motion, MARGIN_M)
    distances: dict[str, Distance] = {}
    found: dict[str, Structure] = {}
    shapes = require_structures(wanted, anatomy)
    files = {f"keep_clear.files.{name}": (name, file) for name, file in wanted.files.items()}
    for name in wanted.names:
        if name in anatomy.structure_files:
            files[f"anatomy.{name}_file"] = name, anatomy.structure_files[name]
            continue
        report(f"meshing the surface of {name}", 0.0)
        distances[name] = shapes[name].distance
        found[name] = Structure(*shape_triangles(shapes[name], low, high))
    for key, (name, file) in files.items():
        report(f"reading the surface of {name}", 0.0)
        unit = 1.0 if placement is None else placement.unit_mm
        surface = surface_of(key, Path(file), unit, is_part=True)
        vertices: Array = surface.vertices_m
        if placement is not None:
            vertices = 1e-3 * placement.to_scene(1e3 * vertices / unit)
        found[name] = Structure(vertices, surface.faces)
        distances[name] = partial(triangle_distance, vertices, surface.faces)
        if surface.report.repairs:
            parts.notes[f"surface of {name}"] = " ".join(surface.report.repairs)
    slack_m = max(structure.slack_m for structure in found.values())
    deep = ""
    if any(len(structure.faces) > MANY_TRIANGLES for structure in found.values()):
        deep = f" ({1e3 * (slack_m + DEEP_OVERLAP_ERROR_M):.2g} mm if it is more than 1 mm deep)"
    parts.notes["keep clear"] = (
        "distances in the trace are lower bounds. The error is at most "
        f"{1e3 * (slack_m + DISTANCE_ERROR_M):.2g} mm, and in a breach at most "
        f"{1e3 * (slack_m + OVERLAP_ERROR_M):.2g} mm{deep}. Both errors are larger if tens of "
        "thousands of triangles have the same distance from the tool"
    )
    return KeepClear(
        profile,
        found,
        distances,
        box_m=np.array([low, high]),
        margin_m=1e-3 * wanted.margin_mm,
    )


def require_structures(wanted: Wanted, anatomy: CutAnatomy) -> Mapping[str, Shape]:
    """Check the requested structure names, and return the procedural structures of an anatomy.

    Raises
    ------
    InputError
        If the anatomy does not have a named structure.
    """
    shapes = structures(anatomy)
    for name in wanted.names:
        if name not in anatomy.structure_files and name not in shapes:
            raise _unknown_structure(name, anatomy, shapes)
    return shapes


def _unknown_structure(name: str, anatomy: CutAnatomy, shapes: Mapping[str, Shape]) -> InputError:
    """Return the error for a name that does not belong to a structure of the anatomy."""
    known = [*shapes, *anatomy.structure_files]
    remedy = f"give a surface of {name} in [keep_clear.files]"
    if known:
        remedy = f"use {known[0]}, or {remedy}"
    elif name == "pulp" and isinstance(anatomy, MolarSurfaces):
        remedy = "set anatomy.pulp_file"
    named = f"structures of the anatomy ({', '.join(known)})"
    if not known:
        named = "left out, because the anatomy has no structures"
    return InputError("keep_clear.names", f"be {named}", shown(name), remedy)
