"""Displacement spaces on tetrahedra: shape functions, nodes and block pattern of matrices.

Linear spaces (P1) have nodes at the corners. Quadratic spaces (P2) also have nodes in the middles
of edges.

The shape functions of straight-sided simplices are written in barycentric coordinates l_c.

The gradients g_c of these coordinates are constant. The gradient of shape function A is ``sum_c
sum_i slope[A, c, i] l_i g_c``. For a corner it is g_A (linear) or ``(4 l_A - 1) g_A`` (quadratic),
with 1 = sum l_i. For the middle of edge ij it is ``4 (l_i g_j + l_j g_i)``. Products are integrated
exactly with ``mean(l_i l_j) = (1 + delta_ij) / ((d + 1) (d + 2))`` in d dimensions, so no
quadrature is needed.

The block pattern contains the positions of the 3x3 blocks in an assembled matrix, and the cells
that contribute to each block.

Pairs of nodes are grouped by two stable counting sorts, whose time is linear in the number of
pairs. SciPy's conversion from compressed rows to compressed columns is such a sort. The block of
each pair is summed once, with the lower node first. The mirrored block is copied.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp
from scipy.sparse import csr_array

from kernels.launcher import SplitLaunch
from kernels.tetrahedra import cell_gradients
from meshes.base.arrays import Array, Int32s, Ints
from meshes.base.errors import InputError
from meshes.tets.tetrahedra import TetMesh


@dataclass(frozen=True, eq=False)
class Pattern:
    """Block pattern of a symmetric matrix over nodes. Both triangles are stored by rows.

    Attributes
    ----------
    row_start
        Index of the first block in the row of each node, shape (n + 1,).
    column
        Column (node) of each block, shape (b,), rising within a row.
    pair_start
        Index in `contribution` of the first contribution to each pair of nodes, shape (p + 1,).
    contribution
        Code of each contribution, shape (c,): (cell index) * (pairs per cell) + (index of the pair
        in the cell). The contributions to a pair are in the order of cells. If the cell lists the
        nodes of the pair in reverse order, the bitwise complement of the code is stored.
    place
        Index of each pair's block, shape (p,). The block lies in the row of the lower node of the
        pair.
    mirror
        Index of the transposed block of each pair, shape (p,); equal to `place` on the diagonal.
    """

    row_start: Int32s
    column: Int32s
    pair_start: Int32s
    contribution: Int32s
    place: Int32s
    mirror: Int32s

    @classmethod
    def of(cls, cell_nodes: Ints, node_count: int) -> "Pattern":
        """Return the block pattern of cells with the nodes `cell_nodes`, shape (m, k)."""
        a, b = local_pairs(cell_nodes.shape[1]).T
        nodes = cell_nodes.astype(np.int32)
        first = nodes[:, a].ravel()
        second = nodes[:, b].ravel()
        flipped = first > second
        low = np.where(flipped, second, first)
        high = np.where(flipped, first, second)
        order, start = grouped(low, high, node_count)
        lead = order[start[:-1]]
        low = low[lead]
        high = high[lead]
        below = high != low
        upper = np.bincount(low, minlength=node_count)
        lower = np.bincount(high[below], minlength=node_count)
        row_start = np.concatenate([[0], np.cumsum(upper + lower)])
        rank = np.arange(len(low))
        place = row_start[low] + lower[low] + rank - (np.cumsum(upper) - upper)[low]
        turned = _sorted_by(high, np.flatnonzero(below).astype(np.int32), node_count)
        mirror = place.copy()
        mirror[turned] = (
            row_start[high[turned]]
            + np.arange(len(turned))
            - (np.cumsum(lower) - lower)[high[turned]]
        )
        column = np.empty(row_start[-1], np.int32)
        column[place] = high
        column[mirror] = low
        contribution = np.where(flipped[order], ~order, order)
        return cls(
            *(
                part.astype(np.int32)
                for part in (row_start, column, start, contribution, place, mirror)
            )
        )


def local_pairs(nodes_a_cell: int) -> Ints:
    """Return the pairs (a, b), a <= b, of the k nodes of a cell, shape (k (k + 1) / 2, 2).

    The pairs are ordered row by row.
    """
    return np.stack(np.triu_indices(nodes_a_cell), axis=1)


def grouped(first: Int32s, second: Int32s, count: int) -> tuple[Int32s, Ints]:
    """Return the stable sorting order of number pairs, and the start of each distinct pair in it.

    The numbers are below `count`. For p distinct pairs, the starts have shape (p + 1,); the last
    entry is the number of pairs.
    """
    every = np.arange(len(first), dtype=np.int32)
    order = _sorted_by(first, _sorted_by(second, every, count), count)
    ordered_first = first[order]
    ordered_second = second[order]
    new = np.ones(len(order) + 1, bool)
    new[1:-1] = (ordered_first[1:] != ordered_first[:-1]) | (
        ordered_second[1:] != ordered_second[:-1]
    )
    return order, np.flatnonzero(new)


def _sorted_by(key: Int32s, order: Int32s, count: int) -> Int32s:
    """Return `order` sorted stably by keys below `count`, in linear time."""
    row = csr_array((order, key[order], np.array([0, len(order)], np.int32)), shape=(1, count))
    return row.tocsc().data


EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
"""Corners of each edge of a tetrahedron, in VTK's order of the edges."""

