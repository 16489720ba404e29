"""Devices and their plant.

The tests cover closed forms, friction, encoders, delay, limits, and the laws that every device
keeps.
"""

from math import exp, inf, pi, sqrt

import numpy as np
import pytest

from tissue import InputError
from tissue.haptics.device.device import DeviceParameters, Sample, device_parameters
from tissue.haptics.device.recorded import Fault, FaultyDevice, MouseDevice, RecordedDevice
from tissue.haptics.device.simulated import Plant, SimulatedDevice
from tissue.haptics.hand.hand import Grip, Hand, HandAction, hand_parameters
from tissue.haptics.loop.filters import ForceRange
from tissue.motion.quaternion import conjugate, exponential, logarithm, product

NOTHING = np.zeros(3)
TICK = 1e-3


class Steady:
    """A hand that does the same all the time."""

    def __init__(self, **action):
        self.action = HandAction(**action)

    def act(self, time_s, position_m):
        return self.action


def test_a_pushed_mass_with_damping_and_amplifier_follows_the_closed_form():
    mass, damping, bandwidth, force = 0.05, 0.4, 100.0, 0.7
    plant = Plant(mass_kg=mass, damping_N_s_m=damping, amplifier_Hz=bandwidth)
    for _ in range(37):
        plant.advance(1.3e-3, command=(force, 0.0, -force), external=(0.0, 0.0, 0.0))
    time, slow, fast = 37 * 1.3e-3, damping / mass, 2 * pi * bandwidth
    speed = (
        force
        / damping
        * (1 - (fast * exp(-slow * time) - slow * exp(-fast * time)) / (fast - slow))
    )
    assert plant.velocity == pytest.approx((speed, 0.0, -speed), rel=1e-11)
    assert plant.motor_force[0] == pytest.approx(force * (1 - exp(-fast * time)), rel=1e-12)


def test_a_held_mass_swings_as_it_should_and_its_energy_is_booked():
    plant = Plant(mass_kg=0.1, damping_N_s_m=0.0)
    plant.hand = (300.0, 1.0, 0.1)
    plant.advance(0.05, command=(0.5, 0.0, 0.0), external=(0.0, 2.0, 0.0), substeps=1)
    rate, decay = sqrt(300.0 / 0.2 - (1.0 / 0.4) ** 2), 1.0 / 0.4
    swing = 1.0 - exp(-decay * 0.05) * (np.cos(rate * 0.05) + decay / rate * np.sin(rate * 0.05))
    assert plant.position[:2] == pytest.approx(
        (0.5 / 300.0 * swing, 2.0 / 300.0 * swing), rel=1e-11
    )
    assert plant.motor_work_J == pytest.approx(0.5 * plant.position[0], rel=1e-12)


def slide(substeps):
    """Path length until friction and damping stop a mass that slides across two axes [m]."""
    plant = Plant(mass_kg=0.045, damping_N_s_m=0.35, friction_N=0.26)
    plant.velocity = (0.3, -0.4, 0.0)
    for _ in range(200):
        plant.advance(1e-3, command=(0.0, 0.0, 0.0), external=(0.0, 0.0, 0.0), substeps=substeps)
    assert plant.velocity == (0.0, 0.0, 0.0)
    assert plant.position[1] / plant.position[0] == pytest.approx(-4.0 / 3.0, rel=1e-12)
    return sqrt(sum(x * x for x in plant.position))


def test_friction_stops_a_slide_where_the_closed_form_does():
    mass, damping, friction, speed = 0.045, 0.35, 0.26, 0.5
    exact = mass * speed / damping - mass * friction / damping**2 * np.log(
        1 + damping * speed / friction
    )
    errors = [abs(slide(substeps) / exact - 1.0) for substeps in (1, 2, 4, 8, 16)]
    assert errors[-1] < 1e-3
    # first order in the substep
    assert np.polyfit(np.log([1, 2, 4, 8, 16]), np.log(errors), 1)[0] < -0.8


@pytest.mark.parametrize("amplifier", [inf, 300.0])
def test_a_mass_at_rest_does_not_creep_or_chatter_until_the_friction_is_passed(amplifier):
    plant = Plant(mass_kg=0.045, damping_N_s_m=0.35, friction_N=0.26, amplifier_Hz=amplifier)
    plant.hand = (300.0, 4.0, 0.1)
    rng = np.random.default_rng(0)
    for _ in range(500):
        direction = rng.normal(size=3)
        push = tuple(0.2599 * direction / np.linalg.norm(direction))
        plant.advance(1e-3, command=push, external=(0.0, 0.0, 0.0), substeps=5)
        assert plant.position == (0.0, 0.0, 0.0) and plant.velocity == (0.0, 0.0, 0.0)
    for _ in range(20):
        plant.advance(1e-3, command=(0.27, 0.0, 0.0), external=(0.0, 0.0, 0.0), substeps=5)
    assert plant.position[0] > 0.0


