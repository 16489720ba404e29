"""Sobol indices from few runs: of a polynomial chaos of degree two, with the variance that it explains."""

from itertools import combinations

import numpy as np

from meshes.base.arrays import Array
from tissue.uncertainty.sobol import SobolIndices

__all__ = ["LEAST_EXPLAINED", "surrogate_indices"]

LEAST_EXPLAINED = 0.8
"""Cross-validated share of a figure's variance below which a surrogate gives no indices."""
RIDGES = 10.0 ** np.arange(-6, 3)
FOLDS, DRAWS = 8, 100


def surrogate_indices(
    free: Array, figures: Array, groups: tuple[tuple[int, ...], ...], *, seed: int
) -> tuple[SobolIndices, Array]:
    """Indices of figures, and the share of the variance of each that is explained in runs left out of the fit.

    The figures are those of a sum of products of normalised Hermite polynomials up to degree two, its coefficients by
    ridge regression (Sudret 2008, Reliab. Eng. Syst. Saf. 93:964).

    Parameters
    ----------
    free
        Independent standard normal numbers of each run, shape (n, p).
    figures
        Shape (n, figures).
    groups
        Columns of each group; every column belongs to one.
    """
    terms = _terms(free.shape[1])
    basis = np.column_stack([_product(free, term) for term in terms])
    members = np.array([[any(at in group for at in term) for term in terms] for group in groups])
    alone = np.array([[all(at in group for at in term) for term in terms] for group in groups])
    count, width = len(groups), figures.shape[1]
    found = np.full((2, 3, count, width), np.nan)
    explained = np.full(width, np.nan)
    rng = np.random.default_rng(seed)
    for column, values in enumerate(figures.T):
        if np.ptp(values) == 0.0:
            continue
        ridge, explained[column] = _best(basis, values)
        if explained[column] < LEAST_EXPLAINED:
            continue
        rows = [np.arange(len(free)), *rng.integers(0, len(free), (DRAWS, len(free)))]
        drawn = np.array([_shares(_fitted(basis[each], values[each], ridge), alone, members) for each in rows])
        found[:, 0, :, column] = drawn[0]
        found[:, 1:, :, column] = np.moveaxis(np.quantile(drawn[1:], (0.05, 0.95), axis=0), 0, 1)
    return SobolIndices(found[0, 0], found[1, 0], found[0, 1:], found[1, 1:]), explained


def _terms(width: int) -> list[tuple[int, ...]]:
    """Columns of each product: one, squares as the same twice, and pairs."""
    places = range(width)
    return [*((at,) for at in places), *((at, at) for at in places), *combinations(places, 2)]


def _product(free: Array, term: tuple[int, ...]) -> Array:
    if len(term) == 2 and term[0] == term[1]:
        return np.asarray((free[:, term[0]] ** 2 - 1.0) / np.sqrt(2.0))
    return np.asarray(free[:, list(term)].prod(axis=1))


def _fitted(basis: Array, values: Array, ridge: float) -> Array:
    """Coefficients by ridge regression, means taken away."""
    centred = basis - basis.mean(axis=0)
    kernel = centred @ centred.T
    kernel[np.diag_indices_from(kernel)] += ridge * len(basis)
    return np.asarray(centred.T @ np.linalg.solve(kernel, values - values.mean()))


def _best(basis: Array, values: Array) -> tuple[float, float]:
    """Ridge of the least error on runs that the fit has not seen, and the share of the variance that it explains."""
    errors = np.zeros(len(RIDGES))
    for fold in range(FOLDS):
        seen = np.arange(len(values)) % FOLDS != fold
        middle, mean = basis[seen].mean(axis=0), values[seen].mean()
        for at, ridge in enumerate(RIDGES):
            guess = mean + (basis[~seen] - middle) @ _fitted(basis[seen], values[seen], ridge)
            errors[at] += ((guess - values[~seen]) ** 2).sum()
    at = int(np.argmin(errors))
    return float(RIDGES[at]), 1.0 - float(errors[at]) / (len(values) * float(values.var()))


def _shares(coefficients: Array, alone: Array, members: Array) -> Array:
    """First-order and total indices, shape (2, groups)."""
    squares = coefficients**2 / max(float((coefficients**2).sum()), 1e-300)
    return np.stack([alone @ squares, members @ squares])
