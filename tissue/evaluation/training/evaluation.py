"""Errors of predictors on recorded runs, against the force that came."""

from collections.abc import Callable, Sequence
from math import ceil

import numpy as np

from meshes.base.arrays import Array
from tissue.evaluation.statistics.metrics import force_error
from tissue.evaluation.training.recording import Recording
from tissue.haptics.loop.motor_path import force_later_N
from tissue.prediction.contact import Contact, SeesContact
from tissue.prediction.predictor import Predictor

__all__ = ["HORIZONS", "forecast", "forecast_errors", "touching"]

HORIZONS = (1, 2, 3, 4, 6, 8, 10)
"""Ticks ahead at which predictors are compared."""


def forecast(
    predictor: Predictor, run: Recording, horizons: Sequence[float], *, model_ticks: int = 1
) -> tuple[Array, Array]:
    """What a predictor gives in every tick, shape (n, horizons, 3) [N], and whether it is the primary's, shape (n,).

    It sees the force every `model_ticks`, and until the next one the contact of that tick, as it does in a loop.
    """
    predicted, is_primary = np.empty((len(run.force_N), len(horizons), 3)), np.empty(len(run.force_N))
    shown = predictor if isinstance(predictor, SeesContact) else None
    with np.errstate(over="ignore", invalid="ignore"):  # a predictor without a guard may grow beyond all bounds
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
    """||predicted - F|| / ||F|| of a new predictor on each run, shape (runs, horizons).

    F is the reference force in the tick that was predicted, over all ticks that can be predicted.

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
    """The runs that have a force in ticks that can be predicted: a hand may come too late for a short scene."""
    return [run for run in runs if run.force_N[max(HORIZONS) :].any()]
