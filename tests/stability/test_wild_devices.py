"""Hands that let go or jerk, and devices that report false values.

The force stays bounded and does not stay stale.
"""

from functools import partial

import numpy as np
import pytest

from tissue.haptics.device.device import Sample, device_parameters
from tissue.haptics.device.recorded import Fault, FaultyDevice
from tissue.haptics.device.sample_guard import SampleGuard
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, HandAction, hand_parameters, waypoints
from tissue.haptics.renderer import renderer
from tissue.haptics.rigid_wall import press_wall
from tissue.scene.registry import RENDERERS

TICK, SECONDS, STIFFNESS_N_M = 1e-3, 1.2, 1500.0
FAULT_S = (0.8, 0.9)
FAULTS = [
    Fault(kind, *FAULT_S, jump_m=jump_m)
    for kind, jump_m in (
        ("dropped", 0.0),
        ("late", 0.0),
        ("duplicated", 0.0),
        ("jump", np.nan),
        ("jump", 1e9),
    )
]
NO_FAULT = Fault("dropped", SECONDS, SECONDS)


class LettingGo(Hand):
    """Hand that releases the device after 0.8 s."""

    def act(self, time_s, position_m):
        return super().act(time_s, position_m) if time_s < 0.8 else HandAction()


def pressed(kind, fault=NO_FAULT, *, seconds=SECONDS, hand=Hand):
    """Press 5 mm into a wall with a quiet expert's hand; run, guard, and the simulated device."""
    device = device_parameters("omni")
    path = waypoints([0.0, 1e-3], [[0.0, 0.0, 5e-3], [0.0, 0.0, -5e-3]])
    holding = hand(hand_parameters("expert"), path, rng=np.random.default_rng(7))
    simulated = SimulatedDevice(device, holding, position_m=(0.0, 0.0, 5e-3))
    guard = SampleGuard(force_limit_N=device.force_limit_N)
    law = renderer(kind, device.loop(STIFFNESS_N_M))
    run = press_wall(FaultyDevice(simulated, fault), law, duration_s=seconds, guard=guard)
    return run, guard, simulated


@pytest.mark.parametrize("kind", RENDERERS)
@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_a_faulty_device_fades_and_comes_back(kind, fault):
    run, guard, simulated = pressed(kind, fault)
    limit = device_parameters("omni").force_limit_N
    size = np.linalg.norm(run.force_N, axis=1)
    at = lambda seconds: int(seconds / TICK)  # noqa: E731
    assert np.isfinite(run.force_N).all() and size.max() <= limit * (1 + 1e-12)
    assert size[at(0.79)] > 0.3
    if fault.kind != "late":  # late ones are accepted again as long as they are young enough
        assert not size[at(FAULT_S[0] + 0.03) : at(FAULT_S[1]) - 1].any(), "a stale force stays"
    assert size[at(1.15)] > 0.3, "the force does not come back"
    jumps = np.abs(np.diff(size[at(FAULT_S[0]) - 1 : at(FAULT_S[1])]))
    assert jumps.max() < 0.06 * size.max(), "the force steps instead of fading"
    assert guard.bad_ticks >= 97
    reported = [what for when, what in guard.events if when > 0.1]
    assert (
        len(reported) >= 2
        and reported[-1] == "samples are good again"
        and reported[0].endswith("the force fades")
    )
    assert simulated.refused_commands == 0
    assert np.abs(simulated.translation.position).max() < 0.05


def test_one_missing_sample_takes_a_twentieth_of_the_force():
    run, guard, _ = pressed("penalty", Fault("dropped", 0.8, 0.801))
    assert guard.bad_ticks == 1
    size = np.linalg.norm(run.force_N, axis=1)
    assert size[800] == pytest.approx(0.95 * size[799], rel=1e-6)
    assert size[804] == pytest.approx(size[799], rel=0.02)


@pytest.mark.parametrize("kind", RENDERERS)
def test_a_hand_that_lets_go_is_not_thrown_at(kind):
    """A wall gives a released device no more energy than its spring held.

    The omni's own friction then stops the handle.
    """
    run, _, simulated = pressed(kind, hand=LettingGo)
    held = run.force_N[799, 2]
    assert held > 0.3 and run.force_N[:, 2].max() <= 3.3
    assert not run.force_N[-100:].any()
    energy = 0.5 * held**2 / STIFFNESS_N_M
    assert (
        0.0
        < simulated.translation.position[2]
        <= energy / device_parameters("omni").friction_N + 1e-3
    )
    assert simulated.translation.velocity == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("kind", RENDERERS)
@pytest.mark.parametrize(
    "direction", [(0.0, 0.0, -1.0), (0.6, 0.0, 0.8)], ids=["into the wall", "off it"]
)
def test_a_jerk_of_60_N_stays_bounded_and_settles(kind, direction):
    jerk = 60.0 * np.array(direction)
    jerking = partial(Hand, push=lambda t: jerk if 0.7 <= t < 0.72 else 0.0 * jerk)
    run, _, _ = pressed(kind, hand=jerking, seconds=2.5)
    assert np.linalg.norm(run.force_N, axis=1).max() <= 3.3 * (1 + 1e-12)
    assert np.abs(run.velocity_m_s).max() > 0.5, "it was no jerk"
    assert np.abs(run.position_m).max() < 0.3
    assert run.ripple_N(0.1) < 0.2


def test_the_guard_lets_a_fast_hand_pass_and_takes_up_a_device_that_comes_back():
    guard = SampleGuard(force_limit_N=3.0)
    for tick in range(50):
        assert guard.validate_sample(
            Sample(tick * TICK, (4e-3 * tick, 0.0, 0.0), (4.0, 0.0, 0.0)), tick * TICK
        )
    assert guard.bad_ticks == 0
    # Gone for 100 ms, back 0.3 m away: that is 3 m/s and accepted.
    assert guard.validate_sample(None, 0.06) is None
    assert guard.validate_sample(Sample(0.15, (0.5, 0.0, 0.0)), 0.15)
    # A jump of 0.3 m in a millisecond is not, until a hand could have got there.
    assert guard.validate_sample(Sample(0.151, (0.8, 0.0, 0.0)), 0.151) is None
    assert guard.validate_sample(Sample(0.25, (0.8, 0.0, 0.0)), 0.25)
    assert [what for _, what in guard.events] == [
        "no sample: the force fades",
        "samples are good again",
        "a jump too large for a hand (positions must be in metres): the force fades",
        "samples are good again",
    ]


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e9])
def test_a_model_that_fails_is_held_back_as_well(wrong):
    guard = SampleGuard(force_limit_N=3.0, torque_limit_Nm=0.1)
    for tick in range(60):
        assert guard.validate_sample(Sample(tick * TICK, (0.0, 0.0, 0.0)), tick * TICK)
        bad = 30 <= tick < 55
        force, torque = guard.limit_force(
            np.array([0.0, wrong if bad else 1.0, 0.0]), np.array([wrong if bad else 0.5, 0.0, 0.0])
        )
        assert np.linalg.norm(force) <= 3.0 * (1 + 1e-12) and np.linalg.norm(torque) <= 0.1 * (
            1 + 1e-12
        )
        if tick == 29:
            assert force[1] == 1.0 and torque[0] == 0.1
    if not np.isfinite(wrong):
        assert any("not finite" in what for _, what in guard.events)
