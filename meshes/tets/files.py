"""Tetrahedral meshes of soft organs, from a file, a mesh object or a closed surface."""

from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, by, names_of_caller, require_file, require_positive
from meshes.base.extras import install_command
from meshes.base.isolated_parser import Answer, parse_isolated
from meshes.base.progress import Progress, silent
from meshes.surfaces.surface import Surface, surface_from_triangles
from meshes.surfaces.vtk_files import outer_triangles, read_vtk
from meshes.tets.msh import (
    MOST_PARTS,
    StoredMesh,
    broken_sections,
    is_old_text,
    part_name,
    read_msh,
)
from meshes.tets.tetrahedra import TetMesh
from meshes.tets.tetrahedralise import tetrahedralise

_ORGAN_MM = (20.0, 450.0)
"""Range of the longest side of an organ [mm], from a small gland to an enlarged liver.

The range determines the unit, because no number is in this range both in millimetres and in metres.
"""
_TYPICAL_MM = 200.0
"""Longest side [mm] that an organ gets from a suggested scale, equal to the size of a liver."""
_PER_UNIT = "use 1 for millimetres, 1000 for metres"
_PART_ARRAYS = (
    "part",
    "gmsh:physical",
    "medit:ref",
    "parts",
    "region",
    "regions",
    "MaterialIds",
    "material",
    "label",
)
"""Names of cell arrays in which programs write part numbers, the most probable name first."""
_SIZES_MM = (1.5, 1500.0)
"""Range of the longest side of a plausible organ [mm].

Below this range, the unit is probably metres. Above this range, the unit is probably micrometres.
"""
_STRAIGHT = "Took the corners of quadratic tetrahedra: their edges became straight."
_NO_FACES = np.zeros((0, 3), dtype=np.int64)
_NO_TETS = np.zeros((0, 4), dtype=np.int64)
_TETRAHEDRON = 10
_QUADRATIC_TETRAHEDRON = 24
"""VTK cell types of linear and quadratic tetrahedra."""


@dataclass(frozen=True, eq=False)
class TetFile:
    """Mesh read from a file, with notes.

    Attributes
    ----------
    mesh
        Mesh in the frame of the file, in metres.
    unit_mm
        Millimetres per unit of the file.
    sentences
        Sentences that describe the unit, findings in the mesh, and changes of the mesh.
    surface
        Surface from the file if this surface was filled with tetrahedra; None if the file contains
        tetrahedra.
    """

    mesh: TetMesh
    unit_mm: float
    sentences: tuple[str, ...]
    surface: Surface | None = None


def read_tets(
    path: str | Path,
    *,
    unit_mm: float | None = None,
    edge_m: float | None = None,
    report: Progress = silent,
) -> TetFile:
    """Read a tetrahedral mesh, or read a closed surface and fill it with tetrahedra.

    Gmsh text files of versions 1 and 2 (``.msh``) are read by `meshes.tets.msh`, other Gmsh files
    by meshio, and all other formats by pyvista. In a file with tetrahedra, cells that are not
    tetrahedra are ignored. The part of each cell is read from a cell array with a usual name, such
    as ``gmsh:physical``, ``part`` or ``region``. The field ``part_names``, if present, contains the
    names of the part numbers 0, 1, ... in the array ``part``.

    Parameters
    ----------
    path
        File. Its suffix determines the format.
    unit_mm
        Millimetres per unit of the file. If None, the unit is millimetres or metres, whichever
        gives a bounding box whose longest side is 20 to 450 mm.
    edge_m
        Edge length [m] of the tetrahedra that fill a surface. If None, an edge that gives about
        30,000 tetrahedra is chosen.
    report
        Function that is called with the current task's name and finished fraction (0 to 1).

    Raises
    ------
    InputError
        If the file is missing, empty or not readable, or does not contain a solid. If `unit_mm` is
        None, the error is also raised for a solid that has the size of an organ neither in
        millimetres nor in metres.
    """
    file = Path(path)
    stored = _read_stored(file)
    scale, why = _unit(np.ptp(stored.used, axis=0), unit_mm, file.name)
    if len(stored.tets):
        mesh, sentences = stored.repaired(scale)
        return TetFile(mesh, scale, (why, *sentences))
    surface = surface_from_triangles(
        stored.points, stored.triangles, source=file.name, scale_mm=scale
    )
    mesh, sentences = tetrahedralise(surface, edge_m=edge_m, report=report)
    return TetFile(mesh, scale, (why, *surface.report.repairs, *sentences), surface)


