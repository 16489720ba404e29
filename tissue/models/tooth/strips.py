"""Memory layout of cells and nodes for SIMD kernels, and products over strips of eight cells."""

from typing import Any

import numpy as np
import warp as wp

from kernels.cell_strips import LANES, lanes_of, strip_products
from kernels.launcher import SplitLaunch
from kernels.mirror import put
from meshes.base.arrays import Int32s, Ints
from tissue.models.tooth.grid import HexGrid


class StripLayout:
    """Memory layout of nodes and cells for SIMD kernels (lane vectors and strips).

    A pencil is the row of all nodes, or of all cells, with equal x and y. A strip is eight cells in
    a row along z. In memory the nodes of a pencil follow each other along z. The last node of a
    pencil is followed by free space, because the last strip may extend beyond this node.

    Attributes
    ----------
    slots
        Length of a lane vector, see `LaneVector`. ``slot`` is the position of each node in a lane
        vector, int32, shape (n,).
    strip
        Strip of each cell, and lane of the cell in the strip, int32, shape (c, 2).
    start, base
        First strip of each pencil of cells, shape (p + 1,). Positions in a lane vector of the four
        lowest nodes of each strip, shape (s, 4). Both arrays are int32.
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
        For each slot, its value and the next seven values, shape (3, slots - 7).
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
    """Recorded kernel launch that multiplies a vector by the stiffness of the strips.

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
