"""Class for tetrahedral meshes, and functions for cells, surfaces and quality measures."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array, Bytes, Ints, directed_edges
from meshes.base.errors import InputError, in_brackets
from meshes.base.whole_file import whole_file

if TYPE_CHECKING:
    import pyvista

EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
"""Corner indices of the edges of a tetrahedron."""
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Corner indices of the face opposite each corner, counter-clockwise as seen from outside."""

Nodes = Array
Cells = Ints


def signed_volumes(nodes: Nodes, cells: Cells) -> Array:
    """Compute the signed volume, shape (m,), of each tetrahedron in cubed units of the nodes.

    The volume is negative if a tetrahedron is inverted.
    """
    a, b, c, d = (nodes[cells[:, i]] for i in range(4))
    # a sixth of the triple product of three edges
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0


def mean_ratio(nodes: Nodes, cells: Cells) -> Array:
    """Compute the mean ratio, a quality measure, of each tetrahedron, shape (m,).

    The mean ratio is 12 (3 V)^(2/3), divided by the sum of squared edges (Liu and Joe, 1994).

    The ratio is 1 for a regular tetrahedron, 0.84 for a tetrahedron cut from the corner of a cube,
    0 for a flat tetrahedron, and negative for an inverted tetrahedron.
    """
    # 1e-300 avoids a division by zero for four equal corners.
    volume = signed_volumes(nodes, cells)
    squares = _edge_squares(nodes, cells).sum(axis=0)
    return (
        12.0 * np.sign(volume) * (3.0 * np.abs(volume)) ** (2.0 / 3.0) / np.maximum(squares, 1e-300)
    )


def flatness(nodes: Nodes, cells: Cells) -> Array:
    """Compute the ratio 6 |V| / (longest edge)^3 of each tetrahedron, shape (m,).

    The ratio is 0.71 for a regular tetrahedron.
    """
    longest = np.sqrt(_edge_squares(nodes, cells).max(axis=0))
    return 6.0 * np.abs(signed_volumes(nodes, cells)) / np.maximum(longest, 1e-300) ** 3


