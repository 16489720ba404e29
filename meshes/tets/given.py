"""Tetrahedra that a caller has in hand: a pyvista grid, a mesh of meshio, arrays, or a file, in millimetres."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, by, names_of_caller, require_positive
from meshes.tets.files import MOST_PARTS, PART_ARRAYS, read_stored
from meshes.tets.msh import StoredMesh
from meshes.tets.quality import repair_tets
from meshes.tets.tetrahedra import TetMesh

__all__ = ["GivenTets", "given_tets", "require_millimetres"]

SIZES_MM = (1.5, 1500.0)
"""Longest side of what is pressed [mm]: below it a size in metres is likelier, beyond it one in micrometres."""
TETRA = 10
QUADRATIC_TETRA = 24


@dataclass(frozen=True, eq=False)
class GivenTets:
    """A mesh as the caller has it, and as it is solved.

    Attributes
    ----------
    points_mm
        Points as the caller numbers them [mm], shape (n, 3).
    mesh
        Tetrahedra, repaired where they had to be [m].
    sentences
        What was found and done, a sentence each.
    """

    points_mm: NDArray[np.float64]
    mesh: TetMesh
    sentences: tuple[str, ...]


def given_tets(
    mesh: object, *, scale_mm: float | None = None, part_names: Mapping[int, str] | None = None
) -> GivenTets:
    """Tetrahedra of whatever holds them.

    Parameters
    ----------
    mesh
        `TetMesh`, pyvista UnstructuredGrid, anything with ``points`` and ``cells`` as of meshio, points and cells as a
        pair of arrays, shapes (n, 3) and (m, 4), or a file (.vtu .vtk .msh .mesh). The parts are an array over the
        cells named ``part`` or as meshers name them, of numbers or of names.
    scale_mm
        Millimetres per unit of the mesh; None: it is in millimetres, which its size must bear out.
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
        raise InputError("mesh must hold tetrahedra, got none: fill a surface by from_surface")
    used = np.unique(stored.tets)
    inside = used[0] >= 0 and used[-1] < len(stored.points)
    if not inside or not np.isfinite(stored.points[used]).all():
        raise InputError("mesh must hold finite points for all cells, got others: export it again")
    scale = require_millimetres("mesh", stored.points[used], scale_mm)
    values, part = np.unique(stored.part, return_inverse=True)
    if len(values) > MOST_PARTS:
        raise InputError(f"mesh must have at most {MOST_PARTS} parts, got {len(values)}: join some")
    names = stored.names | dict(part_names or {})
    known = tuple(names.get(int(v), f"part {v}") for v in values) if len(values) > 1 else ("body",)
    with names_of_caller(dict.fromkeys(("nodes", "nodes_m", "cells"), "mesh")):
        repaired, report = repair_tets(1e-3 * scale * stored.points, stored.tets, part.reshape(-1), known)
    return GivenTets(scale * stored.points, repaired, (*stored.notes, *report.sentences()))


def require_millimetres(name: str, points: NDArray[np.float64], scale_mm: float | None) -> float:
    """Millimetres per unit of points, shape (n, 3): as given, or 1 where their size is one in millimetres.

    Raises
    ------
    InputError
        If it is not, naming the scale that would do.
    """
    if scale_mm is not None:
        return require_positive("scale_mm", scale_mm, "use 1 for millimetres, 1000 for metres")
    sides = np.ptp(points, axis=0)
    if not SIZES_MM[0] <= float(sides.max()) <= SIZES_MM[1]:
        unit, scale = ("metres", 1000) if sides.max() < SIZES_MM[0] else ("micrometres", 0.001)
        raise InputError(
            f"{name} must be in millimetres, got one of {by(sides, '.3g')}, which looks like {unit}: give "
            f"scale_mm={scale}, or scale_mm=1 if that is its size"
        )
    return 1.0


