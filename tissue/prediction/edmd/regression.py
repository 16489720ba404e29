"""Least squares over data that come in blocks: one triangular factor, ridge, truncated singular values."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = ["Regression", "regress", "triangle"]

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


def triangle(blocks: Iterable[Array]) -> tuple[Array, int]:
    """Triangular factor of rows (k, c) that come in blocks, shape (c, c), and the number of rows.

    Block by block (Golub & Van Loan 2013, section 5.3), which keeps the digits that a Gram matrix, having the condition
    number squared, would lose. Sums of squares and products of any combination of columns are those of the factor's.
    """
    factor, samples = np.zeros((0, 0)), 0
    for rows in blocks:
        samples += len(rows)
        factor = np.asarray(np.linalg.qr(np.vstack((factor, rows)) if len(factor) else rows, mode="r"))
    return np.pad(factor, ((0, factor.shape[1] - len(factor)), (0, 0))), samples


def regress(factor: Array, samples: int, *, size: int, ridge: float, rank: int | None, free: int) -> Regression:
    """Weights that minimise Σ|target - regressors weights|² + ridge · samples · |weights|².

    Parameters
    ----------
    factor
        Of [regressors targets] by `triangle`, or columns combined from one: below its first `size` rows the
        regressors are zero. Regressors are scaled to about one.
    samples
        Rows that the factor stands for.
    size
        Number of regressors.
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
    if rank is not None and not 1 <= rank <= size:
        raise InputError(f"rank must be in [1, {size}], the number of regressors, got {rank}: leave it out to keep all")
    matrix, right, rest = factor[:size, :size], factor[:size, size:], factor[size:, size:]
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
