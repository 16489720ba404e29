"""Devices that report other units or other quaternions.

The run ends, or the force fades, with a sentence.
"""

import numpy as np
import pytest

import tissue
from tissue import Sample, load_scene
from tissue.haptics.device.device import ComputedDevice, DeviceError, DeviceParameters
from tissue.haptics.device.reach import Reach
from tissue.haptics.device.sample_guard import SampleGuard
from tissue.haptics.real.adapter import HardwareSample
from tissue.haptics.real.mapped import MappedDevice
from tissue.scene.hardware import Hardware

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


class Adapter:
    """An adapter on a path in a unit of its own; every poll has a new sample."""

    limits = LIMITS

    def __init__(self, path, quaternion=(0.0, 0.0, 0.0, 1.0)):
        self.path, self.quaternion, self.pushed, self.polls = path, quaternion, [], 0

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        self.close()

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
    assert "a device that gives w first starts so" in what
    for quaternion in (TURN, (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)):
        guard = SampleGuard(force_limit_N=1.0)
        guard.validate_sample(Sample(0.0, (0.0, 0.0, 0.0), quaternion=quaternion), 0.0)
        assert not guard.events
