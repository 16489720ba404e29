"""Training of a scene's predictors: fit to recorded runs, forecast errors, validation on runs
held out.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import ceil

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.evaluation.statistics.metrics import force_error
from tissue.evaluation.training.recording import Recorder, Recording, trial
from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.sampled_loop import force_later_N
from tissue.prediction.edmd import Edmd, window
from tissue.prediction.operator import Delays, Identity, Operator
from tissue.prediction.predictor import Contact, Predictor, SeesContact
from tissue.prediction.trained import VALIDATED_AT, Trained
from tissue.scene.registry import PREDICTORS
from tissue.scene.scene import Scene
from tissue.simulation.builders.prediction import FALLBACKS, trained_predictor

__all__ = [
    "HORIZONS",
    "LAGS",
    "LEAST_TRIALS",
    "MOST_TRIALS",
    "TRIALS",
    "fit",
    "forecast",
    "forecast_errors",
    "growth_of",
    "touching",
    "train",
    "validated",
    "with_fallback",
]

TRIALS = 12
"""Runs of a scene by default, four a group of hands."""
LEAST_TRIALS = 6
"""Fewest runs: one of them validates."""
MOST_TRIALS = 10_000
"""Maximum number of runs.

A hundred times the runs of the shipped predictors would take days and is treated as a typing error.
"""
HELD_OUT = 4
"""Interval of the runs that validate: one run in this number. The others train."""
HORIZONS = (1, 2, 3, 4, 6, 8, 10)
"""Ticks ahead at which predictors are compared."""
LEAST_RUNS = 3
LAGS = 80
"""Number of delays, most of a period of tremor.

With fewer delays the operator treats encoder steps at 15 to 40 Hz as motion. The figures are the
look-ahead's excess error on unseen runs of palpation over the excess error of zero-order hold. 50
delays leave 0.39 to 0.49, and 0.65 to 0.78 at 0.6 of the pace. 100 delays leave 0.34 to 0.40 and
0.57 to 0.61, but in files of 0.2 MB. On the wall all leave 0.17 to 0.24. A regression of the
displacement itself, measured or true, was no better.
"""
RIDGE = 1e-6
"""Ridge penalty as a share of the variance, which keeps weights of delayed states small.

