"""States in and out of order, by a motion in closed form."""

import numpy as np
import pytest

from tissue.haptics.real.adapter import HardwareSample
from tissue.haptics.real.haply_frames import StateOrder

TICK = 1e-3


def circle(speed_m_s, count=400, radius_m=0.03):
    angle = speed_m_s / radius_m * TICK * np.arange(count)
    places = radius_m * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    speeds = speed_m_s * np.column_stack([-np.sin(angle), np.cos(angle), 0.0 * angle])
    return [
        HardwareSample(tuple(p), tuple(v))
        for p, v in zip(places.tolist(), speeds.tolist(), strict=True)
    ]


def wrong_at(samples, tick_s=TICK):
    order = StateOrder()
    return np.array([order.observe(each, tick_s * place) for place, each in enumerate(samples)])


@pytest.mark.parametrize("speed", [0.0, 0.1, 0.5, 2.0])
def test_states_in_order_are_right(speed):
    assert not wrong_at(circle(speed)).any()


@pytest.mark.parametrize("window", [2, 5, 30])
@pytest.mark.parametrize("speed", [0.3, 1.0])
def test_states_out_of_order_are_recognised_and_right_ones_again(window, speed):
    samples, rng = circle(speed), np.random.default_rng(1)
    mixed = [
        each
        for start in range(100, 250, window)
        for each in swapped(samples[start : start + window], rng)
    ]
    found = wrong_at(samples[:100] + mixed + samples[100 + len(mixed) :])
    assert not found[:100].any() and found[100:140].any() and not found[-50:].any()


def swapped(part, rng):
    """A part in another order: two are exchanged, more are mixed."""
    return part[::-1] if len(part) == 2 else [part[index] for index in rng.permutation(len(part))]


def test_a_blow_whose_velocity_lags_is_right():
    """From 1 m/s to -1 m/s at once, stated by a first-order filter of 4 ms."""
    true = np.where(np.arange(200) < 100, 1.0, -1.0)
    places, stated, lagging = np.cumsum(true) * TICK, [], 1.0
    for speed in true:
        lagging += (1.0 - np.exp(-0.25)) * (speed - lagging)
        stated.append(lagging)
    samples = [
        HardwareSample((x, 0.0, 0.0), (v, 0.0, 0.0))
        for x, v in zip(places.tolist(), stated, strict=True)
    ]
    assert not wrong_at(samples).any()


@pytest.mark.parametrize("tick_s", [TICK, 0.05])
def test_one_old_state_is_no_wrong_order(tick_s):
    samples = circle(0.7)
    samples.insert(200, samples[190])
    assert not wrong_at(samples, tick_s).any()


def test_encoder_steps_at_rest_are_right():
    rng = np.random.default_rng(2)
    places = 1e-5 * rng.integers(-3, 4, size=(500, 3))
    speeds = rng.normal(scale=0.02, size=(500, 3))
    assert not wrong_at(
        [HardwareSample(tuple(p), tuple(v)) for p, v in zip(places, speeds, strict=True)]
    ).any()
