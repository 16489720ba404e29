"""Tetrahedral meshes: nodes, cells, parts, and the surface around them."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array, Bytes, Ints
from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file
from meshes.tets.checks import cell_faces, signed_volumes

__all__ = ["TetMesh", "grid_of", "write_organ"]

if TYPE_CHECKING:
    import pyvista
_TETRA = 10


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Tetrahedra with straight edges, all of positive volume.

    Attributes
    ----------
    nodes_m
        Node positions [m], shape (n, 3).
    cells
        Nodes of each tetrahedron, shape (m, 4); (b - a) . ((c - a) x (d - a)) is positive.
    part
        Part that each tetrahedron belongs to, shape (m,).
    part_names
        Names of the parts.

    Raises
    ------
    InputError
        If positions are not finite, a cell names a node that does not exist, or a volume is not
        positive.
    """

    nodes_m: Array
    cells: Ints
    part: Bytes = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    part_names: tuple[str, ...] = ("body",)

    def __post_init__(self) -> None:
        if len(self.part) == 0 and len(self.cells):
            object.__setattr__(self, "part", np.zeros(len(self.cells), dtype=np.uint8))
        if not np.isfinite(self.nodes_m).all():
            bad = int(np.flatnonzero(~np.isfinite(self.nodes_m).all(axis=1))[0])
            raise InputError(
                "nodes_m", "be finite", f"node {bad} at {self.nodes_m[bad]}", "repair or leave out"
            )
        if len(self.cells) == 0:
            raise InputError(
                "cells", "hold at least one tetrahedron", "none", "mesh the surface first"
            )
        if self.cells.min() < 0 or self.cells.max() >= len(self.nodes_m):
            raise InputError(
                "cells",
                f"name nodes 0 to {len(self.nodes_m) - 1}",
                f"{self.cells.min()} to {self.cells.max()}",
                "number nodes from 0",
            )
        flat = int((self.volumes_m3 <= 0.0).sum())
        if flat:
            raise InputError(
                "cells",
                "have positive volume",
                f"{flat} of {len(self.cells)} inverted or flat",
                "repair them first",
            )

    @cached_property
    def volumes_m3(self) -> Array:
        """Volume of each tetrahedron [m3], shape (m,)."""
        return signed_volumes(self.nodes_m, self.cells)

    @cached_property
    def surface(self) -> Ints:
        """Triangles that bound the mesh, counter-clockwise seen from outside, shape (f, 3)."""
        triangles, _, shared = cell_faces(self.cells)
        return triangles[shared == 1]

    @cached_property
    def surface_nodes(self) -> Ints:
        """Nodes on the surface in rising order, shape (s,)."""
        return np.unique(self.surface)


def grid_of(mesh: TetMesh) -> "pyvista.UnstructuredGrid":
    """Convert a mesh to a pyvista grid [mm] with ``part`` over its cells.

    ``part`` counts into the field ``part_names``.
    """
    import pyvista
    from vtkmodules.vtkCommonCore import vtkStringArray

    cells = np.insert(mesh.cells, 0, 4, axis=1).ravel()
    grid = pyvista.UnstructuredGrid(
        cells, np.full(len(mesh.cells), _TETRA, dtype=np.uint8), 1e3 * mesh.nodes_m
    )
    grid.cell_data["part"] = mesh.part
    names = vtkStringArray()  # pyvista's own method accepts ASCII only
    names.SetName("part_names")
    for name in mesh.part_names:
        names.InsertNextValue(name)
    grid.GetFieldData().AddArray(names)
    return grid


def write_organ(mesh: TetMesh, path: str | Path) -> None:
    """Write a mesh [mm] with its parts and their names.

    ``anatomy.file`` of a scene and `read_tets` read the file.

    Raises
    ------
    InputError
        If the file is not named ``.vtu``.
    """
    file = Path(path)
    if file.suffix != ".vtu":
        raise InputError("path", "end in .vtu", file.name, "name it organ.vtu")
    with whole_file(file) as temporary:
        grid_of(mesh).save(temporary)
