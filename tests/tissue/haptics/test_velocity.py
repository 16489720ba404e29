"""Filter of positions from encoder steps: closed forms, and its delay in the stability judge."""

from dataclasses import replace

import numpy as np
import pytest
from hand_steps import meet
from quiet_press import LIMITS, PERSON, check_ripple, quiet_press

from tissue import InputError
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, in_hands, judge
from tissue.haptics.loop.filters import (
    OBSERVER_MEMORY,
    VELOCITY_MEMORY,
    ConstantAcceleration,
    constant_acceleration_map,
)
from tissue.haptics.loop.forecast import Forecast
from tissue.haptics.loop.sampled_loop import (
    ForecastMemory,
    SampledVelocity,
    WallLoop,
    loop_matrix,
)
from tissue.haptics.loop.stability_map import growth_while_running
from tissue.models.tissue_model import WallModel

TICK = 1e-3


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.85, 0.95])
def test_its_poles_are_its_memory(memory):
    """The poles of the filter are its memory.

    (z - m)^3 = z^3 - 3 m z^2 + 3 m^2 z - m^3; the polynomial is compared, since a triple eigenvalue
    rounds to 1e-5.
    """
    onward, _ = constant_acceleration_map(memory)
    np.testing.assert_allclose(
        np.poly(onward), [1.0, -3.0 * memory, 3.0 * memory**2, -(memory**3)], atol=1e-12
    )


def test_it_is_the_parabola_through_all_samples_by_least_squares():
    """The filter is the parabola through all samples by weighted least squares.

    Weights are 0.85 to the power of the age, over 400 samples of noise: the oldest weigh 1e-28.
    """
    places = np.random.default_rng(0).standard_normal((400, 2))
    estimate = ConstantAcceleration(0.85, step_s=TICK)
    for place in places:
        found = estimate.step(place)
    age = np.arange(-399.0, 1.0)
    fitted = np.polynomial.polynomial.polyfit(age, places, 2, w=np.sqrt(0.85**-age))
    np.testing.assert_allclose(found, fitted[1] / TICK, rtol=1e-6)


def test_a_constant_acceleration_has_no_delay_and_a_pause_forgets():
    estimate = ConstantAcceleration(0.9, step_s=TICK)
    for tick in range(400):
        found = estimate.step(np.array([1e-6 * tick**2, 3e-6 * tick]))
    np.testing.assert_allclose(found, [2e-6 * 399 / TICK, 3e-3], rtol=1e-9)
    estimate.pause()
    assert not estimate.step(np.array([7.0, 7.0])).any()


