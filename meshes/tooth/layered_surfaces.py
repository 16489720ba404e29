"""A tooth from one closed surface per layer: placed, its overlaps and gaps measured and resolved, a socket added."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, names_of_caller, require_range
from meshes.base.placement import Placement
from meshes.base.simplices import cross_products
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from meshes.surfaces.repair import Triangles
from meshes.surfaces.site import Site, sample_surface
from meshes.surfaces.surface import Surface, read_surface
from meshes.tooth.checks import require_known, require_pulp_within, require_tooth_size, require_touching
from meshes.tooth.layer_contact import PITCH_M, LayerContact, inside_lattice, measure_contact
from meshes.tooth.layered_solid import Lattice, LayeredSolid, joined, socket_lattice
from meshes.tooth.layers import PRIORITY, TOOTH_LAYERS
from meshes.tooth.lesion_site import lesion_site
from meshes.tooth.site import tooth_axes
from meshes.voxels.column_crossings import column_crossings
from meshes.voxels.voxelise import voxelise

__all__ = ["layered_anatomy", "layered_surfaces"]

_SAMPLE_PITCH_M, _MOST_SAMPLES = 0.1e-3, 300_000
_LESION_M = 0.15e-3


def layered_surfaces(
    paths_by_layer: Mapping[str, str | Path],
    *,
    scale_mm: float | None = None,
    socket_mm: float = 0.0,
    at_lesion: bool = False,
) -> Anatomy:
    """Tooth from surface files, one closed surface per layer, in one common frame and unit.

    Parameters
    ----------
    paths_by_layer
        File by layer name; enamel and dentin at least.
    scale_mm
        Millimetres per unit of the files; None: guessed from the dentin, used for all.
    socket_mm, at_lesion
        As in `layered_anatomy`.

    Raises
    ------
    InputError
        If a file cannot be used, or as in `layered_anatomy`.
    """
    require_known(paths_by_layer, "paths_by_layer")
    dentin = _read("dentin", paths_by_layer["dentin"], scale_mm)
    scale = dentin.report.scale_mm
    surfaces = {name: dentin if name == "dentin" else _read(name, path, scale) for name, path in paths_by_layer.items()}
    return layered_anatomy(surfaces, socket_mm=socket_mm, at_lesion=at_lesion)


def _read(layer: str, path: str | Path, scale_mm: float | None) -> Surface:
    """The surface of a layer; an error of its file names the layer."""
    with names_of_caller({word: f"{layer} {word}" for word in ("file", "surface", "vertices", "faces", "cells")}):
        return read_surface(path, scale_mm=scale_mm)


def layered_anatomy(
    surfaces: Mapping[str, Surface],
    *,
    socket_mm: float = 0.0,
    at_lesion: bool = False,
    at: Site | None = None,
) -> Anatomy:
    """Tooth from closed surfaces by layer name, in the site frame of teeth.

    The origin is where the tooth's long axis through the middle of the enamel leaves the enamel: where a thin bur that
    comes down that axis first touches. z points from the roots to the crown, x along the wider direction of the roots.
    A voxel shared by layers belongs to the one that holds its centre, so it is full; the layers keep their volumes. Of
    two layers the first of `meshes.tooth.layers.PRIORITY` has what both claim and the gap between them.

    Parameters
    ----------
    surfaces
        Surfaces by layer name; enamel and dentin at least. The dentin may be hollow or hold the pulp.
    socket_mm
        Thickness of bone added around the ligament [mm], 0 (none) to 10: the points nearer to the ligament than to the
        rest of the tooth.

    at_lesion
        Whether the origin lies over the lesion, see `meshes.tooth.lesion_site.lesion_site`.
    at
        The site in the frame of the surfaces, where it is known.

    Raises
    ------
    InputError
        If a layer is unknown, enamel or dentin is missing, the size is no tooth's, layers do not touch, the pulp lies
        outside the dentin, or a socket is asked for without a ligament.
    """
    require_known(surfaces, "surfaces")
    margin = _socket_margin(surfaces, socket_mm)
    order = [name for name in PRIORITY if name in surfaces]
    samples = {name: _spread(surface) for name, surface in surfaces.items()}
    require_touching(samples, {name: (surface.vertices_m, surface.faces) for name, surface in surfaces.items()})
    scale = surfaces["dentin"].report.scale_mm
    if "bone" not in surfaces:
        size_mm = 1e3 * float(np.ptp(np.concatenate(list(samples.values())), axis=0).max())
        require_tooth_size(size_mm, "scale_mm", f"{scale:g}", size_mm / scale)
    if at_lesion:
        upright = layered_anatomy(surfaces)
        assert upright.placement is not None
        found = lesion_site(voxelise(upright, spacing_m=_LESION_M))
        return layered_anatomy(surfaces, socket_mm=socket_mm, at=found.within(upright.placement))
    centre, rotation, note = _site(surfaces, samples) if at is None else (at.centre_m, at.rotation, at.confidence)
    placed = {name: ((surfaces[name].vertices_m - centre) @ rotation, surfaces[name].faces) for name in surfaces}
    samples = {name: (points - centre) @ rotation for name, points in samples.items()}
    origin, contact = _contact(placed, order)
    if "pulp" in surfaces:
        require_pulp_within(samples["pulp"], placed["dentin"], samples["dentin"])
    gap = Lattice(origin, PITCH_M, contact.gap_layer) if contact.gap_mm3 else None
    solid = _solid({name: placed[name] for name in order}, samples, gap, margin)
    notes = _notes(surfaces, note, contact, order, socket_mm)
    placement = Placement(1e3 * centre, rotation, scale)
    shape = _shape(solid, samples, margin)
    return Anatomy("tooth from surfaces", shape, TOOTH_LAYERS, solid.classify, notes, solid.sample, placement)


def _socket_margin(surfaces: Mapping[str, Surface], socket_mm: float) -> float:
    """Thickness of the bone to add [m]; a refusal where there is no ligament to add it around, or bone is given."""
    margin = 1e-3 * require_range("socket_mm", socket_mm, 0.0, 10.0, "use 2.5, or 0 for none")
    if margin > 0.0 and ("ligament" not in surfaces or "bone" in surfaces):
        raise InputError(
            "socket_mm",
            "be 0 without a ligament or with a bone surface",
            f"{socket_mm:g}",
            "add the ligament, or leave the socket out",
        )
    return margin


def _solid(
    placed: Mapping[str, Triangles],
    samples: Mapping[str, NDArray[np.float64]],
    gap: Lattice | None,
    margin: float,
) -> LayeredSolid:
    """The layers placed in the site frame, the first with the highest priority, with a socket of this margin [m]."""
    from scipy.spatial import cKDTree

    layer = np.concatenate([np.full(len(samples[name]), TOOTH_LAYERS.index(name), np.uint8) for name in samples])
    socket = None
    if margin > 0.0:
        others = np.concatenate([points for name, points in samples.items() if name != "ligament"])
        socket = socket_lattice(samples["ligament"], others, margin)
    return LayeredSolid(
        {TOOTH_LAYERS.index(name): placed[name] for name in placed},
        joined([placed[name] for name in samples]),
        cKDTree(np.concatenate(list(samples.values()))),
        layer,
        gap,
        socket,
    )


def _shape(solid: LayeredSolid, samples: Mapping[str, NDArray[np.float64]], margin: float) -> Shape:
    """Outer shape of the solid, with bounds around the samples and the socket's margin [m]."""
    points = np.concatenate(list(samples.values()))
    high = np.maximum(points.max(axis=0), samples.get("ligament", points).max(axis=0) + margin)
    return Shape(solid.distance, tuple((points.min(axis=0) - margin).tolist()), tuple(high.tolist()))


