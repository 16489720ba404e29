"""Gmsh files of versions 1 and 2 in text.

The available libraries do not read them, or only with an additional library.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from meshes.base.text_numbers import number_in, whole_number_in
from meshes.base.visible_text import visible

__all__ = ["StoredMesh", "part_name", "read_msh"]

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