@pytest.mark.parametrize("memory", [0.5, 0.9])
def test_the_observed_position_is_that_of_the_parabola(memory):
    """The observed position has no delay for a constant acceleration, and lags behind a jump.

    After a step of the device, the estimate rises by 1 - memory^3 in the first sample. It then
    passes the new position and returns to it.
    """
    observer = ConstantAcceleration(memory, step_s=TICK)
    for tick in range(400):
        observer.step(np.array([1e-6 * tick**2, 3e-6 * tick]))
    np.testing.assert_allclose(observer.position, [1e-6 * 399**2, 3e-6 * 399], rtol=1e-9)
    observer.pause()
    found = []
    for place in (0.0, *[1.0] * 400):
        observer.step(np.array([place]))
        found.append(float(observer.position[0]))
    assert found[0] == 0.0 and found[1] == pytest.approx(1.0 - memory**3, rel=1e-12)
    assert 1.0 < max(found) < 1.4 and found[-1] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("model_ticks", [1, 3])
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_the_map_of_an_observed_loop_is_what_the_loop_does(damping, model_ticks):
    """The map of an observed loop is the loop, over 30 ticks of a device in closed form.

    The loop has a delay of 2.4 ticks and a low-pass. Position and velocity are those of the
    observer.
    """
    loop = WallLoop(
        mass_kg=0.05,
        damping_N_s_m=0.1,
        stiffness_N_m=300.0,
        wall_damping_N_s_m=damping,
        velocity_memory=0.9,
        observes=True,
        delay_s=2.4e-3,
        filter_s=2e-3,
        model_ticks=model_ticks,
    )
    state = np.zeros(len(loop_matrix(loop)))
    state[1] = 0.01
    for _ in range(30 // model_ticks):
        state = loop_matrix(loop) @ state
    device = SimulatedDevice(
        DeviceParameters(mass_kg=0.05, damping_N_s_m=0.1, transport_delay_s=2.4e-3), substeps=1
    )
    device.translation.velocity = (0.0, 0.0, 0.01)
    observer, force, filtered = ConstantAcceleration(0.9, step_s=TICK), 0.0, 0.0
    for tick in range(31):
        depth = device.read(TICK * tick).position_m[2]
        speed = observer.step(np.array([depth]))[0]
        if tick % model_ticks == 0:
            force = -300.0 * observer.position[0] - damping * speed
        filtered += (1.0 - np.exp(-0.5)) * (force - filtered)
        device.command((0.0, 0.0, filtered), (0.0, 0.0, 0.0))
    assert depth == pytest.approx(state[0], rel=1e-10)


def test_an_observed_loop_without_a_filter_is_refused():
    with pytest.raises(InputError, match="velocity_memory"):
        WallLoop(mass_kg=0.05, damping_N_s_m=0.1, stiffness_N_m=300.0, observes=True)


def test_the_judged_stiffness_falls_with_the_memory_of_the_observer():
    """The judged stiffness falls with the memory of the observer.

    With the memory 0 the observer passes the position on, and the loop is that without observer. Up
    to 0.6 the observer changes the critical stiffness by at most 1.3 %. Then it falls, to a half at
    0.9. A running loop has the same critical stiffness.
    """
    plain = LIMITS.loop(1.0, filter_s=1e-3)
    memories = (0.0, 0.3, 0.6, 0.8, 0.85, 0.9, 0.95)
    loops = [replace(plain, velocity_memory=each, observes=True) for each in memories]
    held = [in_hands(each, [PERSON.grip[:3]])[0] for each in loops]
    critical = [critical_stiffness_N_m(each) for each in held]
    print(dict(zip(memories, np.round(critical), strict=True)))
    assert critical[0] == pytest.approx(
        critical_stiffness_N_m(in_hands(plain, [PERSON.grip[:3]])[0]), rel=1e-4
    )
    assert critical[:3] == pytest.approx([critical[0]] * 3, rel=0.02)
    assert (np.diff(critical[2:]) < 0.0).all()
    assert critical[5] == pytest.approx(0.49 * critical[0], rel=0.02)
    measured = growth_while_running([held[5]] * 2, critical[5] * np.array([0.99, 1.01]))
    assert measured[0] < 1.0 < measured[1]


@pytest.mark.parametrize(("share", "settles"), [(0.95, True), (1.05, False)])
def test_the_whole_loop_with_an_observer_is_stable_up_to_the_stiffness_that_is_judged(
    share, settles
):
    """The whole loop with an observer is stable up to the stiffness that is judged."""
    free = replace(LIMITS.loop(1.0, filter_s=1e-3), velocity_memory=OBSERVER_MEMORY, observes=True)
    loop = free.with_stiffness(share * judge(free, [PERSON.grip[:3]]).critical_N_m)
    _, measures, _ = meet(quiet_press(loop, margin=1.0 - share), WallModel(1e6, radius_m=5e-3), 2.0)
    check_ripple(measures, settles=settles)


@pytest.mark.parametrize(("share", "settles"), [(0.95, True), (1.05, False)])
def test_the_whole_loop_with_a_damper_is_stable_up_to_the_stiffness_that_is_judged(share, settles):
    """The whole loop with a damper is stable up to the stiffness that is judged.

    As in test_hand_motion, with a damper on the filtered velocity; the wall is 1 / 250 as compliant
    as the spring.
    """
    free = replace(
        LIMITS.loop(1.0, filter_s=1e-3, wall_damping_N_s_m=0.6), velocity_memory=VELOCITY_MEMORY
    )
    loop = free.with_stiffness(share * judge(free, [PERSON.grip[:3]]).critical_N_m)
    _, measures, _ = meet(quiet_press(loop, margin=1.0 - share), WallModel(1e6, radius_m=5e-3), 2.0)
    check_ripple(measures, settles=settles)


def test_the_loop_s_filter_is_that_of_one_device_for_several_places_at_once():
    """Two places a tick, by the filter of one: the same velocity in m/s."""
    loop = replace(device_parameters("touch").loop(400.0), velocity_memory=0.9)
    sampled, single = (
        SampledVelocity(loop, np.zeros((3, 2))),
        ConstantAcceleration(0.9, step_s=TICK),
    )
    places = np.random.default_rng(1).normal(size=(30, 2)) * 1e-3
    for place in places:
        found, wanted = sampled.step(place - places[0]), single.step(place)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert (
        SampledVelocity(replace(loop, velocity_memory=None), np.zeros((0, 2))).step(places[0])
        is None
    )


@pytest.mark.parametrize("filtered", [False, True])
def test_a_forecast_is_the_sum_of_its_taps_over_what_was_seen(filtered):
    """A forecast is the sum of its taps over the observed samples.

    It is F + C (sum of taps (x, v, F) at each age - F), with the gains for place and speed scaled
    by the coupling's stiffness. Two loops run side by side, with a model every second tick: a tick
    without a force of the model adds none.
    """
    rng = np.random.default_rng(2)
    taps = rng.normal(size=(2, 3, 3))
    loop = replace(
        device_parameters("touch").loop(400.0, model_ticks=2),
        forecast=Forecast(taps=taps, gain=0.7, stiffness_N_m=250.0),
        velocity_memory=0.9 if filtered else None,
    )
    positions, forces, speeds = (
        rng.normal(size=(4, 2)),
        rng.normal(size=(3, 2)),
        rng.normal(size=(3, 2)),
    )
    if not filtered:
        speeds = (positions[:-1] - positions[1:]) / TICK
    for tick in (0, 1):
        known = list(positions[1:]), list(speeds[1:]) if filtered else [], list(forces[1:])
        memory = ForecastMemory(loop, *known)
        found = memory.predict(positions[0], speeds[0] if filtered else None, forces[0], tick)
        total = np.zeros(2)
        for age in range(3):
            phase = (tick - age) % 2
            by_place, by_speed, by_force = taps[phase, age]
            total += 400.0 / 250.0 * (by_place * positions[age] + by_speed * speeds[age])
            total += by_force * forces[age] if phase == 0 else 0.0
        np.testing.assert_allclose(found, forces[0] + 0.7 * (total - forces[0]), rtol=1e-12)
        np.testing.assert_array_equal(memory.positions, positions[:3])
        np.testing.assert_array_equal(memory.forces, forces[:2])
