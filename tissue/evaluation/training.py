"""Training and validation of force predictors on recorded runs of a scene."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from math import ceil

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.evaluation.recorded_runs import Recorder, Recording, trial
from tissue.evaluation.statistics.metrics import force_error
from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.sampled_loop import force_later_N
from tissue.prediction.delays import (
    COORDINATES,
    DELAYS,
    HORIZON,
    DelayOperator,
    Moments,
)
from tissue.prediction.predictor import Predictor, SeesContact
from tissue.prediction.trained import FINE_STEP_M, VALIDATED_AT, Trained
from tissue.scene.registry import PREDICTORS
from tissue.scene.scene import Scene
from tissue.simulation.builders.prediction import FALLBACKS, trained_predictor

TRIALS = 12
"""Default number of recorded runs of a scene: four for each expertise group."""
LEAST_TRIALS = 6
"""Smallest number of recorded runs, of which one is used for validation."""
MOST_TRIALS = 10_000
"""Largest number of recorded runs.

This is a hundred times the number for the shipped predictors, and would take days to run. A larger
number is assumed to be a typing error.
"""
VALIDATION_INTERVAL = 4
"""Number of successive runs of which one is used for validation, the others for training.

Successive runs have hands of the three expertise groups in turn. Because 4 and 3 have no common
factor, successive validation runs have different groups too.
"""
HORIZONS = (1, 2, 3, 4, 6, 8, 10)
"""Prediction horizons at which predictors are compared [ticks]."""
LEAST_RUNS = 3
MARGIN = 3.0
"""Limit of the scaled inputs' mean square, relative to the largest value in training.

