"""Reading of triangles from surface files: STL, OBJ, PLY and VTK."""

import re
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Ints, Triangles
from meshes.base.errors import InputError, counted, enumerated, require_file
from meshes.base.isolated_parser import parse_isolated
from meshes.base.tables import decoded_text
from meshes.base.text_tables import number_in, whole_number_in

SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".vtp")
_HEADER = 84
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""Size of the header of a binary STL file [byte] (`_HEADER`), and record type of a triangle."""
_IGNORED = re.compile(
    "vt|vn|vp|p|l|g|s|mg|o|usemtl|mtllib|usemap|maplib|lod|bevel|c_interp|d_interp|shadow_obj|"
    "trace_obj|ctech|stech|call|csh|deg|bmat|step|cstype|curv|curv2|surf|parm|trim|hole|scrv|sp|"
    "end|con"
)
"""OBJ keywords that do not define vertices or polygons."""
_FURTHER = re.compile(r"/\S*")


def read_triangles(file: Path, notes: list[str] | None = None) -> Triangles:
    """Read vertices [file units], shape (n, 3), and triangles, shape (m, 3), from a file.

    Parameters
    ----------
    file
        File. Its suffix determines the format.
    notes
        List to which a sentence is appended for each possible problem in the file.

    Raises
    ------
    InputError
        If the file is missing, empty, not readable or has an unknown format, or a triangle refers
        to a vertex that does not exist.
    """
    if file.suffix.lower() not in SURFACE_SUFFIXES:
        raise InputError(
            "file",
            f"end in {enumerated(SURFACE_SUFFIXES, 'or')}",
            file.name,
            "convert it, or read an image volume with read_image",
        )
    require_file(file, "a surface")
    kind = file.suffix.lower()[1:].upper()
    read = {"STL": _read_stl, "OBJ": _read_obj, "PLY": _read_ply}.get(kind, _read_by_vtk)
    try:
        vertices, faces = read(file, [] if notes is None else notes)
        require_triangles(vertices, faces, file.name)
    except InputError:
        _require_decimal_points(file)
        raise
    return vertices.astype(np.float64, copy=False), faces.astype(np.int64, copy=False)


_Stored = tuple[NDArray[np.number], NDArray[np.number]]
_COMMAS = re.compile(rb"\d,\d+(?:[eE][+-]?\d+)?[ \t]+[+-]?\d+,\d")
"""Regular expression for two numbers with decimal commas."""
_SEARCHED = 100_000
"""Number of bytes at the start of an unreadable file that are searched for decimal commas."""


def _require_decimal_points(file: Path) -> None:
    """Raise an error if a file contains numbers with decimal commas."""
    with file.open("rb") as stored:
        if found := _COMMAS.search(stored.read(_SEARCHED)):
            raise InputError(
                f"file: {file.name} has decimal commas, such as {found[0].decode('latin-1')!r}. "
                "Export it with decimal points."
            )


def _read_by_vtk(file: Path, notes: list[str]) -> _Stored:
    """Read a surface with VTK in a separate process."""
    _, arrays = parse_isolated(
        "meshes.surfaces.vtk_files:vtk_triangles",
        file,
        what=f"{file.suffix[1:].upper()} surface",
        remedy="export it again",
    )
    return arrays["points"], arrays["triangles"]


def _read_ply(file: Path, notes: list[str]) -> _Stored:
    """Read a PLY file with trimesh if possible, otherwise with VTK.

    VTK also reads binary files with polygons of different sizes, and files with additional bytes
    after the triangles. VTK stores coordinates only in single precision.
    """
    if not _is_whole_ply(file):
        reason = f"{file.name} does not have the length that its header states."
    else:
        try:
            return _ply_by_trimesh(file)
        except MemoryError:
            raise
        except Exception as problem:  # the library raises many undocumented types of errors
            cause = str(problem).rstrip(".!") or type(problem).__name__
            reason = f"trimesh does not read {file.name}: {cause}."
    found = _read_by_vtk(file, notes)
    notes.append(f"{reason} VTK read it, with coordinates in single precision.")
    return found


def _ply_by_trimesh(file: Path) -> _Stored:
    """Read a PLY file with trimesh."""
    import trimesh

    # A PLY file may refer to a missing texture. trimesh would print a traceback for it.
    mesh: Any = trimesh.load(file, force="mesh", process=False, skip_materials=True)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _refusal(wanted: str, got: str) -> InputError:
    return InputError("file", wanted, got, "export it again")


def require_triangles(vertices: NDArray[np.number], faces: NDArray[np.number], source: str) -> None:
    """Raise an error if there are no triangles, or if a triangle refers to a missing vertex."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        got = f"vertices of shape {vertices.shape} and faces of shape {faces.shape} in {source}"
        raise _refusal("contain triangles in space", got)
    count = len(vertices)
    if count == 0 or len(faces) == 0:
        raise _refusal(
            "contain triangles", f"{count} vertices and {len(faces)} triangles in {source}"
        )
    if faces.min() < 0 or faces.max() >= count:
        face, corner = np.argwhere((faces < 0) | (faces >= count))[0]
        raise InputError(
            "faces",
            f"refer to the vertices 0 to {count - 1} of the file",
            f"vertex {faces[face, corner]} in face {face} of {source}, counted from 0",
            "export it again",
        )


