"""A soft organ from a file: tetrahedra as stored, or a surface filled with them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, by, require_file, require_positive
from meshes.base.isolated_parser import parse_isolated
from meshes.base.progress import Progress, silent
from meshes.surfaces.surface import Surface, surface_from_triangles
from meshes.tets.msh import StoredMesh, part_name, read_msh
from meshes.tets.quality import repair_tets
from meshes.tets.tetrahedra import TetMesh
from meshes.tets.tetrahedralise import tetrahedralise

__all__ = ["MOST_PARTS", "PART_ARRAYS", "TetFile", "read_stored", "read_tets"]

_ORGAN_MM = (20.0, 450.0)
_TYPICAL_MM = 200.0
_UNITS = ((1.0, "millimetres"), (1000.0, "metres"))
PART_ARRAYS = ("gmsh:physical", "medit:ref", "part", "parts", "region", "regions", "MaterialIds", "material", "label")
"""Arrays of integers over the cells that give the parts, by the names that meshers write, the likeliest first."""
MOST_PARTS = 64
"""An array of more values than these is no list of parts."""


@dataclass(frozen=True, eq=False)
class TetFile:
    """A mesh read from a file and how it came to be.

    Attributes
    ----------
    mesh
        The mesh, in the frame of the file, in metres.
    unit_mm
        Millimetres per unit of the file.
    sentences
        The unit, what was found and what was done, a sentence each.
    surface
        The surface in which the tetrahedra were made here; None of tetrahedra as they were stored.
    """

    mesh: TetMesh
    unit_mm: float
    sentences: tuple[str, ...]
    surface: Surface | None = None


def read_tets(
    path: str | Path, *, unit_mm: float | None = None, edge_m: float | None = None, report: Progress = silent
) -> TetFile:
    """Read a tetrahedral mesh, or read a closed surface and fill it with tetrahedra.

    Gmsh text of versions 1 and 2 (``.msh``) is read here, everything else by pyvista, which reads VTK files itself and
    further formats where meshio is installed. Cells other than tetrahedra are left out next to tetrahedra. An array of
    integers over the cells that is named as parts usually are (``gmsh:physical``, ``part``, ``region``, ...) gives the
    parts; of ``part``, texts in the field ``part_names`` are their names, counted from 0.

    Parameters
    ----------
    path
        File; its suffix names the format.
    unit_mm
        Millimetres per unit of the file. None: millimetres or metres, whichever makes the longest side 20 to 450 mm.
    edge_m
        Edge of the tetrahedra that fill a surface [m]; None: about 30,000 of them.
    report
        Called with what is being done and the share of it that is done (0 to 1).

    Raises
    ------
    InputError
        If the file is missing, empty or not readable, holds no solid, or is not of an organ's size in any plain unit.
    """
    file = Path(path)
    stored = read_stored(file)
    used = stored.points[np.unique(stored.tets if len(stored.tets) else stored.triangles)]
    bad = int((~np.isfinite(used).all(axis=1)).sum())
    if bad:
        raise InputError(f"nodes must be finite, got {bad} of {len(used)} that are not in {file.name}: export it again")
    scale, why = _unit(np.ptp(used, axis=0), unit_mm, file.name)
    if len(stored.tets):
        values, part = np.unique(stored.part, return_inverse=True)
        names = tuple(stored.names.get(int(v), f"part {v}") for v in values) if len(values) > 1 else ("body",)
        mesh, repaired = repair_tets(stored.points * (1e-3 * scale), stored.tets, part.reshape(-1), names)
        return TetFile(mesh, scale, (why, *stored.notes, *repaired.sentences()))
    surface = surface_from_triangles(stored.points, stored.triangles, source=file.name, scale_mm=scale)
    filled, sentences = tetrahedralise(surface, edge_m=edge_m, report=report)
    return TetFile(filled, scale, (why, *stored.notes, *surface.report.repairs, *sentences), surface)


def read_stored(file: Path) -> StoredMesh:
    """What a mesh file holds, in its units and as it numbers its nodes; raises as `read_tets`."""
    require_file(file, "a mesh")
    return read_msh(file) if file.suffix.lower() == ".msh" else _from_vtk(file)


def _unit(size: NDArray[np.float64], unit_mm: float | None, name: str) -> tuple[float, str]:
    """Millimetres per file unit and a sentence on how they were found, for a box in file units."""
    longest = float(size.max())
    if unit_mm is None:
        for scale, unit in _UNITS:
            if _ORGAN_MM[0] <= longest * scale <= _ORGAN_MM[1]:
                sides = by(scale * size, ".3g")
                return scale, f"{name} names no unit and was taken to be in {unit}: {sides} mm."
        raise InputError(
            f"anatomy.scale_mm must be given where the unit is not plain, got none for {name}, whose box of "
            f"{by(size, '.3g')} is an organ neither in millimetres nor in metres: give millimetres per unit, "
            f"{_TYPICAL_MM / longest:.2g} would make it {_TYPICAL_MM:g} mm long"
        )
    scale = require_positive("anatomy.scale_mm", unit_mm, "use 1 for millimetres, 1000 for metres")
    note = f"{name} was read at {scale:g} mm per unit, as given: {by(scale * size, '.3g')} mm"
    if not _ORGAN_MM[0] <= longest * scale <= _ORGAN_MM[1]:
        note += f", which is not the size of an organ ({_ORGAN_MM[0]:g} to {_ORGAN_MM[1]:g} mm)"
    return scale, f"{note}."


def _from_vtk(file: Path) -> StoredMesh:
    """A file as pyvista reads it."""
    remedy = "export it as .vtu, .vtk, .msh or .stl"
    facts, arrays = parse_isolated("meshes.surfaces.vtk_reading:vtk_mesh", file, what="mesh", remedy=remedy)
    none = np.zeros((0, 4), dtype=np.int64)
    points, triangles = arrays["points"].astype(np.float64), arrays.get("triangles", none[:, :3])
    tets, names = arrays.get("tets", none), facts.get("names", [])
    if len(tets) == 0 and len(triangles) == 0:
        raise InputError(f"file must hold tetrahedra or triangles, got none in {file.name}: export it again")
    part, notes = np.zeros(len(tets), dtype=np.int64), []
    known: dict[int, str] = {}
    for name in PART_ARRAYS:
        values = arrays[f"cells {names.index(name)}"] if name in names else np.zeros(0)
        whole = values.ndim == 1 and len(values) > 0 and bool(np.isfinite(values).all())
        if whole and (values == np.round(values)).all() and len(np.unique(values)) <= MOST_PARTS:
            part = values.astype(np.int64)
            for number, text in enumerate(facts.get("parts", []) if name == "part" else []):
                known[number] = part_name(text, known, f"part_names of {file.name}", "write them again")
            break
    if facts.get("others"):
        notes.append(f"Left out {facts['others']} cells that are not tetrahedra.")
    if facts.get("quadratic"):
        notes.append("Took the corners of quadratic tetrahedra: their edges became straight.")
    return StoredMesh(points, tets.astype(np.int64), triangles.astype(np.int64), part, known, tuple(notes))