TRIANGLE_EDGES = EDGES[:3]
"""Corners of each edge of a triangle."""

GAUSS = 0.13819660112501052
"""Smaller barycentric coordinate of the four Gauss points of a tetrahedron: (5 - sqrt 5) / 20."""


def gauss_points(order: int) -> Array:
    """Return the barycentric coordinates of a tetrahedron's Gauss points.

    The points have equal weights. The shape is (1, 4) for linear cells and (4, 4) for quadratic
    cells.
    """
    # One point at the centroid is enough for linear cells, whose strain is constant.
    return np.full((1, 4), 0.25) if order == 1 else GAUSS + (1.0 - 4.0 * GAUSS) * np.eye(4)


def gradient_slopes(corners: int, order: int) -> Array:
    """Return the coefficients of the shape functions' gradients, shape (nodes, corners, corners).

    Entry [A, c, i] of the array ``slope`` is the coefficient of l_i g_c in the gradient of shape
    function A. Here l_i is a barycentric coordinate, and g_c is the gradient of l_c.
    """
    edges = _edges(corners, order)
    slope = np.zeros((corners + len(edges), corners, corners))
    for a in range(corners):
        # g_A, or (4 l_A - sum l_i) g_A for quadratic cells
        slope[a, a] = 1.0 if order == 1 else -1.0
        slope[a, a, a] += 0.0 if order == 1 else 4.0
    for middle, (i, j) in enumerate(edges, start=corners):
        slope[middle, j, i] = slope[middle, i, j] = 4.0
    return slope


def gradient_products(corners: int, order: int) -> Array:
    """Return mean products of shape-function gradients, shape (nodes, nodes, corners, corners).

    The means are taken over the simplex. Entry [A, B, c, d] is the factor of g_c g_d^T, where g_c
    is the gradient of barycentric coordinate c.
    """
    slope = gradient_slopes(corners, order)
    mean = (1.0 + np.eye(corners)) / (corners * (corners + 1))
    return np.einsum("aci,bdj,ij->abcd", slope, slope, mean)


def mean_gradient_products(corners: int, order: int) -> Array:
    """Return products of mean shape-function gradients, shape (nodes, nodes, corners, corners)."""
    slope = gradient_slopes(corners, order).mean(axis=2)
    return np.einsum("ac,bd->abcd", slope, slope)


def mean_shape(corners: int, order: int) -> Array:
    """Return the means of the shape functions over the simplex, shape (nodes,).

    Each mean is the share of a uniform load that its node carries.
    """
    if order == 1:
        return np.full(corners, 1.0 / corners)
    # Means of 4 l_i l_j and of l_i (2 l_i - 1), with d + 1 corners.
    middle = 4.0 / (corners * (corners + 1))
    at_corner = 4.0 / (corners * (corners + 1)) - 1.0 / corners
    return np.concatenate(
        [np.full(corners, at_corner), np.full(len(_edges(corners, order)), middle)]
    )


