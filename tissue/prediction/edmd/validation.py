"""Error of an operator against the horizon, and the choice of a dictionary by cross-validation over episodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import BLOCK, Episode, check_episodes, window
from tissue.prediction.edmd.lifted import Operator

__all__ = ["Choice", "HorizonErrors", "choose", "horizon_errors"]


@dataclass(frozen=True)
class HorizonErrors:
    """Errors of predictions 1 to h steps ahead, all from the same starts.

    Attributes
    ----------
    rms
        Root mean square over the starts of each state entry's error, in its unit, shape (h, d); inf where it diverges.
    relative
        The same in training deviations of the entries, root mean square over those looked at, shape (h,).
    starts
        Number of predictions.
    """

    rms: Array
    relative: Array
    starts: int


@dataclass(frozen=True)
class Choice:
    """What cross-validation chose.

    Attributes
    ----------
    name
        The candidate with the lowest mean score.
    operator
        That candidate fitted to all episodes.
    scores
        Relative error at the horizon of every candidate, one for each fold; inf where it diverges or was refused.
    refused
        Why a candidate could not be fitted.
    """

    name: str
    operator: Operator
    scores: dict[str, Array]
    refused: dict[str, str]


def horizon_errors(
    operator: Operator, episodes: Sequence[Episode], horizon: int, *, columns: Sequence[int] = ()
) -> HorizonErrors:
    """Compare predictions 1 to `horizon` steps ahead, inputs known, with what followed, from every possible start.

    Parameters
    ----------
    horizon
        Steps ahead, at least 1.
    columns
        State entries that `relative` looks at; empty for all.

    Raises
    ------
    InputError
        If an episode cannot be used, or none is long enough for the horizon.
    """
    lags, size = operator.dictionary.lags, operator.state_size
    ready = check_episodes(episodes, lags, varying=False)
    squares, starts = np.zeros((horizon, size)), 0
    with np.errstate(over="ignore", invalid="ignore"):
        for episode in ready:
            states, windows = episode.states, window(episode.states, lags)
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
                f"episodes must be longer than {lags + horizon} rows for this horizon, got none: shorten it"
            )
        rms = np.sqrt(squares / starts)
        rms[~np.isfinite(rms)] = np.inf
        chosen = list(columns) if len(columns) else slice(None)
        relative = np.sqrt(((rms / operator.scale[:size])[:, chosen] ** 2).mean(axis=1))
    return HorizonErrors(rms, relative, starts)


def choose(
    candidates: Mapping[str, Edmd],
    episodes: Sequence[Episode],
    *,
    horizon: int,
    folds: int = 5,
    columns: Sequence[int] = (),
) -> Choice:
    """The candidate whose fits to the other folds predict a fold best, `horizon` steps ahead.

    Whole episodes go into a fold, in turn: neighbouring samples of one episode are too alike to be held out.

    Raises
    ------
    InputError
        If every candidate is refused.
    """
    scores, refused = {}, {}
    for name, candidate in candidates.items():
        found = np.full(folds, np.inf)
        try:
            for fold in range(folds):
                kept = [each for index, each in enumerate(episodes) if index % folds != fold]
                operator = candidate.fit(kept)
                found[fold] = horizon_errors(operator, episodes[fold::folds], horizon, columns=columns).relative[-1]
        except InputError as problem:
            found[:], refused[name] = np.inf, str(problem)
        scores[name] = found
    best = min(scores, key=lambda name: float(scores[name].mean()))
    if best in refused:
        raise InputError(f"candidates must hold one that can be fitted, got none: {refused[best]}")
    return Choice(best, candidates[best].fit(episodes), scores, refused)
