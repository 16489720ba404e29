"""Class for the content of a mesh file, and reading of Gmsh text files (versions 1 and 2).

These versions are read without meshio, because meshio does not read version 1 and is an optional
package. `meshes.tets.files` uses meshio for version 4 and for binary files.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from meshes.base.tables import decoded_text
from meshes.base.text_tables import number_in, visible, whole_number_in
from meshes.tets.quality import describe, repair_tets
from meshes.tets.tetrahedra import TetMesh, require_cells

_TRIANGLE = 2
_TETRAHEDRON = 4
"""Numbers of the element types triangle and tetrahedron in Gmsh."""
_SECTIONS = {1: ("$NOD", "$ELM"), 2: ("$Nodes", "$Elements")}
_LONGEST_NAME = 60
"""Longest name of a part [characters]. Names are shown in tables and legends."""
MOST_PARTS = 64
"""Largest number of distinct values in an array of part numbers.

An array with more distinct values is assumed to contain numbers of cells or materials, not part
numbers.
"""


@dataclass(frozen=True, eq=False)
class StoredMesh:
    """Content of a mesh file, in the units of the file.

    Attributes
    ----------
    points
        Nodes, shape (n, 3).
    tets, triangles
        Node indices of the tetrahedra and triangles, shapes (m, 4) and (k, 3).
    part
        Part number of each tetrahedron, shape (m,); 0 for a tetrahedron without a part.
    names
        Dictionary from part number to name, for the parts that have a name.
    notes
        Notes on content that is omitted, one sentence each.
    """

    points: Array
    tets: Ints
    triangles: Ints
    part: Ints
    names: dict[int, str]
    notes: tuple[str, ...] = ()

    @property
    def used(self) -> Array:
        """Points, shape (k, 3), of the tetrahedra, or of the triangles if there are no tetrahedra.

        A missing point, or a point that is not finite, raises an `InputError`.
        """
        cells = self.tets if len(self.tets) else self.triangles
        require_cells(self.points, cells)
        return self.points[np.unique(cells)]

    def repaired(self, unit_mm: float) -> tuple[TetMesh, tuple[str, ...]]:
        """Return the tetrahedra in metres after any repairs, and sentences on the repairs."""
        values, part = np.unique(self.part, return_inverse=True)
        if len(values) > MOST_PARTS:
            raise InputError(
                "mesh", f"have at most {MOST_PARTS} parts", len(values), "join some parts"
            )
        names = tuple(self.names.get(int(value), f"part {value}") for value in values)
        mesh, repairs = repair_tets(
            self.points * (1e-3 * unit_mm),
            self.tets,
            part.reshape(-1),
            names if len(values) > 1 else ("body",),
        )
        return mesh, (*self.notes, *describe(mesh), *repairs)


def read_msh(file: Path) -> StoredMesh:
    """Read a Gmsh text file of version 1 (``$NOD``) or 2 (``$MeshFormat`` 2.x).

    Raises
    ------
    InputError
        If the file has another version, is binary or truncated, or refers to missing nodes.
    """
    text = decoded_text(file, "file", remedy="save it with gmsh -format msh22")
    lines = [line.rstrip("\r") for line in text.split("\n")]
    version = _version(lines, file)
    try:
        of_nodes, of_elements = (_section(lines, opening) for opening in _SECTIONS[version])
        numbers, points = _nodes(of_nodes)
        elements = [_element(line, version) for line in of_elements]
        tets = _of_kind(elements, _TETRAHEDRON, 4)
        triangles = _of_kind(elements, _TRIANGLE, 3)
        names = _names(_section(lines, "$PhysicalNames"), file) if "$PhysicalNames" in lines else {}
    except InputError:
        raise
    except (ValueError, IndexError, OverflowError) as problem:
        raise broken_sections(file) from problem
    part = np.array([tag for kind, tag, _ in elements if kind == _TETRAHEDRON], dtype=np.int64)
    left = len(elements) - len(tets)
    notes = (f"Left out {left} elements that are not tetrahedra.",) if left and len(tets) else ()
    tets, triangles = (_numbered(each, numbers, file) for each in (tets, triangles))
    return StoredMesh(points, tets, triangles, part, names, notes)


def broken_sections(file: Path) -> InputError:
    """Return the error for a Gmsh file that is damaged or truncated."""
    return InputError(
        "file",
        "contain complete sections of nodes and elements",
        f"an incomplete section in {file.name}",
        "export it again",
    )


def is_old_text(file: Path) -> bool:
    """Return whether a file may be a Gmsh text file of version 1 or 2."""
    with file.open("rb") as stored:
        first = stored.readline(_LONGEST_NAME).split()
        second = stored.readline(_LONGEST_NAME).split()
    if first != [b"$MeshFormat"] or len(second) < 2:
        return True
    return second[0].startswith(b"2") and second[1] == b"0"


def _version(lines: list[str], file: Path) -> int:
    """Return the version of a Gmsh text file from its first line. Version 1 starts with nodes."""
    version = {"$NOD": 1, "$MeshFormat": 2}.get(lines[0].strip())
    if version is None:
        raise InputError(
            "file",
            "be a Gmsh text file of version 1 or 2",
            f"another format in {file.name}",
            "save it with gmsh -format msh22",
        )
    return version


def _section(lines: list[str], opening: str) -> list[str]:
    """Return the lines of a section of a Gmsh file."""
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


def _element(line: str, version: int) -> tuple[int, int, list[int]]:
    """Return type, physical group (0 without a group) and nodes of a finite element.

    In version 1, the line contains: number, type, physical group, elementary group, count of nodes,
    nodes. In version 2, the line contains: number, type, count of tags, tags, nodes.
    """
    row = [whole_number_in(word) for word in line.split()]
    if version == 1:
        return row[1], row[2], row[5:]
    return row[1], row[3] if row[2] else 0, row[3 + row[2] :]


def _of_kind(elements: list[tuple[int, int, list[int]]], kind: int, corners: int) -> Ints:
    chosen = [nodes for each, _, nodes in elements if each == kind]
    if any(len(each) != corners for each in chosen):
        raise ValueError("elements")
    return np.array(chosen, dtype=np.int64).reshape(-1, corners)


def _numbered(cells: Ints, numbers: Ints, file: Path) -> Ints:
    """Replace the node numbers in cells by node indices."""
    order = np.argsort(numbers)
    found = order[np.minimum(np.searchsorted(numbers, cells, sorter=order), len(numbers) - 1)]
    unknown = cells[numbers[found] != cells]
    if len(unknown):
        got = f"node {unknown[0]} in {file.name}"
        raise InputError("elements", "refer to nodes of the file", got, "export it again")
    return found


def _names(lines: list[str], file: Path) -> dict[int, str]:
    """Read the names of physical volumes from lines with dimension, number and "name"."""
    names: dict[int, str] = {}
    for line in lines:
        dimension, number, name = line.split(maxsplit=2)
        if whole_number_in(dimension) == 3:
            name = name.strip().removeprefix('"').removesuffix('"')
            names[whole_number_in(number)] = part_name(
                name, names, f"physical volumes of {file.name}"
            )
    return names


def part_name(text: str, known: Mapping[int, str], what: str) -> str:
    """Return a part name that differs from all names in `known`."""
    shown = visible(text).replace("\n", " ").strip()
    if not shown or len(shown) > _LONGEST_NAME or shown in known.values() or shown == "none":
        raise InputError(
            what,
            f"have different names of 1 to {_LONGEST_NAME} characters other than 'none'",
            f"{shown[:_LONGEST_NAME]!r}",
            "rename these parts",
        )
    return shown