@pytest.mark.parametrize("delay", [0.0, 0.25e-3, 1e-3, 2.6e-3])
def test_a_command_arrives_after_the_delay_exactly(delay):
    device = SimulatedDevice(
        DeviceParameters(mass_kg=0.05, damping_N_s_m=0.0, transport_delay_s=delay), substeps=1
    )
    device.read(3 * TICK)
    device.command(np.array([0.0, 1.0, 0.0]), NOTHING)
    acted = 10 * TICK - 3 * TICK - delay
    assert device.read(10 * TICK).position_m[1] == pytest.approx(
        0.5 * 1.0 / 0.05 * acted**2, rel=1e-9
    )
    assert device.translation.velocity[1] == pytest.approx(acted / 0.05, rel=1e-12)


def test_encoders_step_and_speed_is_their_difference():
    device = SimulatedDevice(
        DeviceParameters(mass_kg=0.05, damping_N_s_m=0.0, encoder_step_m=5.5e-5), substeps=1
    )
    device.translation.velocity = (0.013, 0.0, 0.0)
    before = device.read(0.0)
    for tick in range(1, 50):
        sample = device.read(tick * TICK)
        assert sample.position_m[0] == pytest.approx(
            5.5e-5 * round(0.013 * tick * TICK / 5.5e-5), abs=1e-18
        )
        assert sample.velocity_m_s[0] == pytest.approx(
            (sample.position_m[0] - before.position_m[0]) / TICK, abs=1e-12
        )
        before = sample
    assert device.read(49.4 * TICK) is before and before.time_s == pytest.approx(49 * TICK)


def test_commands_beyond_the_device_are_limited_and_counted():
    device = SimulatedDevice(device_parameters("six-dof"))
    device.command(np.array([30.0, 0.0, 40.0]), np.array([0.0, 1.0, 0.0]))
    device.read(0.1)
    assert device.saturated_ticks == 2
    assert np.array(device.translation.motor_force) == pytest.approx(
        [0.6 * 8.5, 0.0, 0.8 * 8.5], rel=1e-6
    )
    assert np.array(device.rotation.motor_force) == pytest.approx([0.0, 0.188, 0.0], rel=1e-6)
    for wrong in (np.nan, np.inf):
        device.command(np.array([0.0, wrong, 0.0]), NOTHING)
    device.read(0.3)
    assert device.refused_commands == 2 and max(map(abs, device.translation.motor_force)) < 1e-12


def test_a_torque_turns_the_handle_about_its_axis_through_more_than_a_turn():
    """On the group: alpha = torque / inertia about a slanted axis, to four times pi."""
    parameters = DeviceParameters(
        mass_kg=0.05, damping_N_s_m=0.0, damping_Nm_s_rad=0.0, torque_limit_Nm=1.0
    )
    device, axis, torque = SimulatedDevice(parameters, substeps=1), np.array([0.6, 0.0, 0.8]), 4e-3
    device.command(NOTHING, torque * axis)
    ticks = 600
    angle = 0.5 * torque / parameters.inertia_kg_m2 * (ticks * TICK) ** 2
    assert angle > 4 * pi
    sample = device.read(ticks * TICK)
    turned = exponential(tuple(angle * axis))
    assert logarithm(product(sample.quaternion, conjugate(turned))) == pytest.approx(
        (0.0, 0.0, 0.0), abs=1e-9
    )
    assert np.array(sample.spin_rad_s) == pytest.approx(
        axis * torque / 5e-5 * (ticks - 0.5) * TICK, rel=1e-9
    )


def test_a_hand_turns_the_device_to_where_it_aims():
    aim = exponential((0.5, -0.4, 0.3))
    grip = Grip(300.0, 4.0, 0.1, 0.6, 0.01, 2e-4)
    device = SimulatedDevice(device_parameters("six-dof"), Steady(aim_quaternion=aim, grip=grip))
    seen = device.read(1.0)
    left = logarithm(product(device.orientation, conjugate(aim)))
    assert sqrt(sum(a * a for a in left)) <= 1e-3 / 0.6 + 1e-9  # friction over stiffness
    assert logarithm(product(seen.quaternion, conjugate(device.orientation))) == pytest.approx(
        (0, 0, 0), abs=2.3e-4
    )
    three = SimulatedDevice(device_parameters("omni"), Steady(aim_quaternion=aim, grip=grip))
    assert not three.six_dof and three.read(0.01).quaternion == aim
    three.command(NOTHING, np.ones(3))
    assert three.saturated_ticks == 0


RECORD = (np.array([0.0, 0.1, 0.3]), np.array([[0.0, 0, 0], [0.01, 0, 0], [0.01, 0.04, 0]]))


def a_mouse():
    mouse = MouseDevice()
    mouse.push((0.01, 0.0, 0.0), exponential((0.0, 0.1, 0.0)))
    return mouse


def a_hand():
    path = lambda time_s: np.array([0.01 * time_s, 0.0, 0.0])  # noqa: E731
    return SimulatedDevice(
        device_parameters("omni"),
        Hand(hand_parameters("novice"), path, rng=np.random.default_rng(1)),
    )


