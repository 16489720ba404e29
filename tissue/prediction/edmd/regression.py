"""Least squares over data that come in blocks: one triangular factor, ridge, truncated singular values."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = ["Regression", "regress"]

DEPENDENT = 1e-13
"""Singular values below this share of the largest are rounding of the factor: their columns depend on the others."""


@dataclass(frozen=True)
class Regression:
    """What least squares gave.

    Attributes
    ----------
    weights
        Shape (p, q): targets are about regressors @ weights.
    residual_rms
        Root mean square of what is left of each target, shape (q,).
    moments
        Mean outer product of the regressors, shape (p, p).
    rank, condition
        Singular values kept; largest over smallest of them.
    samples
        Rows seen.
    """

    weights: Array
    residual_rms: Array
    moments: Array
    rank: int
    condition: float
    samples: int


def regress(blocks: Iterable[tuple[Array, Array]], *, ridge: float, rank: int | None, free: int) -> Regression:
    """Weights that minimise Σ|target - regressors weights|² + ridge · samples · |weights|².

    The rows are reduced to the triangular factor of [regressors targets], block by block (Golub & Van Loan 2013,
    section 5.3), which keeps the digits that a Gram matrix, having the condition number squared, would lose.

    Parameters
    ----------
    blocks
        Regressors (k, p) and targets (k, q), with regressors scaled to about one.
    ridge
        Weight of the penalty, at least 0.
    rank
        Singular values to keep, or None for all.
    free
        Number of the last regressors that the penalty leaves alone.

    Raises
    ------
    InputError
        If there are fewer rows than regressors, or, without ridge and rank, a regressor
        depends on the others.
    """
    factor, samples, size = np.zeros((0, 0)), 0, 0
    for regressors, targets in blocks:
        rows = np.hstack((regressors, targets))
        samples, size = samples + len(rows), regressors.shape[1]
        factor = np.asarray(np.linalg.qr(np.vstack((factor, rows)) if len(factor) else rows, mode="r"))
    if rank is not None and not 1 <= rank <= size:
        raise InputError(f"rank must be in [1, {size}], the number of regressors, got {rank}: leave it out to keep all")
    whole = np.zeros((max(len(factor), size), factor.shape[1]))
    whole[: len(factor)] = factor
    matrix, right, rest = whole[:size, :size], whole[:size, size:], whole[size:, size:]
    penalty = np.diag(np.sqrt(ridge * samples * (np.arange(size) < size - free)))
    left, values, right_vectors = np.linalg.svd(np.vstack((matrix, penalty)) if ridge > 0.0 else matrix, False)
    kept = size if rank is None else rank
    if values[kept - 1] <= DEPENDENT * values[0]:
        if rank is None and samples < size:
            raise InputError(
                f"episodes must hold at least {size} samples, got {samples}: record more, or set ridge=1e-6"
            )
        index = int(np.abs(right_vectors[-1]).argmax())
        raise InputError(
            f"observables and inputs must be independent, got number {index} as a combination of the others or always "
            "zero: leave it out, or set ridge=1e-8 or a lower rank"
        )
    projected = left[:size, :kept].T @ right
    weights = right_vectors[:kept].T @ (projected / values[:kept, None])
    missed = right - matrix @ weights
    squares = (missed**2).sum(axis=0) + (rest**2).sum(axis=0)
    return Regression(
        weights=weights,
        residual_rms=np.sqrt(squares / samples),
        moments=matrix.T @ matrix / samples,
        rank=kept,
        condition=float(values[0] / values[kept - 1]),
        samples=samples,
    )
