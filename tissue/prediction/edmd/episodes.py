"""Recorded training episodes: contents, checks and windows."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = ["Episode", "blocks", "check_episodes", "window"]

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
