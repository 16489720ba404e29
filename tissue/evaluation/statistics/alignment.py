"""Two paths aligned by place: which moment of one corresponds to which of the other, and how far they lie apart."""

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError

__all__ = ["aligned_rows", "deviation_mm"]

POINTS = 800
"""Samples of either path that the alignment goes over; distances are refined between them."""


def aligned_rows(path: Array, model: Array) -> Ints:
    """Row of the model that each row of a path corresponds to, never falling (Sakoe and Chiba 1978).

    The sum of distances over pairs is smallest among all orders of passing through both paths without going back. Both
    start at their first points. The alignment may end before the last point of the model, because a path that is
    right as far as it goes deviates nowhere.

    Parameters
    ----------
    path, model
        Points in time, any unit, shapes (n, d) and (m, d).

    Returns
    -------
    NDArray
        Shape (n,), from 0 to m - 1.

    Raises
    ------
    InputError
        If a path is empty, or they differ in their dimension.
    """
    if path.ndim != 2 or model.ndim != 2 or not len(path) or not len(model) or path.shape[1] != model.shape[1]:
        raise InputError(
            f"path and model must have shapes (n, d) and (m, d), got {path.shape} and {model.shape}: cut both"
        )
    ours, theirs = (
        np.unique(np.linspace(0, len(each) - 1, min(POINTS, len(each))).round().astype(int)) for each in (path, model)
    )
    cost = np.linalg.norm(path[ours][:, None] - model[theirs][None], axis=2)
    n, m = cost.shape
    total = np.full((n + 1, m + 1), np.inf)
    total[0, 0] = 0.0
    for diagonal in range(n + m - 1):  # all cells of one diagonal depend only on those of the two before
        i = np.arange(max(0, diagonal - m + 1), min(n, diagonal + 1))
        j = diagonal - i
        before = np.minimum(np.minimum(total[i, j + 1], total[i + 1, j]), total[i, j])
        total[i + 1, j + 1] = cost[i, j] + before
    at = np.zeros(n)
    met = np.zeros(n)
    row = n
    column = 1 + int(np.argmin(total[n, 1:]))
    while row > 0 and column > 0:
        at[row - 1] += theirs[column - 1]
        met[row - 1] += 1
        steps = (total[row - 1, column - 1], total[row - 1, column], total[row, column - 1])
        back = int(np.argmin(steps))
        row -= int(back != 2)
        column -= int(back != 1)
    return np.interp(np.arange(len(path)), ours, at / met).round().astype(np.int64)


def deviation_mm(path: Array, model: Array, rows: Ints) -> Array:
    """Distance of each point from the model's path near its aligned row [mm], shape (n,).

    Parameters
    ----------
    path, model
        Points in time [mm], shapes (n, d) and (m, d).
    rows
        Row of the model for each point, from :func:`aligned_rows`, shape (n,).
    """
    reach = 2 * int(np.ceil(max(len(path), len(model)) / POINTS)) + 2
    best = np.full(len(path), np.inf)
    for shift in range(-reach, reach):
        start = np.clip(rows + shift, 0, max(0, len(model) - 2))
        edge = model[np.minimum(start + 1, len(model) - 1)] - model[start]
        length = (edge**2).sum(axis=1)
        along = ((path - model[start]) * edge).sum(axis=1) / np.where(length > 0.0, length, 1.0)
        foot = model[start] + np.clip(along, 0.0, 1.0)[:, None] * edge
        best = np.minimum(best, np.linalg.norm(path - foot, axis=1))
    return best
