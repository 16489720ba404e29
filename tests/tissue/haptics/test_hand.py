"""Hands: minimum jerk, corrections, tremor, noise, reflex and groups.

They are deterministic by their generator.
"""

from dataclasses import replace

import numpy as np
import pytest

from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Aim, Hand, hand_parameters, minimum_jerk

TICK = 1e-3
STILL = {"endpoint_noise": 0.0, "force_noise": 0.0, "tremor_m": 0.0}


def to(point):
    return lambda time_s: np.zeros(3) if time_s == 0.0 else np.array(point)


def aim(path, seed=3, **changed):
    given = {
        "reaction_s": 0.2,
        "submovement_s": 0.4,
        "correction_s": 0.2,
        "endpoint_noise": 0.0,
    } | changed
    parameters = replace(hand_parameters("expert"), **given)
    return Aim(path, parameters, rng=np.random.default_rng(seed))


def test_minimum_jerk_is_at_rest_at_both_ends_and_its_speed_is_its_slope():
    shares = np.linspace(-0.1, 1.1, 2401)
    share, speed = np.array([minimum_jerk(s) for s in shares]).T
    assert minimum_jerk(0.5) == (0.5, 1.875)  # Flash and Hogan's peak
    assert np.abs(np.gradient(share, shares) - speed).max() < 1e-4
    assert share[shares <= 0.0].max() == 0.0 and share[shares >= 1.0].min() == 1.0
    # no step in speed: |s''| < 5.8
    assert np.abs(np.diff(speed)).max() < 6.0 * (shares[1] - shares[0])


def test_one_reach_is_one_minimum_jerk_after_the_reaction_time():
    reach = aim(to([0.1, -0.05, 0.0]))
    for tick in range(800):
        time = tick * TICK
        share, speed = minimum_jerk((time - 0.2) / 0.4)
        position, velocity = reach.at(time)
        assert position == pytest.approx((0.1 * share, -0.05 * share, 0.0), abs=1e-15)
        assert velocity == pytest.approx((0.25 * speed, -0.125 * speed, 0.0), abs=1e-14)


def test_errors_are_corrected_a_reaction_time_later():
    """Errors are corrected one reaction time later.

    With scatter the first end misses; the remaining error shrinks by the scatter with every
    correction.
    """
    ends = []
    for seed in range(100):
        reach = aim(to([0.1, 0.0, 0.0]), seed, correction_s=0.5, endpoint_noise=0.1)
        at = [reach.at(tick * TICK)[0][0] - 0.1 for tick in range(2500)]
        ends.append((at[600], at[1100], at[2400]))
    scatter = np.std(ends, axis=0)
    assert scatter[0] == pytest.approx(0.01, rel=0.15)  # of 100 trials: 7 %, twice
    assert scatter[1] < 0.2 * scatter[0] and scatter[2] < 1e-4


def test_a_path_is_followed_without_falling_behind():
    path = lambda time_s: np.array([0.02 * time_s, 0.01 * np.sin(time_s), 0.0])  # noqa: E731
    follow = aim(path)
    late = [np.subtract(follow.at(t)[0], path(t)) for t in np.arange(0.0, 5.0, TICK)][2000:]
    assert np.abs(late).max() < 1e-3


def parameters(**changed):
    return replace(hand_parameters("novice"), **(STILL | changed))


def held(hand, seconds, *, device=None):
    """Positions of a device in a hand [m], shape (n, 3)."""
    simulated = SimulatedDevice(
        device or replace(device_parameters("six-dof"), friction_N=0.0, encoder_step_m=0.0), hand
    )
    return np.array(
        [simulated.read(tick * TICK).position_m for tick in range(round(seconds / TICK))]
    )


def test_a_push_meets_grip_and_reflex():
    """Grip and reflex resist a push.

    At rest the deviation is the push over stiffness and reflex together; before the reflex, over
    stiffness alone.
    """
    push = np.array([1.0, -0.5, 0.0])
    given = parameters()
    moved = held(
        Hand(given, to([0.0, 0.0, 0.0]), rng=np.random.default_rng(0), push=lambda t: push), 3.0
    )
    stiffness = given.stiffness_N_m * (1.0 + given.reflex_share)
    assert moved[-1] == pytest.approx(push / stiffness, rel=1e-6)
    slow = held(
        Hand(
            replace(given, reflex_share=0.0),
            to([0, 0, 0]),
            rng=np.random.default_rng(0),
            push=lambda t: push,
        ),
        3.0,
    )
    assert slow[-1] == pytest.approx(push / given.stiffness_N_m, rel=1e-6)
    reflex = round(given.reflex_s / TICK)
    assert (
        moved[:reflex] == pytest.approx(slow[:reflex], abs=1e-12)
        and np.abs(moved - slow)[: reflex + 20].max() > 1e-6
    )


def test_tremor_lies_within_8_to_12_hz_and_has_its_size():
    given = parameters(tremor_m=1e-4)
    hand = Hand(given, to([0.0, 0.0, 0.0]), rng=np.random.default_rng(6))
    shaken = np.array([hand.act(tick * TICK, (0.0, 0.0, 0.0)).aim_m for tick in range(30_000)])
    # 2 Hz for 30 s: 60 looks, 13 % of scatter
    assert shaken.std(axis=0) == pytest.approx(1e-4 * np.ones(3), rel=0.15)
    power = (np.abs(np.fft.rfft(shaken, axis=0)) ** 2).sum(axis=1)
    frequency = np.fft.rfftfreq(len(shaken), TICK)
    band = (frequency > 8.0) & (frequency < 12.0)
    assert power[band].sum() > 0.6 * power.sum()
    assert 9.0 < frequency[power.argmax()] < 11.0


def test_noise_grows_with_the_force():
    spread = []
    for force in (0.0, 1.0, 4.0):
        hand = Hand(
            parameters(force_noise=0.05),
            to([0, 0, 0]),
            rng=np.random.default_rng(2),
            push=lambda t, force=force: np.array([force, 0.0, 0.0]),
        )
        spread.append(
            np.std(
                [hand.act(tick * TICK, (0.0, 0.0, 0.0)).push_N for tick in range(10_000)], axis=0
            ).mean()
        )
    assert spread[0] == 0.0
    assert spread[1] == pytest.approx(0.05, rel=0.1) and spread[2] == pytest.approx(
        4.0 * spread[1], rel=1e-9
    )
