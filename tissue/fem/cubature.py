"""Few points with volumes of their own that do the work of all: sparse non-negative least squares.

Energy-conserving sampling and weighting (Farhat, Avery, Chapman and Cortial 2014, Int. J. Numer. Meth. Engng 98:625)
takes whole elements; single integration points (Hernandez, Caicedo and Ferrer 2017, Comput. Methods Appl. Mech. Engrg
313:687) are fewer evaluations for the same error. Weights that are not negative keep the energy of a stable law
positive.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from meshes.base.arrays import Array, Ints

__all__ = ["few_points"]

NOTHING = 1e-14
"""Weight over the greatest at which a point leaves."""
RIDGE = 1e-12
"""Of the diagonal, added to the normal equations."""


def few_points(work: Array, tolerance: float, most: int) -> tuple[Ints, Array, float]:
    """Points and their weights whose summed work is nearly that of all points with weight 1.

    Lawson and Hanson's active set, one point more each round, stopped as soon as the sum is near enough.

    Parameters
    ----------
    work
        Work of each point, a row for each mode of each trained state, shape (k, p).
    tolerance
        Error of the summed work that is allowed, over its size (root of the sum of squares).
    most
        Most points.

    Returns
    -------
    Points, shape (c,), their weights, all positive, shape (c,), and the error reached.
    """
    goal = work.sum(axis=1)
    size, towards = float(np.linalg.norm(goal)), work.T @ goal
    chosen: list[int] = []
    weights, products = np.zeros(0), np.zeros((0, work.shape[1]))
    barred: list[int] = []
    error = 1.0
    while error > tolerance and len(chosen) < most:
        gain = towards - weights @ products
        gain[chosen + barred] = -np.inf
        point = int(gain.argmax())
        if gain[point] <= 0.0:
            break
        chosen.append(point)
        products = np.vstack([products, work[:, point] @ work])
        weights = np.append(weights, 0.0)
        while (found := _solved(products[:, chosen], towards[chosen])).min() <= 0.0:
            down = found <= 0.0
            share = float((weights[down] / (weights[down] - found[down])).min())
            weights = weights + share * (found - weights)
            kept = weights > NOTHING * weights.max()
            chosen = [each for each, stays in zip(chosen, kept, strict=True) if stays]
            weights, products = weights[kept], products[kept]
        weights = found
        barred = [] if point in chosen else [*barred, point]
        error = float(np.linalg.norm(goal - work[:, chosen] @ weights)) / size
    return np.array(chosen, dtype=np.int64), weights, error


def _solved(square: Array, right: Array) -> Array:
    """Solution of the normal equations of the chosen points."""
    ridge = RIDGE * float(np.trace(square)) / len(square) * np.eye(len(square))
    found: Array = cho_solve(cho_factor(square + ridge), right)
    return found
