"""Runs of scenes by a hand on a device: balances in closed form, and bounded forces."""

import numpy as np
import pytest
from hand_runs import played_N, run_of
from hand_steps import STEP_S

from tissue import load_scene, simulate
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.hand.hand import hand_parameters
from tissue.simulation.builders.force_met import chosen_scale
from tissue.simulation.builders.loop import judged_loop, loop_settings


@pytest.fixture(scope="module")
def on_the_wall():
    return run_of("wall")


def test_on_the_wall_the_played_force_settles_and_is_bounded(on_the_wall):
    trace, force = on_the_wall.trace, played_N(on_the_wall)
    late = (trace["time_s"] > 0.6) & (trace["time_s"] < 1.0)
    assert 0.3 < force[late].mean() < 3.3
    # 1 ms of low-pass behind a force that a hand changes in tenths of a second: within a few per
    # cent.
    np.testing.assert_allclose(force[late], trace["model_force_z_N"][late], rtol=0.1)
    assert force.max() <= device_parameters("touch").force_limit_N
    assert trace["passivity_J"].min() > -1e-3
    assert not force[trace["time_s"] > 1.9].any()


def test_the_same_seed_gives_the_same_run_and_another_hand_or_seed_another(on_the_wall):
    once = on_the_wall.trace.rows[:800]
    np.testing.assert_array_equal(once, run_of("wall", duration_s=0.8).trace.rows)
    for changes in ({"hand": "novice"}, {"seed": 1}):
        assert not np.array_equal(once, run_of("wall", duration_s=0.8, **changes).trace.rows)


@pytest.mark.parametrize("device", ["touch", "omni", "six-dof"])
@pytest.mark.parametrize("law", ["penalty", "passivity", "proxy"])
def test_every_device_and_renderer_stays_within_its_limits(device, law):
    run, limits = (
        run_of("wall", device=device, renderer=law, duration_s=0.8),
        device_parameters(device),
    )
    assert 0.0 < played_N(run).max() <= limits.force_limit_N
    assert np.abs(run.trace.vectors("device_torque", "Nm")).max() <= limits.torque_limit_Nm
    assert run.trace["margin"][0] > 0.5


@pytest.mark.parametrize("delay_ms", [0, 4])
def test_the_energy_of_the_trace_is_that_of_the_motors(delay_ms):
    """Also where the delay is made here; and the supervised wall gives next to nothing."""
    for law, most in (("proxy", 1e-3), ("passivity", 3e-4)):
        run = run_of("wall", device="six-dof", renderer=law, coupling__delay_ms=delay_ms)
        energy = run.trace["passivity_J"]
        assert energy[-1] == pytest.approx(
            -run.parts.motion.device.translation.motor_work_J, abs=6e-5
        )
        assert -most < energy.min() < 0.0


def test_a_recorded_motion_by_a_hand_turns_with_it(tmp_path):
    path = tmp_path / "poses.csv"
    half = np.linspace(0.0, 0.2, 5)
    rows = [
        f"{t:g},0,0,20,0,0,{np.sin(h):.9f},{np.cos(h):.9f}"
        for t, h in zip(np.linspace(0, 0.8, 5), half, strict=True)
    ]
    path.write_text(
        "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw\n" + "\n".join(rows)
    )
    run = run_of("wall", motion__kind="replay", motion__file=str(path), duration_s=0.9)
    np.testing.assert_allclose(run.trace["tool_qz"][-1], np.sin(0.2), atol=1e-6)
    np.testing.assert_allclose(run.trace["tool_qz"][400], np.sin(0.1), atol=1e-3)


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
        "2.5 m at the tool for each metre at the device: a stiffness at the tool is felt as 1 of it"
        in str(run.parts.notes["coupling"])
    )


