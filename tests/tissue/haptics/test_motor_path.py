"""Path from a rendered force to the motor.

Its delay is compared with the closed form, its force with a simulated device.
"""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from tissue.evaluation.statistics.metrics import excess_error, force_error, latency_ms
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.simulated import Plant
from tissue.haptics.loop.filters import DelayLine, LowPass
from tissue.haptics.loop.sampled_loop import (
    force_later_N,
    mean_over_ticks_N,
    motor_force_N,
    motor_lag_ticks,
)

TICK = 1e-3
TOUCH = device_parameters("touch")
PATHS = [
    TOUCH.loop(1.0, filter_s=1e-3),
    replace(TOUCH.loop(1.0), delay_s=4.5e-3),
    replace(TOUCH.loop(1.0), delay_s=2.3e-3, amplifier_Hz=inf, filter_s=3e-3),
    replace(TOUCH.loop(1.0), delay_s=0.0, amplifier_Hz=80.0),
]


def wander(seed, count, slow=40):
    """A force that varies over tens of milliseconds, without force at its start."""
    noise = np.random.default_rng(seed).normal(size=(count + 4 * slow, 3))
    noise[: 3 * slow] = 0.0
    window = np.hanning(2 * slow)
    return np.stack(
        [
            np.convolve(column, window / window.sum(), "same")[2 * slow : -2 * slow]
            for column in noise.T
        ]
    ).T


@pytest.mark.parametrize("loop", PATHS)
def test_a_ramp_comes_later_by_the_stated_delay(loop):
    """After all has settled the mean over tick n of what was n is n + 1/2 less the delay."""
    ticks = np.arange(400.0)
    played = motor_force_N(loop, np.outer(ticks, [1.0, -2.0, 0.5]))
    np.testing.assert_allclose(
        played[200:, 0], ticks[200:] + 0.5 - motor_lag_ticks(loop), atol=1e-9
    )
    np.testing.assert_allclose(played[200:, 1:], np.outer(played[200:, 0], [-2.0, 0.5]), atol=1e-9)


def test_four_milliseconds_of_latency_are_six_of_a_touch():
    """Four milliseconds of latency are six of a Touch.

    They are e^-1 / (1 - e^-1) = 0.582 of the low-pass, 4 of latency, 0.5 of transport, 0.5 of the
    hold, and 1000 / (600 pi).
    """
    loop = TOUCH.loop(1.0, filter_s=1e-3)
    late = replace(loop, delay_s=loop.delay_s + 4e-3)
    assert motor_lag_ticks(late) == pytest.approx(0.58198 + 4.0 + 0.5 + 0.5 + 0.53052, abs=1e-4)


@pytest.mark.parametrize("loop", PATHS)
def test_the_force_is_that_of_a_plant_stepped_through_it(loop):
    """The force equals that of a plant stepped through it.

    Low-pass, whole ticks and the rest of the delay are computed as in the loop; the amplifier in
    200 parts of a tick.
    """
    force, parts = wander(3, 120), 200
    low_pass, line = LowPass(loop.filter_s, step_s=TICK), DelayLine(int(loop.delay_s / TICK + 1e-9))
    commands = [np.zeros(3), *(line.step(low_pass.step(each)) for each in force)]
    rest = round((loop.delay_s / TICK) % 1.0 * parts)
    plant = Plant(mass_kg=1.0, damping_N_s_m=0.0, amplifier_Hz=loop.amplifier_Hz)
    found = np.zeros_like(force)
    for tick in range(len(force)):
        for part in range(parts):
            command = commands[tick + (part >= rest)]
            before = np.array(command if loop.amplifier_Hz == inf else plant.motor_force)
            plant.advance(TICK / parts, command=tuple(command.tolist()), external=(0.0, 0.0, 0.0))
            found[tick] += 0.5 * (before + plant.motor_force) / parts
    # The trapezoid of 200 parts is off by (1/200)^2 / 12 of the second derivative, 2 / a^2 at most.
    np.testing.assert_allclose(motor_force_N(loop, force), found, atol=1e-5 * np.abs(force).max())


@pytest.mark.parametrize("loop", PATHS)
@pytest.mark.parametrize("step_N", [0.0, 0.02])
def test_who_knows_the_future_has_no_latency_and_who_holds_the_force_that_of_the_path(loop, step_N):
    ideal = wander(5, 4000, slow=120)  # a low-pass of 3 ms lags 10 Hz by 1 % less than a ramp
    seen = step_N * np.round(ideal / step_N) if step_N else ideal
    wanted, lag = mean_over_ticks_N(ideal), motor_lag_ticks(loop)
    played = motor_force_N(loop, force_later_N(seen, lag))[:-1]
    assert latency_ms(played, wanted, tick_s=TICK) == pytest.approx(0.0, abs=0.05)
    held = motor_force_N(loop, seen)[:-1]
    assert latency_ms(held, wanted, tick_s=TICK) == pytest.approx(lag, abs=0.05)


def test_excess_of_a_perfect_and_a_wrong_answer():
    assert excess_error(0.03, 0.03) == 0.0 == excess_error(0.01, 0.03)
    assert excess_error(0.05, 0.03) == pytest.approx(0.04)
    rng, ideal = np.random.default_rng(0), wander(7, 4000)
    noise = 0.1 * rng.standard_normal(ideal.shape)
    least, wrong = force_error(ideal + noise, ideal), force_error(1.3 * ideal + noise, ideal)
    # Errors that have nothing to do with each other add in squares; 4000 samples leave 1 /
    # sqrt(4000) of their product.
    assert excess_error(wrong, least) == pytest.approx(0.3, abs=0.03)
