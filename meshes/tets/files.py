"""A soft organ from a file: tetrahedra as stored, or a surface filled with them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, by, names_of_caller, require_file, require_positive
from meshes.base.isolated_parser import parse_isolated
from meshes.base.progress import Progress, silent
from meshes.base.text_tables import number_in, visible, whole_number_in
from meshes.surfaces.surface import Surface, surface_from_triangles
from meshes.surfaces.triangle_files import mesh_arrays
from meshes.tets.quality import repair_tets
from meshes.tets.tetrahedra import TetMesh
from meshes.tets.tetrahedralise import tetrahedralise

__all__ = [
    "MOST_PARTS",
    "PART_ARRAYS",
    "GivenTets",
    "StoredMesh",
    "TetFile",
    "given_tets",
    "part_name",
    "read_msh",
    "read_stored",
    "read_tets",
    "require_millimetres",
]

_TRIANGLE = 2
_TETRAHEDRON = 4
_LONGEST_NAME = 60
_OPENINGS = {"$NOD": 1, "$MeshFormat": 2}


@dataclass(frozen=True, eq=False)
class StoredMesh:
    """Content of a file, in its units.

    Attributes
    ----------
    points
        Nodes, shape (n, 3).
    tets, triangles
        Nodes of the tetrahedra and triangles, shapes (m, 4) and (k, 3).
    part
        Part of each tetrahedron, 0 for none, shape (m,).
    names
        Names of the parts that have a name.
    notes
        Omitted content, a sentence each.
    """

    points: Array
    tets: Ints
    triangles: Ints
    part: Ints
    names: dict[int, str]
    notes: tuple[str, ...] = ()


def read_msh(file: Path) -> StoredMesh:
    """Read a Gmsh text file of version 1 (``$NOD``) or 2 (``$MeshFormat`` 2.x).

    Raises
    ------
    InputError
        If the file is of another version, binary, cut short, names nodes it does not hold, or holds
        no solid.
    """
    content = file.read_bytes()
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    lines = [line.rstrip("\r") for line in text.split("\n")]
    version = _OPENINGS.get(lines[0].strip(), 0)
    if version == 2:
        form = lines[1].split() if len(lines) > 1 else []
        if len(form) < 2 or not form[0].startswith("2") or form[1] != "0":
            raise InputError(
                "file",
                "be Gmsh text of version 1 or 2",
                f"version {' '.join(form[:2])} in {file.name}",
                "save it with gmsh -format msh22",
            )
    if version == 0:
        raise InputError(
            "file", "be Gmsh text of version 1 or 2", f"neither in {file.name}", "export it again"
        )
    try:
        numbers, points = _nodes(_section(lines, "$NOD" if version == 1 else "$Nodes"))
        elements = [
            [whole_number_in(x) for x in line.split()]
            for line in _section(lines, "$ELM" if version == 1 else "$Elements")
        ]
        # Version 1: number kind physical elementary count nodes; version 2: number kind
        # count-of-tags tags nodes.
        begins = [5 if version == 1 else 3 + element[2] for element in elements]
        in_tets = [element for element in elements if element[1] == _TETRAHEDRON]
        part = [
            element[2] if version == 1 else (element[3] if element[2] else 0) for element in in_tets
        ]
        names = _names(_section(lines, "$PhysicalNames"), file) if "$PhysicalNames" in lines else {}
        tets = _of_kind(elements, begins, _TETRAHEDRON, 4)
        triangles = _of_kind(elements, begins, _TRIANGLE, 3)
    except InputError:
        raise
    except (ValueError, IndexError, OverflowError) as problem:
        raise InputError(
            "file",
            "hold whole sections of nodes and elements",
            f"a broken one in {file.name}",
            "export it again",
        ) from problem
    order = np.argsort(numbers)
    places = []
    for wanted in (tets, triangles):
        found = order[np.minimum(np.searchsorted(numbers, wanted, sorter=order), len(numbers) - 1)]
        if (numbers[found] != wanted).any():
            unknown = int(wanted[numbers[found] != wanted][0])
            raise InputError(
                "elements", "name nodes of the file", f"{unknown} in {file.name}", "export it again"
            )
        places.append(found)
    if len(tets) == 0 and len(triangles) == 0:
        raise InputError(
            "file", "hold tetrahedra or triangles", f"none in {file.name}", "mesh it in Gmsh first"
        )
    left = len(elements) - len(tets)
    notes = (f"Left out {left} elements that are not tetrahedra.",) if left and len(tets) else ()
    return StoredMesh(points, places[0], places[1], np.array(part, dtype=np.int64), names, notes)


def _section(lines: list[str], opening: str) -> list[str]:
    """Return the lines of a section after its count, as many as the count states."""
    start = lines.index(opening)
    count = whole_number_in(lines[start + 1])
    body = lines[start + 2 : start + 2 + count]
    if len(body) < count or any(line.startswith("$") for line in body):
        raise ValueError(opening)
    return body


def _nodes(lines: list[str]) -> tuple[Ints, Array]:
    rows = [line.split() for line in lines]
    if not rows or any(len(row) < 4 for row in rows):
        raise ValueError("nodes")
    numbers = np.array([whole_number_in(row[0]) for row in rows], dtype=np.int64)
    if len(np.unique(numbers)) != len(numbers):
        raise ValueError("nodes of one number")
    return numbers, np.array([[number_in(x) for x in row[1:4]] for row in rows])


def _of_kind(elements: list[list[int]], begins: list[int], kind: int, corners: int) -> Ints:
    chosen = [e[b:] for e, b in zip(elements, begins, strict=True) if e[1] == kind]
    if any(len(each) != corners for each in chosen):
        raise ValueError("elements")
    return np.array(chosen, dtype=np.int64).reshape(-1, corners)


def _names(lines: list[str], file: Path) -> dict[int, str]:
    """Read names of physical volumes: dimension, number, "name"."""
    names: dict[int, str] = {}
    for line in lines:
        dimension, number, name = line.split(maxsplit=2)
        if whole_number_in(dimension) != 3:
            continue
        name = name.strip().removeprefix('"').removesuffix('"')
        names[whole_number_in(number)] = part_name(
            name, names, f"physical volumes of {file.name}", "name them otherwise in Gmsh"
        )
    return names


def part_name(text: str, known: Mapping[int, str], what: str, remedy: str) -> str:
    """Return the name of a part as a file has it, which no other part has.

    Raises
    ------
    InputError
        If the name is empty, too long, or used by another part.
    """
    shown = visible(text).replace("\n", " ").strip()
    if not shown or len(shown) > _LONGEST_NAME or shown in known.values() or shown == "none":
        raise InputError(
            what,
            f"have names that differ, of 1 to {_LONGEST_NAME} characters and not 'none'",
            f"{shown[:_LONGEST_NAME]!r}",
            remedy,
        )
    return shown


_ORGAN_MM = (20.0, 450.0)
_TYPICAL_MM = 200.0
_UNITS = ((1.0, "millimetres"), (1000.0, "metres"))
PART_ARRAYS = (
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
"""Names of cell arrays of integers that give the parts, the most likely first.

