"""Positions of the 3x3 blocks of an assembled matrix, and the cells that contribute to each block.

Pairs of nodes are grouped by two stable counting sorts, linear in their number. SciPy's conversion
of one compressed row into columns is such a sort. Each pair occurs once, lower node first. Its
mirror image gets a place, not a sum.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from meshes.base.arrays import Int32s, Ints

__all__ = ["Pattern", "grouped", "local_pairs"]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Block pattern of a symmetric matrix over nodes, with both triangles stored by rows.

    Attributes
    ----------
    row_start
        First block of each node's row, shape (n + 1,).
    column
        Node of each block's column, rising within a row, shape (b,).
    pair_start
        First contribution to each pair of nodes, shape (p + 1,).
    contribution
        Cell times the pairs in a cell, plus the pair in the cell, shape (c,); in the order of cells
        within a pair. The bitwise complement where the pair is reversed in its cell.
    place
        Block of each pair with the lower node as its row, shape (p,).
    mirror
        Block of its transpose, shape (p,); equal to `place` on the diagonal.
    """

    row_start: Int32s
    column: Int32s
    pair_start: Int32s
    contribution: Int32s
    place: Int32s
    mirror: Int32s

    @classmethod
    def of(cls, cell_nodes: Ints, node_count: int) -> "Pattern":
        """Return the pattern of cells with the nodes `cell_nodes`, shape (m, k)."""
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
        column = np.empty(row_start[-1], dtype=np.int32)
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
    """Return the pairs a <= b of a cell's nodes, row by row, shape (k (k + 1) / 2, 2)."""
    return np.stack(np.triu_indices(nodes_a_cell), axis=1)


def grouped(first: Int32s, second: Int32s, count: int) -> tuple[Int32s, Ints]:
    """Return the stable order that sorts pairs of numbers, and the start of each pair.

    The numbers are below `count`. The starts have shape (p + 1,).
    """
    every = np.arange(len(first), dtype=np.int32)
    order = _sorted_by(first, _sorted_by(second, every, count), count)
    ordered_first = first[order]
    ordered_second = second[order]
    new = np.ones(len(order) + 1, dtype=bool)
    new[1:-1] = (ordered_first[1:] != ordered_first[:-1]) | (
        ordered_second[1:] != ordered_second[:-1]
    )
    return order, np.flatnonzero(new)


def _sorted_by(key: Int32s, order: Int32s, count: int) -> Int32s:
    """Return `order` sorted stably by keys below `count`, in time linear in both."""
    row = csr_array(
        (order, key[order], np.array([0, len(order)], dtype=np.int32)), shape=(1, count)
    )
    return np.asarray(row.tocsc().data)