def _read_stored(file: Path) -> StoredMesh:
    """Read the content of a mesh file, in the units and with the node numbers of the file."""
    require_file(file, "a mesh")
    if file.suffix.lower() == ".msh":
        found = read_msh(file) if is_old_text(file) else _read_by_meshio(file)
    else:
        facts, arrays = parse_isolated(
            "meshes.tets.files:vtk_mesh",
            file,
            what="mesh",
            remedy="export it as .vtu, .vtk, .msh or .stl",
        )
        names = {int(number): name for number, name in facts["names"]}
        fields: dict[str, Any] = arrays
        found = StoredMesh(**fields, names=names, notes=tuple(facts["notes"]))
    if len(found.tets) == 0 and len(found.triangles) == 0:
        got = f"none in {file.name}"
        raise InputError("file", "contain tetrahedra or triangles", got, "mesh the solid first")
    return found


def _read_by_meshio(file: Path) -> StoredMesh:
    """Read a Gmsh file of version 4, or a binary Gmsh file."""
    try:
        from meshio.gmsh import read
    except ImportError:
        raise InputError(
            f"file: {file.name} is a Gmsh file of version 4 or binary, which meshio reads, but "
            f"meshio is not installed. Run {install_command('gmsh')}, or save the file with "
            "gmsh -format msh22."
        ) from None
    # meshio prints warnings, such as missing physical groups
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        try:
            return _of_blocks(read(file))
        except (InputError, MemoryError):
            raise
        except Exception as problem:  # meshio raises many types of errors for a damaged file
            raise broken_sections(file) from problem


def _unit(size: Array, unit_mm: float | None, name: str) -> tuple[float, str]:
    """Return the millimetres per file unit, and a sentence on the unit.

    `size` contains the sides of the bounding box in file units.
    """
    longest = float(size.max())
    if unit_mm is None:
        for scale, unit in ((1.0, "millimetres"), (1000.0, "metres")):
            if _ORGAN_MM[0] <= longest * scale <= _ORGAN_MM[1]:
                sides = by(scale * size, ".3g")
                return scale, f"{name} names no unit and was taken to be in {unit}: {sides} mm."
        raise InputError(
            "anatomy.scale_mm",
            (
                f"be given for {name}, because its size of {by(size, '.3g')} fits an organ "
                "neither in millimetres nor in metres"
            ),
            "none",
            (
                f"use the millimetres per unit, for example {_TYPICAL_MM / longest:.2g} for a "
                f"length of {_TYPICAL_MM:g} mm"
            ),
        )
    scale = require_positive("anatomy.scale_mm", unit_mm, _PER_UNIT)
    note = f"{name} was read at {scale:g} mm per unit, as given: {by(scale * size, '.3g')} mm"
    if not _ORGAN_MM[0] <= longest * scale <= _ORGAN_MM[1]:
        note += f", which is not the size of an organ ({_ORGAN_MM[0]:g} to {_ORGAN_MM[1]:g} mm)"
    return scale, f"{note}."


@dataclass(frozen=True, eq=False)
class GivenTets:
    """Mesh that the caller passed, and the repaired mesh for the simulation.

    Attributes
    ----------
    points_mm
        Points [mm], shape (n, 3), in the caller's numbering.
    mesh
        Tetrahedra [m], repaired if necessary.
    sentences
        Findings and changes, one sentence each.
    """

    points_mm: Array
    mesh: TetMesh
    sentences: tuple[str, ...]