def _read_stl(file: Path, notes: list[str]) -> _Stored:
    """Read an STL file, binary or text."""
    payload = max(file.stat().st_size - _HEADER, 0)
    with file.open("rb") as stored:
        head = stored.read(_HEADER)
        # The number of triangles follows 80 bytes of text.
        count = int.from_bytes(head[80:], "little")
        whole = payload // _RECORD.itemsize
        # Binary files may also begin with the word "solid". UTF-16 text has zeros between letters.
        words = (head + stored.read(_SEARCHED)).replace(b"\0", b"").lower()
        is_text = b"facet" in words or b"endsolid" in words
        if is_text and (count == 0 or payload != count * _RECORD.itemsize):
            return _read_text_stl(file)
        if count > whole or not whole:
            got = f"{file.name} with {whole} of the {count} triangles that its header states"
            if not whole:
                got = f"{file.name} without a complete triangle"
            raise _refusal("be a complete STL file", got)
        # Programs that write the file during a computation may store a count of 0 or an outdated
        # count.
        if count < whole and payload == whole * _RECORD.itemsize:
            notes.append(f"Read {whole} triangles of {file.name}, whose header states {count}.")
            count = whole
        elif payload != count * _RECORD.itemsize:
            further = payload - count * _RECORD.itemsize
            notes.append(f"Left out {further} bytes after the triangles of {file.name}.")
        stored.seek(_HEADER)
        records = np.fromfile(stored, dtype=_RECORD, count=count)
    return records["corners"].reshape(-1, 3).astype(np.float64), np.arange(3 * count).reshape(-1, 3)


_CORNER = re.compile(r"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def _read_text_stl(file: Path) -> _Stored:
    """Read the triangles of all solids in a text STL file."""
    text = decoded_text(file, "file", remedy="export it again")
    try:
        corners = np.array([[number_in(each) for each in row] for row in _CORNER.findall(text)])
    except ValueError as problem:
        got = f"{file.name} with a vertex that is not a number ({problem})"
        raise _refusal("be a readable STL file", got) from None
    words = text.lower()
    facets = words.count("endfacet")
    if len(corners) != 3 * facets or "endsolid" not in words:
        end = "an" if "endsolid" in words else "no"
        counts = f"{counted(len(corners), 'vertex line')}, {counted(facets, 'endfacet line')}"
        got = f"{file.name} with {counts} and {end} endsolid line"
        raise _refusal("be a complete STL file", got)
    return corners.reshape(-1, 3), np.arange(len(corners)).reshape(-1, 3)


def _is_whole_ply(file: Path) -> bool:
    """Return False for a text PLY file whose length does not agree with the header.

    Binary files are checked when they are read.
    """
    with file.open("rb") as stored:
        head = [
            line.split() for line in takewhile(lambda line: line.strip() != b"end_header", stored)
        ]
        if not any(line[:2] == [b"format", b"ascii"] for line in head):
            return True
        found = sum(bool(line.strip()) for line in stored)
    counts = [line[2:3] for line in head if line[:1] == [b"element"]]
    # A damaged header may hold thousands of digits, for which `int` raises an error.
    stated = [float(count[0]) if count and count[0].isdigit() else -1.0 for count in counts]
    return min(stated, default=-1.0) >= 0.0 and sum(stated) == found


def _read_obj(file: Path, notes: list[str]) -> tuple[Array, Ints]:
    """Read vertices, shape (n, 3), and triangles, shape (m, 3), of an OBJ file.

    Polygons are converted to fans of triangles around their first corner.
    """
    text = decoded_text(file, "file", remedy="export it again")
    lines = text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines()
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split(maxsplit=1)
        keyword = words[0].lower() if words else ""
        rest = words[1] if len(words) > 1 else ""
        try:
            if keyword == "v":
                vertices.append(_vertex(rest))
            elif keyword == "f":
                polygons.append(_polygon(rest, len(vertices)))
            elif keyword and not _IGNORED.fullmatch(keyword):
                raise ValueError("begins with an unknown keyword")
        except ValueError as problem:
            got = f"line {number} of {file.name}, which {problem}"
            raise _refusal("be a readable OBJ file", got) from None
    triangles = [(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)]
    return np.array(vertices).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _vertex(rest: str) -> list[float]:
    try:
        numbers = [number_in(each) for each in rest.split()]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 4, 6, 7):  # with a weight, a colour, or a weight and a colour
        raise ValueError(f"has {rest.strip()[:40]!r} instead of the three numbers of a vertex")
    return numbers[:3]


def _polygon(rest: str, count: int) -> list[int]:
    """Return the zero-based vertex indices of an OBJ polygon that follows `count` vertices."""
    try:
        numbers = [whole_number_in(each) for each in _FURTHER.sub("", rest).split()]
    except ValueError:
        numbers = []
    # OBJ indices start at 1. Negative indices count from the last vertex. Indices have 64 bits.
    if len(numbers) < 3 or 0 in numbers or max(numbers) >= 1 << 63:
        raise ValueError(
            f"has {rest.strip()[:40]!r} instead of three or more vertex numbers from 1"
        )
    if min(numbers) < -count:
        raise ValueError(f"refers to vertex {min(numbers)} after only {count} vertices")
    return [each - 1 if each > 0 else count + each for each in numbers]
