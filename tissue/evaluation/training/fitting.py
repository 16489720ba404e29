"""From recorded runs to a scene's predictors: operators and the range of their training."""

from collections.abc import Sequence

from meshes.base.errors import InputError
from tissue.evaluation.training.recording import Recording
from tissue.prediction.edmd.dictionary import Delays, Identity
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import window
from tissue.prediction.edmd.lifted import Operator
from tissue.prediction.trained import Trained

__all__ = ["LAGS", "fit", "growth_of"]

LEAST_RUNS = 3
LAGS = 80
"""Delays: most of a period of tremor. With fewer the operator takes steps of the encoder at 15 to 40 Hz for motion: of
the look-ahead's excess error on unseen runs of palpation, in shares of hold's, 50 left 0.39 to 0.49, at 0.6 of the pace
0.65 to 0.78, and 100 left 0.34 to 0.40 and 0.57 to 0.61, but in files of 0.2 MB; on the wall all leave 0.17 to 0.24. A
regression of the displacement itself, measured or true, was no better."""
RIDGE = 1e-6
"""Share of the variance by which weights of delayed states are held small: they are alike to a step of the encoder."""
MARGIN = 3.0
"""Times the largest mean square in training at which a window is out of it; a prior."""


def fit(scene: str, runs: Sequence[Recording], *, lags: int = LAGS) -> Trained:
    """Predictors of a scene from recorded runs; every axis of a run is an episode of its own.

    Raises
    ------
    InputError
        If there are too few runs, nothing is touched, or they cannot be learnt from.
    """
    if len(runs) < LEAST_RUNS:
        raise InputError(f"trials must leave at least {LEAST_RUNS} to learn from, got {len(runs)}: use more")
    if not any(run.force_N.any() for run in runs):
        raise InputError("scene must have a tool that touches, got no force in any trial: run longer, or go deeper")
    episodes = [axis for run in runs for axis in run.episodes()]
    operator = Edmd(Delays(lags), ridge=RIDGE, offset=False).fit(episodes)
    control = Edmd(Identity()).fit([run.driven_episode() for run in runs])
    statistics = operator.statistics
    facts = {
        "dictionary": f"{lags} delays",
        "observables": len(operator.offset),
        "samples": statistics.samples,
        "radius_before_cap": statistics.radius_before,
        "capped": statistics.capped,
        "seeds": [run.seed for run in runs],
    }
    return Trained(scene, operator, control, growth_of(operator, runs), facts=facts)


def growth_of(operator: Operator, runs: Sequence[Recording]) -> float:
    """Mean square of scaled windows, all axes together, beyond which nothing was learnt."""
    largest = 0.0
    for run in runs:
        scaled = [window(axis.states, operator.dictionary.lags) / operator.scale for axis in run.episodes()]
        largest = max(largest, float(sum((each**2).mean(axis=1) for each in scaled).max()))
    return MARGIN * largest
