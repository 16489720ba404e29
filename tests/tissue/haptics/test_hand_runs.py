"""Runs of scenes by a hand on a device: balances in closed form, and bounded forces."""

import re

import numpy as np
import pytest
from hand_runs import played_N, run_of

from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.scene.load import load_scene
from tissue.scene.scene import Scene
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.builders.hand import hand_motion
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.simulate import tick_count


@pytest.fixture(scope="module")
def on_the_wall():
    return run_of("wall")


@pytest.mark.parametrize(
    ("device", "law"), [("touch", "penalty"), ("omni", "passivity"), ("six-dof", "proxy")]
)
def test_every_device_and_renderer_stays_within_its_limits(device, law):
    run, limits = (
        run_of("wall", device=device, renderer=law, duration_s=0.8),
        device_parameters(device),
    )
    assert 0.0 < played_N(run).max() <= limits.force_limit_N
    assert np.abs(run.trace.vectors("device_torque", "Nm")).max() <= limits.torque_limit_Nm
    assert run.trace["margin"][0] > 0.5


@pytest.mark.parametrize(
    ("law", "delay_ms", "most"),
    [("proxy", 0, 1e-3), ("passivity", 0, 3e-4), ("passivity", 4, 3e-4)],
)
def test_the_energy_of_the_trace_is_that_of_the_motors(law, delay_ms, most):
    """Also where the delay is made here; and the supervised wall gives next to nothing."""
    run = run_of(
        "wall",
        device="six-dof",
        renderer=law,
        coupling__delay_ms=delay_ms,
        coupling__force_scale=1.0,
    )
    energy = run.trace["passivity_J"]
    assert energy[-1] == pytest.approx(-run.parts.motion.device.translation.motor_work_J, abs=6e-5)
    assert -most < energy.min() < 0.0


def test_paths_and_forces_are_scaled_by_a_stated_law():
    """Paths and forces are scaled by a stated law.

    The hand moves 1 / m of the path; a tool of K is felt as m f K; the energy is that at the
    device.
    """
    run = run_of("wall", coupling__motion_scale=2.5, coupling__force_scale=0.4)
    trace = run.trace
    away = (
        1e-3 * (trace.vectors("tool", "mm") - [0, 0, 20]),
        1e-3 * (trace.vectors("device", "mm") - [0, 0, 20]),
    )
    free = trace["depth_mm"] == 0.0
    np.testing.assert_allclose(away[0][free], 2.5 * away[1][free], atol=1e-12)
    stretch = away[0][:, 2] / 2.5 - away[1][:, 2]
    np.testing.assert_allclose(trace["raw_force_z_N"], 400.0 * stretch, atol=1e-9)
    np.testing.assert_allclose(trace["raw_force_z_N"], 0.4 * trace["model_force_z_N"], atol=1e-9)
    moved = np.diff(trace.vectors("device", "mm"), axis=0)
    assert abs(trace["passivity_J"][-1]) < 1e-3 * played_N(run).max() * np.abs(moved).sum()
    assert (
        "2.5 m at the tool for each metre at the device; at the device, stiffness is 1 times and "
        "torque 0.16 times the value at the tool" in str(run.parts.notes["coupling"])
    )


def test_the_wall_s_hand_comes_as_deep_as_its_springs_let_it(on_the_wall):
    """The hand on the wall comes as deep as its springs allow.

    Grip (250 N/m and a fifth by reflex) acts against coupling and scaled wall in series: 5 mm x 300
    / (300 + 133) = 3.5 mm. Friction of 0.26 N stops it up to 0.4 mm before or behind that.
    """
    trace, person = on_the_wall.trace, hand_parameters("expert")
    grip, coupled = (
        (1.0 + person.reflex_share) * person.stiffness_N_m,
        1.0 / (1.0 / 400.0 + 1.0 / (chosen_scale(on_the_wall.scene).factor * 1e4)),
    )
    late = (trace["time_s"] > 0.75) & (trace["time_s"] < 1.05)
    assert -trace["device_z_mm"][late].mean() == pytest.approx(
        5.0 * grip / (grip + coupled), abs=0.4
    )


@pytest.mark.parametrize(
    ("hand", "added_s"), [("expert", 0.73), ("intermediate", 0.82), ("novice", 0.9)]
)
def test_a_stated_duration_beyond_the_motion_is_extended_as_the_keys_say(hand, added_s):
    scene = load_scene("wall", {"hand": hand})
    motion, _ = hand_motion(scene, motion_of(scene), allow_unstable=True)
    for stated_s, simulated_s in ((1.499, 1.499), (1.5, 1.5 + added_s), (2.2, 2.2 + added_s)):
        stated = scene.model_copy(update={"duration_s": stated_s})
        assert tick_count(stated, motion) == round(1e3 * simulated_s)
    assert f"{added_s:g} s ({hand})" in " ".join(
        Scene.model_json_schema()["properties"]["duration_s"]["description"].split()
    )


def test_a_thrust_beyond_the_force_of_the_device_is_noted():
    overrides = {"device": "touch", "coupling.force_scale": 0.2, "duration_s": 0.1}
    scene = load_scene("pedicle", overrides)
    note = hand_motion(scene, motion_of(scene), allow_unstable=True)[1]
    assert re.search(r"presses with [\d.]+ of motion.thrust_N = 30, .* lower coupling", note)
    scene = load_scene("pedicle", overrides | {"motion.thrust_N": 5.0})
    note = hand_motion(scene, motion_of(scene), allow_unstable=True)[1]
    assert "motion.thrust_N" not in note
