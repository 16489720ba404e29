"""Predictors beyond their limits: in another tissue, with an exploding operator, on a chattering loop."""

from dataclasses import replace

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.evaluation.recorded_runs import Recorder, trial
from tissue.evaluation.training import forecast, forecast_errors
from tissue.prediction.delays import DelayPath
from tissue.prediction.guard import Guarded
from tissue.prediction.koopman import Koopman
from tissue.prediction.predictor import Linear
from tissue.prediction.trained import Trained, shipped_file
from tissue.simulation.builders.prediction import trained_predictor

LIMIT_N = 3.3


@pytest.fixture(scope="module")
def wall():
    return Trained.read(shipped_file("wall"))


@pytest.fixture(scope="module")
def unseen():
    return Recorder().record(trial(load_scene("wall"), 777, delay_ms=4))


def exploding(wall):
    """Return the operator of the wall with targets that are a hundred times as large."""
    moments = wall.operator.moments
    return replace(wall.operator, moments=replace(moments, targets=100.0 * moments.targets))


def stiffer(contact, factor):
    """Return the contact of a tool that does not cut, with `factor` times the force and stiffness."""
    return replace(
        contact,
        spring_N_m=factor * contact.spring_N_m,
        force_N=factor * contact.force_N,
        stiffness_N_m=factor * contact.stiffness_N_m,
        surface_N_m=factor * contact.surface_N_m,
    )


def test_the_guard_bounds_the_prediction_of_an_exploding_operator(wall, unseen):
    guarded = Guarded(Koopman(DelayPath(exploding(wall))), Linear(), reach_N=LIMIT_N)
    predicted, primary = forecast(guarded, unseen, (4,))
    line, _ = forecast(Linear(), unseen, (4,))
    assert np.linalg.norm(predicted - line, axis=2).max() <= LIMIT_N * (1.0 + 1e-12)
    assert primary[unseen.force_N.any(axis=1)].mean() < 0.2


@pytest.mark.parametrize("factor", [0.5, 2.0, 8.0])
@pytest.mark.parametrize("kind", ["koopman", "koopman-look-ahead"])
def test_in_a_force_it_was_not_trained_on_it_is_as_good_as_at_home(wall, unseen, kind, factor):
    """In an untrained force range, the prediction error is unchanged to rounding.

    The same motion has half to eight times the force and stiffness.
    """
    contact = [stiffer(each, factor) for each in unseen.contact]
    other = replace(unseen, force_N=factor * unseen.force_N, contact=contact)
    make = lambda: trained_predictor(kind, wall, force_limit_N=LIMIT_N * factor).inner  # noqa: E731
    home, away = (forecast_errors(make, [run], horizons=(4,))[0, 0] for run in (unseen, other))
    assert away == pytest.approx(home, rel=1e-9)


@pytest.mark.slow
def test_prediction_takes_a_loop_past_where_latency_makes_it_chatter():
    """Prediction keeps a loop in contact where latency makes it chatter.

    At 1.5 kN/m and 4 ms the wall throws the device off again and again (24 switches); predicted, it
    is held (4).
    """
    switches = {}
    for prediction in ("none", "koopman"):
        entries = {
            "seed": 500,
            "coupling.delay_ms": 4,
            "coupling.stiffness_N_m": 1500.0,
            "coupling.force_scale": 1.0,
            "prediction": prediction,
        }
        trace = simulate(load_scene("wall", entries), allow_unstable=True).trace
        touching = trace["raw_force_z_N"] != 0.0
        switches[prediction] = int(np.abs(np.diff(touching.astype(int))).sum())
    assert switches["none"] > 2 * switches["koopman"]
    assert switches["koopman"] < 10
