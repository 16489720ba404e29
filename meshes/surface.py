"""A bone surface from a file: read, given a unit, repaired, and refused where it encloses no solid."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.errors import InputError, require_positive
from meshes.repair import drop_debris, edge_counts, fill_holes, merge_vertices, orient, signed_volume

__all__ = ["SURFACE_SUFFIXES", "Surface", "SurfaceReport", "read_surface", "surface_from_triangles"]

SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".vtp")
_SMALLEST_MM, _LARGEST_MM = 1.0, 1000.0
_UNITS = (("millimetres", 1.0, 5.0, 700.0), ("metres", 1000.0, 0.005, 0.7))
_CENTIMETRES = (6.0, 60.0)
_MERGE_TOLERANCE = 1e-6
_DEBRIS_AREA = 0.01
_HOLE_AREA = 0.03
_FLATTEST = 1e-3
_TYPICAL_BONE_MM = 140.0


@dataclass(frozen=True)
class SurfaceReport:
    """What was found in a surface file and done to it.

    Attributes
    ----------
    source
        File name, or what the surface was made from.
    scale_mm
        Millimetres per unit of the file.
    unit_guess
        How the unit was chosen, a phrase.
    size_mm
        Sides of the bounding box [mm].
    volume_mm3
        Volume enclosed [mm3].
    repairs
        What was changed, a sentence each.
    """

    source: str
    scale_mm: float
    unit_guess: str
    size_mm: tuple[float, float, float]
    volume_mm3: float
    repairs: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed triangle surface, wound outward, in the frame of its file.

    Attributes
    ----------
    vertices_m
        Vertices [m], shape (n, 3), float64.
    faces
        Vertex numbers of the triangles, shape (m, 3), int64.
    report
        Where it came from and what was done to it.
    """

    vertices_m: NDArray[np.float64]
    faces: NDArray[np.int64]
    report: SurfaceReport


def read_surface(path: str | Path, *, scale_mm: float | None = None) -> Surface:
    """Read a surface from STL, OBJ, PLY, VTK or VTP and make it enclose a solid.

    Parameters
    ----------
    path
        File; its suffix names the format.
    scale_mm
        Millimetres per unit of the file; None: guessed from the longest side of the bounding box (5 to 700:
        millimetres; 0.005 to 0.7: metres; anything else is refused).

    Raises
    ------
    InputError
        If the file is missing, empty, of unknown format or not readable, or its surface cannot be made to enclose a
        solid of 1 mm to 1 m.
    """
    file = Path(path)
    if file.suffix.lower() not in SURFACE_SUFFIXES:
        raise InputError(
            f"file must end in {', '.join(SURFACE_SUFFIXES)}, got {file.name}: convert it, or read a "
            "volume with read_volume"
        )
    if not file.is_file():
        raise InputError(f"file must exist, got {file}: check the path, which is taken from the working directory")
    if file.stat().st_size == 0:
        raise InputError(f"file must hold a surface, got the empty file {file.name}: export it again")
    vertices, faces = _read_triangles(file)
    return surface_from_triangles(vertices, faces, source=file.name, scale_mm=scale_mm)


def surface_from_triangles(
    vertices: NDArray[Any], faces: NDArray[Any], *, source: str = "triangles", scale_mm: float | None = None
) -> Surface:
    """Make triangles enclose a solid: one unit, vertices merged, debris dropped, wound outward, small holes filled.

    Parameters
    ----------
    vertices
        Vertices [file units], shape (n, 3).
    faces
        Vertex numbers, shape (m, 3).
    source, scale_mm
        As in `read_surface`.

    Raises
    ------
    InputError
        As in `read_surface`.
    """
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    if len(vertices) == 0 or len(faces) == 0:
        raise InputError(
            f"file must hold triangles, got {len(vertices)} vertices and {len(faces)} triangles in "
            f"{source}: export the surface as triangles"
        )
    bad = int((~np.isfinite(vertices).all(axis=1)).sum())
    if bad:
        raise InputError(
            f"vertices must be finite, got {bad} of {len(vertices)} that are not in {source}: export it again"
        )
    used = vertices[np.unique(faces)]
    longest = float(np.ptp(used, axis=0).max())
    _require_thickness(used, longest, source)
    scale, guess = _unit(longest, scale_mm, source)
    vertices = vertices * (1e-3 * scale)
    longest *= 1e-3 * scale
    vertices, faces, repairs = _repaired(vertices, faces, longest, source)
    size = np.ptp(vertices, axis=0) * 1e3
    report = SurfaceReport(
        source,
        scale,
        guess,
        (float(size[0]), float(size[1]), float(size[2])),
        signed_volume(vertices, faces) * 1e9,
        tuple(repairs),
    )
    return Surface(vertices, faces, report)


