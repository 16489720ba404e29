"""Devices that report other units or other quaternions.

The run ends, or the force fades, with a sentence.
"""

import numpy as np
import pytest

import tissue
from tissue import Sample, load_scene
from tissue.haptics.device.device import ComputedDevice, DeviceError, DeviceParameters, Reach
from tissue.haptics.device.recorded import MouseDevice
from tissue.haptics.device.sample_guard import SampleGuard
from tissue.haptics.real.adapter import HardwareAdapter, HardwareSample
from tissue.haptics.real.mapped import MappedDevice
from tissue.haptics.real.self_test import self_test
from tissue.scene.coupling import Hardware

TICK = 1e-3
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
        match=r"its workspace is 160 x 120 x 70 mm\. If it reports millimetres, give metres",
    ):
        tissue.simulate(wall(), device=device)
    assert len(device.forces) * TICK * 4.0 < 3.1 * DIAGONAL_M  # not long after the arm's end
    assert not device.forces[-1].any()


def test_a_real_device_in_millimetres_ends_the_run_at_zero():
    adapter = Adapter(falling_mm)
    device = MappedDevice(adapter, Hardware(ramp_ms=0.0), start_m=(0.0, 0.0, 0.02))
    with pytest.raises(DeviceError, match="If it reports millimetres, give metres"):
        tissue.simulate(wall(), device=device)
    assert adapter.polls * TICK * 4.0 < 3.0 * DIAGONAL_M + 0.2
    assert not adapter.pushed[-1].any()


def test_the_self_test_names_millimetres():
    clock = iter(np.arange(0.0, 100.0, 2.5e-4))
    with pytest.raises(DeviceError, match="If it reports millimetres"):
        self_test(Adapter(falling_mm), clock=lambda: next(clock), pause=lambda seconds: None)


@pytest.mark.slow
def test_a_loop_stops_a_device_in_millimetres():
    device = Goes(lambda time_s: (0.0, 0.0, -4.0 * time_s))
    bone = tissue.Bone.block((12, 8, 5), spacing_mm=0.5)
    with pytest.raises(DeviceError, match="If it reports millimetres"):
        tissue.Loop(bone, device=device).run(2.0)
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


def test_one_wild_sample_does_not_end_a_run_and_no_workspace_is_three_metres():
    reach = Reach(DeviceParameters(mass_kg=0.1, damping_N_s_m=0.5))
    for place in [(0.0, 0.0, 0.0), (1e9, 0.0, 0.0), (float("nan"), 0.0, 0.0), (2.9, 0.0, 0.0)] * 40:
        reach.require(place)
    with pytest.raises(DeviceError, match="3100 mm from its first one, but no workspace is stated"):
        reach.require((3.1, 0.0, 0.0), samples=1)


def test_a_clutch_and_a_mouse_go_further_than_an_arm():
    """The device goes to and fro in its workspace; its clutch is held while it goes back."""
    adapter = Adapter(lambda time_s: (0.1 * (time_s % 1.0), 0.0, 0.0))
    adapter.poll, polls = None, []
    device = MappedDevice(adapter, Hardware(clutch_button=0), now=lambda: TICK * len(polls))

    def poll():
        polls.append(None)
        phase = 1e-3 * len(polls) % 2.0
        place = 0.15 * (phase if phase < 1.0 else 2.0 - phase)
        return HardwareSample((place, 0.0, 0.0), buttons=int(phase >= 1.0))

    adapter.poll = poll
    guard = SampleGuard(force_limit_N=1.0)
    last = [guard.validate_sample(device.read(TICK * tick), TICK * tick) for tick in range(12_000)][
        -1
    ]
    assert last.position_m[0] > 3.0 * DIAGONAL_M
    mouse = MouseDevice()
    mouse.push((2.0, 0.0, 0.0))
    run = tissue.simulate(wall(duration_s=0.5), device=mouse)
    assert run.trace["device_x_mm"][-1] > 1900.0


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


def test_an_adapter_whose_quaternion_is_right_again_goes_on_from_there():
    adapter = Adapter(lambda time_s: (0.0, 0.0, 0.01), (0.4, 0.0, 0.0, 0.4))
    device = MappedDevice(adapter, Hardware(), start_m=(0.0, 0.0, 0.02))
    device.read(0.0)
    adapter.quaternion = TURN
    sample = device.read(TICK)
    assert sample.position_m == pytest.approx(
        (0.0, 0.0, 0.02)
    ) and sample.quaternion == pytest.approx((0, 0, 0, 1))


def test_a_device_that_gives_w_first_is_named():
    guard = SampleGuard(force_limit_N=1.0)
    guard.validate_sample(Sample(0.0, (0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0)), 0.0)
    ((_, what),) = guard.events
    assert "a device that gives w first starts so" in what
    for quaternion in (TURN, (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)):
        guard = SampleGuard(force_limit_N=1.0)
        guard.validate_sample(Sample(0.0, (0.0, 0.0, 0.0), quaternion=quaternion), 0.0)
        assert not guard.events
