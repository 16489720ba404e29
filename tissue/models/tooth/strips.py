"""Products of the stiffness of a grid's cells with a vector.

The products are computed for strips of eight cells along z, or for single cells with packed
stiffness.
"""

from typing import Any

import numpy as np
import warp as wp

from kernels.cell_strips import LANES, WEIGHTS, lanes_of, strip_products
from kernels.hexahedra import cell_products, gather_cells
from kernels.lane_vectors import cube_weights, from_lanes, to_lanes
from kernels.launcher import SplitLaunch, run_once
from kernels.mirror import put
from meshes.base.arrays import Array, Int32s, Integers, Ints
from tissue.models.tooth.grid import HexGrid


class PackedProduct:
    """Recorded kernel launch: product of the stiffness of some cells and the nodal displacements.

    Parameters
    ----------
    grid
        The grid.
    cells, rows
        Cells of the product and the row of each cell in ``stiffness``, each of shape (k,).
    stiffness
        Warp array of packed stiffness [N/m], as in :mod:`kernels.hexahedra`. Every call reads this
        array.
    live
        Warp array, shape (c,), with 0 for each cell that carries no load.
    vector, force
        Warp arrays of vec3d, shape (n,): displacement of the nodes [m], and the force [N] to which
        the product is added.
    cores
        Number of processor cores that share kernel launches.
    """

    def __init__(
        self,
        grid: HexGrid,
        cells: Integers,
        rows: Integers,
        stiffness: Any,
        *,
        live: Any,
        vector: Any,
        force: Any,
        cores: int | None,
    ) -> None:
        place = np.full(grid.cell_count + 1, -1)
        place[cells] = np.arange(len(cells))
        nodes = np.unique(grid.cell_nodes[cells])
        corner_force = wp.zeros((len(cells), 8), wp.vec3d, vector.device)
        self._cells = SplitLaunch(
            cell_products,
            len(cells),
            [cells, rows, grid.cell_nodes, live, stiffness, vector],
            [corner_force],
            cores=cores,
        )
        self._nodes = SplitLaunch(
            gather_cells,
            len(nodes),
            [nodes, place[grid.node_cells[nodes]], corner_force],
            [force],
            cores=cores,
        )

    def __call__(self) -> None:
        """Compute the product and add it to ``force``."""
        self._cells()
        self._nodes()


AT_CUBE = 1e-6
"""Largest distance of a particle from its regular position that counts as rounding [cell edges]."""