def _stored(mesh: object) -> StoredMesh:
    """Points, tetrahedra and parts of whatever holds them."""
    if isinstance(mesh, str | Path):
        with names_of_caller({"file": "mesh"}):
            return read_stored(Path(mesh))
    if hasattr(mesh, "celltypes") and hasattr(mesh, "cell_data"):
        return _of_grid(mesh)
    if hasattr(mesh, "points") and hasattr(mesh, "cells"):
        return _of_blocks(mesh)
    if isinstance(mesh, tuple | list) and len(mesh) == 2:
        points, cells = (np.asarray(each) for each in mesh)
        if points.ndim == 2 and points.shape[1] == 3 and cells.ndim == 2 and cells.shape[1] == 4:
            return StoredMesh(
                points.astype(np.float64), cells.astype(np.int64), _NO_FACES, np.zeros(len(cells), int), {}
            )
        raise InputError(
            f"mesh must be points of shape (n, 3) and cells of shape (m, 4), got {points.shape} and {cells.shape}: "
            "give the four corners of each tetrahedron"
        )
    raise InputError(
        f"mesh must be a grid of pyvista, a mesh of meshio, points and cells, or a file, got {type(mesh).__name__}: "
        "wrap arrays as (points, cells)"
    )


_NO_FACES = np.zeros((0, 3), dtype=np.int64)


def _of_grid(grid: Any) -> StoredMesh:
    """Tetrahedra of a pyvista grid; of quadratic ones the corners."""
    kinds = np.asarray(grid.celltypes)
    by_kind = {kind: cells for kind, cells in grid.cells_dict.items() if kind in (TETRA, QUADRATIC_TETRA)}
    if not by_kind:
        return StoredMesh(np.zeros((0, 3)), np.zeros((0, 4), int), _NO_FACES, np.zeros(0, int), {})
    order = np.concatenate([np.flatnonzero(kinds == kind) for kind in by_kind])
    tets = np.concatenate([np.asarray(cells)[:, :4] for cells in by_kind.values()]).astype(np.int64)
    data = {name: np.asarray(grid.cell_data[name])[order] for name in grid.cell_data}
    listed = [str(name) for name in grid.field_data["part_names"]] if "part_names" in grid.field_data else []
    part, names = _parts(data, len(tets), dict(enumerate(listed)))
    return StoredMesh(np.asarray(grid.points, dtype=np.float64), tets, _NO_FACES, part, names)


def _of_blocks(mesh: Any) -> StoredMesh:
    """Tetrahedra of a mesh of meshio: blocks of cells with a type, arrays over them by name."""
    chosen = [k for k, block in enumerate(mesh.cells) if block.type in ("tetra", "tetra10")]
    tets = [np.asarray(mesh.cells[k].data)[:, :4] for k in chosen]
    if not tets:
        return StoredMesh(np.zeros((0, 3)), np.zeros((0, 4), int), _NO_FACES, np.zeros(0, int), {})
    data = {name: np.concatenate([np.asarray(rows[k]) for k in chosen]) for name, rows in mesh.cell_data.items()}
    solids = {int(row[0]): name for name, row in (getattr(mesh, "field_data", None) or {}).items() if int(row[1]) == 3}
    cells = np.concatenate(tets).astype(np.int64)
    part, names = _parts(data, len(cells), solids)
    return StoredMesh(np.asarray(mesh.points, dtype=np.float64), cells, _NO_FACES, part, names)


def _parts(
    data: Mapping[str, NDArray[Any]], count: int, named: dict[int, str]
) -> tuple[NDArray[np.int64], dict[int, str]]:
    """Number of each cell's part, shape (m,), and the names of the numbers."""
    for array in ("part", *PART_ARRAYS):
        values = data.get(array, np.zeros(0))
        if values.shape != (count,):
            continue
        if values.dtype.kind in "USO":
            names, part = np.unique(values.astype(str), return_inverse=True)
            return part.reshape(-1), dict(enumerate(names.tolist()))
        if values.dtype.kind in "biuf" and (values == np.round(values)).all():
            return values.astype(np.int64), named
    return np.zeros(count, dtype=np.int64), {}
