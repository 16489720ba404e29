"""Organ filled with tetrahedra, from a surface with inclusions or from an image's labels."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from meshes.base.errors import InputError, names_of_caller, require_positive
from meshes.base.progress import Progress
from meshes.surfaces.surface import Surface
from meshes.tets.stuffing import with_inclusion
from meshes.voxels.mesh_sampling import triangle_distance
from tissue.simulation.builders.organ_given import surface_of
from tissue.simulation.builders.organ_made import MadeOrgan, made_of, material_of

__all__ = ["of_labels", "of_surface"]

ENVELOPE = 0.1
"""Largest overlap of inclusions beyond their surroundings, over the edge length.

The mesher moves a surface by up to this distance.
"""


def of_surface(
    surface: object,
    stated: dict[str, Any],
    *,
    edge_mm: float | None,
    inclusions: Mapping[str, object],
    scale_mm: float | None,
    report: Progress,
) -> MadeOrgan:
    """Return an organ inside a closed surface, with its inclusions as parts.

    Raises
    ------
    InputError
        If a surface is not closed or not in millimetres, or an inclusion sticks out, overlaps
        another one or has no modulus.
    """
    from meshes.tets.tetrahedralise import FILL_EDGES, tetrahedralise

    without = [name for name in inclusions if name not in (stated.get("parts") or {})]
    if without:
        raise InputError(
            "parts", "give a modulus of every inclusion", f"none of {without[0]}", "add it in kPa"
        )
    # refuse invalid materials before meshing, which takes minutes
    material_of(stated, ("body", *inclusions))
    outer = surface_of("surface", surface, scale_mm)
    usual = max(outer.report.size_mm) / FILL_EDGES
    edge = usual if edge_mm is None else require_positive("edge_mm", edge_mm, f"use {usual:.2g}")
    inner = {
        name: surface_of(f"inclusions[{name!r}]", each, scale_mm)
        for name, each in inclusions.items()
    }
    _require_apart(outer, inner, 1e-3 * ENVELOPE * edge)
    with names_of_caller({"edge_m": "edge_mm"}):
        mesh, sentences = tetrahedralise(outer, edge_m=1e-3 * edge, report=report)
    notes = {"mesh": " ".join((*outer.report.repairs, *sentences))}
    for name, each in inner.items():
        with names_of_caller({name: f"inclusions[{name!r}]"}):
            mesh, notes[name] = with_inclusion(
                mesh, name, each.vertices_m, each.faces, volume_m3=1e-9 * each.report.volume_mm3
            )
    return made_of(mesh, notes, stated, surface=outer)


def of_labels(
    labels: object,
    stated: dict[str, Any],
    *,
    organ: str,
    names: str | Path | None,
    edge_mm: float | None,
    report: Progress,
) -> MadeOrgan:
    """Return an organ of a label image; its parts are the labels that have a modulus.

    Raises
    ------
    InputError
        If there is no such label, a part does not lie at the organ, or a value is out of its range.
    """
    from meshes.ct.labels import Labels, read_labels
    from meshes.organs.from_labels import labelled_organ

    parts = stated.get("parts") or {}
    with names_of_caller({"path": "labels"}):
        known = (
            labels if isinstance(labels, Labels) else read_labels(Path(str(labels)), names=names)
        )
    organ = known.names[known.number(organ)]
    stated = stated | {
        "parts": {known.names[known.number(str(name))]: each for name, each in parts.items()}
    }
    material_of(stated, (organ, *stated["parts"]))
    found = labelled_organ(known, organ, [name for name in stated["parts"] if name != organ])
    mesh, notes = found.mesh(edge_mm, report=report)
    return made_of(mesh, notes, stated, surface=found.surface)


def _require_apart(outer: Surface, inclusions: Mapping[str, Surface], off_m: float) -> None:
    """Refuse inclusions that overlap each other or stick out of the organ by over `off_m` [m]."""
    for name, each in inclusions.items():
        key = f"inclusions[{name!r}]"
        out = triangle_distance(outer.vertices_m, outer.faces, each.vertices_m)
        if out.min() > 0.0:
            raise InputError(key, "lie inside the surface", "all of it outside", "move it")
        if out.max() > off_m:
            raise InputError(
                key,
                "lie inside the surface",
                f"it up to {1000.0 * float(out.max()):.3g} mm outside",
                "move it, or cut it off there",
            )
        for other, before in inclusions.items():
            if other == name:
                break
            pairs = ((before, each), (each, before))
            deep = max(
                -float(triangle_distance(a.vertices_m, a.faces, b.vertices_m).min())
                for a, b in pairs
            )
            if deep > off_m:
                raise InputError(
                    key,
                    f"not reach into inclusions[{other!r}]",
                    f"it {1000.0 * deep:.3g} mm deep",
                    "subtract one from the other",
                )
