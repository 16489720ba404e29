"""Train a scene's predictors: run it, fit, and validate on runs held out."""

from dataclasses import replace
from functools import partial

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.builders.prediction import FALLBACKS, trained_predictor
from tissue.evaluation.training.evaluation import HORIZONS, forecast_errors, touching
from tissue.evaluation.training.fitting import fit
from tissue.evaluation.training.recording import Recorder, Recording, trial
from tissue.haptics.device.device import device_parameters
from tissue.prediction.trained import VALIDATED_AT, Trained
from tissue.scene.registry import PREDICTORS
from tissue.scene.scene import Scene

__all__ = ["LEAST_TRIALS", "MOST_TRIALS", "TRIALS", "train", "validated", "with_fallback"]

TRIALS = 12
"""Runs of a scene by default, four a group of hands."""
LEAST_TRIALS = 6
"""Fewest runs: one of them validates."""
MOST_TRIALS = 10_000
"""Most runs: a hundred times what the shipped predictors needed would take days, and is taken for a slip."""
HELD_OUT = 4
"""One run in so many validates; the others train."""


def train(scene: Scene, *, trials: int = TRIALS, cores: int | None = None, progress: Progress = silent) -> Trained:
    """Predictors of a scene, trained on runs by hands of all groups and validated on runs held out.

    The scene's own seed is not used: trial i has seed i.

    Raises
    ------
    InputError
        If there are too few trials or the scene cannot be run.
    """
    if not LEAST_TRIALS <= trials <= MOST_TRIALS:
        raise InputError(f"trials must be from {LEAST_TRIALS} to {MOST_TRIALS}, got {trials}: use {TRIALS}")
    recorder, runs = Recorder(cores=cores), []
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
    """With the best of the predictors without a lifted operator, by their mean errors on some runs."""
    makers = {kind: partial(trained_predictor, kind, trained, force_limit_N=force_limit_N) for kind in FALLBACKS}
    runs = touching(runs)
    errors = {kind: forecast_errors(make, runs, horizons=(VALIDATED_AT,)).mean() for kind, make in makers.items()}
    return replace(trained, fallback=min(errors, key=lambda kind: float(errors[kind])))


def validated(trained: Trained, held_out: list[Recording], force_limit_N: float) -> Trained:
    """With the mean errors of all predictors on runs that were held out.

    Raises
    ------
    InputError
        If none of these runs touches anything.
    """
    held_out = touching(held_out)
    if not held_out:
        raise InputError("trials must leave a run that touches to validate on, got none: use more, or run longer")
    makers = {kind: partial(trained_predictor, kind, trained, force_limit_N=force_limit_N) for kind in PREDICTORS}
    errors = {kind: forecast_errors(make, held_out).mean(axis=0).tolist() for kind, make in makers.items()}
    validation = {"held_out": [run.seed for run in held_out], "horizons_ms": list(HORIZONS), "errors": errors}
    return replace(trained, facts=trained.facts | {"validation": validation})