def given_tets(
    mesh: object, *, scale_mm: float | None = None, part_names: Mapping[int, str] | None = None
) -> GivenTets:
    """Return the tetrahedra of a mesh, which may be any supported object or file.

    Parameters
    ----------
    mesh
        One of: a `TetMesh`; a pyvista UnstructuredGrid; a meshio mesh, or an object with attributes
        ``points`` and ``cells`` of the same form; a pair of arrays, points (n, 3) and cells (m, 4);
        a file (.vtu, .vtk, .msh, .mesh). The part of each cell is read from a cell array of numbers
        or names. The array is named ``part`` or has a name that meshing programs use, such as
        ``gmsh:physical``.
    scale_mm
        Millimetres per unit of the mesh. If None, the mesh is in millimetres, and its size is
        checked.
    part_names
        Names of numbered parts.

    Raises
    ------
    InputError
        If the mesh has no tetrahedra, has a size that indicates another unit, or cannot be
        repaired.
    """
    if isinstance(mesh, TetMesh):
        return GivenTets(1e3 * mesh.nodes_m, mesh, ())
    stored = _stored(mesh)
    if not len(stored.tets):
        raise InputError(
            "mesh", "contain tetrahedra", "none", "fill a surface with tetrahedra by from_surface"
        )
    stored.names.update(part_names or {})
    with names_of_caller(dict.fromkeys(("nodes", "nodes_m", "cells"), "mesh")):
        scale = require_millimetres("mesh", stored.used, scale_mm)
        return GivenTets(scale * stored.points, *stored.repaired(scale))


def require_millimetres(name: str, points: Array, scale_mm: float | None) -> float:
    """Return the number of millimetres per unit of the coordinates in `points`.

    The result is the given value, or 1 if the size of the points is plausible in millimetres.

    Raises
    ------
    InputError
        If `scale_mm` is None and the size is not plausible. The message suggests a plausible scale.
    """
    if scale_mm is not None:
        return require_positive("scale_mm", scale_mm, _PER_UNIT)
    sides = np.ptp(points, axis=0)
    if not _SIZES_MM[0] <= float(sides.max()) <= _SIZES_MM[1]:
        unit, scale = ("metres", 1000) if sides.max() < _SIZES_MM[0] else ("micrometres", 0.001)
        raise InputError(
            name,
            "be in millimetres",
            f"sides of {by(sides, '.3g')}, which look like {unit}",
            f"give scale_mm={scale}, or scale_mm=1 if the size is right",
        )
    return 1.0


def _stored(mesh: object) -> StoredMesh:
    """Return the points, tetrahedra and part numbers of any supported mesh object."""
    if isinstance(mesh, str | Path):
        with names_of_caller({"file": "mesh"}):
            return _read_stored(Path(mesh))
    if hasattr(mesh, "celltypes") and hasattr(mesh, "cell_data"):
        return _of_grid(mesh, "mesh")
    if hasattr(mesh, "points") and hasattr(mesh, "cells"):
        return _of_blocks(mesh)
    if not isinstance(mesh, tuple | list) or len(mesh) != 2:
        raise InputError(
            "mesh",
            "be a pyvista grid, a meshio mesh, a tuple (points, cells) or a file",
            type(mesh).__name__,
            "pass arrays as (points, cells)",
        )
    points, cells = (np.asarray(each) for each in mesh)
    if points.ndim != 2 or points.shape[1] != 3 or cells.ndim != 2 or cells.shape[1] != 4:
        raise InputError(
            "mesh",
            "be points of shape (n, 3) and cells of shape (m, 4)",
            f"{points.shape} and {cells.shape}",
            "give the four corners of each tetrahedron",
        )
    part = np.zeros(len(cells), dtype=np.int64)
    return StoredMesh(points.astype(np.float64), cells.astype(np.int64), _NO_FACES, part, {})


def vtk_mesh(file: Path) -> Answer:
    """Read a mesh with VTK, in the process that `meshes.base.isolated_parser` starts.

    The result consists of the arrays of a `StoredMesh` and a dictionary with its part names (as
    pairs) and its notes.
    """
    import pyvista

    data = read_vtk(file)
    found = _of_grid(data.combine() if isinstance(data, pyvista.MultiBlock) else data, file.name)
    arrays = {name: getattr(found, name) for name in ("points", "tets", "triangles", "part")}
    return {"names": list(found.names.items()), "notes": found.notes}, arrays


