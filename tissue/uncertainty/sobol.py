"""Sobol indices: how much of the variance of a figure each constant, or group of correlated constants, explains."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from tissue.uncertainty.sample import normals

__all__ = ["SobolIndices", "sobol_indices"]

DRAWS = 400
"""Draws of the bootstrap, from which the ends of 90 % intervals are read."""


@dataclass(frozen=True, eq=False)
class SobolIndices:
    """Indices of figures by groups.

    Attributes
    ----------
    first, total
        First-order and total indices, shape (groups, figures); NaN of a figure that does not vary.
    first_ends, total_ends
        Ends of their 90 % intervals by bootstrap, shape (2, groups, figures).
    """

    first: Array
    total: Array
    first_ends: Array
    total_ends: Array


def sobol_indices(
    figures: Callable[[Array], Array], groups: tuple[tuple[int, ...], ...], *, count: int, seed: int
) -> SobolIndices:
    """First-order and total indices of a function of independent standard normal numbers.

    Two samples A and B are taken, and for every group one that is A with the group's columns from B. First-order
    indices follow Saltelli et al. (2010, Comput. Phys. Commun. 181:259, table 2 b), total ones Jansen (2 f there).

    Parameters
    ----------
    figures
        Figures, shape (n, figures), of numbers of shape (n, p).
    groups
        Columns of each group; every column belongs to one.
    count
        Rows of A, a power of two; the function is called for count (groups + 2) rows.
    """
    width = sum(map(len, groups))
    both = normals(count, 2 * width, seed=seed)
    first_rows, second_rows = both[:, :width], both[:, width:]
    a, b = figures(first_rows), figures(second_rows)
    mixed = []
    for group in groups:
        rows = first_rows.copy()
        rows[:, group] = second_rows[:, group]
        mixed.append(figures(rows))
    middle = 0.5 * (a.mean(axis=0) + b.mean(axis=0))
    a, b, c = a - middle, b - middle, np.stack(mixed) - middle
    first, total = _indices(a, b, c)
    rng = np.random.default_rng(seed)
    drawn = [_indices(a[rows], b[rows], c[:, rows]) for rows in rng.integers(0, count, (DRAWS, count))]
    ends = np.quantile(np.array(drawn), (0.05, 0.95), axis=0)  # shape (2, first or total, groups, figures)
    return SobolIndices(first, total, ends[:, 0], ends[:, 1])


def _indices(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Both indices of centred figures, c of shape (groups, n, figures)."""
    variance = 0.5 * (a * a + b * b).mean(axis=0) - (0.5 * (a + b).mean(axis=0)) ** 2
    variance = np.where(variance > 0.0, variance, np.nan)
    return (b * (c - a)).mean(axis=1) / variance, 0.5 * ((c - a) ** 2).mean(axis=1) / variance
