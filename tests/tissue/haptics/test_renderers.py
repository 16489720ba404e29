"""Renderers: one contract, three laws, in translation and rotation."""

import numpy as np
import pytest

from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Grip, HandAction, hand_parameters
from tissue.haptics.renderer import PassivityRenderer, PenaltyRenderer, TurningRenderer, renderer
from tissue.haptics.rigid_wall import knock
from tissue.motion.quaternion import exponential, logarithm, product, unit
from tissue.scene.registry import RENDERERS

TICK, NOTHING = 1e-3, np.zeros(3)
WALL = device_parameters("six-dof").loop(800.0, wall_damping_N_s_m=2.0)


@pytest.fixture(params=RENDERERS.names)
def law(request):
    return renderer(request.param, WALL)


def test_a_free_device_feels_nothing(law):
    rng = np.random.default_rng(0)
    for _ in range(50):
        at, speed = rng.normal(size=3), rng.normal(size=3)
        assert not law.render(at, speed, at, speed, TICK).any()


def test_a_resting_device_feels_the_spring(law):
    gap = np.array([1e-3, -2e-3, 5e-4])
    assert law.render(-gap, NOTHING, NOTHING, NOTHING, TICK) == pytest.approx(
        800.0 * gap, rel=1e-12
    )


def test_a_contact_only_brakes_along_the_gap(law):
    gap, speed = np.array([0.0, 0.0, 2e-3]), np.array([0.0, 0.0, -0.1])
    force = law.render(-gap, speed, NOTHING, NOTHING, TICK)
    assert force == pytest.approx([0.0, 0.0, 1.6 + 0.2], rel=1e-12)


@pytest.mark.parametrize("kind", RENDERERS)
def test_the_laws_turn_with_the_world(kind):
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    found = []
    for frame in (np.eye(3), turn):
        law, rng = renderer(kind, WALL), np.random.default_rng(1)
        forces = []
        for _ in range(30):
            at, speed, foot, slide = (
                frame @ rng.normal(size=3) * size for size in (1e-3, 0.1, 1e-3, 0.1)
            )
            forces.append(frame.T @ law.render(at, speed, foot, slide, TICK))
        found.append(forces)
    assert np.allclose(*found, rtol=1e-9, atol=1e-12)


def test_penalty_never_pulls_into_the_surface_and_the_supervised_one_may_brake():
    out = np.array([0.0, 0.0, 3.0])
    penalty = renderer("penalty", WALL)
    assert not penalty.render(np.array([0.0, 0.0, -1e-3]), out, NOTHING, NOTHING, TICK).any()
    supervised = renderer("passivity", device_parameters("six-dof").loop(800.0))
    for depth in (0.0, -4e-3, -3.8e-3, -3.5e-3):
        force = supervised.render(np.array([0.0, 0.0, depth]), NOTHING, NOTHING, NOTHING, TICK)
    force = supervised.render(np.array([0.0, 0.0, -3e-3]), NOTHING, NOTHING, NOTHING, TICK)
    assert supervised.control.observer.energy_J < 0.0 < supervised.control.damping_N_s_m
    assert force[2] < 0.5 * 800.0 * 3e-3  # on its path out, with nothing in store


def test_a_turn_is_rendered_on_the_group():
    """A turn is rendered on the group.

    The torque follows the shortest rotation vector, across half a turn's sign and for either sign
    of the quaternion.
    """
    law = TurningRenderer(PenaltyRenderer(0.3))
    gap = np.array([0.3, -0.5, 0.2])
    device = unit((0.3, 0.2, -0.5, 0.7))
    proxy = product(exponential(tuple(gap)), device)
    for sign in (1.0, -1.0):
        other = tuple(sign * part for part in proxy)
        assert law.render(device, NOTHING, other, NOTHING, TICK) == pytest.approx(
            0.3 * gap, rel=1e-12
        )
    far = law.render(device, NOTHING, product(exponential((0.0, 0.0, 3.5)), device), NOTHING, TICK)
    assert far == pytest.approx([0.0, 0.0, 0.3 * (3.5 - 2 * np.pi)], rel=1e-12)


class Turning:
    """A loose grip that aims half a radian into the wall of a rotation."""

    def act(self, time_s, position_m):
        return HandAction(
            aim_quaternion=exponential((0.0, 0.0, -0.3)),
            grip=Grip(300.0, 4.0, 0.1, 0.6, 2e-4, 5e-5),
        )


@pytest.mark.parametrize("supervised", [False, True])
def test_a_stop_for_a_rotation_creates_energy_unless_it_is_supervised(supervised):
    """A stop for a rotation creates energy unless it is supervised.

    The stop at angle 0 about z has 1.5 N m/rad, three times the vendor's limit, in a hand with
    little damping.
    """
    device = SimulatedDevice(device_parameters("six-dof"), Turning())
    inner = PenaltyRenderer(1.5)
    lag = 0.5 + 0.53  # ticks of delay and amplifier
    law = TurningRenderer(
        PassivityRenderer(inner, damping_limit_N_s_m=0.02, delay_ticks=lag) if supervised else inner
    )
    given = []
    for tick in range(1500):
        sample = device.read(tick * TICK)
        angle = logarithm(sample.quaternion)[2]
        proxy = exponential((0.0, 0.0, max(angle, 0.0)))
        torque = law.render(sample.quaternion, np.array(sample.spin_rad_s), proxy, NOTHING, TICK)
        device.command(NOTHING, torque)
        given.append(device.rotation.motor_work_J)
    if supervised:
        assert law._inner.control.dissipated_J > 0.0
        assert given[-1] < 0.2 * 2e-3
    else:
        assert given[-1] > 2e-3


def test_a_knocked_hand_presses_the_wall_before_the_jerk():
    run, _ = knock(device_parameters("touch"), hand_parameters("expert"), "penalty", 500.0)
    before = (run.time_s > 0.6) & (run.time_s < 0.8)
    assert (run.position_m[before, 2] < 0.0).all() and (run.force_N[before, 2] > 0.0).all()