class StripLayout:
    """Memory layout of nodes and cells for SIMD kernels (lane vectors and strips).

    A pencil is the row of all nodes, or of all cells, with equal x and y. A strip is eight cells in
    a row along z. In memory the nodes of a pencil follow each other along z. After the last node of
    a pencil there is free space for a strip that extends beyond this node.

    Attributes
    ----------
    slots
        Length of a lane vector. ``slot`` is the position of each node in a lane vector, int32,
        shape (n,).
    strip
        Strip of each cell, and lane of the cell in the strip, int32, shape (c, 2).
    start, base
        First strip of each pencil of cells, shape (p + 1,), and slots of the four lowest nodes of
        each strip, shape (s, 4), int32.
    colours
        Groups of pencils of cells, as int32 arrays. Two pencils of a group share no node.
    """

    def __init__(self, grid: HexGrid) -> None:
        width = int(grid.node_place[:, 1].max()) + 1
        keys_of_nodes, first, last = _pencils(grid.node_place, width)
        ends = np.cumsum(last - first + 1 + LANES)
        begin = ends - (last - first + 1 + LANES)
        self.slots = int(LANES * (ends[-1] // LANES + 2))
        pencil = np.searchsorted(keys_of_nodes, _pencil_keys(grid.node_place, width))
        self.slot = (begin[pencil] + grid.node_place[:, 2] - first[pencil]).astype(np.int32)
        keys, low, high = _pencils(grid.cell_place, width)
        strips = -(-(high - low + 1) // LANES)
        self.start = np.concatenate([[0], np.cumsum(strips)]).astype(np.int32)
        cell_pencil = np.searchsorted(keys, _pencil_keys(grid.cell_place, width))
        above = grid.cell_place[:, 2] - low[cell_pencil]
        self.strip = np.stack(
            [self.start[cell_pencil] + above // LANES, above % LANES], axis=1
        ).astype(np.int32)
        which = np.repeat(np.arange(len(keys)), strips)
        z = low[which] + LANES * (np.arange(len(which)) - self.start[which])
        corners = np.searchsorted(
            keys_of_nodes, keys[:, None] + np.array([0, 1, width, width + 1])
        )[which]
        self.base = (begin[corners] + z[:, None] - first[corners]).astype(np.int32)
        colour = 2 * (keys // width & 1) + (keys % width & 1)
        self.colours = [
            np.flatnonzero(colour == each).astype(np.int32) for each in np.unique(colour)
        ]


class LaneVector:
    """Vector with three components for each node, in the memory layout of `StripLayout`.

    The attributes are three views of one memory block.

    Attributes
    ----------
    single
        Single values, shape (3, slots).
    from_each
        The eight numbers that begin at each slot, shape (3, slots - 7).
    by_eight
        Groups of eight slots without overlap, shape (3, slots / 8).
    """

    def __init__(self, layout: StripLayout, scalar: Any, *, device: str) -> None:
        self.scalar = scalar
        self.slots = layout.slots
        count = layout.slots - LANES + 1
        self.single = wp.zeros((3, layout.slots), scalar, device)
        self.from_each = self._seen(1, count)
        self.by_eight = self._seen(LANES, layout.slots // LANES)

    def _seen(self, step: int, count: int) -> Any:
        size = wp.types.type_size_in_bytes(self.scalar)
        return wp.array(
            ptr=self.single.ptr,
            dtype=lanes_of(self.scalar),
            shape=(3, count),
            strides=(self.slots * size, step * size),
            device=self.single.device,
            copy=False,
        )


class StripProduct:
    """Recorded kernel launch: product of the stiffness of strips and a vector.

    Parameters
    ----------
    layout
        The strips.
    weight
        Weights of the strips, a Warp array of single or double precision, shape (strips, WEIGHTS,
        LANES).
    vector, force
        Vector that is multiplied, and vector to which the product is added. Both are lane vectors
        with the precision of the weights.
    """

    def __init__(
        self,
        layout: StripLayout,
        weight: Any,
        vector: LaneVector,
        force: LaneVector,
        *,
        device: str,
        cores: int | None,
    ) -> None:
        lanes: Any = wp.array(
            ptr=weight.ptr,
            dtype=lanes_of(vector.scalar),
            shape=weight.shape[:2],
            device=device,
            copy=False,
        )
        start = put(layout.start, wp.int32, device)
        base = put(layout.base, wp.vec4i, device)
        self._kept = weight  # `lanes` points into this array and does not own it
        self._launches = [
            SplitLaunch(
                strip_products(vector.scalar),
                len(pencils),
                [pencils, start, base, lanes, vector.from_each],
                [force.from_each],
                cores=cores,
            )
            for pencils in layout.colours
        ]

    def __call__(self) -> None:
        """Compute the product and add it to ``force``."""
        for launch in self._launches:
            launch()


class CellStrips:
    """Stiffness of the cells of a body as weights in strips of eight cells.

    The weights are stored in double precision, and again in single precision for smoothing. A cell
    is divided into eight cubes. Cells whose particles do not lie at the centres of these cubes have
    no weights.

    Parameters
    ----------
    grid
        The cells.
    place, particle_cell
        Position of each particle in its cell (0 to 1 along each edge), shape (p, 3), and index of
        this cell, shape (p,). The particles are sorted by cell.
    vector, force
        Warp arrays of vec3d, shape (n,): displacement of the nodes [m], which `product` reads, and
        the force [N], which it writes.

    Attributes
    ----------
    regular
        True for each cell with weights, bool, shape (c,).
    weight, single
        Weights in double and in single precision, Warp arrays, shape (strips, WEIGHTS, LANES).
    """

    def __init__(
        self,
        grid: HexGrid,
        place: Array,
        particle_cell: Int32s,
        *,
        vector: Any,
        force: Any,
        cores: int | None,
    ) -> None:
        device = str(vector.device)
        self.layout = StripLayout(grid)
        # The cubes have half the cell's edge, so their centres lie at 1/4 and 3/4.
        off = (np.abs(np.abs(place - 0.5) - 0.25) > AT_CUBE).any(axis=1)
        self.regular = np.ones(grid.cell_count, np.bool_)
        self.regular[particle_cell[off]] = False
        shape = (len(self.layout.base), WEIGHTS, LANES)
        self.weight = wp.zeros(shape, wp.float64, device)
        self.single = wp.zeros(shape, wp.float32, device)
        self.regular_on = put(self.regular.astype(np.uint8), wp.uint8, device)
        self.strip_on = put(self.layout.strip, wp.vec2i, device)
        self.slot_on = put(self.layout.slot, wp.int32, device)
        moved, self._force = (LaneVector(self.layout, wp.float64, device=device) for _ in range(2))
        count = len(vector)
        self._take_vector = SplitLaunch(
            to_lanes, count, [self.slot_on, vector], [moved.single], cores=cores
        )
        self._product = StripProduct(
            self.layout, self.weight, moved, self._force, device=device, cores=cores
        )
        self._give_force = SplitLaunch(
            from_lanes, count, [self.slot_on, self._force.single], [force], cores=cores
        )

    def update(
        self, particles: list[Any], live: Any, cells: Int32s, *, edge_m: float, strength: float
    ) -> None:
        """Update the weights of some cells from their particles, see `kernels.lane_vectors`."""
        inputs = [*particles, live, self.regular_on, self.strip_on, cells, edge_m, strength]
        run_once(cube_weights, len(cells), inputs, [self.weight, self.single])

    def product(self) -> None:
        """Compute the product of the double-precision weights with the displacement."""
        self._take_vector()
        self._force.single.zero_()
        self._product()
        self._give_force()


def _pencil_keys(place: Int32s, width: int) -> Ints:
    return place[:, 0].astype(np.int64) * width + place[:, 1]


def _pencils(place: Int32s, width: int) -> tuple[Ints, Ints, Ints]:
    """Return the key, and the lowest and highest position along z, of each pencil.

    A pencil is the row of all positions with equal x and y. The given positions must be in
    lexicographic order.
    """
    keys, first = np.unique(_pencil_keys(place, width), return_index=True)
    last = np.append(first[1:], len(place)) - 1
    return keys, place[first, 2].astype(np.int64), place[last, 2].astype(np.int64)
