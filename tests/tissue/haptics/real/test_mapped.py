"""Real device in the scene, against closed forms.

The tests cover turns, places, powers, the clutch, the ramp, the cap and the watchdog.
"""

from math import cos, radians, sin

import numpy as np
import pytest

from tissue.haptics.device.device import DeviceParameters, ReportsPlayedForce
from tissue.haptics.device.safe_device import SafeDevice
from tissue.haptics.real.adapter import HardwareAdapter, HardwareSample
from tissue.haptics.real.mapped import MappedDevice
from tissue.motion.motion import matrix_of
from tissue.motion.quaternion import exponential
from tissue.scene.coupling import Hardware

TICK = 1e-3
LIMITS = DeviceParameters(mass_kg=0.1, damping_N_s_m=0.5, force_limit_N=8.0, torque_limit_Nm=0.2)
TURNS = [(0.0, 0.0, 0.0), (90.0, 0.0, 0.0), (0.0, 0.0, -90.0), (20.0, -35.0, 140.0)]


class Double(HardwareAdapter):
    """An adapter whose samples a test gives, and which records what is pushed."""

    def __init__(self):
        self.limits, self.sample, self.pushed = LIMITS, None, []
        self.entered = self.left = self.closed = 0

    def __enter__(self):
        self.entered += 1
        return self

    def __exit__(self, kind, error, trace):
        self.left += 1

    def open(self):
        pass

    def poll(self):
        sample, self.sample = self.sample, None
        return sample

    def push(self, force_N, torque_Nm):
        self.pushed.append((np.array(force_N), np.array(torque_Nm)))

    def close(self):
        self.closed += 1


class Clock:
    """A clock that goes with the ticks of a test."""

    def __init__(self):
        self.time_s = 0.0

    def __call__(self):
        return self.time_s


def mapped(start_m=(0.0, 0.0, 0.0), **settings):
    adapter, clock = Double(), Clock()
    settings = {"ramp_ms": 0.0} | settings
    return MappedDevice(adapter, Hardware(**settings), start_m=start_m, now=clock), adapter, clock


def run(device, adapter, clock, samples, force_N=(1.0, 0.0, 0.0)):
    """A tick for each sample, None for none: what was read, and what was played in the world."""
    read, played = [], []
    for sample in samples:
        adapter.sample = sample
        read.append(device.read(clock.time_s))
        device.command(np.array(force_N), np.zeros(3))
        played.append(device.played[0].copy())
        clock.time_s += TICK
    return read, np.array(played)


