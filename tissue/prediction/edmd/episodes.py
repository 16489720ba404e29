"""Recorded episodes to learn from: what they hold, what is refused, and windows of them."""

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive

__all__ = ["Episode", "blocks", "check_episodes", "window"]

SAME_STEP = 1e-6
"""Relative difference of two steps that still counts as one sample rate: rounding of printed times."""
BLOCK = 2048
"""Rows lifted and factored at a time: they and their factor stay in the cache, whatever the length of a trace."""
STILL = 1e-12
"""A column that varies by less than this share of its size is constant: rounding."""


class Episode(NamedTuple):
    """One uninterrupted recording; a plain tuple of the same order is as good.

    Attributes
    ----------
    states
        One row a sample, shape (n, d), any units.
    inputs
        What acts from each sample to the next, held in between, shape (n, m); None if nothing does.
    step_s
        Time between samples [s].
    rates
        Time derivatives of the states, shape (n, d), which only a generator's fit needs; else None.
    """

    states: Array
    inputs: Array | None
    step_s: float
    rates: Array | None = None


def check_episodes(
    episodes: Sequence[Episode], lags: int, *, rates: bool = False, varying: bool = True
) -> list[Episode]:
    """The episodes as float64, if a fit with so many delays can learn from them, or, not `varying`, be tried on them.

    Raises
    ------
    InputError
        If there is none, a number is not finite, shapes or steps differ between episodes, an episode is too short for
        the delays, or a column never varies; names the episode, the column and the remedy.
    """
    if not len(episodes):
        raise InputError("episodes must hold at least one episode, got none: record one")
    ready = [_checked(index, Episode(*each), lags, rates) for index, each in enumerate(episodes)]
    first = ready[0]
    for index, each in enumerate(ready):
        if abs(each.step_s - first.step_s) > SAME_STEP * first.step_s:
            raise InputError(
                f"step_s must be the same in all episodes, got {first.step_s:g} in 0 and {each.step_s:g} in {index}: "
                "resample them to one rate"
            )
        widths = [(e.states.shape[1], 0 if e.inputs is None else e.inputs.shape[1]) for e in (first, each)]
        if widths[0] != widths[1]:
            raise InputError(
                f"episodes must have the same columns of states and inputs, got {widths[0]} in 0 and {widths[1]} in "
                f"{index}: give all the same"
            )
    if not varying:
        return ready
    _refuse_constant("states", [each.states for each in ready])
    _refuse_constant("inputs", [each.inputs[:-1] for each in ready if each.inputs is not None])
    return ready


def window(states: Array, lags: int) -> Array:
    """Each row with the rows before it, newest first, shape (n - lags, (lags + 1) d)."""
    if lags == 0:
        return states
    count = len(states) - lags
    return np.concatenate([states[lags - lag : lags - lag + count] for lag in range(lags + 1)], axis=1)


def blocks(episode: Episode, lags: int) -> Iterator[tuple[Array, Array]]:
    """Windows and inputs of an episode, some thousand samples at a time, with one window more than there are inputs.

    The windows have shape (k + 1, (lags + 1) d), the inputs shape (k, m): input i leads from window i to i + 1.
    """
    windows = window(episode.states, lags)
    inputs = np.zeros((len(episode.states), 0)) if episode.inputs is None else episode.inputs
    for start in range(0, len(windows) - 1, BLOCK):
        stop = min(start + BLOCK, len(windows) - 1)
        yield windows[start : stop + 1], inputs[lags + start : lags + stop]


def _checked(index: int, episode: Episode, lags: int, rates: bool) -> Episode:
    """One episode as float64, or an error that names it."""
    states = _table(f"states of episode {index}", episode.states)
    inputs = None if episode.inputs is None else _table(f"inputs of episode {index}", episode.inputs)
    slopes = None if episode.rates is None else _table(f"rates of episode {index}", episode.rates)
    for name, each in (("inputs", inputs), ("rates", slopes)):
        if each is not None and len(each) != len(states):
            raise InputError(
                f"{name} of episode {index} must have one row for each of {len(states)} states, got {len(each)}: "
                "repeat the last row or cut the states"
            )
    if inputs is not None and inputs.shape[1] == 0:
        inputs = None
    if rates and (slopes is None or slopes.shape != states.shape):
        got = "none" if slopes is None else f"shape {slopes.shape}"
        raise InputError(
            f"rates of episode {index} must have the shape of its states {states.shape}, got {got}: give the time "
            "derivatives, or fit Edmd and take its generator()"
        )
    if len(states) < lags + 2:
        raise InputError(
            f"episode {index} must have at least {lags + 2} rows for {lags} delays, got {len(states)}: leave it out or "
            "take fewer delays"
        )
    step = require_positive(f"step_s of episode {index}", episode.step_s, "use the time between samples, such as 0.001")
    return Episode(states, inputs, step, slopes)


def _table(name: str, values: object) -> Array:
    """A finite table of numbers."""
    try:
        table = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be a table of numbers, got {type(values).__name__}: use an array") from None
    if table.ndim != 2:
        raise InputError(f"{name} must have shape (rows, columns), got {table.shape}: one row a sample")
    if not isfinite(table.sum()):
        row, column = np.argwhere(~np.isfinite(table))[0] if not np.isfinite(table).all() else (0, 0)
        raise InputError(
            f"{name} must be finite, got {table[row, column]} in row {row}, column {column}: cut the episode there"
        )
    return table


def _refuse_constant(name: str, tables: list[Array]) -> None:
    """Refuse a column that never varies: it cannot be separated from the constant."""
    if not tables:
        return
    lowest = np.min([each.min(axis=0) for each in tables], axis=0)
    highest = np.max([each.max(axis=0) for each in tables], axis=0)
    still = highest - lowest <= STILL * np.maximum(np.abs(lowest), np.abs(highest))
    if still.any():
        column = int(np.argmax(still))
        raise InputError(f"column {column} of {name} must vary, got {lowest[column]:g} throughout: leave it out")
