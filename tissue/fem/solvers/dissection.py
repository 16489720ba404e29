"""Nested dissection by coordinates: an order of elimination that keeps a factor sparse (George 1973, SIAM J. Numer.
Anal. 10:345)."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from meshes.base.arrays import Array, Ints

__all__ = ["dissection"]

LEAF = 16
"""Sets of at most this many nodes are not cut further."""


def dissection(nodes_m: Array, graph: csr_array) -> Ints:
    """Nodes in order of elimination, shape (n,).

    A set is cut at the median of its longest extent; the nodes of one side that touch the other come last.

    Parameters
    ----------
    nodes_m
        Node positions [m], shape (n, 3).
    graph
        Nodes that share a cell, shape (n, n).
    """
    side = np.zeros(len(nodes_m), dtype=np.int8)
    last_first: list[Ints] = []
    waiting = [np.arange(len(nodes_m))]
    while waiting:
        nodes = waiting.pop()
        along = nodes_m[nodes, int(np.ptp(nodes_m[nodes], axis=0).argmax())] if len(nodes) > LEAF else np.zeros(1)
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
    return np.concatenate(last_first[::-1])


def _touches(graph: csr_array, nodes: Ints, marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the nodes have a marked neighbour."""
    rows = graph[nodes]
    return np.asarray(rows @ marked.astype(np.int32) > 0)
