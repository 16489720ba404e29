"""Metrics of a trial against closed forms, and what they refuse."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from meshes.base.errors import InputError
from tissue.evaluation.statistics.metrics import (
    acceleration_change_m_s2,
    completion_time_s,
    excess_error,
    force_error,
    force_mae_N,
    force_rms_N,
    latency_ms,
    overshoot_mm,
    spectral_arc_length,
)

TICK_S = 1e-3
EXACT = 1e-12
"""Sums of a few thousand doubles."""


def reach(duration_s, size_mm=100.0, pad_s=0.0):
    """Time and speed of a minimum-jerk reach (Flash and Hogan 1985)."""
    time = np.arange(0.0, duration_s + 0.5 * TICK_S, TICK_S)
    s = time / duration_s
    speed = size_mm / duration_s * 30.0 * s**2 * (1.0 - s) ** 2
    pad = np.zeros(round(pad_s / TICK_S))
    return np.concatenate([pad, speed, pad])


def wander(rng, count, *, slow=60):
    """A force that varies over tens of milliseconds."""
    noise = rng.normal(size=(count + 4 * slow, 3))
    window = np.hanning(2 * slow)
    return np.stack(
        [
            np.convolve(column, window / window.sum(), "same")[2 * slow : -2 * slow]
            for column in noise.T
        ]
    ).T


@pytest.mark.parametrize("scale", [0.0, 0.5, 0.97, 1.0, 1.3])
def test_a_scaled_force_errs_by_its_scale(scale):
    ideal = wander(np.random.default_rng(1), 500)
    assert force_error(scale * ideal, ideal) == pytest.approx(abs(scale - 1.0), abs=EXACT)


def test_errors_of_a_constant_offset():
    ideal = np.tile([0.0, 0.0, 5.0], (100, 1))
    force = ideal + np.array([3.0, 4.0, 0.0])
    assert force_mae_N(force, ideal) == pytest.approx(5.0, abs=EXACT)
    assert force_rms_N(force, ideal) == pytest.approx(5.0, abs=EXACT)
    assert force_error(force, ideal) == pytest.approx(1.0, abs=EXACT)


def test_rms_weighs_one_large_error_more_than_mae():
    ideal, force = np.ones(100), np.ones(100)
    force[0] = 11.0
    assert force_mae_N(force, ideal) == pytest.approx(0.1, abs=EXACT)
    assert force_rms_N(force, ideal) == pytest.approx(1.0, abs=EXACT)


def test_errors_do_not_turn_with_the_frame():
    rng = np.random.default_rng(2)
    ideal = wander(rng, 300)
    force = ideal + 0.1 * rng.normal(size=ideal.shape)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    for metric in (force_error, force_mae_N, force_rms_N):
        assert metric(force @ turn.T, ideal @ turn.T) == pytest.approx(
            metric(force, ideal), rel=1e-12
        )


@pytest.mark.parametrize("ticks", [-7, 0, 1, 4, 33])
def test_latency_of_a_shifted_force(ticks):
    wide = wander(np.random.default_rng(3), 2100)
    ideal, force = wide[50:2050], wide[50 - ticks : 2050 - ticks]
    # A parabola through three samples of a correlation this broad misses its peak by less than a
    # hundredth of a tick.
    assert latency_ms(force, ideal, tick_s=TICK_S) == pytest.approx(float(ticks), abs=0.01)


def test_latency_between_ticks_and_of_a_low_pass():
    time = np.arange(4000) * TICK_S
    slow = 2.0 * np.pi * 3.0
    ideal, force = np.sin(slow * time), np.sin(slow * (time - 4.3e-3))
    assert latency_ms(force, ideal, tick_s=TICK_S) == pytest.approx(4.3, abs=0.05)
    # A first-order low-pass lags a sine by atan(w tau) / w, 5 ms less a hundredth at 3 Hz.
    tau = 5e-3
    filtered = np.sin(slow * time - np.arctan(slow * tau))
    assert latency_ms(filtered, ideal, tick_s=TICK_S) == pytest.approx(
        1e3 * np.arctan(slow * tau) / slow, abs=0.05
    )


def test_the_printed_smoothness_is_jerk_times_tick():
    time = np.arange(1000) * TICK_S
    velocity = np.outer(0.5 * 2000.0 * time**2, [0.6, 0.0, 0.8])  # a jerk of 2 m/s^3
    assert acceleration_change_m_s2(velocity, tick_s=TICK_S) == pytest.approx(
        2.0 * TICK_S, rel=1e-9
    )
    even = np.outer(3.0 * time, [1.0, 0.0, 0.0])
    assert acceleration_change_m_s2(even, tick_s=TICK_S) < 1e-9


def test_spectral_arc_length_of_a_bell():
    """The spectral arc length of a bell is exact.

    The spectrum of a Gaussian bell is a Gaussian: its arc is found by quadrature, with frequency as
    a share of the range.
    """
    width = 0.1
    time = np.arange(-2.0, 2.0, TICK_S)
    edge = np.sqrt(-2.0 * np.log(0.05)) / (2.0 * np.pi * width)

    def slope(x):
        decay = 2.0 * np.pi * width * edge
        return -(decay**2) * x * np.exp(-0.5 * (decay * x) ** 2)

    exact = -quad(lambda x: np.hypot(1.0, slope(x)), 0.0, 1.0)[0]
    found = spectral_arc_length(np.exp(-0.5 * (time / width) ** 2), tick_s=TICK_S)
    # The last frequency above the threshold lies up to one step of 1/65 Hz short of the edge.
    assert found == pytest.approx(exact, abs=0.005)


def test_spectral_arc_length_ignores_size_duration_and_rest():
    once = spectral_arc_length(reach(1.0, pad_s=0.5), tick_s=TICK_S)
    assert spectral_arc_length(reach(1.0, size_mm=7.0, pad_s=0.5), tick_s=TICK_S) == pytest.approx(
        once, rel=1e-12
    )
    # The spectrum is sampled more or less finely about the threshold.
    assert spectral_arc_length(reach(2.0, pad_s=0.5), tick_s=TICK_S) == pytest.approx(
        once, abs=0.01
    )
    assert spectral_arc_length(reach(1.0, pad_s=1.5), tick_s=TICK_S) == pytest.approx(
        once, abs=0.01
    )


def test_spectral_arc_length_falls_with_every_stop():
    pieces = [
        spectral_arc_length(
            np.concatenate([np.r_[reach(0.6), np.zeros(300)]] * count), tick_s=TICK_S
        )
        for count in (1, 2, 3, 4)
    ]
    assert all(later < earlier - 0.3 for earlier, later in pairwise(pieces))


def test_overshoot_and_time():
    assert overshoot_mm([0.0, 9.0, 11.5, 10.0], target_mm=10.0) == 1.5
    assert overshoot_mm([0.0, 9.0], target_mm=10.0) == 0.0
    time = 2.0 + np.arange(6) * 0.5
    assert completion_time_s(time, [False, True, False, True, True, True]) == 1.5
    assert completion_time_s(time, [True] * 6) == 0.0
    assert completion_time_s(time, [True] * 5 + [False]) == np.inf


FORCE = np.ones((200, 3))
REFUSED = {
    "zero ideal": (
        lambda: force_error(FORCE, 0.0 * FORCE),
        "ideal_N must not be zero in all ticks",
    ),
    "not a number": (
        lambda: force_rms_N(FORCE * np.nan, FORCE),
        "force_N must be finite, got .* at tick 0",
    ),
    "empty": (lambda: force_mae_N([], []), "force_N must have shape"),
    "constant": (lambda: latency_ms(FORCE, FORCE, tick_s=TICK_S), "force_N must vary"),
    "short": (
        lambda: latency_ms(FORCE[:60], FORCE[:60], tick_s=TICK_S),
        "longest_ms must be at least one tick",
    ),
    "late": (
        lambda: latency_ms(
            np.arange(400) > 250, np.arange(400) > 200, tick_s=TICK_S, longest_ms=20
        ),
        "longest_ms must exceed the lag",
    ),
    "at rest": (
        lambda: spectral_arc_length(np.zeros(100), tick_s=TICK_S),
        "speed_mm_s must contain at least two frequencies",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_metric_refuses_is_reported(case):
    call, message = REFUSED[case]
    with pytest.raises(InputError, match=message) as refused:
        call()
    assert ". " in str(refused.value)


def test_errors_that_do_not_depend_on_each_other_add_in_squares():
    assert excess_error(0.5, 0.3) == pytest.approx(0.4)
    assert excess_error(0.3, 0.3) == 0.0 == excess_error(0.2, 0.3)