def _edges(corners: int, order: int) -> Ints:
    if order == 1:
        return EDGES[:0]
    return EDGES if corners == 4 else TRIANGLE_EDGES


@dataclass(frozen=True, eq=False)
class Space:
    """Space of continuous displacements that are linear or quadratic in each cell.

    Attributes
    ----------
    mesh
        The cells, with straight edges.
    order
        Order of the shape functions, 1 or 2. Linear cells lock if Poisson's ratio is near 0.5;
        quadratic cells do not.
    device
        Warp device name.

    Raises
    ------
    InputError
        If the order is neither 1 nor 2.
    """

    mesh: TetMesh
    order: int = 1
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.order not in (1, 2):
            raise InputError(
                "order", "be 1 or 2", self.order, "use 2 where Poisson's ratio is above 0.45"
            )

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.mesh.nodes_m) + (len(self._edges[0]) if self.order == 2 else 0)

    @property
    def unknown_count(self) -> int:
        """Number of unknowns: x, y and z of each node."""
        return 3 * self.node_count

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return len(self.mesh.cells)

    @cached_property
    def nodes_m(self) -> Array:
        """Node positions [m]: nodes of the mesh, then middles of its edges, shape (n, 3)."""
        corners = self.mesh.nodes_m
        if self.order == 1:
            return corners
        a, b = self._edges[0].T
        return np.concatenate([corners, 0.5 * (corners[a] + corners[b])])

    @cached_property
    def cell_nodes(self) -> Ints:
        """Nodes of each cell, shape (m, 4) or (m, 10).

        The corners come first, then the middles of `EDGES` in VTK's order.
        """
        if self.order == 1:
            return self.mesh.cells
        return np.concatenate([self.mesh.cells, len(self.mesh.nodes_m) + self._edges[1]], axis=1)

    @cached_property
    def faces(self) -> Ints:
        """Nodes of each face of the surface, shape (f, 3) or (f, 6).

        The corners come first, as in the mesh, then the middles of the edges.
        """
        return self.with_middles(self.mesh.surface)

    def with_middles(self, triangles: Ints) -> Ints:
        """Return triangles, with their middle nodes if the space is quadratic.

        The triangles are faces of cells, shape (f, 3).
        """
        if self.order == 1:
            return triangles
        ends = np.sort(triangles[:, TRIANGLE_EDGES], axis=2)
        count = len(self.mesh.nodes_m)
        known = self._edges[0] @ np.array([count, 1])
        wanted = ends @ np.array([count, 1])
        return np.concatenate([triangles, count + np.searchsorted(known, wanted)], axis=1)

    @cached_property
    def pattern(self) -> Pattern:
        """Positions of the nonzero blocks of a matrix that is assembled on this space."""
        return Pattern.of(self.cell_nodes, self.node_count)

    @cached_property
    def gradients(self) -> tuple[wp.array[object], wp.array[object]]:
        """Gradients of the barycentric coordinates [1/m] and volumes [m3] on the device.

        The gradients are an array of vectors, shape (m, 4), and the volumes have shape (m,).
        """
        count = self.cell_count
        outputs = [
            wp.empty((count, 4), wp.vec3d, self.device),
            wp.empty(count, wp.float64, self.device),
        ]
        inputs = [self.mesh.nodes_m, self.mesh.cells]
        SplitLaunch(cell_gradients, count, inputs, outputs)()
        return outputs[0], outputs[1]

    @cached_property
    def volumes_m3(self) -> Array:
        """Volume of each cell [m3], shape (m,)."""
        return self.gradients[1].numpy()

    @cached_property
    def _edges(self) -> tuple[Ints, Ints]:
        """Rising corners of each edge, shape (e, 2), and edges of each cell, shape (m, 6)."""
        ends = np.sort(self.mesh.cells[:, EDGES].reshape(-1, 2), axis=1).astype(np.int32)
        order, start = grouped(ends[:, 0], ends[:, 1], len(self.mesh.nodes_m))
        edge_of = np.empty(len(order), np.int64)
        edge_of[order] = np.repeat(np.arange(len(start) - 1), np.diff(start))
        return ends[order[start[:-1]]].astype(np.int64), edge_of.reshape(-1, len(EDGES))
