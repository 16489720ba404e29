"""Samples that a loop accepts from a device: times, types and noise.

A hand is never taken for noise.
"""

from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest

import tissue
from tissue import load_scene
from tissue.haptics.device.device import (
    ComputedDevice,
    DeviceError,
    DeviceParameters,
    Reach,
    Sample,
    device_parameters,
)
from tissue.haptics.device.sample_guard import Roughness, SampleGuard
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters, waypoints
from tissue.haptics.loop.filters import SlewLimit
from tissue.haptics.real.adapter import HardwareAdapter, HardwareSample
from tissue.haptics.real.mapped import MappedDevice
from tissue.haptics.renderer import renderer
from tissue.haptics.rigid_wall import press_wall
from tissue.scene.coupling import Hardware
from tissue.scene.registry import DEVICES, HANDS

TICK = 1e-3
NOISE_M = 2e-3
AT = (0.0, 0.0, 0.0)


def accepted(samples, **limits):
    """Share of samples that are accepted, and the faults found."""
    guard = SampleGuard(force_limit_N=3.0, **limits)
    for tick, sample in enumerate(samples):
        guard.validate_sample(sample, tick * TICK)
    return 1.0 - guard.bad_ticks / len(samples), [what for _, what in guard.events]


def moving(offsets, *, speed_m_s=0.1):
    """Samples of a straight motion with offsets [m], shape (n, 3)."""
    return [
        Sample(tick * TICK, (speed_m_s * tick * TICK + x, y, z))
        for tick, (x, y, z) in enumerate(offsets.tolist())
    ]


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_is_a_fault_from_its_first_tenths_of_a_second(seed):
    noise = np.random.default_rng(seed).normal(scale=NOISE_M, size=(2000, 3))
    share, events = accepted(moving(noise))
    assert share < 0.05 and events[0].startswith("noise too large for a hand")


def test_noise_of_a_turn_is_a_fault_and_smooth_samples_are_accepted_again():
    rng = np.random.default_rng(0)
    turns = np.zeros((1000, 3))
    turns[200:600] = rng.normal(scale=0.05, size=(400, 3))
    samples = [
        Sample(tick * TICK, AT, quaternion=(*(0.5 * turn), np.sqrt(1.0 - 0.25 * turn @ turn)))
        for tick, turn in enumerate(turns)
    ]
    guard = SampleGuard(force_limit_N=3.0)
    good = np.array(
        [
            guard.validate_sample(sample, tick * TICK) is not None
            for tick, sample in enumerate(samples)
        ]
    )
    assert good[:200].all() and good[220:600].mean() < 0.05 and good[750:].all()


@pytest.mark.parametrize("scale_m", [2e-5, 1e-4, 2e-4])
def test_the_noise_of_a_sensor_is_none(scale_m):
    noise = np.random.default_rng(1).normal(scale=scale_m, size=(5000, 3))
    assert accepted(moving(noise, speed_m_s=1.0)) == (1.0, [])


def test_roughness_by_its_closed_form():
    """Roughness follows its closed form.

    Three samples of an acceleration a lie a T^2 / 2 off the straight line: rough above the limit,
    not below.
    """
    for share, noisy in ((0.99, False), (1.01, True)):
        course = Roughness(2000.0)
        for tick in range(100):
            course.observe(tick * TICK, 0.5 * share * 2000.0 * (tick * TICK) ** 2, 0.0, 0.0)
        assert course.noisy == noisy
    course = Roughness(2000.0)
    for tick in range(100):  # one leap of a metre
        course.observe(tick * TICK, float(tick == 50), 0.0, 0.0)
        assert not course.noisy