Delayed states are equal to within one encoder step.
"""
MARGIN = 3.0
"""Ratio to the largest mean square in training at which a window is outside of it; a prior."""


def train(
    scene: Scene, *, trials: int = TRIALS, cores: int | None = None, progress: Progress = silent
) -> Trained:
    """Train the predictors of a scene on runs by hands of all groups, and validate them.

    The validation uses runs that are not in the training.

    The scene's own seed is not used: trial i has seed i.

    Raises
    ------
    InputError
        If there are too few trials or the scene cannot be run.
    """
    if not LEAST_TRIALS <= trials <= MOST_TRIALS:
        raise InputError(
            "trials", f"be from {LEAST_TRIALS} to {MOST_TRIALS}", trials, f"use {TRIALS}"
        )
    recorder = Recorder(cores=cores)
    runs = []
    for index in range(trials):
        progress(f"running trial {index + 1} of {trials}", index / (trials + 2))
        runs.append(recorder.record(trial(scene, index)))
    progress("fitting", trials / (trials + 2))
    kept = [run for index, run in enumerate(runs) if index % HELD_OUT != HELD_OUT - 1]
    limit = device_parameters(trial(scene, 0).held.kind, scene.constants).force_limit_N
    trained = with_fallback(fit(scene.name, kept), kept, limit)
    progress("validating", (trials + 1) / (trials + 2))
    return validated(trained, runs[HELD_OUT - 1 :: HELD_OUT], limit)


def with_fallback(trained: Trained, runs: list[Recording], force_limit_N: float) -> Trained:
    """Choose the fallback with the smallest mean error among the unlifted predictors.

    These are the predictors without a lifted operator.
    """
    makers = {
        kind: partial(trained_predictor, kind, trained, force_limit_N=force_limit_N)
        for kind in FALLBACKS
    }
    runs = touching(runs)
    errors = {
        kind: forecast_errors(make, runs, horizons=(VALIDATED_AT,)).mean()
        for kind, make in makers.items()
    }
    return replace(trained, fallback=min(errors, key=lambda kind: float(errors[kind])))


def validated(trained: Trained, held_out: list[Recording], force_limit_N: float) -> Trained:
    """Add the mean errors of all predictors on validation runs.

    Raises
    ------
    InputError
        If none of these runs touches anything.
    """
    held_out = touching(held_out)
    if not held_out:
        raise InputError(
            "trials", "leave a run that touches to validate on", "none", "use more, or run longer"
        )
    makers = {
        kind: partial(trained_predictor, kind, trained, force_limit_N=force_limit_N)
        for kind in PREDICTORS
    }
    errors = {
        kind: forecast_errors(make, held_out).mean(axis=0).tolist() for kind, make in makers.items()
    }
    validation = {
        "held_out": [run.seed for run in held_out],
        "horizons_ms": list(HORIZONS),
        "errors": errors,
    }
    return replace(trained, facts=trained.facts | {"validation": validation})


def fit(scene: str, runs: Sequence[Recording], *, lags: int = LAGS) -> Trained:
    """Fit the predictors of a scene to recorded runs. Every axis of a run is a separate episode.

    Raises
    ------
    InputError
        If there are too few runs, nothing is touched, or the runs are not suitable for training.
    """
    if len(runs) < LEAST_RUNS:
        raise InputError(
            "trials", f"leave at least {LEAST_RUNS} to learn from", len(runs), "use more"
        )
    if not any(run.force_N.any() for run in runs):
        raise InputError(
            "scene", "have a tool that touches", "no force in any trial", "run longer, or go deeper"
        )
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
    """Return the mean square of scaled windows, all axes together, that training has reached.

    Beyond this value, nothing was learnt.
    """
    largest = 0.0
    for run in runs:
        scaled = [
            window(axis.states, operator.dictionary.lags) / operator.scale
            for axis in run.episodes()
        ]
        largest = max(largest, float(sum((each**2).mean(axis=1) for each in scaled).max()))
    return MARGIN * largest


def forecast(
    predictor: Predictor, run: Recording, horizons: Sequence[float], *, model_ticks: int = 1
) -> tuple[Array, Array]:
    """Compute the forecasts of every tick [N], shape (n, horizons, 3), and the primary flags.

    The flag, shape (n,), is set if the forecast is from the primary predictor.

    The predictor receives the force every `model_ticks`. Until the next force it receives the
    contact of that tick, as in a loop.
    """
    predicted = np.empty((len(run.force_N), len(horizons), 3))
    is_primary = np.empty(len(run.force_N))
    shown = predictor if isinstance(predictor, SeesContact) else None
    # a predictor without a guard may grow beyond all bounds
    with np.errstate(over="ignore", invalid="ignore"):
        for index, (position, velocity, force) in enumerate(
            zip(run.position_m, run.velocity_m_s, run.force_N, strict=True)
        ):
            if shown is not None:
                shown.meet(Contact.of_row(run.contact[index - index % model_ticks]))
            predictor.observe(position, velocity, force if index % model_ticks == 0 else None)
            predicted[index] = [predictor.predict(horizon) for horizon in horizons]
            is_primary[index] = predictor.is_primary
    return predicted, is_primary


def forecast_errors(
    make: Callable[[], Predictor],
    runs: Sequence[Recording],
    *,
    horizons: Sequence[float] = HORIZONS,
    model_ticks: int = 1,
) -> Array:
    """Return ||predicted - F|| / ||F|| of a new predictor on each run, shape (runs, horizons).

    F is the reference force in the predicted tick, over all ticks that can be predicted.

    Raises
    ------
    InputError
        If a run has no force in those ticks; see `touching`.
    """
    errors = np.empty((len(runs), len(horizons)))
    for row, run in enumerate(runs):
        predicted, _ = forecast(make(), run, horizons, model_ticks=model_ticks)
        for column, horizon in enumerate(horizons):
            known = len(run.force_N) - ceil(horizon)
            came = force_later_N(run.force_N, horizon)[:known]
            errors[row, column] = force_error(predicted[:known, column], came)
    return errors


def touching(runs: Sequence[Recording]) -> list[Recording]:
    """Return the runs that have a force in ticks that can be predicted: a hand may come too late
    for a short scene.
    """
    return [run for run in runs if run.force_N[max(HORIZONS) :].any()]
