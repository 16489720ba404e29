"""Grid of trilinear hexahedra, particles and supports of a tooth.

Only the cells that hold material particles exist. The ligament is modelled as springs to the
ground.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from meshes.base.arrays import Array, Bytes, Flags, Int32s, Integers, Ints
from tissue.fem.solvers.held_body import rigid_modes

CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
"""Corners of a cell, in units of its edge, shape (8, 3)."""
CORNER_PAIRS = list(combinations_with_replacement(range(8), 2))
"""Pairs (a, b) of cell corners, a <= b, in the order of the blocks in a packed stiffness."""
NEIGHBOURS = np.array([[i, j, k] for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
"""Offsets from a node to the 27 nodes around it, shape (27, 3); row 13 is the node itself."""


@dataclass(frozen=True, eq=False)
class HexGrid:
    """Existing cells of a Cartesian grid, and the nodes of these cells.

    Cells and nodes are in lexicographic order of (x, y, z).

    Attributes
    ----------
    origin_m
        Corner of the grid with the lowest coordinates [m], shape (3,).
    edge_m
        Edge of a cell [m].
    cell_place
        Integer position of each cell in the grid, int32, shape (c, 3).
    node_place
        Integer position of each node in the grid, int32, shape (n, 3).
    cell_nodes
        Nodes of each cell, int32, shape (c, 8). Corner a = 4 i + 2 j + k is displaced from the
        lowest corner of the cell by (i, j, k) times the edge.
    """

    origin_m: Array
    edge_m: float
    cell_place: Int32s
    node_place: Int32s
    cell_nodes: Int32s

    @classmethod
    def of_cells(cls, cell_place: Integers, *, origin_m: Array, edge_m: float) -> "HexGrid":
        """Return the grid of the cells at the integer positions ``cell_place``, shape (c, 3).

        Positions may be repeated.
        """
        low = cell_place.min(axis=0)
        origin = np.asarray(origin_m, np.float64) + edge_m * low
        cells = _distinct(cell_place - low)
        corners = (cells[:, None, :] + CORNERS).reshape(-1, 3)
        nodes = _distinct(corners)
        cell_nodes = _found(_table(nodes), corners).reshape(-1, 8)
        return cls(origin, float(edge_m), cells, nodes, cell_nodes)

    @classmethod
    def around(
        cls, position_m: Array, *, edge_m: float, origin_m: Array | None = None
    ) -> "HexGrid":
        """Return the grid of the cells that hold the points ``position_m`` [m], shape (n, 3).

        The corners of the cells lie at ``origin_m`` plus multiples of ``edge_m``. The default of
        ``origin_m`` is half an edge below the lowest coordinates of the points.
        """
        origin = (
            position_m.min(axis=0) - 0.5 * edge_m
            if origin_m is None
            else np.asarray(origin_m, np.float64)
        )
        place = np.floor((position_m - origin) / edge_m).astype(np.int64)
        return cls.of_cells(place, origin_m=origin, edge_m=edge_m)

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return len(self.cell_place)

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.node_place)

    @cached_property
    def node_position_m(self) -> Array:
        """Positions of the nodes [m], shape (n, 3)."""
        return self.origin_m + self.edge_m * self.node_place

    @cached_property
    def cell_centre_m(self) -> Array:
        """Centres of the cells [m], shape (c, 3)."""
        return self.origin_m + self.edge_m * (self.cell_place + 0.5)

    @cached_property
    def node_cells(self) -> Int32s:
        """Cells around each node, int32, shape (n, 8).

        Column a holds the cell whose corner a is the node, or -1 if there is no such cell.
        """
        cells = np.full((self.node_count, 8), -1, dtype=np.int32)
        for corner in range(8):
            cells[self.cell_nodes[:, corner], corner] = np.arange(self.cell_count, dtype=np.int32)
        return cells

    @cached_property
    def node_neighbours(self) -> Int32s:
        """For each node, indices of the nodes that share one of its cells, int32, shape (n, 27).

        The columns are in the order of `NEIGHBOURS`; -1 means that there is no such node.
        """
        found = np.full((self.node_count, 27), -1, dtype=np.int32)
        for corner in range(8):
            for other in range(8):
                # Index of the offset in `NEIGHBOURS`.
                step = int((CORNERS[other] - CORNERS[corner] + 1) @ (9, 3, 1))
                found[self.cell_nodes[:, corner], step] = self.cell_nodes[:, other]
        return found

    @property
    def node_colour(self) -> Ints:
        """Number (colour) of each node, 0 to 7, shape (n,); nodes of one colour share no cell.

        The eight nodes of a cell have eight different colours.
        """
        # The colour depends on whether the position is even or odd along each axis.
        return (self.node_place & 1) @ (4, 2, 1)

    @cached_property
    def face_pairs(self) -> Int32s:
        """Pairs of cells that share a face, int32, shape (f, 2)."""
        pairs = []
        for axis in range(3):
            beyond = self.find_cells(self.cell_place + np.eye(3, dtype=np.int32)[axis])
            here = np.flatnonzero(beyond >= 0)
            pairs.append(np.stack([here, beyond[here]], axis=1))
        return np.concatenate(pairs).astype(np.int32)

    def find_cells(self, place: Integers) -> Int32s:
        """Return the cells at integer positions, shape (n, 3), or -1 where there is no cell."""
        return _found(self._cell_at, place)

    @cached_property
    def _cell_at(self) -> Int32s:
        return _table(self.cell_place)

    def find_nodes(self, place: Integers) -> Int32s:
        """Return the nodes at integer positions, shape (n, 3), or -1 where there is no node."""
        return _found(self._node_at, place)

    @cached_property
    def _node_at(self) -> Int32s:
        return _table(self.node_place)

    def locate(self, position_m: Array) -> tuple[Int32s, Array]:
        """Return the cell that holds each point, and the position of the point in that cell.

        The indices of the cells have shape (n,); -1 means that no cell holds the point. The
        positions, shape (n, 3), are coordinates from 0 to 1 along the edges of the cell.
        """
        scaled = (np.atleast_2d(position_m) - self.origin_m) / self.edge_m
        place = np.floor(scaled)
        return self.find_cells(place.astype(np.int64)), scaled - place

    def coarse(self) -> tuple["HexGrid", Int32s]:
        """Return the grid with twice the cell edge, and the coarse cell that contains each cell.

        The indices of the coarse cells are int32, shape (c,).
        """
        grid = HexGrid.of_cells(
            self.cell_place >> 1, origin_m=self.origin_m, edge_m=2.0 * self.edge_m
        )
        return grid, grid.find_cells(self.cell_place >> 1)


def ball_weight(distance_m: Array, reach_m: float) -> Array:
    """Return the weight 1 - (d / R)^2 of points at distances d < R from a centre, 0 elsewhere."""
    return np.maximum(1.0 - (distance_m / reach_m) ** 2, 0.0)


def shape_values(place: Array) -> Array:
    """Return the trilinear shape functions of the eight corners at points in a cell.

    The points, shape (n, 3), have coordinates of 0 to 1 along each edge. The values have shape (n,
    8).
    """
    factors = np.where(CORNERS == 1, place[:, None, :], 1.0 - place[:, None, :])
    return factors.prod(axis=2)


def _distinct(place: Integers) -> Int32s:
    """Return the distinct integer positions in lexicographic order, shape (k, 3)."""
    there = np.zeros(place.max(axis=0) + 1, np.bool_)
    there[tuple(place.T)] = True
    # C order keeps the rounding of sums over nodes. Recorded traces depend on it.
    return np.argwhere(there).astype(np.int32, order="C")


def _table(place: Int32s) -> Int32s:
    """Return a table from integer positions to rows of `place`, with a border; -1 for no row."""
    table = np.full(place.max(axis=0) + 3, -1, np.int32)
    table[tuple(place.T + 1)] = np.arange(len(place))
    return table


def _found(table: Int32s, place: Integers) -> Int32s:
    """Return the row for each integer position, shape (n, 3); -1 if the table has no row."""
    return table[tuple(np.clip(place + 1, 0, np.array(table.shape) - 1).T)]


FULL_STEPS = 65535
"""Remaining fraction of an uncut particle, in steps of 1/65535."""


@dataclass(frozen=True, eq=False)
class ParticleSet:
    """Particles of a body, in the caller's order.

    Attributes
    ----------
    position_m
        Positions [m], shape (n, 3).
    volume_m3
        Volume of each particle before any cut [m3], shape (n,).
    modulus_Pa
        Young's modulus [Pa], shape (n,).
    poisson_ratio
        Poisson's ratio, shape (n,). Trilinear cells lock if the ratio is near 0.5.
    layer
        Index of the layer, uint8, shape (n,).
    remaining
        Remaining fraction of each particle, in steps of 1/65535, uint16, shape (n,).
    """

    position_m: Array
    volume_m3: Array
    modulus_Pa: Array
    poisson_ratio: Array
    layer: Bytes
    remaining: NDArray[np.uint16]

    @classmethod
    def uniform(
        cls, position_m: Array, *, volume_m3: float, modulus_Pa: float, poisson_ratio: float = 0.3
    ) -> "ParticleSet":
        """Return uncut particles of one size and one material.

        The default Poisson's ratio, 0.3, is close to the values of bone and dentin (0.30 to 0.32).
        """
        count = len(position_m)
        return cls(
            np.asarray(position_m, np.float64),
            np.full(count, float(volume_m3)),
            np.full(count, float(modulus_Pa)),
            np.full(count, float(poisson_ratio)),
            np.zeros(count, np.uint8),
            np.full(count, FULL_STEPS, dtype=np.uint16),
        )

    @property
    def lame_Pa(self) -> Array:
        """Lame constants lambda and mu [Pa], shape (n, 2)."""
        ratio = self.poisson_ratio
        first = self.modulus_Pa * ratio / ((1.0 + ratio) * (1.0 - 2.0 * ratio))
        return np.stack([first, self.modulus_Pa / (2.0 * (1.0 + ratio))], axis=1)


@dataclass(frozen=True, eq=False)
class NodeSupports:
    """Supports of a grid: displacement components of nodes, held at given values.

    Attributes
    ----------
    fixed
        Components that are held, bool, shape (n, 3).
    displacement_m
        Prescribed displacement [m], shape (n, 3), used only for fixed components.
    """

    fixed: Flags
    displacement_m: Array

    @classmethod
    def of(
        cls, node_count: int, *, held: Flags | None = None, displacement_m: Array | None = None
    ) -> "NodeSupports":
        """Return supports that hold whole nodes or single displacement components.

        ``held`` is a mask of nodes, shape (n,), or of components, shape (n, 3). The held
        displacement is zero unless ``displacement_m`` is given.
        """
        fixed = np.zeros((node_count, 3), np.bool_)
        if held is not None:
            fixed |= held if held.ndim == 2 else held[:, None]
        return cls(fixed, np.where(fixed, 0.0 if displacement_m is None else displacement_m, 0.0))


@dataclass(frozen=True, eq=False)
class PointSprings:
    """Springs that connect points of a body to the ground, each with a stiffness matrix.

    If a point moves by u, the restoring force is S u.

    Attributes
    ----------
    position_m
        Positions of the k points [m], shape (k, 3).
    stiffness_N_m
        Stiffness S of each spring, symmetric [N/m], shape (k, 3, 3).
    """

    position_m: Array
    stiffness_N_m: Array

    def chosen(self, these: Flags) -> "PointSprings":
        """Return the springs that are selected by the mask ``these``, shape (k,)."""
        return PointSprings(self.position_m[these], self.stiffness_N_m[these])

    def restraint(self, centre_m: Array, length_m: float) -> Array:
        """Return the stiffness of the springs against rigid motion about a point, shape (6, 6).

        Rotations are multiplied by ``length_m``, so that all entries have the unit N/m. The order
        of rows and columns is: three translations, three rotations.
        """
        motion = rigid_modes((self.position_m - centre_m) / length_m, np.zeros(3))
        return np.einsum("kia,kib->ab", motion, self.stiffness_N_m @ motion)

    def by_cell(self, grid: HexGrid) -> tuple[Int32s, Array]:
        """Return the m cells that hold springs, and the stiffness of the springs in each cell.

        The indices of the cells are int32, shape (m,). The stiffness is the sum of ``N_a N_b S``
        over the springs of a cell, with the shape functions N of corners a and b. The 36 blocks
        with a <= b have shape (m, 36, 3, 3).
        """
        cell, place = grid.locate(self.position_m)
        order = np.argsort(cell, kind="stable")
        share = shape_values(place[order])
        stiffness = self.stiffness_N_m[order]
        cells, first = np.unique(cell[order], return_index=True)
        blocks = np.zeros((len(cells), len(CORNER_PAIRS), 3, 3))
        for row, (a, b) in enumerate(CORNER_PAIRS if len(cells) else []):
            blocks[:, row] = np.add.reduceat(
                (share[:, a] * share[:, b])[:, None, None] * stiffness, first, axis=0
            )
        return cells.astype(np.int32), blocks


NO_SPRINGS = PointSprings(np.zeros((0, 3)), np.zeros((0, 3, 3)))


def bed_stiffness(
    modulus_Pa: float, poisson_ratio: float, thickness_m: float
) -> tuple[float, float]:
    """Return the stiffness of a thin bonded layer, across and along the layer [N/m3].

    The layer is bonded on both sides. A layer cannot bulge at its edges if its thickness is much
    smaller than its width. The stiffness per area is then a modulus divided by the thickness.
    Across the layer, the modulus is the confined modulus E (1 - v) / ((1 + v) (1 - 2 v)). Along the
    layer, it is the shear modulus. Such a layer is a Winkler foundation. The relative error is of
    the order of thickness divided by width.
    """
    confined = (
        modulus_Pa * (1.0 - poisson_ratio) / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    )
    return confined / thickness_m, modulus_Pa / (2.0 * (1.0 + poisson_ratio)) / thickness_m


def bed_springs(
    tooth: Flags,
    bed: Flags,
    *,
    origin_m: Array,
    spacing_m: float,
    across_N_m3: float,
    along_N_m3: float,
) -> tuple[PointSprings, float]:
    """Return springs at the faces between the voxels of a tooth and of its bed (the ligament).

    The springs act at the centres of the tooth's voxels. The spring of a face has the stiffness ``A
    (k_t I + (k_n - k_t) n n^T)``, with the stiffness of the bed across the surface, k_n, and along
    the surface, k_t.

    The voxel faces form a staircase. n is therefore the normal of the smoothed surface, and A is
    the area of the face times the component of n along the normal of the face. The sum of A over
    the faces is the area of the smooth surface.

    Parameters
    ----------
    tooth, bed
        Voxels of the tooth and of its bed, shape (nx, ny, nz).
    origin_m, spacing_m
        Corner of voxel (0, 0, 0) and edge of a voxel [m].
    across_N_m3, along_N_m3
        Stiffness of the bed, see `bed_stiffness`.

    Returns
    -------
    The springs, and the area of the surface between tooth and bed [m2].
    """
    # The filter width is chosen. With it, the area of a sphere is 0.3 % too large; it is 1.2 % too
    # large with 1 voxel and 7 % with 0.5 voxel. A wider filter rounds edges.
    smooth = gaussian_filter(tooth.astype(np.float32), 1.5)
    slope = np.stack(np.gradient(smooth), axis=-1)
    positions = [np.zeros((0, 3))]
    matrices = [np.zeros((0, 3, 3))]
    total = 0.0
    for axis in range(3):
        low = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        high = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        for inner, outer in ((low, high), (high, low)):
            faces = np.argwhere(tooth[inner] & bed[outer])
            if len(faces) == 0:
                continue
            # The normal at a face is the mean of its two sides. With the tooth's side alone, the
            # area of a sphere is 3 % too small.
            leans = slope[low][tuple(faces.T)] + slope[high][tuple(faces.T)]
            normal = leans / np.maximum(np.linalg.norm(leans, axis=1, keepdims=True), 1e-9)
            area = spacing_m**2 * np.abs(normal[:, axis])
            total += float(area.sum())
            across = np.einsum("ki,kj->kij", normal, normal)
            matrices.append(
                area[:, None, None] * (along_N_m3 * np.eye(3) + (across_N_m3 - along_N_m3) * across)
            )
            if inner is high:
                faces[:, axis] += 1
            positions.append(origin_m + spacing_m * (faces + 0.5))
    return PointSprings(np.concatenate(positions), np.concatenate(matrices)), total
