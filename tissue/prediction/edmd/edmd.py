"""Extended dynamic mode decomposition with inputs over many episodes.

It also computes the errors over the prediction horizon.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.prediction.edmd.dictionary import Dictionary
from tissue.prediction.edmd.lifted import FitStatistics, Generator, LiftedMap, Operator

__all__ = [
    "Edmd",
    "Episode",
    "HorizonErrors",
    "Regression",
    "blocks",
    "check_episodes",
    "horizon_errors",
    "regress",
    "triangle",
    "window",
]

BLOCK = 2048
"""Number of rows lifted and factored at a time.

The rows and their factor stay in the cache for any length of a trace.
"""
STILL = 1e-12
"""Relative variation below which a column counts as constant; smaller ones are rounding errors."""


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
    rates
        Time derivatives of the states, shape (n, d). Only the fit of a generator needs them; else
        None.
    """

    states: Array
    inputs: Array | None
    step_s: float
    rates: Array | None = None


def check_episodes(
    episodes: Sequence[Episode], lags: int, *, varying: bool = True
) -> list[Episode]:
    """Return the episodes after checking that a fit with `lags` delays can use them.

    Parameters
    ----------
    episodes
        One or more, with equal columns and step.
    lags
        Earlier states in a window.
    varying
        Refuse a column that never varies. Set it to False for episodes that only test a fit.

    Raises
    ------
    InputError
        If a number is not finite, an episode is too short for the delays, or a column never varies.
        The message names the episode, the column and the remedy.
    """
    ready = [Episode(*each) for each in episodes]
    for index, each in enumerate(ready):
        for name, table in (
            ("states", each.states),
            ("inputs", each.inputs),
            ("rates", each.rates),
        ):
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
    if varying:
        _refuse_constant("states", [each.states for each in ready])
        _refuse_constant("inputs", [each.inputs[:-1] for each in ready if each.inputs is not None])
    return ready


def window(states: Array, lags: int) -> Array:
    """Return each row with the rows before it, newest first, shape (n - lags, (lags + 1) d)."""
    if lags == 0:
        return states
    count = len(states) - lags
    return np.concatenate(
        [states[lags - lag : lags - lag + count] for lag in range(lags + 1)], axis=1
    )


def blocks(episode: Episode, lags: int) -> Iterator[tuple[Array, Array]]:
    """Yield windows and inputs of an episode, some thousand samples at a time.

    Each item has one window more than inputs. The windows have shape (k + 1, (lags + 1) d), the
    inputs shape (k, m): input i leads from window i to i + 1.
    """
    windows = window(episode.states, lags)
    inputs = np.zeros((len(episode.states), 0)) if episode.inputs is None else episode.inputs
    for start in range(0, len(windows) - 1, BLOCK):
        stop = min(start + BLOCK, len(windows) - 1)
        yield windows[start : stop + 1], inputs[lags + start : lags + stop]


def _refuse_constant(name: str, tables: list[Array]) -> None:
    """Check that every column varies: a constant one cannot be separated from the offset."""
    for index, column in enumerate(np.concatenate(tables).T if tables else ()):
        if np.ptp(column) <= STILL * np.abs(column).max():
            raise InputError(
                f"column {index} of {name}", "vary", f"{column[0]:g} throughout", "leave it out"
            )