MAKERS = {
    "simulated": a_hand,
    "six-dof": lambda: SimulatedDevice(device_parameters("six-dof")),
    "recorded": lambda: RecordedDevice(*RECORD),
    "mouse": a_mouse,
    "faulty": lambda: FaultyDevice(a_hand(), Fault("dropped", 9.0, 9.0)),
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_every_device_keeps_the_contract(make):
    device, again = make(), make()
    before = None
    for tick in range(250):
        sample = device.read(tick * TICK)
        assert isinstance(sample, Sample) and all(np.isfinite(part).all() for part in sample)
        assert sample == again.read(tick * TICK), "not deterministic"
        assert sample.time_s == pytest.approx(tick * TICK, abs=1e-9)
        assert np.linalg.norm(sample.quaternion) == pytest.approx(1.0, abs=1e-12)
        if before is not None:
            moved = (np.array(sample.position_m) - before.position_m) / TICK
            assert np.abs(moved - sample.velocity_m_s).max() < 0.02
        before = sample
        for each in (device, again):
            each.command(np.array([0.1, 0.0, 0.0]), np.array([0.0, 1e-3, 0.0]))
    position, velocity, quaternion, spin = map(np.array, before[1:])
    assert position.shape == velocity.shape == spin.shape == (3,) and quaternion.shape == (4,)


def test_a_record_is_replayed_and_ends():
    turned = np.array([exponential((0.0, 0.0, angle)) for angle in (0.0, 0.2, 0.2)])
    device = RecordedDevice(*RECORD, turned)
    at = device.read(0.05)
    assert at.position_m == pytest.approx((0.005, 0.0, 0.0)) and at.velocity_m_s == pytest.approx(
        (0.1, 0.0, 0.0)
    )
    assert logarithm(at.quaternion) == pytest.approx(
        (0.0, 0.0, 0.1)
    ) and at.spin_rad_s == pytest.approx((0.0, 0.0, 2.0))
    assert device.read(0.2).velocity_m_s == pytest.approx((0.0, 0.2, 0.0))
    assert device.read(0.301) is None and device.read(-0.01) is None


def test_a_mouse_is_followed_smoothly_and_alike_at_any_rate():
    found = []
    for step in (1e-3, 7e-3):
        mouse = MouseDevice()
        mouse.push((0.02, -0.01, 0.0))
        for tick in range(1, round(0.07 / step) + 1):
            sample = mouse.read(tick * step)
        found.append((*sample.position_m, *sample.velocity_m_s))
    share = 1.0 - (1.0 + 0.07 / 0.03) * exp(-0.07 / 0.03)
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert found[0][:2] == pytest.approx((0.02 * share, -0.01 * share), rel=1e-9)


def test_a_force_is_brought_into_range_by_a_law_that_can_be_undone():
    law, rng = ForceRange(limit_N=3.3), np.random.default_rng(4)
    sizes = np.geomspace(1e-4, 6.0, 60)
    played = []
    for size in sizes:
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        force, compressed = law.play(size * direction)
        played.append(float(np.linalg.norm(force)))
        assert force == pytest.approx(played[-1] * direction, rel=1e-12)
        assert compressed == (size > 0.7 * 3.3)
        above = max(played[-1] - 0.7 * 3.3, 0.0)
        undone = min(played[-1], 0.7 * 3.3) - 0.3 * 3.3 * np.log1p(-above / (0.3 * 3.3))
        assert undone == pytest.approx(size, rel=1e-6)
    assert (np.diff(played) > 0.0).all() and played[-1] < 3.3
    assert np.linalg.norm(law.play(np.array([1e9, 0.0, 0.0]))[0]) <= 3.3 * (1 + 1e-15)
    knee = [float(law.play(np.array([(2.31 + d), 0.0, 0.0]))[0][0]) for d in (-1e-5, 0.0, 1e-5)]
    assert knee[2] - knee[1] == pytest.approx(knee[1] - knee[0], rel=1e-4)  # no kink
    for wrong in (np.nan, np.inf):
        with pytest.raises(InputError, match="force must be finite"):
            law.play(np.array([0.0, wrong, 0.0]))


def test_the_axes_of_a_plant_are_alike():
    places = []
    for axis in range(3):
        plant = Plant(mass_kg=0.1, damping_N_s_m=0.5, friction_N=0.05, amplifier_Hz=100.0)
        plant.hand = (300.0, 2.0, 0.2)
        unit = np.eye(3)[axis]
        for tick in range(50):
            command = tuple((0.8 * unit).tolist())
            external = tuple((0.3 * np.sin(tick) * unit).tolist())
            plant.advance(1e-3, command=command, external=external, substeps=4)
        places.append([plant.position[axis], plant.velocity[axis], plant.motor_work_J])
    assert places[0] == places[1] == places[2] and places[0][0] > 0.0