def _spread(surface: Surface) -> NDArray[np.float64]:
    """Points about 0.1 mm apart over a surface [m], shape (n, 3)."""
    area = 0.5 * float(np.linalg.norm(cross_products(surface.vertices_m, surface.faces), axis=1).sum())
    count = int(np.clip(area / _SAMPLE_PITCH_M**2, 1000, _MOST_SAMPLES))
    return sample_surface(surface.vertices_m, surface.faces, count).points


def _site(
    surfaces: Mapping[str, Surface], samples: Mapping[str, NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64], str]:
    """Origin [m] and axes of the tooth's site in the frame of the surfaces, and how they were found."""
    body = np.concatenate([points for name, points in samples.items() if name not in ("enamel", "bone")])
    axes = tooth_axes(samples["enamel"], body)
    for name in ("enamel", "dentin"):
        placed = (surfaces[name].vertices_m - axes.middle_m) @ axes.rotation
        found = column_crossings(placed, surfaces[name].faces, np.array([1e-9]), np.array([1e-9]))
        if len(found.height):
            origin = axes.middle_m + found.height.max() * axes.rotation[:, 2]
            return origin, axes.rotation, f"{axes.note}; origin on the {name}"
    raise InputError(
        "layers", "lie on the tooth's long axis", "none of enamel and dentin there", "check which layer is which"
    )


def _contact(placed: Mapping[str, Triangles], order: Sequence[str]) -> tuple[NDArray[np.float64], LayerContact]:
    """First point of the lattice [m], and how the layers fit together on it."""
    low = np.min([vertices.min(axis=0) for vertices, _ in placed.values()], axis=0) - 2.5 * PITCH_M
    high = np.max([vertices.max(axis=0) for vertices, _ in placed.values()], axis=0) + 2.5 * PITCH_M
    axes = [a + PITCH_M * np.arange(int(np.ceil((b - a) / PITCH_M))) for a, b in zip(low, high, strict=True)]
    return low, measure_contact({name: inside_lattice(*placed[name], axes) for name in placed}, order)


def _notes(
    surfaces: Mapping[str, Surface], note: str, contact: LayerContact, order: Sequence[str], socket_mm: float
) -> dict[str, str]:
    """What was found and assumed, for reports."""

    def listed(volumes: Mapping[tuple[str, str], float]) -> str:
        return ", ".join(f"{one} and {other} {volume:.3g} mm3" for (one, other), volume in volumes.items())

    notes = {
        "surfaces": ", ".join(f"{name} {surface.report.volume_mm3:.4g} mm3" for name, surface in surfaces.items()),
        "unit": surfaces["dentin"].report.unit_guess,
        "long axis": note,
        "mesial and buccal": "not distinguished: x is the wider direction of the roots",
        "overlaps": listed(contact.overlap_mm3) or "none",
        "gaps": listed(contact.gap_mm3) or "none",
        "priority": " > ".join(order),
        "densities": "by layer, assumed",
    }
    if contact.void_mm3 > 0.0:
        notes["voids"] = f"{contact.void_mm3:.3g} mm3 enclosed by the layers and in none, left empty"
    if "pulp" not in surfaces:
        notes["pulp"] = "none given: distance and exposure of the pulp are unknown"
    if "ligament" not in surfaces:
        notes["ligament"] = "none given: the tooth has no support but what the scene states"
    if socket_mm > 0.0:
        notes["bone"] = f"{socket_mm:g} mm around the ligament, added"
    return notes