The inputs of the predictor are past displacements of the device and stretches of the coupling
spring. Above the limit, inputs count as outside the training range. The value is assumed.
"""


def train(
    scene: Scene, *, trials: int = TRIALS, cores: int | None = None, progress: Progress = silent
) -> Trained:
    """Train the predictors of a scene on runs with simulated hands, and validate the predictors.

    In the runs, simulated hands of all expertise groups move the tool.

    The validation uses runs that are not used for training.

    Run i has the seed i; the seed of the scene is ignored.

    Raises
    ------
    InputError
        If the number of trials is out of range, or the scene cannot be run.
    """
    if not LEAST_TRIALS <= trials <= MOST_TRIALS:
        raise InputError(
            "trials",
            f"be from {LEAST_TRIALS} to {MOST_TRIALS}",
            trials,
            f"use a number such as {TRIALS}",
        )
    recorder = Recorder(cores=cores)
    device = device_parameters(trial(scene, 0).held.kind, scene.constants)
    held_out = range(VALIDATION_INTERVAL - 1, trials, VALIDATION_INTERVAL)

    def recorded(index: int, encoder_step_m: float | None = None) -> Recording:
        """Record a trial."""
        one = trial(scene, index)
        run = recorder.record(one, encoder_step_m=encoder_step_m)
        if not run.contact[0].cuts:
            run = replace(run, ideal_N=recorder.ideal_force_N(one, run))
        return run

    runs = []
    fine = []
    for index in range(trials):
        # fit and validation count as two more trials
        progress(f"running trial {index + 1} of {trials}", index / (trials + 2))
        runs.append(recorded(index))
        if device.encoder_step_m > FINE_STEP_M and index not in held_out:
            fine.append(recorded(index, FINE_STEP_M))
    progress("fitting", trials / (trials + 2))
    kept = [run for index, run in enumerate(runs) if index not in held_out]
    limit = device.force_limit_N
    other = fit(scene.name, fine).operator if fine else None
    trained = replace(fit(scene.name, kept), step_m=device.encoder_step_m, fine=other)
    trained = with_fallback(trained, kept, limit)
    trained.facts["command"] = f"tissue train {scene.name} --trials {trials}"
    progress("validating", (trials + 1) / (trials + 2))
    return validated(trained, [runs[index] for index in held_out], limit)


def with_fallback(trained: Trained, runs: list[Recording], force_limit_N: float) -> Trained:
    """Return a copy of the trained predictors that uses the best fallback predictor.

    When a guard rejects a prediction, it uses the fallback. The fallback is the predictor in
    `FALLBACKS` with the smallest mean error.

    None of the predictors in `FALLBACKS` uses a trained operator.
    """
    errors = _mean_errors(FALLBACKS, trained, touching(runs), force_limit_N, (VALIDATED_AT,))
    return replace(trained, fallback=min(errors, key=lambda kind: errors[kind][0]))


def _mean_errors(
    kinds: Iterable[str],
    trained: Trained,
    runs: list[Recording],
    force_limit_N: float,
    horizons: Sequence[float] = HORIZONS,
) -> dict[str, list[float]]:
    """For each predictor, return a list with the mean error over all runs at each horizon."""
    errors = {}
    for kind in kinds:
        make = partial(trained_predictor, kind, trained, force_limit_N=force_limit_N)
        errors[kind] = forecast_errors(make, runs, horizons=horizons).mean(axis=0).tolist()
    return errors


def validated(trained: Trained, held_out: list[Recording], force_limit_N: float) -> Trained:
    """Measure all predictors on validation runs; return `trained` with the mean errors.

    Raises
    ------
    InputError
        If no run in `held_out` has contact.
    """
    held_out = touching(held_out)
    if not held_out:
        raise InputError(
            "trials",
            "leave a run with contact for the validation",
            "none",
            "use more trials, or a longer duration_s",
        )
    validation = {
        "held_out": [run.seed for run in held_out],
        "horizons_ms": list(HORIZONS),
        "errors": _mean_errors(PREDICTORS, trained, held_out, force_limit_N),
    }
    return replace(trained, facts=trained.facts | {"validation": validation})


def fit(scene: str, runs: Sequence[Recording]) -> Trained:
    """Fit the operator of a scene to recorded runs.

    Motions along x, y and z have equal weight.

    Raises
    ------
    InputError
        If there are too few runs, if no run has a force, or if the runs are not suitable for
        training.
    """
    if len(runs) < LEAST_RUNS:
        raise InputError(
            "trials",
            f"leave at least {LEAST_RUNS} runs to learn from",
            len(runs),
            "use more trials",
        )
    if not any(run.force_N.any() for run in runs):
        raise InputError(
            "scene",
            "have a tool that touches the tissue",
            "no force in any trial",
            "use a longer duration_s, or a deeper path",
        )
    count = 0
    sums = np.zeros((COORDINATES, COORDINATES + 2 * HORIZON))
    seen_in_runs = []
    for run in runs:
        seen, targets = run.samples()
        seen_in_runs.append(seen)
        rows = seen.swapaxes(1, 2).reshape(-1, COORDINATES)
        wanted = targets.swapaxes(1, 2).reshape(-1, 2 * HORIZON)
        sums += rows.T @ np.hstack((rows, wanted))
        count += len(rows)
    sums /= count
    moments = Moments(sums[:, :COORDINATES], sums[:, COORDINATES:])
    facts = {
        "delays": list(DELAYS),
        "samples": count,
        "groups": [run.group for run in runs],
        "seeds": [run.seed for run in runs],
    }
    moments.check()
    operator = DelayOperator(moments, MARGIN * _largest_square(moments, seen_in_runs))
    return Trained(scene, operator, facts=facts)


def _largest_square(moments: Moments, seen_in_runs: Iterable[Array]) -> float:
    """Return the largest value, over all ticks, of the mean square of the scaled inputs.

    The mean is taken over all axes together.
    """
    inverse = 1.0 / np.diag(moments.coordinates)
    squares = (np.einsum("tca,c->t", seen**2, inverse).max() for seen in seen_in_runs)
    return float(max(squares)) / COORDINATES


def forecast(
    predictor: Predictor, run: Recording, horizons: Sequence[float], *, model_ticks: int = 1
) -> tuple[Array, Array]:
    """Predict the force at each of the given horizons [ticks] from every tick of a run.

    Return the predicted forces [N], shape (n, horizons, 3), and a flag for each tick, shape (n,).
    The flag is 1 if the predicted force comes mainly from the primary predictor, and 0 if it comes
    mainly from the fallback.

    To imitate a slow tissue model, the predictor receives a new force and new contact data only
    every `model_ticks` ticks.
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
                # of the last tick of the model
                shown.meet(run.contact[index - index % model_ticks])
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
    """Return the relative errors of a predictor made for each run, shape (runs, horizons).

    The error is ||predicted - F|| / ||F||, where F is the recorded force in the predicted tick. The
    norms are taken over all ticks for which the predicted tick is still within the run.

    Raises
    ------
    InputError
        If a run has no force in the predicted ticks; see `touching`.
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
    """Return the runs that have a nonzero force in ticks that can be predicted.

    A tick can be predicted if the run contains all earlier ticks at the distances in `HORIZONS`.
    Some runs have no such force, because the hand may not reach the tissue in a short run.
    """
    return [run for run in runs if run.force_N[max(HORIZONS) :].any()]
