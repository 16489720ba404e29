"""Fronts of a multifrontal factorisation: which unknowns each eliminates, which it changes, and what it waits for."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array

from meshes.base.arrays import Ints

__all__ = ["Front", "fronts_of"]


@dataclass(frozen=True, eq=False)
class Front:
    """A block of unknowns that is eliminated at once.

    Attributes
    ----------
    start, stop
        Its unknowns, in order of elimination.
    below
        Later unknowns that its elimination changes, rising, shape (r,).
    children
        Fronts whose changes reach this one first.
    """

    start: int
    stop: int
    below: Ints
    children: list[int]


def fronts_of(lower: csc_array, starts: Ints) -> list[Front]:
    """Fronts of blocks of unknowns, in order of elimination: children come before their parents.

    Parameters
    ----------
    lower
        Lower triangle of the matrix in order of elimination, shape (n, n).
    starts
        First unknown of each block and n, rising, shape (blocks + 1,).
    """
    marked = np.zeros(lower.shape[0], dtype=np.bool_)
    block_of = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    children: list[list[int]] = [[] for _ in starts[1:]]
    fronts: list[Front] = []
    for block, (start, stop) in enumerate(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)):
        marked[lower.indices[lower.indptr[start] : lower.indptr[stop]]] = True
        for child in children[block]:
            marked[fronts[child].below] = True
        below = stop + np.flatnonzero(marked[stop:])
        marked[start:] = False
        if len(below):
            children[int(block_of[below[0]])].append(block)
        fronts.append(Front(start, stop, below, children[block]))
    return fronts