def rotation(turn_deg):
    """About the world's x, then y, then z, by the sines and cosines of the angles."""
    (a, b, c) = map(radians, turn_deg)
    about_x = np.array([[1, 0, 0], [0, cos(a), -sin(a)], [0, sin(a), cos(a)]])
    about_y = np.array([[cos(b), 0, sin(b)], [0, 1, 0], [-sin(b), 0, cos(b)]])
    about_z = np.array([[cos(c), -sin(c), 0], [sin(c), cos(c), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


@pytest.mark.parametrize("turn_deg", TURNS)
def test_positions_are_turned_about_the_first_one_which_is_the_tools_start(turn_deg):
    start = (0.01, -0.02, 0.03)
    device, adapter, clock = mapped(start, turn_deg=turn_deg)
    places = np.random.default_rng(1).normal(scale=0.05, size=(20, 3))
    speeds = np.random.default_rng(2).normal(size=(20, 3))
    read, _ = run(
        device,
        adapter,
        clock,
        [HardwareSample(tuple(p), tuple(v)) for p, v in zip(places, speeds, strict=True)],
    )
    turn = rotation(turn_deg)
    np.testing.assert_allclose(
        [each.position_m for each in read], start + (places - places[0]) @ turn.T, atol=1e-15
    )
    np.testing.assert_allclose([each.velocity_m_s for each in read], speeds @ turn.T, atol=1e-14)


@pytest.mark.parametrize("turn_deg", TURNS)
def test_power_is_the_same_in_both_frames(turn_deg):
    device, adapter, clock = mapped(turn_deg=turn_deg)
    rng = np.random.default_rng(3)
    for _ in range(20):
        velocity, spin, force, torque = rng.normal(size=(4, 3))
        adapter.sample = HardwareSample((0.0, 0.0, 0.0), tuple(velocity), spin_rad_s=tuple(spin))
        sample = device.read(clock.time_s)
        device.command(force, torque)
        pushed, turning = adapter.pushed[-1]
        assert pushed @ velocity == pytest.approx(force @ sample.velocity_m_s, rel=1e-12)
        assert turning @ spin == pytest.approx(torque @ sample.spin_rad_s, rel=1e-12)


@pytest.mark.parametrize("turn_deg", TURNS)
def test_orientation_starts_without_a_turn_and_turns_in_the_worlds_axes(turn_deg):
    device, adapter, clock = mapped(turn_deg=turn_deg)
    first, about = exponential((0.3, -0.2, 0.9)), (0.1, 0.4, -0.2)
    read, _ = run(
        device,
        adapter,
        clock,
        [
            HardwareSample((0.0, 0.0, 0.0), quaternion=first),
            HardwareSample(
                (0.0, 0.0, 0.0),
                quaternion=quaternion_after(first, about),
                spin_rad_s=tuple(np.array(about) / TICK),
            ),
        ],
    )
    np.testing.assert_allclose(read[0].quaternion, (0.0, 0.0, 0.0, 1.0), atol=1e-15)
    world = rotation(turn_deg) @ about
    np.testing.assert_allclose(
        matrix_of(np.array(read[1].quaternion)),
        matrix_of(np.array(exponential(tuple(world)))),
        atol=1e-14,
    )
    np.testing.assert_allclose(read[1].spin_rad_s, world / TICK, rtol=1e-12)


def quaternion_after(first, vector):
    """The orientation ``first`` followed by a turn, by matrices' own law for quaternions."""
    from tissue.motion.quaternion import product

    return product(exponential(vector), first)


def test_the_clutch_leaves_the_tool_and_lets_it_go_on_from_there():
    device, adapter, clock = mapped(clutch_button=1)
    places = np.linspace(0.0, 0.06, 61)
    held = (np.arange(61) >= 20) & (np.arange(61) < 40)
    turns = [exponential((0.01 * tick, 0.0, 0.0)) for tick in range(61)]
    samples = [
        HardwareSample((x, 0.0, 0.0), (1.0, 0.0, 0.0), turn, buttons=2 * int(down))
        for x, turn, down in zip(places, turns, held, strict=True)
    ]
    read, played = run(device, adapter, clock, samples)
    at = np.array([each.position_m[0] for each in read])
    np.testing.assert_allclose(at[:20], places[:20], atol=1e-15)
    assert (at[20:40] == at[19]).all() and not any(
        v for each in read[20:40] for v in each.velocity_m_s
    )
    np.testing.assert_allclose(at[40:], at[19] + places[40:] - places[40], atol=1e-15)
    angle = np.array([2 * np.arctan2(each.quaternion[0], each.quaternion[3]) for each in read])
    np.testing.assert_allclose(angle[20:41], angle[19], atol=1e-12)
    np.testing.assert_allclose(np.diff(angle[40:]), 0.01, atol=1e-12)
    assert (
        not played[20:40].any() and (played[:20, 0] == 1.0).all() and (played[40:, 0] == 1.0).all()
    )


@pytest.mark.parametrize("ramp_ms", [50.0, 200.0])
def test_the_force_comes_on_in_a_straight_line_after_the_start_and_after_each_release(ramp_ms):
    device, adapter, clock = mapped(ramp_ms=ramp_ms, force_button=0)
    ticks = round(ramp_ms) + 20
    pressed = [HardwareSample((0.0, 0.0, 0.0), buttons=1)] * ticks
    loose = [HardwareSample((0.0, 0.0, 0.0), buttons=0)] * 10
    _, played = run(device, adapter, clock, pressed + loose + pressed, force_N=(0.0, 3.0, -4.0))
    sizes = np.linalg.norm(played, axis=1) / 5.0
    ramp = np.minimum(np.arange(ticks) / ramp_ms, 1.0)
    np.testing.assert_allclose(sizes[:ticks], ramp, atol=1e-12)
    assert not sizes[ticks : ticks + 10].any()
    np.testing.assert_allclose(
        sizes[ticks + 10 :], np.minimum((np.arange(ticks) + 1) / ramp_ms, 1.0), atol=1e-12
    )


@pytest.mark.parametrize(("cap", "least"), [(None, 8.0), (3.0, 3.0), (50.0, 8.0)])
def test_the_cap_keeps_the_direction(cap, least):
    device, adapter, clock = mapped(force_cap_N=cap, turn_deg=(10.0, 20.0, 30.0))
    run(device, adapter, clock, [HardwareSample((0.0, 0.0, 0.0))])
    for wanted in np.random.default_rng(4).normal(scale=6.0, size=(50, 3)):
        device.command(wanted, np.zeros(3))
        size = np.linalg.norm(wanted)
        np.testing.assert_allclose(device.played[0], wanted * min(least / size, 1.0), rtol=1e-12)
        assert np.linalg.norm(adapter.pushed[-1][0]) == pytest.approx(min(size, least), rel=1e-12)


def test_the_watchdog_repeats_a_sample_and_then_takes_the_force_off():
    device, adapter, clock = mapped(watchdog_ms=10.0, ramp_ms=20.0)
    here = HardwareSample((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    read, played = run(device, adapter, clock, [here] * 30 + [None] * 20 + [here] * 30)
    assert all(sample is not None for sample in read[:39])
    assert [sample.time_s for sample in read[:39]] == pytest.approx(TICK * np.arange(39))
    gone = next(tick for tick, sample in enumerate(read) if sample is None)
    assert gone in (39, 40, 41) and all(sample is None for sample in read[gone:50]), (
        "10 ms after the 30th sample"
    )
    assert (played[21:gone, 0] == 1.0).all() and not played[gone:50].any()
    np.testing.assert_allclose(played[50:70, 0], (np.arange(20) + 1) / 20.0, atol=1e-12)
    sentences = [what for _, what in device.happened()]
    assert sentences == [
        "no sample came for 10 ms: the force is zero",
        "samples arrive again: the force returns",
    ]


def test_a_force_that_the_adapter_took_off_comes_on_from_zero():
    device, adapter, clock = mapped(ramp_ms=20.0)
    here = [HardwareSample((0.0, 0.0, 0.0))]
    adapter.releases, adapter.happened = 0, lambda: ("late",) * adapter.releases
    assert run(device, adapter, clock, here * 30)[1][-1, 0] == 1.0
    adapter.releases = 1
    _, played = run(device, adapter, clock, here * 30)
    np.testing.assert_allclose(
        played[:, 0], np.minimum((np.arange(30) + 1) / 20.0, 1.0), atol=1e-12
    )
    assert device.happened() == [(pytest.approx(0.03), "late")] == device.happened()


def test_a_safe_device_holds_it_and_states_what_was_played():
    device, adapter, _ = mapped(force_cap_N=2.0)
    assert isinstance(device, ReportsPlayedForce)
    with SafeDevice(device) as held:
        adapter.sample = HardwareSample((0.0, 0.0, 0.0))
        held.read(0.0)
        force, _ = held.play(np.array([0.0, 0.0, 5.0]), np.zeros(3))
        np.testing.assert_allclose(force, (0.0, 0.0, 2.0))
    assert (adapter.entered, adapter.left) == (1, 1) and not adapter.pushed[-1][0].any()
    device.close()
    assert adapter.closed == 1
