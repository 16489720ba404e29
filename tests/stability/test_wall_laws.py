"""Limits of published statements about haptic loops, each next to the statement that holds.

The numbers E3, E4, E9, E10 and E11 refer to the project's list of errors in a published haptic
framework.
"""

from math import pi, sqrt

import numpy as np
import pytest

from tissue.haptics.loop.critical_stiffness import (
    critical_stiffness_N_m,
    delay_bound_N_m,
    in_hands,
    pade_bound_N_m,
    passive_bound_N_m,
)
from tissue.haptics.loop.filters import LowPass
from tissue.haptics.loop.sampled_loop import WallLoop, spectral_radius
from tissue.haptics.loop.stability_map import growth_while_running
from tissue.haptics.renderer import PassivityControl, ProxyRenderer

TICK = 1e-3


def amplitude(time_constant_s, frequency_Hz):
    """Return the steady amplitude of the low-pass for a sine of amplitude 1.

    It is run at 2000 steps a period.
    """
    step = 5e-4 / frequency_Hz
    low_pass = LowPass(time_constant_s, step_s=step)
    times = step * np.arange(round(8.0 * time_constant_s / step) + 2000)
    found = [low_pass.step(np.full(3, np.sin(2 * pi * frequency_Hz * t)))[0] for t in times]
    return np.abs(found[-2000:]).max()


def test_e3_the_filter_parameter_is_a_time_and_no_frequency():
    """At its true cutoff 1 / (2 pi a) the amplitude is 1 / sqrt 2; at "a Hz" nothing is cut."""
    time_constant = 5e-3
    cutoff_Hz = 1.0 / (2.0 * pi * time_constant)
    assert amplitude(time_constant, cutoff_Hz) == pytest.approx(sqrt(0.5), rel=2e-3)
    printed = 1.0 / sqrt(1.0 + (1.0 / time_constant) ** 2)  # of 1 Hz, were the cutoff 0.005 Hz
    assert printed < 0.01
    assert amplitude(time_constant, 1.0) > 0.999


UNSAFE = [
    WallLoop(
        mass_kg=0.05, damping_N_s_m=0.1, wall_damping_N_s_m=10.0, delay_s=4e-3, stiffness_N_m=1.0
    ),
    WallLoop(
        mass_kg=0.02, damping_N_s_m=0.1, wall_damping_N_s_m=5.0, delay_s=4e-3, stiffness_N_m=1.0
    ),
    WallLoop(mass_kg=0.05, damping_N_s_m=5.0, delay_s=20e-3, stiffness_N_m=1.0),
]


@pytest.mark.parametrize("loop", UNSAFE)
def test_e4_pade_promises_stiffness_that_runs_away(loop):
    """The loop grows just inside the line of the first-order Padé delay.

    Just inside the limit of the eigenvalues it settles.
    """
    exact, promised = critical_stiffness_N_m(loop), pade_bound_N_m(loop)
    assert promised > 1.05 * exact
    # w t is no longer small
    assert sqrt(promised / loop.mass_kg) * (loop.delay_s + 0.5 * TICK) > 0.5
    grown = growth_while_running([loop, loop], np.array([0.98 * promised, 0.98 * exact]))
    assert grown[0] > 1.0 > grown[1]


def test_e4_pade_is_good_where_the_delay_is_short():
    loop = WallLoop(mass_kg=0.05, damping_N_s_m=0.1, delay_s=4e-3, stiffness_N_m=1.0)
    assert pade_bound_N_m(loop) == pytest.approx(critical_stiffness_N_m(loop), rel=1e-3)
    assert delay_bound_N_m(loop) == pytest.approx(critical_stiffness_N_m(loop), rel=2e-3)


def energy_from_a_cycle(law):
    """Return the energy that a contact gives to a device led once around a cycle in it [J].

    The steps are fine, so that nothing leaks.
    """
    step, given = 1e-4, 0.0
    for time in np.arange(0.0, 1.0, step):
        depth = np.array([1e-3 * np.sin(2 * pi * time), 0.0, -2e-3 + 1e-3 * np.cos(2 * pi * time)])
        speed = 2 * pi * 1e-3 * np.array([np.cos(2 * pi * time), 0.0, -np.sin(2 * pi * time)])
        given += float(law(depth, speed) @ speed) * step
    return given


def test_e9_a_damper_with_the_printed_sign_feeds_the_device():
    stiffness, damping, proxy = 500.0, 2.0, np.zeros(3)
    expected = damping * (2 * pi * 1e-3) ** 2
    printed = energy_from_a_cycle(lambda p, v: stiffness * (proxy - p) + damping * v)
    assert printed == pytest.approx(expected, rel=1e-3)
    ours = ProxyRenderer(stiffness, damping)
    assert energy_from_a_cycle(
        lambda p, v: ours.render(p, v, proxy, np.zeros(3), TICK)
    ) == pytest.approx(-expected, rel=1e-3)


@pytest.mark.parametrize("rate_Hz", [1000.0, 2000.0, 5000.0])
def test_e10_positive_gains_at_1_khz_are_not_enough(rate_Hz):
    """Positive gains at 1 kHz or more do not make a loop passive.

    With k, b > 0 it is "passive" as printed, yet it grows; more virtual damping makes it worse.
    """
    tick = 1.0 / rate_Hz
    device = {"mass_kg": 0.045, "damping_N_s_m": 0.35, "tick_s": tick}
    stiff = WallLoop(**device, stiffness_N_m=1.05 * 2.0 * 0.35 / tick)
    damped = WallLoop(**device, stiffness_N_m=100.0, wall_damping_N_s_m=2.2 * 0.045 / tick)
    for printed in (stiff, damped):
        assert printed.stiffness_N_m > 0.0 and printed.wall_damping_N_s_m >= 0.0
        assert spectral_radius(printed) > 1.0
        assert growth_while_running([printed], np.array([printed.stiffness_N_m]))[0] > 1.0
    ours = stiff.with_stiffness(passive_bound_N_m(stiff))
    hands = [(0.0, 0.0, 0.0), (3000.0, 0.0, 0.0), (300.0, 4.0, 0.1), (1e5, 0.01, 2.0)]
    assert all(spectral_radius(each) < 1.0 for each in in_hands(ours, hands))


def test_a_controller_without_bound_would_itself_ring():
    """Sampled damping beyond m / T is unstable: the controller's bound keeps it below."""
    mass = 0.045
    beyond = WallLoop(
        mass_kg=mass, damping_N_s_m=0.0, stiffness_N_m=1.0, wall_damping_N_s_m=2.1 * mass / TICK
    )
    assert spectral_radius(beyond) > 1.0
    control, limit = PassivityControl(0.5 * mass / TICK), 0.5 * mass / TICK
    control.step(np.zeros(3), np.zeros(3), np.zeros(3), TICK)
    played = control.step(
        np.array([0.0, 0.0, 3.0]), np.array([0.0, 0.0, 1e-5]), np.array([0.0, 0.0, 1e-2]), TICK
    )
    assert control.damping_N_s_m == limit and played[2] == pytest.approx(3.0 - limit * 1e-2)
    # a fast device without energy in store: no push, and the damping within its bound
    for speed in (0.1, 1.0):
        control = PassivityControl(0.5 * mass / TICK)
        control.step(np.zeros(3), np.zeros(3), np.zeros(3), TICK)
        at = np.array([0.0, 0.0, speed * TICK])
        played = control.step(np.array([0.0, 0.0, 3.0]), at, np.array([0.0, 0.0, speed]), TICK)
        assert -limit * speed - 1e-12 <= played[2] <= 1e-12
