"""Nested dissection by coordinates: an order of elimination that keeps a factor sparse (George 1973, SIAM J. Numer.
Anal. 10:345)."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from meshes.base.arrays import Array, Ints

__all__ = ["dissected", "dissection"]

LEVELS = 10
"""Halvings of the box that the curve follows."""
LEAF = 32
"""Sets of at most this many nodes are not cut further."""


def dissection(nodes_m: Array, graph: csr_array) -> Ints:
    """Nodes in order of elimination, shape (n,); parameters as of `dissected`."""
    return np.concatenate(dissected(nodes_m, graph))


def dissected(nodes_m: Array, graph: csr_array, *, leaf: int = LEAF) -> list[Ints]:
    """Sets of nodes in order of elimination: of each cut first both sides, then what parts them.

    A set is cut at the median of its longest extent; the nodes of one side that touch the other come last.

    Parameters
    ----------
    nodes_m
        Node positions [m], shape (n, 3).
    graph
        Nodes that share a cell, shape (n, n).
    leaf
        Sets of at most this many nodes are not cut further.
    """
    side = np.zeros(len(nodes_m), dtype=np.int8)
    last_first: list[Ints] = []
    waiting = [_along_curve(nodes_m)]
    while waiting:
        nodes = waiting.pop()
        along = nodes_m[nodes, int(np.ptp(nodes_m[nodes], axis=0).argmax())] if len(nodes) > leaf else np.zeros(1)
        low = along < np.median(along)
        if not low.any():
            last_first.append(nodes)
            continue
        lower, upper = nodes[low], nodes[~low]
        side[lower], side[upper] = 1, 2
        rim_below, rim_above = _touches(graph, lower, side == 2), _touches(graph, upper, side == 1)
        side[nodes] = 0
        if rim_below.sum() <= rim_above.sum():
            last_first.append(lower[rim_below])
            lower = lower[~rim_below]
        else:
            last_first.append(upper[rim_above])
            upper = upper[~rim_above]
        waiting += [lower, upper]
    return last_first[::-1]


def _touches(graph: csr_array, nodes: Ints, marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the nodes have a marked neighbour."""
    rows = graph[nodes]
    return np.asarray(rows @ marked.astype(np.int32) > 0)


def _along_curve(nodes_m: Array) -> Ints:
    """Nodes along a curve that passes each octant of a box before the next (Morton 1966), shape (n,)."""
    low = nodes_m.min(axis=0)
    steps = ((nodes_m - low) / max(float(np.ptp(nodes_m, axis=0).max()), 1e-300) * (2**LEVELS - 1)).astype(np.int64)
    code = np.zeros(len(nodes_m), dtype=np.int64)
    for level in range(LEVELS):
        for axis in range(3):
            code |= ((steps[:, axis] >> level) & 1) << (3 * level + axis)
    return np.argsort(code, kind="stable")