DEPENDENT = 1e-13
"""Singular values below this share of the largest are rounding errors of the factor.

Their columns depend on the other columns.
"""


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
        Largest modulus of the eigenvalues after the fit (`tissue.prediction.edmd.lifted`); None
        for no cap.
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
            If the episodes are not usable for a fit (`check_episodes`), observables overflow, or
            columns are collinear and neither ridge nor rank is set.
        """
        ready = check_episodes(episodes, self.dictionary.lags)
        operator = Operator(**vars(self._fit(ready, rates=False)), step_s=ready[0].step_s)
        return operator if self.cap is None else operator.capped(self.cap)

    def fit_generator(self, episodes: Sequence[Episode]) -> Generator:
        """Fit the generator to the observables' rates ∇φ · dx/dt.

        Source: gEDMD, Klus et al. 2020. The cap does not apply.

        Raises
        ------
        InputError
            As for `fit`.
        """
        return Generator(
            **vars(self._fit(check_episodes(episodes, self.dictionary.lags), rates=True))
        )

    def _fit(self, episodes: list[Episode], *, rates: bool) -> LiftedMap:
        """Fit the map, in the units of the observables."""
        state_size = episodes[0].states.shape[1]
        lead = int(self.offset)
        count = self.dictionary.size(state_size)
        carried = 0 if rates else self.dictionary.lags * state_size
        factor, samples = triangle(_rows(episodes, self.dictionary, lead, rates))
        ones = factor[:, :lead].sum(axis=1, keepdims=True)
        known = factor.shape[1] - (count - carried)
        middle = factor[0, lead:known] / factor[0, 0] * self.offset
        spread = np.sqrt((factor[lead:, lead:known] ** 2).sum(axis=0) / samples)
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
        targets = factor[:, columns] if rates else factor[:, columns] - ones * middle[kept]
        scaled = (
            (factor[:, lead:known] - ones * middle) / scale,
            factor[:, :lead],
            targets / scale[kept],
        )
        found = regress(
            np.hstack(scaled), samples, size=known, ridge=self.ridge, rank=self.rank, free=lead
        )
        weights = found.weights.T
        size = len(scale)
        A = weights[:, :count] * scale[kept, None] / scale[kept]
        B = weights[:, count:size] * scale[kept, None] / scale[count:]
        constant = weights[:, size] * scale[kept] if self.offset else np.zeros(count)
        constant = (
            constant - A @ middle[kept] - B @ middle[count:] + (0.0 if rates else middle[kept])
        )
        values = np.linalg.eigvals(weights[:, :count])
        return LiftedMap(
            dictionary=self.dictionary,
            A=A,
            B=B,
            offset=constant,
            middle=middle[kept],
            scale=scale[kept],
            input_middle=middle[count:],
            input_scale=scale[count:],
            moments=found.moments,
            lowest=np.min([each.states.min(axis=0) for each in episodes], axis=0),
            highest=np.max([each.states.max(axis=0) for each in episodes], axis=0),
            statistics=FitStatistics(
                samples=found.samples,
                episodes=len(episodes),
                rank=found.rank,
                condition=found.condition,
                residual_rms=found.residual_rms * scale[kept],
                radius_before=float(values.real.max() if rates else np.abs(values).max()),
            ),
        )


def _rows(
    episodes: list[Episode], dictionary: Dictionary, lead: int, rates: bool
) -> Iterator[Array]:
    """Yield rows [1, φ, u, new] of some thousand samples at a time.

    The ones are left out if `lead` is 0. `new` are the observables of the next step that are not
    among φ. Of delayed states, only the newest one is new. For a generator, `new` are the rates of
    all observables.
    """
    for episode in episodes:
        slopes = None
        if rates and episode.rates is not None:
            slopes = blocks(Episode(episode.rates, None, episode.step_s), dictionary.lags)
        width = episode.states.shape[1]
        for windows, inputs in blocks(episode, dictionary.lags):
            with np.errstate(over="ignore", invalid="ignore"):
                lifted = dictionary.lift(windows)
            if not np.isfinite(lifted).all():
                raise InputError(
                    "observables",
                    "be finite on all states",
                    "overflow",
                    "scale the states, or the dictionary",
                )
            if slopes is None:
                after = [lifted[1:, :width], lifted[1:, width * (dictionary.lags + 1) :]]
            else:
                after = [dictionary.lift_rates(windows, next(slopes)[0])[:-1]]
            yield np.hstack((np.ones((len(inputs), lead)), lifted[:-1], inputs, *after))


@dataclass(frozen=True)
class Regression:
    """Result of a least-squares fit.

    Attributes
    ----------
    weights
        Shape (p, q): targets are about regressors @ weights.
    residual_rms
        Root mean square of the residual of each target, shape (q,).
    moments
        Mean outer product of the regressors, shape (p, p).
    rank, condition
        Number of singular values kept, and the ratio of the largest to the smallest of them.
    samples
        Rows used.
    """

    weights: Array
    residual_rms: Array
    moments: Array
    rank: int
    condition: float
    samples: int


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
) -> Regression:
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
    return Regression(
        weights=weights,
        residual_rms=np.sqrt(squares / samples),
        moments=matrix.T @ matrix / samples,
        rank=kept,
        condition=float(values[0] / values[kept - 1]),
        samples=samples,
    )


@dataclass(frozen=True)
class HorizonErrors:
    """Errors of predictions 1 to h steps ahead, all with common starts.

    Attributes
    ----------
    rms
        Root mean square over the starts of each state entry's error, in its unit, shape (h, d); inf
        where it diverges.
    relative
        Error in training standard deviations of the entries, root mean square over the compared
        entries, shape (h,).
    starts
        Number of predictions.
    """

    rms: Array
    relative: Array
    starts: int


def horizon_errors(
    operator: Operator, episodes: Sequence[Episode], horizon: int, *, columns: Sequence[int] = ()
) -> HorizonErrors:
    """Compare predictions with recorded states from every possible start.

    Predictions reach 1 to `horizon` steps ahead. Inputs are known.

    Parameters
    ----------
    horizon
        Steps ahead, 1 or more.
    columns
        State entries that `relative` includes; empty for all.

    Raises
    ------
    InputError
        If an episode cannot be used, or no episode is long enough for the horizon.
    """
    lags = operator.dictionary.lags
    size = operator.state_size
    ready = check_episodes(episodes, lags, varying=False)
    squares = np.zeros((horizon, size))
    starts = 0
    with np.errstate(over="ignore", invalid="ignore"):
        for episode in ready:
            states = episode.states
            windows = window(episode.states, lags)
            count = len(states) - lags - horizon
            for first in range(0, count, BLOCK):
                last = min(first + BLOCK, count)
                lifted = operator.dictionary.lift(windows[first:last])
                for step in range(horizon):
                    now = slice(lags + first + step, lags + last + step)
                    inputs = None if episode.inputs is None else episode.inputs[now]
                    lifted = operator.advance(lifted, inputs)
                    missed = lifted[:, :size] - states[now.start + 1 : now.stop + 1]
                    squares[step] += (missed**2).sum(axis=0)
                starts += last - first
        if starts == 0:
            raise InputError(
                "episodes",
                f"be longer than {lags + horizon} rows for this horizon",
                "none",
                "shorten it",
            )
        rms = np.sqrt(squares / starts)
        rms[~np.isfinite(rms)] = np.inf
        chosen = list(columns) if len(columns) else slice(None)
        relative = np.sqrt(((rms / operator.scale[:size])[:, chosen] ** 2).mean(axis=1))
    return HorizonErrors(rms, relative, starts)
