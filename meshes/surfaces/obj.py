"""Wavefront OBJ surfaces: polygons by vertex numbers that count from 1, or back from the last by negative ones."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError

__all__ = ["read_obj"]

_IGNORED = frozenset(("vt", "vn", "vp", "p", "l", "g", "s", "mg", "o", "usemtl", "mtllib", "usemap", "maplib", "lod"))
_IGNORED |= {"bevel", "c_interp", "d_interp", "shadow_obj", "trace_obj", "ctech", "stech", "call", "csh", "deg", "bmat"}
_IGNORED |= {"step", "cstype", "curv", "curv2", "surf", "parm", "trim", "hole", "scrv", "sp", "end", "con"}
"""Keywords of the format that do not concern vertices and polygons."""
_FURTHER = re.compile(r"/\S*")


def read_obj(file: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices [file units], shape (n, 3), and triangles, shape (m, 3); polygons become fans about their first corner.

    Raises
    ------
    InputError
        If a line is no line of an OBJ file, a number is none, or a polygon names a vertex that is not there.
    """
    lines = file.read_bytes().decode("latin-1").replace("\\\r\n", " ").replace("\\\n", " ").splitlines()
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for number, line in enumerate(lines, 1):
        keyword, _, rest = line.strip().partition("#")[0].strip().partition(" ")
        try:
            if keyword == "v":
                vertices.append(_vertex(rest))
            elif keyword == "f":
                polygons.append(_polygon(rest, len(vertices)))
            elif keyword and keyword.partition("\t")[0] not in _IGNORED:
                raise ValueError("begins with no keyword of the format")
        except ValueError as problem:
            raise InputError(
                f"file must be a readable OBJ surface, got line {number} of {file.name}, which {problem}: export it "
                "again"
            ) from None
    return _arrays(vertices, polygons, file.name)


def _vertex(rest: str) -> list[float]:
    try:
        numbers = [float(each) for each in rest.split()]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 4, 6, 7):  # with a weight, a colour, or both
        raise ValueError(f"must hold the three numbers of a vertex, not {rest.strip()[:40]!r}")
    return numbers[:3]


def _polygon(rest: str, count: int) -> list[int]:
    """Vertex numbers from 0 of a polygon after so many vertices."""
    try:
        numbers = [int(each) for each in _FURTHER.sub("", rest).split()]
    except ValueError:
        numbers = []
    if len(numbers) < 3 or 0 in numbers:
        raise ValueError(f"must hold three or more vertex numbers from 1, not {rest.strip()[:40]!r}")
    if min(numbers) < -count:
        raise ValueError(f"names vertex {min(numbers)} after {count} vertices")
    return [each - 1 if each > 0 else count + each for each in numbers]


def _arrays(
    vertices: list[list[float]], polygons: list[list[int]], name: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    most = max((max(polygon) for polygon in polygons), default=-1)
    if most >= len(vertices):
        first = next(number for number, polygon in enumerate(polygons, 1) if max(polygon) >= len(vertices))
        raise InputError(
            f"faces must name vertices 1 to {len(vertices)} of the file, got {max(polygons[first - 1]) + 1} in face "
            f"{first} of {name}: export it again"
        )
    triangles = [(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)]
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)