def _of_grid(data: Any, source: str) -> StoredMesh:
    """Return the tetrahedra of a pyvista dataset, or its surface if it has no tetrahedra."""
    kinds = np.asarray(getattr(data, "celltypes", ()))
    present = [kind for kind in (_TETRAHEDRON, _QUADRATIC_TETRAHEDRON) if kind in kinds]
    if not present:
        surface = outer_triangles(data)
        points = surface["points"].astype(np.float64)
        faces = surface["triangles"].astype(np.int64)
        return StoredMesh(points, _NO_TETS, faces, np.zeros(0, dtype=np.int64), {})
    order = np.concatenate([np.flatnonzero(kinds == kind) for kind in present])
    cells = [np.asarray(data.cells_dict[kind])[:, :4] for kind in present]
    known: dict[int, str] = {}
    listed = np.asarray(data.field_data.get("part_names", ()))
    for number, text in enumerate(listed.ravel().tolist() if listed.dtype.kind == "U" else ()):
        known[number] = part_name(text, known, f"part_names of {source}")
    values = {name: np.asarray(data.cell_data[name])[order] for name in data.cell_data}
    part, names = _parts(values, len(order), known)
    notes = []
    if len(kinds) > len(order):
        notes.append(f"Left out {len(kinds) - len(order)} cells that are not tetrahedra.")
    if _QUADRATIC_TETRAHEDRON in present:
        notes.append(_STRAIGHT)
    points = np.asarray(data.points, dtype=np.float64)
    tets = np.concatenate(cells).astype(np.int64)
    return StoredMesh(points, tets, _NO_FACES, part, names, tuple(notes))


def _of_blocks(mesh: Any) -> StoredMesh:
    """Return the tetrahedra of a meshio mesh.

    A meshio mesh contains blocks of cells, one cell type per block, and cell arrays by name.
    """
    chosen = [k for k, block in enumerate(mesh.cells) if block.type in ("tetra", "tetra10")]
    tets = [np.asarray(mesh.cells[k].data)[:, :4] for k in chosen]
    cells = np.concatenate([_NO_TETS, *tets]).astype(np.int64)
    surfaces = [np.asarray(block.data)[:, :3] for block in mesh.cells if block.type == "triangle"]
    faces = np.concatenate([_NO_FACES, *surfaces]).astype(np.int64)
    data = {
        name: np.concatenate([np.asarray(rows[k]) for k in chosen])
        for name, rows in (mesh.cell_data if chosen else {}).items()
    }
    solids: dict[int, str] = {}
    for name, row in (getattr(mesh, "field_data", None) or {}).items():
        # In Gmsh, groups of all dimensions have names and numbers.
        if int(row[1]) == 3:
            solids[int(row[0])] = part_name(name, solids, "physical volumes of the mesh")
    part, names = _parts(data, len(cells), solids)
    left = sum(len(block.data) for block in mesh.cells) - len(cells)
    notes = [f"Left out {left} elements that are not tetrahedra."] if left and len(cells) else []
    if any(mesh.cells[k].type == "tetra10" for k in chosen):
        notes.append(_STRAIGHT)
    points = np.asarray(mesh.points, dtype=np.float64)
    return StoredMesh(points, cells, faces, part, names, tuple(notes))


def _parts(
    data: Mapping[str, NDArray[Any]], count: int, named: dict[int, str]
) -> tuple[Ints, dict[int, str]]:
    """Return the part number of each cell, shape (m,), and the names of the part numbers.

    The field ``part_names`` names the numbers 0, 1, ... in the array ``part``. Names from meshio
    belong to the numbers in the array ``gmsh:physical``.
    """
    for array in _PART_ARRAYS:
        values = data.get(array, np.zeros(0))
        if values.shape != (count,) or not count:
            continue
        if values.dtype.kind in "USO":
            names, part = np.unique(values.astype(str), return_inverse=True)
            return part.reshape(-1), dict(enumerate(names.tolist()))
        whole = np.isfinite(values).all() and (values == np.round(values)).all()
        if whole and len(np.unique(values)) <= MOST_PARTS:
            return values.astype(np.int64), named
    return np.zeros(count, dtype=np.int64), {}
