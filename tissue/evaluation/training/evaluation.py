"""Errors of predictors on recorded runs, against the force that came."""

from collections.abc import Callable, Sequence

import numpy as np

from meshes.base.arrays import Array
from tissue.evaluation.training.recording import Recording
from tissue.prediction.predictor import Predictor

__all__ = ["HORIZONS", "forecast", "forecast_errors"]

HORIZONS = (1, 2, 3, 4, 6, 8, 10)
"""Ticks ahead at which predictors are compared."""


def forecast(
    predictor: Predictor, run: Recording, horizons: Sequence[int], *, model_ticks: int = 1
) -> tuple[Array, Array]:
    """What a predictor gives in every tick, shape (n, horizons, 3) [N], and whether it is the primary's, shape (n,).

    It sees the force every `model_ticks`.
    """
    predicted, is_primary = np.empty((len(run.force_N), len(horizons), 3)), np.empty(len(run.force_N))
    with np.errstate(over="ignore", invalid="ignore"):  # a predictor without a guard may grow beyond all bounds
        for index, (position, velocity, force) in enumerate(
            zip(run.position_m, run.velocity_m_s, run.force_N, strict=True)
        ):
            predictor.observe(position, velocity, force if index % model_ticks == 0 else None)
            predicted[index] = [predictor.predict(horizon) for horizon in horizons]
            is_primary[index] = predictor.is_primary
    return predicted, is_primary


def forecast_errors(
    make: Callable[[], Predictor],
    runs: Sequence[Recording],
    *,
    horizons: Sequence[int] = HORIZONS,
    model_ticks: int = 1,
) -> Array:
    """||predicted - F|| / ||F|| of a new predictor on each run, shape (runs, horizons).

    F is the reference force in the tick that was predicted, over all ticks that can be predicted.
    """
    errors = np.empty((len(runs), len(horizons)))
    for row, run in enumerate(runs):
        predicted, _ = forecast(make(), run, horizons, model_ticks=model_ticks)
        for column, horizon in enumerate(horizons):
            came = run.force_N[horizon:]
            errors[row, column] = np.linalg.norm(predicted[: -horizon or None, column] - came) / np.linalg.norm(came)
    return errors
