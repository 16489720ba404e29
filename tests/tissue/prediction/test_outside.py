"""A predictor from outside the package, as the loop sees it."""

from copy import deepcopy
from threading import Lock

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.prediction.guard import GuardedMaker, Outside


class Line:
    """Predicts 2 N along x and 0.1 N a tick along y."""

    def __init__(self):
        self.observed = []

    def observe(self, position_m, velocity_m_s, force_N):
        self.observed.append((position_m, velocity_m_s, force_N))

    def predict(self, ticks):
        return np.array([2.0, 0.1 * ticks, 0.0])


def test_the_residual_is_what_it_missed_a_tick_ahead():
    """The residual is the error of a prediction one tick ahead.

    It expects (2, 0.1, 0): of (2, 0.1, 0) it misses nothing, of (-1, 4.1, 0) it misses (3, -4, 0).
    """
    outside = Outside(Line(), "line")
    zero = np.zeros(3)
    outside.observe(zero, zero, np.array([9.0, 9.0, 9.0]))
    assert outside.residual_N == 0.0  # nothing was expected yet
    outside.observe(zero, zero, np.array([2.0, 0.1, 0.0]))
    assert outside.residual_N == pytest.approx(0.0, abs=1e-15)
    outside.observe(zero, zero, np.array([-1.0, 4.1, 0.0]))
    assert outside.residual_N == pytest.approx(5.0)
    outside.observe(zero, zero, None)  # no force came: the last error stays
    assert outside.residual_N == pytest.approx(5.0)


def test_one_with_both_methods_is_guarded_by_holding_the_force():
    guarded, zero = GuardedMaker("line", Line)(None, 3.0), np.zeros(3)
    guarded.observe(zero, zero, np.ones(3))
    assert guarded.predict(2.0) == pytest.approx(np.array([2.0, 0.2, 0.0]))
    guarded.inner.inner.trusted = False
    for _ in range(40):
        guarded.observe(zero, zero, np.ones(3))
    assert guarded.predict(2.0) == pytest.approx(np.ones(3))


class Broken(Line):
    """Predictor whose methods fail."""

    def observe(self, position_m, velocity_m_s, force_N):
        raise KeyError("gain")

    def predict(self, ticks):
        return [0.0][3]


class Locked(Line):
    """Predictor that cannot be copied."""

    def __init__(self):
        self.lock = Lock()


class Needy(Line):
    """Predictor with a constructor argument."""

    def __init__(self, gain):
        self.gain = gain


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Outside(Broken(), "own").predict(1.0), r"own .* predict .* IndexError in test_o"),
        (
            lambda: Outside(Broken(), "own").observe(*np.zeros((3, 3))),
            r"own .* observe .* KeyError",
        ),
        (lambda: deepcopy(Outside(Locked(), "own")), r"own must support copying"),
        (lambda: GuardedMaker("own", Needy)(None, 3.0), r"own must be made .* without arguments"),
    ],
)
def test_an_error_of_a_predictor_names_the_predictor(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_a_copy_continues_like_its_original():
    outside = Outside(Line(), "line")
    zero = np.zeros(3)
    outside.observe(zero, zero, np.ones(3))
    copied = deepcopy(outside)
    for each in (outside, copied):
        each.observe(zero, zero, np.array([-1.0, 4.1, 0.0]))
    assert copied.residual_N == outside.residual_N > 0.0
    assert copied.inner is not outside.inner