def _repaired(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], longest: float, source: str
) -> tuple[NDArray[np.float64], NDArray[np.int64], list[str]]:
    """Vertices [m] and triangles of a closed surface wound outward, and what was done."""
    repairs = []
    before = len(vertices)
    vertices, faces = merge_vertices(vertices, faces, _MERGE_TOLERANCE * longest)
    if before > len(vertices):
        repairs.append(f"Merged or dropped {before - len(vertices)} of {before} vertices that coincide or are unused.")
    (vertices, faces), dropped = drop_debris(vertices, faces, _DEBRIS_AREA)
    if dropped:
        repairs.append(f"Dropped {len(dropped)} loose pieces, the largest {1e3 * max(dropped):.3g} mm long.")
    counts = edge_counts(faces)
    faces, turned, inside_out = orient(vertices, faces)
    if turned:
        repairs.append(f"Turned {turned} of {len(faces)} triangles to agree with their neighbours.")
    (vertices, faces), holes = fill_holes(vertices, faces, _HOLE_AREA)
    if holes.left:
        raise InputError(
            f"surface must enclose a solid, got {counts[0]} open and {counts[1]} non-manifold edges in "
            f"{source}, the largest hole {1e6 * holes.largest_area:.3g} mm2: close it in a mesh editor"
        )
    faces, _, late = orient(vertices, faces)
    if inside_out + late:
        repairs.append("Turned the surface outward: it was wound inward.")
    if holes.filled:
        repairs.append(
            f"Closed {holes.filled} holes along {counts[0]} open and {counts[1]} non-manifold edges, the "
            f"largest {1e6 * holes.largest_area:.3g} mm2."
        )
    if signed_volume(vertices, faces) <= 1e-6 * longest**3:
        raise InputError(
            f"surface must enclose a solid, got {1e9 * signed_volume(vertices, faces):.3g} mm3 inside "
            f"{source}: close it in a mesh editor"
        )
    return vertices, faces, repairs


def _read_triangles(file: Path) -> tuple[NDArray[Any], NDArray[Any]]:
    """Vertices, shape (n, 3), and triangles, shape (m, 3), as stored."""
    try:
        if file.suffix.lower() in (".vtk", ".vtp"):
            return _read_vtk(file)
        import trimesh

        mesh: Any = trimesh.load(file, force="mesh", process=False)
        return np.asarray(mesh.vertices), np.asarray(mesh.faces)
    except InputError:
        raise
    except Exception as problem:  # the readers raise many kinds, none documented
        raise InputError(
            f"file must be a readable {file.suffix.lower()[1:].upper()} surface, got {file.name} "
            f"({type(problem).__name__}): export it again"
        ) from problem


def _read_vtk(file: Path) -> tuple[NDArray[Any], NDArray[Any]]:
    """Triangles of a VTK file; its readers print their complaints, which are kept off the terminal."""
    import pyvista
    import vtk

    shown = vtk.vtkObject.GetGlobalWarningDisplay()
    vtk.vtkObject.SetGlobalWarningDisplay(0)
    try:
        data: Any = pyvista.read(file)
        if not isinstance(data, pyvista.PolyData):
            data = data.extract_surface(algorithm="dataset_surface")
        surface = data.triangulate()
        return np.asarray(surface.points), np.asarray(surface.faces).reshape(-1, 4)[:, 1:]
    finally:
        vtk.vtkObject.SetGlobalWarningDisplay(shown)


def _unit(longest: float, scale_mm: float | None, source: str) -> tuple[float, str]:
    """Millimetres per file unit and how they were found, for a longest side in file units."""
    plain = [scale for _, scale, lowest, highest in _UNITS if lowest <= longest <= highest]
    suggestion = plain[0] if plain else float(f"{_TYPICAL_BONE_MM / longest:.2g}")
    if scale_mm is not None:
        scale = require_positive("anatomy.scale_mm", scale_mm, "use 1 for millimetres, 1000 for metres")
        if not _SMALLEST_MM <= longest * scale <= _LARGEST_MM:
            raise InputError(
                f"anatomy.scale_mm must make the longest side 1 mm to 1 m, got {scale:g}, which makes "
                f"{source} {_length(longest * scale)} long: use about {suggestion:g}"
            )
        return scale, f"{scale:g} mm per unit, as told: the longest side is {longest * scale:.4g} mm"
    for name, scale, lowest, highest in _UNITS:
        if lowest <= longest <= highest:
            guess = f"{name}, since the longest side {longest:.3g} would be {longest * scale:.3g} mm"
            if name == "millimetres" and _CENTIMETRES[0] <= longest <= _CENTIMETRES[1]:
                guess += f" (in centimetres it would be {10 * longest:.3g} mm: set anatomy.scale_mm to be sure)"
            return scale, guess
    raise InputError(
        f"anatomy.scale_mm must be given where the unit is not plain, got none for {source}, whose "
        "longest side "
        f"{longest:.3g} would be {_length(longest)} in millimetres and {_length(1e3 * longest)} in "
        f"metres: use millimetres per unit, for example {suggestion:g}"
    )


def _require_thickness(points: NDArray[np.float64], longest: float, source: str) -> None:
    """Refuse points that lie in a plane or on a line, in any direction."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    if not longest > 0.0 or spread[2] < _FLATTEST * spread[0]:
        raise InputError(f"surface must have thickness, got a flat one in {source}: use a closed surface")


def _length(millimetres: float) -> str:
    """Length in the unit a person would say it in."""
    for name, factor in (("km", 1e6), ("m", 1e3), ("mm", 1.0)):
        if millimetres >= factor:
            return f"{millimetres / factor:.3g} {name}"
    return f"{millimetres * 1e3:.3g} µm"