@pytest.mark.parametrize("held", [1, 2, 5])
def test_a_device_that_repeats_its_samples_is_no_noise(held):
    """A sensor of 1000, 500 or 200 Hz behind a loop of 1 kHz, moved by 2 m/s to and fro."""
    times = TICK * held * (np.arange(3000) // held)
    places = 0.1 * np.sin(20.0 * times)
    samples = [Sample(tick * TICK, (x, 0.0, 0.0)) for tick, x in enumerate(places.tolist())]
    assert accepted(samples, oldest_s=0.02) == (1.0, [])


@pytest.mark.parametrize(("group", "name"), list(zip(cycle(HANDS), DEVICES, strict=False)))
def test_a_hand_on_any_device_is_not_taken_for_noise(group, name):
    """A hand is not taken for noise: the hands by turns, each on other devices.

    It makes fast taps on the stiffest wall that a vendor allows, with tremor, encoder steps, and a
    jerk of 19 N.
    """
    device, rng = device_parameters(name), np.random.default_rng(3)
    times = np.arange(0.0, 3.0, 0.2)
    depths = np.where(np.arange(len(times)) % 2, -0.02, 0.02)
    person = replace(hand_parameters(group), tremor_m=2.0 * hand_parameters(group).tremor_m)
    jerk, nothing = np.array([0.0, 6.0, 18.0]), np.zeros(3)
    hand = Hand(
        person,
        waypoints(times, np.column_stack([0.02 * np.sin(9.0 * times), 0.0 * times, depths])),
        rng=rng,
        push=lambda time_s: jerk if 1.0 <= time_s < 1.02 else nothing,
    )
    guard = SampleGuard(force_limit_N=device.force_limit_N)
    roughest = []
    observe = guard._places.observe
    guard._places.observe = lambda *sample: (
        observe(*sample),
        roughest.append(guard._places.share),
    )[0]
    run = press_wall(
        SimulatedDevice(device, hand, position_m=(0.0, 0.0, 0.02)),
        renderer("proxy", device.loop(device.stiffness_limit_N_m)),
        duration_s=2.5,
        guard=guard,
    )
    assert guard.bad_ticks == 0 and np.abs(run.velocity_m_s).max() > 0.4
    assert max(roughest) < 0.3  # two rough samples in a row at most, where five make noise


@pytest.mark.parametrize(
    ("sample", "what"),
    [
        (Sample(0.2, AT), "a sample time in the future"),
        (Sample(1e9, AT), "a sample time in the future"),
        (Sample(0.0, AT), "an old sample"),
        (Sample(0.098, AT), "a sample time before the last sample"),
        (Sample(np.nan, AT), "a sample that is not finite"),
        (Sample(0.1, (np.inf, 0.0, 0.0)), "a sample that is not finite"),
        (Sample(0.1, AT, spin_rad_s=(0.0, 0.0, np.nan)), "a sample that is not finite"),
        (Sample(0.1, AT, spin_rad_s=(0.0, 0.0, -1e9)), "a spin too fast for a hand"),
        (
            Sample(0.1, AT, quaternion=(0.0, 0.0, 0.0, 2.0)),
            "a quaternion that is not of unit length",
        ),
        (
            Sample(0.1, AT, quaternion=(0.0, 0.0, 0.0, 0.98)),
            "a quaternion that is not of unit length",
        ),
    ],
)
def test_what_cannot_be_is_a_fault(sample, what):
    guard = SampleGuard(force_limit_N=3.0)
    for tick in range(100):
        assert guard.validate_sample(Sample(tick * TICK, AT), tick * TICK)
    assert guard.validate_sample(sample, 0.1) is None
    assert guard.events == [(0.1, f"{what}: the force fades")]
    assert guard.validate_sample(Sample(0.101, AT), 0.101)


@pytest.mark.parametrize("name", DEVICES)
def test_a_force_changes_no_faster_than_its_device_states(name):
    device = device_parameters(name)
    limit, wanted = SlewLimit(device.force_slew_N_ms), np.array([0.0, 3.0, -1.0])
    steps = [limit.step(wanted).copy() for _ in range(20)]
    sizes = np.linalg.norm(np.diff([np.zeros(3), *steps], axis=0), axis=1)
    whole = int(np.linalg.norm(wanted) / device.force_slew_N_ms)
    np.testing.assert_allclose(sizes[:whole], device.force_slew_N_ms, rtol=1e-12)
    assert limit.limited == whole and (steps[-1] == wanted).all()
    assert limit.step(wanted) is wanted  # nothing is rounded where it does not act
    np.testing.assert_allclose(np.cross(steps[0], wanted), 0.0, atol=1e-12)


LIMITS = DeviceParameters(
    mass_kg=0.1,
    damping_N_s_m=0.5,
    force_limit_N=8.0,
    workspace_width_m=0.16,
    workspace_height_m=0.12,
    workspace_depth_m=0.07,
)


DIAGONAL_M = (0.16**2 + 0.12**2 + 0.07**2) ** 0.5


TURN = (0.5**0.5, 0.0, 0.0, 0.5**0.5)


class Goes(ComputedDevice):
    """Device whose position is a function of time, in a unit of its own.

    It records its commands.
    """

    def __init__(self, path, quaternion=(0.0, 0.0, 0.0, 1.0)):
        self.path, self.quaternion, self.forces = path, quaternion, []

    def read(self, time_s):
        return Sample(time_s, tuple(self.path(time_s)), quaternion=self.quaternion)

    def command(self, force_N, torque_Nm):
        self.forces.append(force_N.copy())


class Adapter(HardwareAdapter):
    """An adapter on a path in a unit of its own; every poll has a new sample."""

    limits = LIMITS

    def __init__(self, path, quaternion=(0.0, 0.0, 0.0, 1.0)):
        self.path, self.quaternion, self.pushed, self.polls = path, quaternion, [], 0

    def open(self):
        pass

    def poll(self):
        self.polls += 1
        return HardwareSample(tuple(self.path(self.polls * TICK)), quaternion=self.quaternion)

    def push(self, force_N, torque_Nm):
        self.pushed.append(force_N.copy())

    def close(self):
        self.pushed.append(np.zeros(3))


def falling_mm(time_s):
    """1 mm above the wall and down at 4 mm/s, in millimetres."""
    return 0.0, 0.0, 1.0 - 4.0 * time_s


def wall(**changes):
    return load_scene("wall", {"device": "touch", "duration_s": 6.0} | changes)


def test_a_device_in_millimetres_ends_the_run_at_zero_with_its_reason():
    """A device in millimetres ends the run at zero force and reports the reason.

    At 4 mm/s no sample is a jump: only the workspace shows that no arm moves 4 m each second.
    """
    device = Goes(falling_mm)
    with pytest.raises(
        DeviceError,
        match=r"its workspace is 160 x 120 x 70 mm\. If it reports millimetres, convert them to metres",
    ):
        tissue.simulate(wall(), device=device)
    assert len(device.forces) * TICK * 4.0 < 3.1 * DIAGONAL_M  # not long after the arm's end
    assert not device.forces[-1].any()


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_the_reach_is_three_diagonals_of_the_workspace(share):
    reach, end_m = Reach(LIMITS), share * 3.0 * DIAGONAL_M
    places = [(0.3 + end_m * part, 0.0, 0.0) for part in np.linspace(0.0, 1.0, 50)] + [
        (0.3 + end_m, 0.0, 0.0)
    ] * 30
    if share < 1.0:
        for place in places:
            reach.require(place)
    else:
        with pytest.raises(DeviceError):
            for place in places:
                reach.require(place)


@pytest.mark.parametrize(
    "quaternion",
    [
        (0.0, 0.0, 0.0, 0.0),
        (0.3, 0.0, 0.0, 0.3),
        *(
            pytest.param(each, marks=pytest.mark.slow)
            for each in ((0.5, 0.5, 0.5, 0.6), (0.0, 0.0, 90.0, 0.0))
        ),
    ],
)
def test_a_quaternion_of_another_length_gives_no_force(quaternion):
    """A quaternion that is not of unit length gives no force.

    This holds for a user's device and for an adapter, whose workspace would have brought it to unit
    length in silence.
    """
    start = Goes(lambda time_s: (0.0, 0.0, 0.02 - 0.1 * time_s), quaternion)
    run = tissue.simulate(wall(duration_s=0.45), device=start)
    assert not np.array(start.forces).any()
    assert any("a quaternion that is not of unit length" in what for _, what in run.events)
    adapter = Adapter(lambda time_s: (0.0, 0.0, 0.02 - 0.1 * time_s), quaternion)
    run = tissue.simulate(
        wall(duration_s=0.45),
        device=MappedDevice(adapter, Hardware(ramp_ms=0.0), start_m=(0.0, 0.0, 0.02)),
    )
    assert not np.array(adapter.pushed).any()
    assert any("a quaternion that is not of unit length" in what for _, what in run.events)


def test_a_device_that_gives_w_first_is_named():
    guard = SampleGuard(force_limit_N=1.0)
    guard.validate_sample(Sample(0.0, (0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0)), 0.0)
    ((_, what),) = guard.events
    assert "a device that gives w first starts with this orientation" in what
    for quaternion in (TURN, (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)):
        guard = SampleGuard(force_limit_N=1.0)
        guard.validate_sample(Sample(0.0, (0.0, 0.0, 0.0), quaternion=quaternion), 0.0)
        assert not guard.events
