"""Loop of a device that presses an organ of a stiffening law, at its limit of stability.

The tool balances the spring of the coupling and the tissue. The loop therefore has the stiffness of
both in series, with the tangent of the law at the depth of the tool. A coupling is judged on a wall
that does not yield, which no tangent exceeds.
"""

from dataclasses import replace

import numpy as np
import pytest
from kicked_loop import growth_per_s
from pressed_block import STEP_S, TOP_M, Pressed, law_of

from tissue import load_scene
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, in_hands
from tissue.haptics.loop.filters import LowPass
from tissue.haptics.proxy.held_tool import PressingTool
from tissue.models.organ.probe import SphereProbe
from tissue.motion.quaternion import UPRIGHT
from tissue.simulation.builders.loop import judged_loop, loop_settings

DEPTH_M = 3e-3
FORCE_N = 2.0
"""Depth of the tool and force at the device at which the loop is nudged."""
RATIO = 8.0
"""Tangent stiffness of the tissue, as it is felt, over the critical stiffness of the loop."""
BLOCK = {
    "probe": SphereProbe(6e-3),
    "law": law_of("exponential", 0.3, rate=15.0),
    "poisson_ratio": 0.3,
    "prony": None,
    "width_m": 0.04,
    "across": 6,
}


class Late:
    """Stand-in for a thread. Each solve is done after a number of ticks."""

    def __init__(self, ticks):
        self.ticks = ticks

    def submit(self, function, *arguments):
        return Done(function(*arguments), self.ticks)

    def shutdown(self):
        """Do nothing."""


class Done:
    """Solve that is reported as done after a number of ticks."""

    def __init__(self, found, ticks):
        self.found = found
        self.ticks = ticks

    def done(self):
        self.ticks -= 1
        return self.ticks <= 0

    def result(self):
        return self.found


@pytest.fixture(scope="module")
def tangent():
    """Force [N] and tangent stiffness [N/m] at the depth, at rest."""
    block = Pressed(**BLOCK, interval_s=0.0)
    forces = []
    for depth_m in (1e-3, 2e-3, 0.99 * DEPTH_M, 1.01 * DEPTH_M):
        block.press(depth_m)
        block.model.converge(block.motion, limit=20)
        forces.append(block.model.respond(block.motion).wrench[2])
    force_N = 0.5 * (forces[2] + forces[3])
    slope_N_m = (forces[3] - forces[2]) / (0.02 * DEPTH_M)
    assert slope_N_m * DEPTH_M / force_N > 1.9, "a ball on linear tissue has 1.5"
    return force_N, slope_N_m


def growth(tangent, share, *, extra_s, late_ticks):
    """Return the growth of the ringing of a nudged loop [1/s].

    Its stiffness is a share of the critical stiffness, with a part of the judged loop's delay.
    """
    settings = loop_settings(load_scene("liver-press", {"device": "touch"}))
    still = dict.fromkeys(("endpoint_noise", "force_noise", "tremor_m", "reflex_share"), 0.0)
    person = replace(settings.person, **still)
    judged = judged_loop(settings)
    hand = person.grip[:3]
    critical = critical_stiffness_N_m(in_hands(judged, [hand])[0])
    exact = replace(judged, delay_s=judged.delay_s - STEP_S + extra_s)
    series = share * critical_stiffness_N_m(in_hands(exact, [hand])[0])
    coupling = series / (1.0 - series / (RATIO * critical))
    force_N, tangent_N_m = tangent
    force_scale = FORCE_N / force_N
    motion_scale = RATIO * critical / (force_scale * tangent_N_m)
    spring = coupling / (motion_scale * force_scale)
    block = Pressed(**BLOCK, interval_s=25e-3)
    model = block.model
    if late_ticks:
        model.waits = False
        model._law._thread = Late(late_ticks)
    start = block.motion.tip_m.copy()
    goal_m = (start[2] - TOP_M + DEPTH_M) / motion_scale + FORCE_N / coupling + FORCE_N / hand[0]

    def path(time_s):
        nudge_m = 2e-5 * (time_s > 1.2)
        return start - np.array([0.0, 0.0, goal_m * min(time_s / 0.8, 1.0) + nudge_m])

    limits = replace(settings.limits, friction_N=0.0, encoder_step_m=0.0)
    device = SimulatedDevice(
        limits, Hand(person, path, rng=np.random.default_rng(0)), position_m=tuple(start)
    )
    tool = PressingTool(spring, start)
    low_pass = LowPass(1e-3, step_s=STEP_S)
    response = model.respond(block.motion)
    played_N = np.zeros(2600)
    for tick in range(len(played_N)):
        time_s = tick * STEP_S
        wanted_m = start + motion_scale * (np.array(device.read(time_s).position_m) - start)
        model.wait_for_background(time_s)
        for _ in range(2):
            tip_m = tool.follow(wanted_m, UPRIGHT, np.zeros(6), response, STEP_S)
            block.motion.tip_m[:] = tip_m
            model.advance(block.motion)
            response = model.respond(block.motion)
            if not tool.has_entered(response):
                break
        force = low_pass.step(force_scale * spring * (tip_m - wanted_m))
        device.command(force, np.zeros(3))
        played_N[tick] = force[2]
    model.finish()
    assert played_N[1150] == pytest.approx(FORCE_N, rel=0.15)
    rate = growth_per_s(played_N, first=1250, top=0.1 * FORCE_N, smallest=1e-7)
    print(f"share {share:g}: {rate:.3f} 1/s")
    return rate


@pytest.mark.parametrize("late_ticks", [pytest.param(0, marks=pytest.mark.slow), 100])
def test_a_loop_within_the_judged_limit_fades(tangent, late_ticks):
    """The nudge fades by a factor of ten in 1.1 s, also where each solve of the law is 0.1 s late."""
    assert growth(tangent, 0.97, extra_s=STEP_S, late_ticks=late_ticks) < -2.1


@pytest.mark.parametrize(("share", "fades"), [(0.97, True), (1.06, False)])
@pytest.mark.slow
def test_the_limit_is_that_of_the_tangent_in_series(tangent, share, fades):
    """The judged loop has a tick of delay more than the balance of an undisturbed press needs.

    The limit of this loop is 1.03 of that of the tangent in series.
    """
    rate = growth(tangent, share, extra_s=0.0, late_ticks=0)
    assert rate < 0.0 if fades else rate > 0.0