def cell_faces(cells: Cells) -> tuple[Ints, Ints, Ints]:
    """Return all faces of all cells, four per cell, with outward normals.

    A face that belongs to two cells is listed twice.

    Returns
    -------
    Triangles, shape (4 m, 3); index of each triangle's face, shape (4 m,); number of cells to which
    this face belongs, shape (4 m,). A face has the same index in both cells, although its two
    orientations differ.
    """
    triangles = cells[:, FACES].reshape(-1, 3)
    _, where, count = np.unique(
        np.sort(triangles, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return triangles, where, count[where]


def outer_faces(cells: Cells) -> Ints:
    """Return the faces, shape (f, 3), that belong to only one cell, with outward normals."""
    triangles, _, shared = cell_faces(cells)
    return triangles[shared == 1]


def pieces(cells: Cells) -> Ints:
    """Return the index, shape (m,), of the connected piece to which each cell belongs.

    The cells of a piece are connected through common faces.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    where = cell_faces(cells)[1]
    owner = np.repeat(np.arange(len(cells)), 4)
    face = len(cells) + where
    links = coo_array(
        (np.ones(len(owner), dtype=np.int8), (owner, face)), shape=(face.max() + 1,) * 2
    )
    _, label = connected_components(links, directed=False)
    return np.unique(label[: len(cells)], return_inverse=True)[1]


def pinched_edges(surface: Cells) -> Ints:
    """Return the edges, shape (k, 2), at which more than two triangles of a surface meet."""
    edges, uses = np.unique(np.sort(directed_edges(surface), axis=1), axis=0, return_counts=True)
    return edges[uses > 2]


def _edge_squares(nodes: Nodes, cells: Cells) -> Array:
    """Compute the squared length, shape (6, m), of the six edges of each tetrahedron."""
    return np.stack(
        [((nodes[cells[:, i]] - nodes[cells[:, j]]) ** 2).sum(axis=1) for i, j in EDGES]
    )


def place(points_m: Array) -> str:
    """Format the mean of points [m], shape (n, 3), as a position in mm for a message."""
    return in_brackets(1e3 * points_m.mean(axis=0), ".3g")


def require_cells(nodes: Array, cells: Ints) -> None:
    """Raise an error if a cell refers to a node that does not exist or is not finite."""
    if cells.min() < 0 or cells.max() >= len(nodes):
        raise InputError(
            "cells",
            f"refer to the nodes 0 to {len(nodes) - 1}",
            f"nodes {cells.min()} to {cells.max()}",
            "write the mesh again",
        )
    bad = int((~np.isfinite(nodes[np.unique(cells)]).all(axis=1)).sum())
    if bad:
        raise InputError(
            "nodes",
            "be finite",
            f"{bad} of {len(nodes)} nodes that are not finite",
            "write the mesh again",
        )


_TETRA = 10
"""VTK cell type of a tetrahedron."""


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Mesh of tetrahedra with straight edges and positive volumes.

    Attributes
    ----------
    nodes_m
        Node positions [m], shape (n, 3).
    cells
        Node indices a, b, c, d of each tetrahedron, shape (m, 4). (b - a) . ((c - a) x (d - a)) is
        positive.
    part
        Index of the part that each tetrahedron belongs to, shape (m,).
    part_names
        Names of the parts.

    Raises
    ------
    InputError
        If positions are not finite, a cell refers to a node that does not exist, or a volume is not
        positive.
    """

    nodes_m: Array
    cells: Ints
    part: Bytes = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    part_names: tuple[str, ...] = ("body",)

    def __post_init__(self) -> None:
        if len(self.part) == 0 and len(self.cells):
            object.__setattr__(self, "part", np.zeros(len(self.cells), dtype=np.uint8))
        if len(self.cells) == 0:
            raise InputError(
                "cells", "contain at least one tetrahedron", "none", "mesh the surface first"
            )
        # `require_cells` does not check nodes that no cell uses.
        is_finite = np.isfinite(self.nodes_m).all(axis=1)
        if not is_finite.all():
            bad = int(is_finite.argmin())
            raise InputError(
                "nodes_m",
                "be finite",
                f"node {bad} at {self.nodes_m[bad]}",
                "repair this node or leave it out",
            )
        require_cells(self.nodes_m, self.cells)
        flat = int((self.volumes_m3 <= 0.0).sum())
        if flat:
            raise InputError(
                "cells",
                "have positive volume",
                f"{flat} of {len(self.cells)} cells that are inverted or flat",
                "repair them first",
            )

    @cached_property
    def volumes_m3(self) -> Array:
        """Volume of each tetrahedron [m3], shape (m,)."""
        return signed_volumes(self.nodes_m, self.cells)

    @cached_property
    def surface(self) -> Ints:
        """Triangles that bound the mesh, counter-clockwise as seen from outside, shape (f, 3)."""
        return outer_faces(self.cells)

    @cached_property
    def surface_nodes(self) -> Ints:
        """Indices of the nodes on the surface in ascending order, shape (s,)."""
        return np.unique(self.surface)


def grid_of(mesh: TetMesh) -> "pyvista.UnstructuredGrid":
    """Convert a mesh to a pyvista grid [mm] with the cell array ``part``.

    The values of ``part`` are indices into the field ``part_names``.
    """
    import pyvista
    from vtkmodules.vtkCommonCore import vtkStringArray

    # In VTK, the number of corners precedes the corners of each cell.
    cells = np.insert(mesh.cells, 0, 4, axis=1).ravel()
    grid = pyvista.UnstructuredGrid(
        cells, np.full(len(mesh.cells), _TETRA, dtype=np.uint8), 1e3 * mesh.nodes_m
    )
    grid.cell_data["part"] = mesh.part
    names = vtkStringArray()  # pyvista's own method only accepts ASCII
    names.SetName("part_names")
    for name in mesh.part_names:
        names.InsertNextValue(name)
    grid.GetFieldData().AddArray(names)
    return grid


def write_organ(mesh: TetMesh, path: str | Path) -> None:
    """Write a mesh in mm, with its parts and part names, to a VTU file.

    The file can be used for the scene key ``anatomy.file``. `read_tets` can read the file.

    Raises
    ------
    InputError
        If the file name does not end with ``.vtu``.
    """
    file = Path(path)
    if file.suffix != ".vtu":
        raise InputError("path", "end in .vtu", file.name, "name it for example organ.vtu")
    with whole_file(file) as temporary:
        grid_of(mesh).save(temporary)