They are the names that meshers write.
"""
MOST_PARTS = 64
"""Largest number of values of an array that lists parts."""
SIZES_MM = (1.5, 1500.0)
"""Range of the longest side of a plausible organ [mm].

Below it a size in metres is likelier, above it one in micrometres.
"""
_NO_FACES = np.zeros((0, 3), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class TetFile:
    """Mesh read from a file, with notes on how it was made.

    Attributes
    ----------
    mesh
        The mesh, in the frame of the file, in metres.
    unit_mm
        Millimetres per unit of the file.
    sentences
        The unit, findings and changes, a sentence each.
    surface
        The surface in which the tetrahedra were made here; None for tetrahedra as stored in the
        file.
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

    Gmsh text of versions 1 and 2 (``.msh``) is read here, everything else by pyvista, which reads
    VTK files itself and further formats where meshio is installed. Cells other than tetrahedra are
    left out next to tetrahedra. An array of integers over the cells that is named as parts usually
    are (``gmsh:physical``, ``part``, ``region``, ...) gives the parts; of ``part``, texts in the
    field ``part_names`` are their names, counted from 0.

    Parameters
    ----------
    path
        File; its suffix names the format.
    unit_mm
        Millimetres per unit of the file. None: millimetres or metres, the unit that makes the
        longest side 20 to 450 mm.
    edge_m
        Edge of the tetrahedra that fill a surface [m]; None: about 30,000 of them.
    report
        Called with the name of the current task and the finished fraction of it (0 to 1).

    Raises
    ------
    InputError
        If the file is missing, empty or not readable, holds no solid, or is not of an organ's size
        in any plain unit.
    """
    file = Path(path)
    stored = read_stored(file)
    used = stored.points[np.unique(stored.tets if len(stored.tets) else stored.triangles)]
    bad = int((~np.isfinite(used).all(axis=1)).sum())
    if bad:
        raise InputError(
            "nodes",
            "be finite",
            f"{bad} of {len(used)} that are not in {file.name}",
            "export it again",
        )
    scale, why = _unit(np.ptp(used, axis=0), unit_mm, file.name)
    if len(stored.tets):
        values, part = np.unique(stored.part, return_inverse=True)
        names = (
            tuple(stored.names.get(int(v), f"part {v}") for v in values)
            if len(values) > 1
            else ("body",)
        )
        mesh, repaired = repair_tets(
            stored.points * (1e-3 * scale), stored.tets, part.reshape(-1), names
        )
        return TetFile(mesh, scale, (why, *stored.notes, *repaired.sentences()))
    surface = surface_from_triangles(
        stored.points, stored.triangles, source=file.name, scale_mm=scale
    )
    filled, sentences = tetrahedralise(surface, edge_m=edge_m, report=report)
    return TetFile(
        filled, scale, (why, *stored.notes, *surface.report.repairs, *sentences), surface
    )


def read_stored(file: Path) -> StoredMesh:
    """Read the content of a mesh file, in its units and with its node numbers.

    It raises the same errors as `read_tets`.
    """
    require_file(file, "a mesh")
    return read_msh(file) if file.suffix.lower() == ".msh" else _from_vtk(file)


def _unit(size: Array, unit_mm: float | None, name: str) -> tuple[float, str]:
    """Return millimetres per file unit, for a box in file units, and a note.

    The note is a sentence on how the unit was found.
    """
    longest = float(size.max())
    if unit_mm is None:
        for scale, unit in _UNITS:
            if _ORGAN_MM[0] <= longest * scale <= _ORGAN_MM[1]:
                sides = by(scale * size, ".3g")
                return scale, f"{name} names no unit and was taken to be in {unit}: {sides} mm."
        raise InputError(
            "anatomy.scale_mm",
            "be given where the unit is not plain",
            (
                f"none for {name}, whose box of {by(size, '.3g')} is an organ neither in "
                "millimetres nor in metres"
            ),
            (
                f"give millimetres per unit, {_TYPICAL_MM / longest:.2g} would make it "
                f"{_TYPICAL_MM:g} mm long"
            ),
        )
    scale = require_positive("anatomy.scale_mm", unit_mm, "use 1 for millimetres, 1000 for metres")
    note = f"{name} was read at {scale:g} mm per unit, as given: {by(scale * size, '.3g')} mm"
    if not _ORGAN_MM[0] <= longest * scale <= _ORGAN_MM[1]:
        note += f", which is not the size of an organ ({_ORGAN_MM[0]:g} to {_ORGAN_MM[1]:g} mm)"
    return scale, f"{note}."


def _from_vtk(file: Path) -> StoredMesh:
    """Read a file by pyvista."""
    remedy = "export it as .vtu, .vtk, .msh or .stl"
    found = _of_arrays(
        *parse_isolated(
            "meshes.surfaces.triangle_files:vtk_mesh", file, what="mesh", remedy=remedy
        ),
        file.name,
    )
    if len(found.tets) == 0 and len(found.triangles) == 0:
        raise InputError(
            "file", "hold tetrahedra or triangles", f"none in {file.name}", "export it again"
        )
    return found


def _of_arrays(
    facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], source: str
) -> StoredMesh:
    """Build a mesh from the arrays of `meshes.surfaces.triangle_files.mesh_arrays`."""
    none = np.zeros((0, 4), dtype=np.int64)
    tets = arrays.get("tets", none)
    known: dict[int, str] = {}
    for number, text in enumerate(facts.get("parts", [])):
        known[number] = part_name(text, known, f"part_names of {source}", "write them again")
    data = {name: arrays[f"cells {number}"] for number, name in enumerate(facts.get("names", []))}
    part, names = _parts(data, len(tets), known)
    notes = []
    if facts.get("others"):
        notes.append(f"Left out {facts['others']} cells that are not tetrahedra.")
    if facts.get("quadratic"):
        notes.append("Took the corners of quadratic tetrahedra: their edges became straight.")
    points = arrays["points"].astype(np.float64)
    return StoredMesh(points, tets, arrays.get("triangles", none[:, :3]), part, names, tuple(notes))


@dataclass(frozen=True, eq=False)
class GivenTets:
    """Mesh as given by the caller, and as solved.

    Attributes
    ----------
    points_mm
        Points as the caller numbers them [mm], shape (n, 3).
    mesh
        Tetrahedra, repaired where necessary [m].
    sentences
        Findings and changes, a sentence each.
    """

    points_mm: Array
    mesh: TetMesh
    sentences: tuple[str, ...]


def given_tets(
    mesh: object, *, scale_mm: float | None = None, part_names: Mapping[int, str] | None = None
) -> GivenTets:
    """Return tetrahedra from any supported mesh object or file.

    Parameters
    ----------
    mesh
        `TetMesh`, pyvista UnstructuredGrid, anything with ``points`` and ``cells`` as of meshio,
        points and cells as a pair of arrays, shapes (n, 3) and (m, 4), or a file (.vtu .vtk .msh
        .mesh). The parts are an array over the cells named ``part`` or as meshers name them, of
        numbers or of names.
    scale_mm
        Millimetres per unit of the mesh; None: the mesh is in millimetres; its size is checked.
    part_names
        Names of numbered parts.

    Raises
    ------
    InputError
        If it holds no tetrahedra, is of another unit by its size, or cannot be repaired.
    """
    if isinstance(mesh, TetMesh):
        return GivenTets(1e3 * mesh.nodes_m, mesh, ())
    stored = _stored(mesh)
    if not len(stored.tets):
        raise InputError("mesh", "hold tetrahedra", "none", "fill a surface by from_surface")
    used = np.unique(stored.tets)
    inside = used[0] >= 0 and used[-1] < len(stored.points)
    if not inside or not np.isfinite(stored.points[used]).all():
        raise InputError("mesh", "hold finite points for all cells", "others", "export it again")
    scale = require_millimetres("mesh", stored.points[used], scale_mm)
    values, part = np.unique(stored.part, return_inverse=True)
    if len(values) > MOST_PARTS:
        raise InputError("mesh", f"have at most {MOST_PARTS} parts", len(values), "join some")
    names = stored.names | dict(part_names or {})
    known = tuple(names.get(int(v), f"part {v}") for v in values) if len(values) > 1 else ("body",)
    with names_of_caller(dict.fromkeys(("nodes", "nodes_m", "cells"), "mesh")):
        repaired, report = repair_tets(
            1e-3 * scale * stored.points, stored.tets, part.reshape(-1), known
        )
    return GivenTets(scale * stored.points, repaired, (*stored.notes, *report.sentences()))


def require_millimetres(name: str, points: Array, scale_mm: float | None) -> float:
    """Return millimetres per unit of points, shape (n, 3).

    The value is the given one, or 1 if the size of the points is plausible in millimetres.

    Raises
    ------
    InputError
        If the size is not plausible. The message names a scale that is.
    """
    if scale_mm is not None:
        return require_positive("scale_mm", scale_mm, "use 1 for millimetres, 1000 for metres")
    sides = np.ptp(points, axis=0)
    if not SIZES_MM[0] <= float(sides.max()) <= SIZES_MM[1]:
        unit, scale = ("metres", 1000) if sides.max() < SIZES_MM[0] else ("micrometres", 0.001)
        raise InputError(
            name,
            "be in millimetres",
            f"one of {by(sides, '.3g')}, which looks like {unit}",
            f"give scale_mm={scale}, or scale_mm=1 if that is its size",
        )
    return 1.0


def _stored(mesh: object) -> StoredMesh:
    """Return points, tetrahedra and parts of any supported mesh object."""
    if isinstance(mesh, str | Path):
        with names_of_caller({"file": "mesh"}):
            return read_stored(Path(mesh))
    if hasattr(mesh, "celltypes") and hasattr(mesh, "cell_data"):
        return _of_arrays(*mesh_arrays(mesh), "mesh")
    if hasattr(mesh, "points") and hasattr(mesh, "cells"):
        return _of_blocks(mesh)
    if isinstance(mesh, tuple | list) and len(mesh) == 2:
        points, cells = (np.asarray(each) for each in mesh)
        if points.ndim == 2 and points.shape[1] == 3 and cells.ndim == 2 and cells.shape[1] == 4:
            return StoredMesh(
                points.astype(np.float64),
                cells.astype(np.int64),
                _NO_FACES,
                np.zeros(len(cells), int),
                {},
            )
        raise InputError(
            "mesh",
            "be points of shape (n, 3) and cells of shape (m, 4)",
            f"{points.shape} and {cells.shape}",
            "give the four corners of each tetrahedron",
        )
    raise InputError(
        "mesh",
        "be a grid of pyvista, a mesh of meshio, points and cells, or a file",
        type(mesh).__name__,
        "wrap arrays as (points, cells)",
    )


def _of_blocks(mesh: Any) -> StoredMesh:
    """Return tetrahedra of a mesh of meshio.

    The mesh holds blocks of cells with a type, and arrays over them by name.
    """
    chosen = [k for k, block in enumerate(mesh.cells) if block.type in ("tetra", "tetra10")]
    tets = [np.asarray(mesh.cells[k].data)[:, :4] for k in chosen]
    if not tets:
        return StoredMesh(np.zeros((0, 3)), np.zeros((0, 4), int), _NO_FACES, np.zeros(0, int), {})
    data = {
        name: np.concatenate([np.asarray(rows[k]) for k in chosen])
        for name, rows in mesh.cell_data.items()
    }
    solids = {
        int(row[0]): name
        for name, row in (getattr(mesh, "field_data", None) or {}).items()
        if int(row[1]) == 3
    }
    cells = np.concatenate(tets).astype(np.int64)
    part, names = _parts(data, len(cells), solids)
    return StoredMesh(np.asarray(mesh.points, dtype=np.float64), cells, _NO_FACES, part, names)


def _parts(
    data: Mapping[str, NDArray[Any]], count: int, named: dict[int, str]
) -> tuple[Ints, dict[int, str]]:
    """Return the number of each cell's part, shape (m,), and the names of the numbers.

    Names that count from 0 belong to the array ``part``. Names from meshio belong to its array
    ``gmsh:physical``.
    """
    for array in PART_ARRAYS:
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
