"""The guard of two predictors: the handover from one to the other, and which of them is asked."""

import numpy as np
import pytest

from tissue import InputError
from tissue.prediction.guard import BLEND, PROBATION, Guarded
from tissue.prediction.predictor import Hold


class Fake:
    """A predictor that predicts a constant and is trusted on demand."""

    residual_N, is_primary = 0.0, True

    def __init__(self, predicted, trusted=True):
        self.constant, self.trusted, self.paused = predicted, trusted, 0

    def observe(self, position_m, velocity_m_s, force_N):
        """Nothing is kept."""

    def predict(self, ticks):
        """The constant."""
        return np.full(3, self.constant) if np.isscalar(self.constant) else self.constant

    def pause(self):
        """Count it."""
        self.paused += 1


def test_a_handover_has_no_step_and_comes_back():
    inner = Fake(1.0)
    guarded = Guarded(inner, Fake(0.0), reach_N=10.0)
    predicted, primary = [], []
    for tick in range(300):
        inner.trusted = not 100 <= tick < 150
        guarded.observe(np.zeros(3), np.zeros(3), np.ones(3))
        predicted.append(guarded.predict(4)[0])
        primary.append(guarded.is_primary)
    predicted = np.array(predicted)
    assert predicted[99] == 1.0 and predicted[100 + BLEND] == pytest.approx(0.0, abs=1e-12)
    assert np.abs(np.diff(predicted)).max() <= 1.0 / BLEND + 1e-12
    assert not predicted[100 + BLEND : 149 + PROBATION - 1].any() and predicted[
        149 + PROBATION + BLEND
    ] == pytest.approx(1.0)
    assert primary[99] and not primary[120] and primary[-1]


def test_who_misses_more_than_the_other_is_not_asked():
    """The force is 1, then 2; the inner predicts 2 throughout, the other 1."""
    guarded = Guarded(Fake(2.0), Fake(1.0), reach_N=10.0)
    primary = []
    for tick in range(3600):  # what it has cost is forgotten after three seconds
        guarded.observe(np.zeros(3), np.zeros(3), np.full(3, 1.0 + float(tick >= 200)))
        guarded.predict(4)
        primary.append(guarded.is_primary)
    assert primary[0] and not any(primary[20:200]) and primary[-1]


class Ramp(Fake):
    """Predicts a force that rises by 0.1 N a tick, and so much more."""

    clock = 0

    def observe(self, position_m, velocity_m_s, force_N):
        self.clock += 1

    def predict(self, ticks):
        return np.full(3, 0.1 * (self.clock + ticks) + self.constant)


@pytest.mark.parametrize("model_ticks", [1, 5])
def test_a_prediction_for_a_time_between_ticks_is_judged_by_the_force_between(model_ticks):
    """A prediction for a time between ticks is judged by the force between.

    Half a tick early or late would be an error of 0.05 N, more than 1.5 times the other's 0.02 N.
    """
    guarded = Guarded(Ramp(0.0), Ramp(0.02), reach_N=10.0)
    primary = []
    for tick in range(400):
        force = np.full(3, 0.1 * (tick + 1))
        guarded.observe(np.zeros(3), np.zeros(3), force if tick % model_ticks == 0 else None)
        guarded.predict(3.5)
        primary.append(guarded.is_primary)
    assert all(primary)
    exact, other = guarded._missed
    assert exact < 1e-20 and other > 0.1 * 3.0 * 0.02**2


class Ahead(Fake):
    """Predictor of the coming force with a constant error.

    The error is the constant times the change of the force until then, or applies where nothing is
    touched.
    """

    clock, waited = 0, 400

    def observe(self, position_m, velocity_m_s, force_N):
        self.clock += 1

    def force(self, tick):
        return np.full(3, max(np.sin(0.02 * max(tick - self.waited, 0.0)), 0.0))

    def predict(self, ticks):
        then = self.force(self.clock + ticks)
        return (
            then + self.constant * (then - self.force(self.clock)) + self.false_N * (not then.any())
        )

    false_N = 0.0


def primary_of(inner, *, ticks=2000):
    """Return True for ticks in which a predictor is used that zero-order hold guards."""
    guarded, primary = Guarded(inner, Hold(), reach_N=10.0), []
    for tick in range(ticks):
        guarded.observe(np.zeros(3), np.zeros(3), inner.force(tick + 1))
        guarded.predict(6)
        primary.append(guarded.is_primary)
    return np.array(primary)


@pytest.mark.parametrize("wrong_by", [0.0, -0.9, 0.9])
def test_who_misses_less_than_holding_stays(wrong_by):
    assert primary_of(Ahead(wrong_by)).all()


@pytest.mark.parametrize("wrong_by", [-2.2, 1.2, 1.4])
def test_who_misses_a_little_more_than_holding_is_handed_over(wrong_by):
    """Below 1.5 times holding's error, which is no reason against another predictor."""
    primary = primary_of(Ahead(wrong_by))
    assert primary[:400].all() and primary[500:].mean() < 0.1


def test_touches_that_do_not_come_are_held_against_who_foresees_them():
    inner = Ahead(0.0)
    inner.false_N = 0.3
    assert not primary_of(inner)[20:390].any()


def test_the_transition_between_two_predictors_is_bounded_and_finite():
    inner = Fake(1e6)
    guarded = Guarded(inner, Fake(0.0), reach_N=2.0)
    guarded.observe(np.zeros(3), np.zeros(3), np.zeros(3))
    assert np.linalg.norm(guarded.predict(1)) == pytest.approx(2.0)
    before = guarded.predict(1)
    inner.constant = np.nan
    np.testing.assert_array_equal(guarded.predict(1), before)
    guarded.observe(np.array([np.nan, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    assert inner.paused == 1
    with pytest.raises(InputError, match="reach_N must be positive"):
        Guarded(inner, Hold(), reach_N=0.0)


@pytest.mark.parametrize(("reach_N", "size"), [(2.0, 3.0), (10.0, 12.0), (0.5, 0.6), (10.0, 9.0)])
def test_both_differ_by_no_more_than_the_reach(reach_N, size):
    guarded = Guarded(Fake(size / np.sqrt(3.0)), Fake(0.0), reach_N=reach_N)
    guarded.observe(np.zeros(3), np.zeros(3), np.zeros(3))
    assert guarded.predict(1.0) == pytest.approx(np.full(3, min(size, reach_N) / np.sqrt(3.0)))


def test_errors_count_alike_on_every_axis():
    """The inner predictor misses by -0.5, the other by 0.6, and holding by nothing."""
    chosen = []
    for unit in np.eye(3):
        inner = Fake(1.5 * unit)
        other = Fake(0.4 * unit)
        guarded = Guarded(inner, other, reach_N=10.0)
        primary = []
        for _ in range(2000):
            guarded.observe(np.zeros(3), np.zeros(3), unit)
            guarded.predict(4)
            primary.append(guarded.is_primary)
        chosen.append(primary)
    assert chosen[0] == chosen[1] == chosen[2]
    assert any(chosen[0]) and not all(chosen[0])
