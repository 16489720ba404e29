"""Bone surfaces from files: determination of the unit, and repair of the triangles.

A surface that does not enclose a solid raises an error.
"""

from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array, Ints, Triangles, compact
from meshes.base.errors import InputError, counted, require_positive
from meshes.surfaces.repair import (
    Holes,
    drop_debris,
    edge_counts,
    fill_holes,
    merge_vertices,
    orient,
)
from meshes.surfaces.triangle_files import read_triangles, require_triangles

_MERGE_TOLERANCE = 1e-6
"""Largest distance of merged vertices, relative to the longest side of the bounding box.

STL files round coordinates to 6e-8 of the longest side.
"""
_DEBRIS_AREA = 0.01
"""Area of a piece, relative to the largest piece, below which the piece is removed as debris."""
_HOLE_AREA = 0.03
"""Ratio of hole area to surface area above which a hole is a missing part, not a defect."""
_CAP_M2 = 1e-5
"""Area [m2] above which a closed hole is reported as a cap.

A cap is a face that closes a hole. The true shape of the bone at a cap is unknown, which matters if
the tool is near the cap.
"""
_FLATTEST = 1e-3
"""Ratio of smallest to largest spread of points below which the points count as coplanar."""
_FARTHEST = 1e100
"""Limit above which coordinates count as infinite. Squares of larger values may overflow."""
_SMALLEST_MM = 1.0
_LARGEST_MM = 1000.0
"""Limits of a surface's longest side [mm] if the user gives a scale.

The limits, `_SMALLEST_MM` and `_LARGEST_MM`, allow a bone chip and twice the length of a femur.
"""
_UNITS = (("millimetres", 1.0, 5.0, 700.0), ("metres", 1000.0, 0.005, 0.7))
"""Units that can be guessed: name, length [mm], and range of a bone's longest side in this unit.

For both units, the range corresponds to 5 to 700 mm.
"""
_OTHER_UNITS = (("centimetres", 10.0), ("inches", 25.4))
"""Name and length [mm] of further units, for surfaces that are too small in millimetres."""
_USUAL_BONE_MM = (60.0, 600.0)
"""Usual range of the longest side of a scanned bone [mm].

If a size is unusual, a warning names the units in which the longest side would be in this range.
"""
_RESOLVED_MM = 0.01
"""Rounding error [mm] above which a warning is given: a tenth of the finest voxel size."""
_TYPICAL_BONE_MM = 140.0
"""Longest side [mm] that a bone gets from a suggested scale, equal to the size of a scapula."""


class UnitError(InputError):
    """Error for a surface whose size does not fit its unit.

    `suggested_mm` is the longest side [mm] that the surface gets from the scale in the message.
    """

    # The constructor keeps the arguments of the base class, because errors of workers are pickled.
    suggested_mm: float = inf


@dataclass(frozen=True)
class SurfaceReport:
    """Properties of a surface file, and changes that were made to the surface.

    Attributes
    ----------
    source
        File name, or the origin of the surface.
    scale_mm
        Millimetres per unit of the file.
    unit_guess
        Phrase that describes how the unit was determined.
    size_mm
        Sides of the bounding box [mm].
    volume_mm3
        Enclosed volume [mm3].
    repairs
        Changes, one sentence each.
    """

    source: str
    scale_mm: float
    unit_guess: str
    size_mm: tuple[float, float, float]
    volume_mm3: float
    repairs: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Surface:
    """Closed triangle surface with outward normals, in the frame of its file.

    Attributes
    ----------
    vertices_m
        Vertices [m], shape (n, 3), float64.
    faces
        Vertex indices of the triangles, shape (m, 3), int64.
    report
        Properties of the file, and changes to the surface.
    caps_m
        Points [m], one array of shape (k, 3) for each face that closes a hole of more than 10 mm2.
        The scan of the bone may end at such a hole.
    scanned
        Vertices [m] and triangles of the scanned surface. Faces that close holes are not included.
        The axes of a site are computed from these triangles.
    """

    vertices_m: Array
    faces: Ints
    report: SurfaceReport
    caps_m: tuple[Array, ...]
    scanned: Triangles


