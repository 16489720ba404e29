"""Extended dynamic mode decomposition with inputs over many recorded episodes."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.prediction.operator import Dictionary, FitStatistics, Operator

__all__ = ["Edmd", "Episode", "regress", "triangle", "window"]

BLOCK = 2048
"""Number of rows lifted and factored at a time.

The rows and their factor stay in the cache for any length of a trace.
"""
STILL = 1e-12
"""Relative variation below which a column counts as constant; smaller ones are rounding errors."""
DEPENDENT = 1e-13
"""Singular values below this share of the largest are rounding errors of the factor.

Their columns depend on the other columns.
"""


class Episode(NamedTuple):
    """One uninterrupted recording; a plain tuple in this order may replace it.

    Attributes
    ----------
    states
        One row a sample, shape (n, d), any units.
    inputs
        Inputs that act from each sample to the next, held in between, shape (n, m); None for no
        inputs.
    step_s
        Time between samples [s].
    """

    states: Array
    inputs: Array | None
    step_s: float


@dataclass(frozen=True)
class Edmd:
    """Least-squares fit of a linear map of observables.

    Source: Williams, Kevrekidis & Rowley 2015; Korda & Mezić 2018.

    Observables and inputs are centred on their means and scaled by their standard deviations
    inside, and an offset is fitted with them. The fitted operator is in the units of the states.

    Parameters
    ----------
    dictionary
        The observables.
    ridge
        Penalty on the weights of the scaled observables, as a share of their variance (Tikhonov);
        0 or more.
    rank
        Singular values of the scaled data to keep; None for all.
    cap
        Largest modulus of the eigenvalues after the fit (`tissue.prediction.operator`); None for no
        cap.
    offset
        Centre the data and fit an offset; without it, zero maps to zero.
    """

    dictionary: Dictionary
    ridge: float = 0.0
    rank: int | None = None
    cap: float | None = 1.0
    offset: bool = True

    def __post_init__(self) -> None:
        if self.cap is not None and not 0.0 < self.cap < np.inf:
            raise InputError("cap", "be positive and finite", self.cap, "use 1, or None for no cap")

    def fit(self, episodes: Sequence[Episode]) -> Operator:
        """Fit the operator over one step to all pairs of neighbouring samples.

        Raises
        ------
        InputError
            If a number is not finite, an episode is too short for the delays, a column never
            varies, observables overflow, or columns are collinear and neither ridge nor rank is
            set.
        """
        ready = _checked(episodes, self.dictionary.lags)
        state_size = ready[0].states.shape[1]
        lead = int(self.offset)
        count = self.dictionary.size(state_size)
        carried = self.dictionary.lags * state_size
        factor, samples = triangle(_rows(ready, self.dictionary, lead))
        ones = factor[:, :lead].sum(axis=1, keepdims=True)
        known = factor.shape[1] - (count - carried)
        middle = factor[0, lead:known] / factor[0, 0] * self.offset
        spread = np.sqrt((factor[lead:, lead:known] ** 2).sum(axis=0) / samples)
        # A constant column is divided by 1, which is multiplied back below.
        scale = np.where(spread > STILL * np.abs(middle), spread, 1.0)
        kept = slice(0, count)
        # Delayed states are targets that are regressors already, a lag earlier: they are not
        # factored twice.
        columns = np.concatenate(
            (
                known + np.arange(state_size),
                lead + np.arange(carried),
                known + np.arange(state_size, count - carried),
            )
        )
        scaled = (
            (factor[:, lead:known] - ones * middle) / scale,
            factor[:, :lead],
            (factor[:, columns] - ones * middle[kept]) / scale[kept],
        )
        found, residual_rms = regress(
            np.hstack(scaled), samples, size=known, ridge=self.ridge, rank=self.rank, free=lead
        )
        weights = found.T
        size = len(scale)
        A = weights[:, :count] * scale[kept, None] / scale[kept]
        B = weights[:, count:size] * scale[kept, None] / scale[count:]
        constant = weights[:, size] * scale[kept] if self.offset else np.zeros(count)
        operator = Operator(
            dictionary=self.dictionary,
            A=A,
            B=B,
            offset=constant - A @ middle[kept] - B @ middle[count:] + middle[kept],
            middle=middle[kept],
            scale=scale[kept],
            step_s=ready[0].step_s,
            statistics=FitStatistics(
                samples=samples,
                residual_rms=residual_rms * scale[kept],
                radius_before=float(np.abs(np.linalg.eigvals(weights[:, :count])).max()),
            ),
        )
        return operator if self.cap is None else operator.capped(self.cap)


def window(states: Array, lags: int) -> Array:
    """Return each row with the rows before it, newest first, shape (n - lags, (lags + 1) d)."""
    if lags == 0:
        return states
    count = len(states) - lags
    return np.concatenate(
        [states[lags - lag : lags - lag + count] for lag in range(lags + 1)], axis=1
    )


def _checked(episodes: Sequence[Episode], lags: int) -> list[Episode]:
    """Return the episodes after checking that a fit with `lags` delays can use them."""
    ready = [Episode(*each) for each in episodes]
    for index, each in enumerate(ready):
        for name, table in (("states", each.states), ("inputs", each.inputs)):
            if table is not None and not np.isfinite(table).all():
                row, column = np.argwhere(~np.isfinite(table))[0]
                raise InputError(
                    f"{name} of episode {index}",
                    "be finite",
                    f"{table[row, column]} in row {row}, column {column}",
                    "cut the episode there",
                )
        if len(each.states) < lags + 2:
            raise InputError(
                f"episode {index}",
                f"have at least {lags + 2} rows for {lags} delays",
                len(each.states),
                "leave it out or take fewer delays",
            )
    inputs = [each.inputs[:-1] for each in ready if each.inputs is not None]
    for name, tables in (("states", [each.states for each in ready]), ("inputs", inputs)):
        for index, column in enumerate(np.concatenate(tables).T if tables else ()):
            # a constant column cannot be separated from the offset
            if np.ptp(column) <= STILL * np.abs(column).max():
                raise InputError(
                    f"column {index} of {name}", "vary", f"{column[0]:g} throughout", "leave it out"
                )
    return ready


def _rows(episodes: list[Episode], dictionary: Dictionary, lead: int) -> Iterator[Array]:
    """Yield rows [1, φ, u, new] of some thousand samples at a time.

    The ones are left out if `lead` is 0. `new` are the observables of the next step that are not
    among φ. Of delayed states, only the newest one is new.
    """
    lags = dictionary.lags
    for episode in episodes:
        width = episode.states.shape[1]
        windows = window(episode.states, lags)
        inputs = np.zeros((len(episode.states), 0)) if episode.inputs is None else episode.inputs
        for start in range(0, len(windows) - 1, BLOCK):
            stop = min(start + BLOCK, len(windows) - 1)
            with np.errstate(over="ignore", invalid="ignore"):
                lifted = dictionary.lift(windows[start : stop + 1])
            if not np.isfinite(lifted).all():
                raise InputError(
                    "observables",
                    "be finite on all states",
                    "overflow",
                    "scale the states, or the dictionary",
                )
            acting = inputs[lags + start : lags + stop]
            ones = np.ones((len(acting), lead))
            after = (lifted[1:, :width], lifted[1:, width * (lags + 1) :])
            yield np.hstack((ones, lifted[:-1], acting, *after))


def triangle(blocks: Iterable[Array]) -> tuple[Array, int]:
    """Return the triangular factor of rows (k, c) that arrive in blocks, and the number of rows.

    The factor has shape (c, c). It is computed block by block (Golub & Van Loan 2013, section 5.3).
    A Gram matrix would square the condition number and lose digits. The factor has the sums of
    squares and products of any combination of columns of the rows.
    """
    factor = np.zeros((0, 0))
    samples = 0
    for rows in blocks:
        samples += len(rows)
        factor = np.asarray(
            np.linalg.qr(np.vstack((factor, rows)) if len(factor) else rows, mode="r")
        )
    return np.pad(factor, ((0, factor.shape[1] - len(factor)), (0, 0))), samples


def regress(
    factor: Array, samples: int, *, size: int, ridge: float, rank: int | None, free: int
) -> tuple[Array, Array]:
    """Compute weights that minimise Σ|target - regressors weights|² + ridge · samples · |weights|².

    Parameters
    ----------
    factor
        Factor of [regressors targets] by `triangle`, or columns combined from one: below its first
        `size` rows the regressors are zero. Regressors are scaled to about one.
    samples
        Number of rows that the factor was computed from.
    size
        Number of regressors.
    ridge
        Weight of the penalty, 0 or more.
    rank
        Singular values to keep, or None for all.
    free
        Number of regressors at the end that have no penalty.

    Returns
    -------
    The weights, shape (size, targets): targets are about regressors @ weights. The root mean square
    of the residual of each target, shape (targets,).

    Raises
    ------
    InputError
        If there are fewer rows than regressors, or, without ridge and rank, a regressor
        depends on the others.
    """
    if rank is not None and not 1 <= rank <= size:
        raise InputError(
            "rank", f"be in [1, {size}], the number of regressors", rank, "leave it out to keep all"
        )
    matrix = factor[:size, :size]
    right = factor[:size, size:]
    rest = factor[size:, size:]
    penalty = np.diag(np.sqrt(ridge * samples * (np.arange(size) < size - free)))
    left, values, right_vectors = np.linalg.svd(
        np.vstack((matrix, penalty)) if ridge > 0.0 else matrix, False
    )
    kept = size if rank is None else rank
    if values[kept - 1] <= DEPENDENT * values[0]:
        if rank is None and samples < size:
            raise InputError(
                "episodes",
                f"hold at least {size} samples",
                samples,
                "record more, or set ridge=1e-6",
            )
        index = int(np.abs(right_vectors[-1]).argmax())
        raise InputError(
            "observables and inputs",
            "be independent",
            f"number {index} as a combination of the others or always zero",
            "leave it out, or set ridge=1e-8 or a lower rank",
        )
    projected = left[:size, :kept].T @ right
    weights = right_vectors[:kept].T @ (projected / values[:kept, None])
    missed = right - matrix @ weights
    squares = (missed**2).sum(axis=0) + (rest**2).sum(axis=0)
    return weights, np.sqrt(squares / samples)