def test_a_run_of_the_whole_motion_waits_for_the_hand_and_a_short_one_does_not(on_the_wall):
    person = hand_parameters("expert")
    late = person.reaction_s + person.submovement_s + person.correction_s
    assert len(on_the_wall.trace.rows) == round(1e3 * (2.2 + late))
    assert len(run_of("wall", duration_s=0.3).trace.rows) == 300
    replayed = RecordedDevice(np.array([0.0, 2.2]), np.tile([0.0, 0.0, 0.02], (2, 1)))
    assert len(simulate(load_scene("wall"), device=replayed).trace.rows) == 2200


@pytest.mark.parametrize("device", ["touch", "six-dof"])
def test_a_tool_that_does_not_turn_feels_the_bone_and_cuts_nothing(device):
    deep = {
        "motion__points_mm": [[0, 0, 0.5], [0, 0, -8]],
        "motion__feed_mm_s": 5.0,
        "duration_s": 2.0,
    }
    run = run_of("glenoid", device=device, tool__spin_rpm=0.0, voxels__spacing_mm=0.4, **deep)
    trace, limits = run.trace, device_parameters(device)
    touching = trace["contacts"] > 0.0
    assert (
        touching.sum() > 500 and trace["removed_mm3"].max() == 0.0 and trace["behind"].mean() < 0.01
    )
    # nothing pops through the face
    assert trace["tool_z_mm"].min() > -0.5 and trace["device_z_mm"].min() < -1.2
    k = judged_loop(loop_settings(run.scene), step_s=STEP_S).stiffness_N_m
    stretch = 1e-3 * (trace.vectors("tool", "mm") - trace.vectors("device", "mm"))
    model = chosen_scale(run.scene)[0] * trace.vectors("model_force", "N")
    off = np.linalg.norm(k * stretch - model, axis=1)
    assert np.percentile(off, 99) < 2e-3 * np.linalg.norm(model, axis=1).max()
    assert 0.2 < played_N(run).max() <= limits.force_limit_N


def test_the_wall_s_hand_comes_as_deep_as_its_springs_let_it(on_the_wall):
    """The hand on the wall comes as deep as its springs allow.

    Grip (250 N/m and a fifth by reflex) acts against coupling and wall in series: 5 mm x 300 / (300
    + 385) = 2.2 mm. Friction of 0.26 N stops it up to 0.4 mm before or behind that.
    """
    trace, person = on_the_wall.trace, hand_parameters("expert")
    grip, coupled = (
        (1.0 + person.reflex_share) * person.stiffness_N_m,
        1.0 / (1.0 / 400.0 + 1.0 / 1e4),
    )
    late = (trace["time_s"] > 0.75) & (trace["time_s"] < 1.05)
    assert -trace["device_z_mm"][late].mean() == pytest.approx(
        5.0 * grip / (grip + coupled), abs=0.4
    )


@pytest.mark.slow
def test_a_device_on_rails_that_tracks_the_path_feels_the_scripted_force():
    """A device on rails that tracks the path feels the scripted force.

    It moves along the path plus the spring's stretch under the scripted force: 2 to 7 mm along a
    slot.
    """
    changes = {"duration_s": 1.6, "voxels.spacing_mm": 0.1}
    scripted = simulate(load_scene("milling", changes)).trace
    scene = load_scene("milling", changes | {"device": "touch"})
    spring = judged_loop(loop_settings(scene), step_s=STEP_S).stiffness_N_m / chosen_scale(scene)[0]
    tips, late = 1e-3 * scripted.vectors("tool", "mm"), slice(500, 1500)
    force = scripted.vectors("model_force", "N")
    steady = np.column_stack([np.convolve(part, np.full(20, 0.05), "same") for part in force.T])
    rails = RecordedDevice(1e-3 * np.arange(len(tips)), tips - steady / spring)
    felt = simulate(scene, device=rails).trace.vectors("raw_force", "N") / chosen_scale(scene)[0]
    expected = force[late].mean(axis=0)
    assert np.linalg.norm(expected[1:]) > 8.0 * abs(expected[0])  # it acts across the path
    np.testing.assert_allclose(
        felt[late].mean(axis=0), expected, atol=0.1 * np.linalg.norm(expected)
    )