def read_surface(
    path: str | Path,
    *,
    scale_mm: float | None = None,
    cut_off: bool = False,
) -> Surface:
    """Read a surface from an STL, OBJ, PLY, VTK or VTP file, and repair it to enclose a solid.

    Parameters
    ----------
    path
        File. Its suffix determines the format.
    scale_mm
        Millimetres per unit of the file. If None, the unit is guessed from the longest side of the
        bounding box (5 to 700: millimetres; 0.005 to 0.7: metres; otherwise an error is raised).
    cut_off
        Whether the bone may be cut off by the edge of the scan. If true, a large hole is closed by
        a face. Otherwise, a large hole raises an error.

    Raises
    ------
    InputError
        If the file is missing, empty, not readable or has an unknown format. The error is also
        raised if the surface cannot be repaired to enclose a solid with a size of 1 mm to 1 m.
    """
    file = Path(path)
    notes: list[str] = []
    vertices, faces = read_triangles(file, notes)
    surface = surface_from_triangles(
        vertices,
        faces,
        source=file.name,
        scale_mm=scale_mm,
        cut_off=cut_off,
    )
    repairs = (*notes, *surface.report.repairs)
    return replace(surface, report=replace(surface.report, repairs=repairs))


def surface_from_triangles(
    vertices: Array,
    faces: Ints,
    *,
    source: str = "triangles",
    scale_mm: float | None = None,
    cut_off: bool = False,
    every_piece: bool = False,
) -> Surface:
    """Repair triangles so that they enclose a solid.

    The result is in metres and has merged vertices, outward normals, no debris and no holes.

    Parameters
    ----------
    vertices
        Vertices [file units], shape (n, 3).
    faces
        Vertex indices of the triangles, shape (m, 3).
    source, scale_mm, cut_off
        As in `read_surface`.
    every_piece
        Whether all separate pieces are kept. If false, pieces with less than 1 % of the largest
        piece's area are removed.

    Raises
    ------
    InputError
        As in `read_surface`.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    faces = np.asarray(faces, dtype=np.int64)
    require_triangles(vertices, faces, source)
    _require_finite(vertices, source)
    used, _ = compact(vertices, faces)
    longest = float(np.ptp(used, axis=0).max())
    _require_thickness(used, longest, source)
    scale, guess = _unit(longest, scale_mm, source)
    longest *= 1e-3 * scale
    repairs = _rounding(used, scale)
    vertices, faces = _merged(
        1e-3 * scale * vertices, faces, longest, every_piece=every_piece, repairs=repairs
    )
    scanned = len(faces)
    (vertices, faces), holes, volume = _closed(
        vertices, faces, source, cut_off=cut_off, repairs=repairs
    )
    # The volume of a two-sided sheet is only a rounding error. Small pieces of a long structure may
    # have less volume.
    if volume <= (0.0 if every_piece else 1e-6 * longest**3):
        raise InputError(
            "surface",
            "enclose a solid",
            f"{1e9 * volume:.3g} mm3 inside {source}",
            "close it in a mesh editor",
        )
    x, y, z = (1e3 * np.ptp(vertices, axis=0)).tolist()
    report = SurfaceReport(source, scale, guess, (x, y, z), 1e9 * volume, tuple(repairs))
    return Surface(vertices, faces, report, holes.caps, (vertices, faces[:scanned]))


def _require_finite(vertices: Array, source: str) -> None:
    """Raise an error for vertices that are not finite or implausibly far from the origin."""
    if not -_FARTHEST < vertices.min() <= vertices.max() < _FARTHEST:
        bad = int((~(np.abs(vertices) < _FARTHEST).all(axis=1)).sum())
        raise InputError(
            "vertices",
            "be finite",
            f"{bad} of {len(vertices)} vertices that are not finite in {source}",
            "export it again",
        )


def _merged(
    vertices: Array, faces: Ints, longest: float, *, every_piece: bool, repairs: list[str]
) -> Triangles:
    """Merge vertices and, unless `every_piece` is set, remove small separate pieces.

    `longest` is the longest side of the bounding box [m]. Sentences on changes are appended to
    `repairs`.
    """
    before = len(vertices)
    vertices, faces = merge_vertices(vertices, faces, _MERGE_TOLERANCE * longest)
    if before > len(vertices):
        repairs.append(
            f"Merged or dropped {before - len(vertices)} of {before} vertices that coincide "
            "or are unused."
        )
    if not every_piece:
        (vertices, faces), dropped = drop_debris(vertices, faces, _DEBRIS_AREA)
        if dropped:
            pieces = counted(len(dropped), "loose piece")
            repairs.append(f"Dropped {pieces}, the largest {1e3 * max(dropped):.3g} mm long.")
    return vertices, faces


def _closed(
    vertices: Array, faces: Ints, source: str, *, cut_off: bool, repairs: list[str]
) -> tuple[Triangles, Holes, float]:
    """Close the holes, and return triangles with outward normals, holes and volume [m3].

    For each change of the surface, a sentence is appended to `repairs`.

    Raises
    ------
    InputError
        If a large hole is open and `cut_off` is False.
    """
    faces, turned, inside_out, volume = orient(vertices, faces)
    if turned:
        repairs.append(f"Turned {turned} of {len(faces)} triangles to agree with their neighbours.")
    scanned = len(faces)
    open_edges, shared_edges = edge_counts(faces)
    edges = f"{open_edges} open and {shared_edges} non-manifold edges"
    (vertices, faces), holes = fill_holes(vertices, faces, _HOLE_AREA, least_cap=_CAP_M2)
    if holes.large and not cut_off:
        raise InputError(
            "surface",
            "enclose a solid",
            f"{edges} in {source}, with a largest hole of {1e6 * holes.largest_area:.3g} mm2",
            "close it in a mesh editor",
        )
    if len(faces) > scanned:
        faces, _, outward, volume = orient(vertices, faces)
        inside_out += outward
    if inside_out:
        repairs.append("Turned the surface outward: it was wound inward.")
    if holes.filled:
        repairs.append(
            f"Closed {counted(holes.filled, 'hole')} along {edges}, the largest "
            f"{1e6 * holes.largest_area:.3g} mm2."
        )
    if holes.large:
        repairs.append(
            f"The bone is cut off at {counted(holes.large, 'large hole')}, each closed by a face."
        )
    return (vertices, faces), holes, volume


def _require_thickness(points: Array, longest: float, source: str) -> None:
    """Raise an error for points that lie in a plane or on a line."""
    covariance = np.cov(points.T, bias=True)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))
    if not longest > 0.0 or spread[0] < _FLATTEST * spread[2]:
        raise InputError(
            "surface", "have thickness", f"a flat surface in {source}", "use a closed surface"
        )


def _rounding(points: Array, scale_mm: float) -> list[str]:
    """Return a list with a warning if points are too far from the origin for single precision."""
    farthest = float(np.abs(points).max())
    rounding_mm = scale_mm * float(np.spacing(np.float32(farthest)))
    is_single = np.array_equal(points.astype(np.float32), points)
    if not is_single or rounding_mm <= _RESOLVED_MM:
        return []
    return [
        f"The surface lies {1e-3 * scale_mm * farthest:.3g} m from the origin, where single "
        f"precision rounds to {rounding_mm:.2g} mm: move it to the origin before the export."
    ]


def _unit(longest: float, scale_mm: float | None, source: str) -> tuple[float, str]:
    """Determine the millimetres per file unit from the longest side of the bounding box.

    `longest` is the length of this side in file units. Also return a phrase that describes how the
    unit was determined.

    Raises
    ------
    InputError
        If the size of the bone is impossible with the given scale, or no scale is given and the
        size does not determine the unit.
    """
    plain = [
        (name, scale) for name, scale, lowest, highest in _UNITS if lowest <= longest <= highest
    ]
    suggestion = plain[0][1] if plain else float(f"{_TYPICAL_BONE_MM / longest:.2g}")
    if scale_mm is not None:
        scale = require_positive(
            "anatomy.scale_mm", scale_mm, "use 1 for millimetres, 1000 for metres"
        )
        if not _SMALLEST_MM <= longest * scale <= _LARGEST_MM:
            error = UnitError(
                "anatomy.scale_mm",
                "make the longest side 1 mm to 1 m",
                f"{scale:g}, which makes {source} {longest * scale:g} mm long",
                f"use about {suggestion:g}",
            )
            error.suggested_mm = suggestion * longest
            raise error
        size = f"{longest * scale:.4g} mm"
        return scale, f"{scale:g} mm per unit, as given: the longest side is {size}"
    others = [
        f"in {unit} it would be {factor * longest:.3g} mm, scale_mm = {factor:g}"
        for unit, factor in _OTHER_UNITS
        if _USUAL_BONE_MM[0] <= factor * longest <= _USUAL_BONE_MM[1]
    ]
    if not plain:
        error = UnitError(
            "anatomy.scale_mm",
            (
                f"be given for {source}, because its longest side of {longest:.3g} fits a bone "
                "neither in millimetres nor in metres"
            ),
            "none",
            "; ".join([f"use the millimetres per unit, for example {suggestion:g}", *others]),
        )
        error.suggested_mm = suggestion * longest
        raise error
    name, scale = plain[0]
    guess = f"{name}, since the longest side {longest:.3g} would be {longest * scale:.3g} mm"
    if name == "millimetres" and longest < _USUAL_BONE_MM[0] and others:
        guess += f" ({'; '.join(others)}: set anatomy.scale_mm to be sure)"
    return scale, guess
