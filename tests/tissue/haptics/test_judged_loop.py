"""Loop by which a scene's coupling is judged.

The tests cover its inputs, refused couplings, and the nearest accepted one.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from hand_runs import played_N, run_of

from tissue import InputError, load_scene
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters, waypoints
from tissue.haptics.loop.critical_stiffness import judge
from tissue.haptics.loop.filters import LowPass
from tissue.haptics.proxy.held_tool import HeldTurn
from tissue.motion.quaternion import conjugate, exponential, logarithm, product
from tissue.simulation.builders.loop import judged_loop, loop_settings

STEP_S = 1e-3


def test_an_unstable_stiffness_is_refused_with_margin_and_the_nearest_stable_one():
    with pytest.raises(InputError, match="must be below") as refused:
        run_of("wall", coupling__stiffness_N_m=3000.0)
    sentence = str(refused.value)
    assert (
        sentence.startswith("coupling.stiffness_N_m must be below 20")
        and "got 3000 (stability margin -4" in sentence
    )
    nearest = float(sentence.split(". Use ")[1].split(",")[0])
    assert run_of("wall", coupling__stiffness_N_m=nearest, duration_s=0.01).trace["margin"][0] > 0.0


def test_an_unstable_stiffness_that_is_allowed_runs_and_is_bounded():
    run = run_of(
        "wall",
        coupling__stiffness_N_m=2e4,
        coupling__force_scale=1.0,
        allow_unstable=True,
        duration_s=1.0,
    )
    assert run.trace["margin"][0] < 0.0 and "unstable" in run.parts.notes["coupling"]
    assert np.isfinite(run.trace.rows).all()
    assert played_N(run).max() <= device_parameters("touch").force_limit_N
    assert run.trace["saturated"].any()


def test_a_coupling_that_is_stable_only_in_a_hand_is_noted():
    run = run_of("wall", duration_s=0.01)
    note = run.parts.notes["coupling"]
    assert "N/m is stable, " in note
    stated = re.search(r"(\S+) N/m is stable, (\S+) % below the critical value of (\S+) N/m", note)
    chosen, below, critical = map(float, stated.groups())
    assert below == pytest.approx(100.0 * (1.0 - chosen / critical), abs=0.1)
    assert note.endswith("Only friction (or renderer = passivity) can stop the oscillation")
    assert note.split(". ")[-3].startswith("If the hand lets go while the tissue holds the tool")
    soft = run_of("wall", coupling__stiffness_N_m=10.0, duration_s=0.01)
    assert "lets go" not in soft.parts.notes["coupling"]


def test_what_is_judged_counts_the_delay_that_is_there():
    """Latency, the low-pass, and a tick for an organ whose balance is found a tick later."""
    wall, late = (
        judged_loop(loop_settings(load_scene("wall", o))) for o in ({}, {"coupling.delay_ms": 3})
    )
    liver = judged_loop(loop_settings(load_scene("liver-press", {"device": "touch"})))
    bone = judged_loop(loop_settings(load_scene("milling", {"device": "touch"})))
    assert late.delay_s == pytest.approx(wall.delay_s + 3e-3)
    assert liver.delay_s == pytest.approx(wall.delay_s + 1e-3)
    assert bone.delay_s == wall.delay_s and bone.filter_s == 1e-3
    assert judge(late).critical_N_m < judge(wall).critical_N_m


@pytest.mark.parametrize(("share", "settles"), [(0.95, True), (1.05, False)])
def test_the_turning_loop_is_stable_up_to_the_stiffness_that_is_judged(share, settles):
    """The turning loop is stable up to the stiffness that is judged.

    A tissue holds the tool of a six-dof device fast in rotation, 5 % on either side of the critical
    value. A tool that is held fast does not move, so the spring answers the tick's own turn. A soft
    tissue answers a tick later, which the judge of a scene includes.
    """
    limits = replace(
        device_parameters("six-dof"), friction_Nm=0.0, encoder_step_rad=0.0, torque_limit_Nm=1e3
    )
    still = dict.fromkeys(("endpoint_noise", "force_noise", "tremor_m", "reflex_share"), 0.0)
    person = replace(hand_parameters("expert"), **still)
    loop = limits.turning_loop(1.0, filter_s=1e-3)
    stiffness = share * judge(loop, [person.grip[3:]]).critical_N_m
    tissue_Nm_rad = 1e3 * stiffness
    nudge = lambda time_s: np.array(exponential((0.02 * (time_s > 0.1), 0.0, 0.0)))  # noqa: E731
    still_there = waypoints(np.array([0.0, 1.0]), np.zeros((2, 3)))
    hand = Hand(person, still_there, rng=np.random.default_rng(0), turn=nudge)
    device, tool = SimulatedDevice(limits, hand), HeldTurn(stiffness)
    low_pass, torques, torque = LowPass(1e-3, step_s=STEP_S), [], np.zeros(3)
    for index in range(2000):
        at = device.read(index * STEP_S).quaternion
        held_by = tool.follow(at, torque)
        torque = -tissue_Nm_rad * np.array(logarithm(held_by)) + 1e-12
        played = low_pass.step(stiffness * np.array(logarithm(product(held_by, conjugate(at)))))
        device.command(np.zeros(3), played)
        torques.append(played[0])
    ripple = [np.std(torques[first : first + 300]) for first in (700, 1600)]
    assert ripple[1] < 0.7 * ripple[0] if settles else ripple[1] > 1.4 * ripple[0]
