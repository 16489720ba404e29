"""Critical stiffness of a virtual wall.

It is compared with the published table, closed forms, and the simulated loop.
"""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import HandAction, hand_parameters
from tissue.haptics.loop.critical_stiffness import (
    critical_stiffness_N_m,
    delay_bound_N_m,
    in_hands,
    judge,
    passive_bound_N_m,
    quantised_bound_N_m,
    settling_hands,
)
from tissue.haptics.loop.sampled_loop import WallLoop, loop_matrix, spectral_radius
from tissue.haptics.loop.stability_map import measured_critical_N_m
from tissue.scene.registry import DEVICES, HANDS

TABLE = [
    (wall_damping, delay, critical)
    for wall_damping, row in (
        (0.0, (200.07, 66.70, 40.03, 22.26)),
        (0.5, (1188.0, 396.0, 237.0, 131.0)),
    )
    for delay, critical in zip((0, 1, 2, 4), row, strict=True)
]
"""Wall damping [N s/m], delay [ticks], critical stiffness [N/m] for 50 g, 0.1 N s/m and 1 kHz."""
PRINTED_N_M = {0.0: 0.005, 0.5: 0.5}
"""Half of the last digit that each row is printed with [N/m]."""
BY_RUNNING = 0.01
"""Tolerance of a bisection over runs of 4 s; the error is twenty times smaller."""


def wall(wall_damping=0.0, delay=0, **changed):
    given = {"mass_kg": 0.05, "damping_N_s_m": 0.1, "stiffness_N_m": 50.0} | changed
    return WallLoop(wall_damping_N_s_m=wall_damping, delay_s=1e-3 * delay, **given)


@pytest.mark.parametrize(("wall_damping", "delay", "critical"), TABLE)
def test_eigenvalues_give_the_printed_table(wall_damping, delay, critical):
    found = critical_stiffness_N_m(wall(wall_damping, delay))
    assert found == pytest.approx(critical, abs=PRINTED_N_M[wall_damping])


@pytest.mark.slow
def test_running_loops_give_the_printed_table_and_the_eigenvalues():
    loops = [wall(wall_damping, delay) for wall_damping, delay, _ in TABLE]
    found = measured_critical_N_m(loops)
    off = np.abs(np.array(found) / [critical_stiffness_N_m(each) for each in loops] - 1.0).max()
    print(f"critical stiffness by running, against eigenvalues: {100 * off:.3f} %")
    assert found == pytest.approx([critical for *_, critical in TABLE], rel=BY_RUNNING)
    assert found == pytest.approx([critical_stiffness_N_m(each) for each in loops], rel=1e-3)


@pytest.mark.parametrize("model_ticks", [1, pytest.param(8, marks=pytest.mark.slow)])
def test_real_devices_held_and_free_filtered_and_slow(model_ticks):
    loops = []
    for name in DEVICES:
        bare = device_parameters(name).loop(100.0)
        held = in_hands(bare, [hand_parameters(group).grip[:3] for group in HANDS])
        with_reflex = in_hands(bare, [hand_parameters("novice").linear_hands[-1]])[0]
        loops += [
            bare,
            *held,
            replace(held[0], filter_s=1e-3),
            replace(held[0], wall_damping_N_s_m=2.0),
            replace(with_reflex, delay_s=4e-3),
        ]
    loops = [replace(each, model_ticks=model_ticks) for each in loops]
    assert measured_critical_N_m(loops) == pytest.approx(
        [critical_stiffness_N_m(each) for each in loops], rel=BY_RUNNING
    )


class Push:
    """No grip, and one push of 0.1 N in the first tick."""

    def act(self, time_s, position_m):
        return HandAction(push_N=(0.0, 0.0, 0.1 if time_s == 0.0 else 0.0))


@pytest.mark.parametrize("delay", [0.0, 5e-4, 1e-3, 2.3e-3])
@pytest.mark.parametrize("amplifier_Hz", [inf, 300.0])
def test_the_simulated_device_obeys_the_same_boundary(delay, amplifier_Hz):
    """The simulated device has the same stability limit.

    It has no friction and encoder steps, on a wall that also pulls, 0.5 % below and above the
    limit.
    """
    device = DeviceParameters(
        mass_kg=0.045, damping_N_s_m=0.35, transport_delay_s=delay, amplifier_Hz=amplifier_Hz
    )
    critical = critical_stiffness_N_m(device.loop(1.0))

    def amplitude_grows(stiffness):
        simulated = SimulatedDevice(device, Push(), substeps=2)
        depth = []
        for tick in range(6000):
            depth.append(simulated.read(1e-3 * tick).position_m[2])
            simulated.command((0.0, 0.0, -stiffness * depth[-1]), (0.0, 0.0, 0.0))
        early, late = (np.abs(depth[start : start + 1000]).max() for start in (1000, 5000))
        return late > early

    assert not amplitude_grows(0.995 * critical)
    assert amplitude_grows(1.005 * critical)


