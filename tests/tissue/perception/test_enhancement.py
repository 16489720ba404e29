"""Lift and contrast: monotone, off at their defaults, by their slope; and what is tuned to an observer."""

from itertools import product

import numpy as np
import pytest

from tissue import InputError
from tissue.perception.enhancement import START_N, Contrast, EnhancedForce, Lift, steepest
from tissue.perception.observer import Observer
from tissue.perception.tuning import SLOPE_MOST, separation, tuned_enhancement

FORCES = np.linspace(0.0, 5.0, 2001)


@pytest.mark.parametrize(("gain", "exponent", "mean"), [*product((1.0, 1.5, 4.0), (1.0, 1.25, 1.5), (0.05, 0.5, 2.0))])
def test_both_maps_rise_and_are_no_steeper_than_stated(gain, exponent, mean):
    lift, contrast = Lift(gain=gain), Contrast(exponent=exponent)
    out = np.array([contrast.size_N(lift.size_N(force), mean) for force in FORCES])
    slopes = np.diff(out) / np.diff(FORCES)
    assert (slopes > 0.0).all() and slopes.max() <= steepest(lift, contrast) + 1e-9
    if gain == exponent == 1.0:
        np.testing.assert_allclose(out, FORCES, rtol=1e-12)


def test_the_greatest_slope_is_reached():
    """At twice the mean by a contrast alone, at no force by a lift alone: not merely a bound."""
    contrast = Contrast(exponent=1.4)
    assert (contrast.size_N(1.0 + 1e-6, 0.5) - contrast.size_N(1.0, 0.5)) / 1e-6 == pytest.approx(
        contrast.steepest, rel=1e-4
    )
    lift = Lift(gain=3.0)
    assert lift.size_N(1e-7) / 1e-7 == pytest.approx(3.0, rel=1e-4)


def test_a_lift_leaves_strong_forces_a_constant_above():
    lift = Lift(gain=2.0, below_N=0.5)
    assert lift.size_N(1e4) - 1e4 == pytest.approx(0.5, rel=1e-3)


def test_a_contrast_keeps_its_mean_and_the_straight_line_is_smooth():
    contrast = Contrast(exponent=1.5)
    assert contrast.size_N(0.7, 0.7) == pytest.approx(0.7)
    step = 1e-6
    below, at, above = (contrast.size_N(1.4 + k * step, 0.7) for k in (-1, 0, 1))
    assert (above - at) == pytest.approx(at - below, rel=1e-4)


def test_the_mean_follows_a_touch_as_a_first_order_lag_and_rests_without_one():
    force = EnhancedForce(Lift(), Contrast(exponent=1.25, adaptation_s=2.0), tick_s=1e-3)
    for _ in range(2000):
        force.step(np.array([0.0, 0.0, 1.5]))
    expected = 1.5 + (START_N - 1.5) * np.exp(-1.0)
    assert force.mean_N == pytest.approx(expected, rel=1e-3)
    for _ in range(2000):
        force.step(np.zeros(3))
    assert force.mean_N == pytest.approx(expected, rel=1e-3)


def test_the_direction_stays_in_any_frame():
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    one, other = (EnhancedForce(Lift(gain=2.0), Contrast(exponent=1.25), tick_s=1e-3) for _ in range(2))
    for tick in range(200):
        vector = np.array([0.3, -0.1, 0.02 * tick])
        plain = one.step(vector)
        np.testing.assert_allclose(other.step(turn @ vector), turn @ plain, atol=1e-12)
        assert np.cross(plain, vector) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("make", "what"), [
    (lambda: Lift(gain=0.5), "gain"), (lambda: Lift(below_N=0.0), "below_N"),
    (lambda: Contrast(exponent=0.9), "exponent"), (lambda: Contrast(adaptation_s=0.0), "adaptation_s"),
])  # fmt: skip
def test_values_out_of_range_are_refused(make, what):
    with pytest.raises(InputError, match=what):
        make()


def observer(kappa=0.08, offset_N=0.2):
    return Observer.known("someone", alpha=1.0, beta=1.3, kappa=kappa, offset_N=offset_N, lapse=0.02, sigma=0.2)


def test_separation_is_webers_without_enhancement_and_as_stated_with_it():
    """Weber's law by hand; a contrast p spreads neighbours p times as far, of which their common mean takes nothing."""
    pairs = np.array([[0.5, 0.55], [1.0, 1.1]])
    plain = separation(pairs, 0.08, 0.2, Lift(), Contrast())
    assert plain == pytest.approx([0.05 / (0.08 * 0.7), 0.1 / (0.08 * 1.2)])
    sharper = separation(pairs, 0.08, 0.2, Lift(), Contrast(exponent=1.3))
    assert sharper / plain == pytest.approx(1.3, rel=0.03)
    lifted = separation(pairs[:1], 0.08, 0.2, Lift(gain=2.0, below_N=1e2), Contrast())
    assert lifted[0] == pytest.approx(0.1 / (0.08 * 1.2), rel=0.02)  # nearly a factor 2 on a force of 0.5 N


@pytest.mark.parametrize("offset_N", [0.02, 0.2, 1.0])
def test_what_is_tuned_stays_within_the_slope_and_helps_more_than_its_neighbours(offset_N):
    lift, contrast = tuned_enhancement(observer(offset_N=offset_N), force_limit_N=3.3, friction_N=0.1, adaptation_s=2.0)
    assert steepest(lift, contrast) <= SLOPE_MOST
    levels = 3.3 * np.geomspace(0.03, 0.7, 25)
    pairs = np.column_stack([levels, 1.1 * levels])

    def mean(one, other):
        return separation(pairs, 0.08, offset_N + 0.1, one, other).mean()

    best = mean(lift, contrast)
    assert best > 1.1 * mean(Lift(), Contrast())
    for gain, exponent in product((1.0, 1.3, 2.0), (1.0, 1.2, 1.45)):
        other = Lift(gain=gain, below_N=lift.below_N), Contrast(exponent=exponent)
        if steepest(*other) <= SLOPE_MOST:
            assert mean(*other) <= best + 1e-12