def test_passive_bound_is_colgates_and_with_delay_gils():
    for wall_damping in (0.0, 0.05, -0.05):
        assert passive_bound_N_m(wall(wall_damping)) == pytest.approx(
            2.0 * (0.1 - abs(wall_damping)) / 1e-3, rel=1e-6
        )
    for delay in (0, 1, 2, 4):
        assert passive_bound_N_m(wall(0.0, delay)) == pytest.approx(
            delay_bound_N_m(wall(0.0, delay)), rel=1e-5
        )
    assert passive_bound_N_m(wall(0.2)) == 0.0


def test_no_wall_within_the_passive_bound_is_unstable_with_any_hand():
    """Over random devices, walls and passive hands; the bound knows neither mass nor hand."""
    rng = np.random.default_rng(5)
    for _ in range(300):
        damping = 10.0 ** rng.uniform(-1.5, 1.0)
        loop = WallLoop(
            mass_kg=10.0 ** rng.uniform(-2, 0.5),
            damping_N_s_m=damping,
            wall_damping_N_s_m=damping * rng.uniform(-0.8, 0.8),
            stiffness_N_m=1.0,
            delay_s=1e-3 * rng.integers(0, 4) if rng.random() < 0.5 else rng.uniform(0.0, 3e-3),
            filter_s=rng.choice([0.0, 1e-3, 5e-3]),
            amplifier_Hz=rng.choice([inf, 1000.0, 200.0]),
            model_ticks=int(rng.choice([1, 1, 3])),
            hand_stiffness_N_m=10.0 ** rng.uniform(0, 4),
            hand_damping_N_s_m=10.0 ** rng.uniform(-2, 1),
            hand_mass_kg=rng.uniform(0.0, 1.0),
        )
        bound = passive_bound_N_m(loop)
        if bound > 0.0:
            assert spectral_radius(loop.with_stiffness(bound)) < 1.0


def test_quantised_bound_takes_the_smaller_of_its_two():
    omni = device_parameters("omni")
    bound = quantised_bound_N_m(
        omni.loop(1.0), friction_N=omni.friction_N, encoder_m=omni.encoder_step_m
    )
    assert bound == pytest.approx(2.0 * omni.damping_N_s_m / 1e-3)
    assert 2.0 * omni.friction_N / omni.encoder_step_m == pytest.approx(9.5e3, rel=0.01)
    assert quantised_bound_N_m(omni.loop(1.0), friction_N=1e-3, encoder_m=5e-5) == pytest.approx(
        40.0
    )


def test_the_map_of_the_loop_is_what_the_loop_does():
    """The matrix of a filtered, delayed, slow loop against ten steps done by hand, to rounding."""
    loop = wall(0.3, 2.4, filter_s=2e-3, model_ticks=3, stiffness_N_m=300.0)
    state = np.zeros(len(loop_matrix(loop)))
    state[1] = 0.01
    for _ in range(10):
        state = loop_matrix(loop) @ state
    simulated = SimulatedDevice(
        DeviceParameters(mass_kg=0.05, damping_N_s_m=0.1, transport_delay_s=2.4e-3), substeps=1
    )
    simulated.translation.velocity = (0.0, 0.0, 0.01)
    before = force = filtered = 0.0
    for tick in range(31):
        depth = simulated.read(1e-3 * tick).position_m[2]
        if tick % 3 == 0:
            force, before = -300.0 * depth - 0.3 * (depth - before) / 3e-3, depth
        filtered += (1.0 - np.exp(-0.5)) * (force - filtered)
        simulated.command((0.0, 0.0, filtered), (0.0, 0.0, 0.0))
    assert depth == pytest.approx(state[0], rel=1e-10)


def test_a_hand_that_oscillates_alone_does_not_decide():
    """A hand with so little damping that its reflex makes it oscillate is left out."""
    loop = device_parameters("touch").loop(100.0)
    person = hand_parameters("expert")
    assert settling_hands(loop, person.linear_hands) == person.linear_hands
    loose = replace(person, damping_N_s_m=0.8).linear_hands
    alone = [replace(each, stiffness_N_m=0.0) for each in in_hands(loop, loose)]
    assert [spectral_radius(each) < 1.0 for each in alone] == [True, False]
    assert settling_hands(loop, loose) == loose[:1]


def test_the_worst_hand_decides():
    loop, hands = device_parameters("omni").loop(500.0), [(0.0, 0.0, 0.0), (300.0, 4.0, 0.1)]
    free, held = (judge(each) for each in in_hands(loop, hands))
    assert not free.stable and held.stable
    assert judge(loop, hands) == replace(
        free, spectral_radius=max(free.spectral_radius, held.spectral_radius)
    )
