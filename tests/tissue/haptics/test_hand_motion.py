"""A scene by a hand on a device: balances in closed form, and the force within its bounds."""

from dataclasses import replace

import numpy as np
import pytest
from hand_runs import played_N, run_of

from meshes.base.progress import silent
from tissue import InputError, load_scene, simulate
from tissue.builders.hand import hand_motion
from tissue.builders.loop import judged_loop
from tissue.builders.registry import build, motion_of
from tissue.haptics import hand_measures as at
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.faulty import Fault, FaultyDevice
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters
from tissue.haptics.hand.minimum_jerk import waypoints
from tissue.haptics.hand_measures import MEASURES, PERCEIVED, PREDICTED
from tissue.haptics.hand_motion import HandMotion
from tissue.haptics.loop.critical_stiffness import judge
from tissue.haptics.proxy.held_tool import PressingTool
from tissue.haptics.renderer import renderer
from tissue.models.tissue_model import FreeSpace, Response, ToolMotion
from tissue.models.wall import WallModel
from tissue.motion.motion import FollowPath
from tissue.motion.quaternion import logarithm

STEP_S = 1e-3
DOWN, UP = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
COARSE_LIVER = {"organ.order": 1, "anatomy.edge_mm": 30.0, "anatomy.touch_edge_mm": 8.0}


def held(name="wall", **changes):
    """A scene's hand and device without its tissue."""
    scene = load_scene(name, {k.replace("__", "."): v for k, v in changes.items()})
    motion, _ = hand_motion(scene, motion_of(scene, step_s=STEP_S), step_s=STEP_S, allow_unstable=False)
    return motion


def meet(motion, tissue, seconds):
    """Tool tips [m], measures of the motion, and forces on the tool [N], a row a tick."""
    tool, response = ToolMotion(), Response.empty(1)
    motion.begin(tool)
    tissue.place(tool)
    rows = []
    for index in range(round(seconds / STEP_S)):
        motion.advance(index * STEP_S, STEP_S, response, tool)
        tissue.advance(tool)
        response = tissue.respond(tool)
        if motion.correct(response, tool):
            tissue.advance(tool)
            response = tissue.respond(tool)
        motion.play(response)
        rows.append((tool.tip_m.copy(), motion.measures.copy(), response.wrench[:3].copy()))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


@pytest.mark.parametrize(("name", "law"), [("wall", "proxy"), ("wall", "penalty"), ("milling", "passivity")])
def test_in_free_space_the_tool_is_where_the_device_is_and_nothing_is_played(name, law):
    tips, measures, _ = meet(held(name, device="touch", renderer=law), FreeSpace(), 1.0)
    np.testing.assert_array_equal(1e3 * tips, measures[:, :3])
    assert np.ptp(tips, axis=0).max() > 1e-3
    assert not measures[:, 7:17].any()


@pytest.fixture(scope="module")
def on_the_wall():
    return run_of("wall")


def test_on_the_wall_spring_and_wall_balance(on_the_wall):
    """k_c (z_tool - z_device) = k_w depth, from the first tick of a contact on."""
    trace, stiffness = on_the_wall.trace, judged_loop(on_the_wall.scene, step_s=STEP_S).stiffness_N_m
    settled = trace["depth_mm"] > 0.0
    assert settled.sum() > 500
    force, stretch = trace["model_force_z_N"], 1e-3 * (trace["tool_z_mm"] - trace["device_z_mm"])
    np.testing.assert_allclose(force[settled], 1e4 * -1e-3 * trace["tool_z_mm"][settled], rtol=1e-9)
    np.testing.assert_allclose(force[settled], stiffness * stretch[settled], rtol=1e-6, atol=1e-9)


def test_on_the_wall_the_played_force_settles_and_is_bounded(on_the_wall):
    trace, force = on_the_wall.trace, played_N(on_the_wall)
    late = (trace["time_s"] > 0.6) & (trace["time_s"] < 1.0)
    assert 0.3 < force[late].mean() < 3.3
    # 1 ms of low-pass behind a force that a hand changes in tenths of a second: within a few per cent.
    np.testing.assert_allclose(force[late], trace["model_force_z_N"][late], rtol=0.1)
    assert force.max() <= device_parameters("touch").force_limit_N
    assert trace["passivity_J"].min() > -1e-3
    assert not force[trace["time_s"] > 1.9].any()


def test_a_scene_without_a_device_has_no_trace_of_one():
    plain = run_of("wall", device="none", duration_s=0.3)
    assert not set(MEASURES) & set(plain.trace.columns)
    with pytest.raises(InputError, match=r"coupling\.delay_ms and hand and renderer must be left out without a device"):
        run_of("wall", device="none", duration_s=0.3, hand="novice", renderer="penalty", coupling__delay_ms=5)
    assert plain.trace["model_force_z_N"][250] == pytest.approx(1e4 * 5e-3, rel=1e-9)


def test_the_same_seed_gives_the_same_run_and_another_hand_or_seed_another(on_the_wall):
    once = on_the_wall.trace.rows[:800]
    np.testing.assert_array_equal(once, run_of("wall", duration_s=0.8).trace.rows)
    for changes in ({"hand": "novice"}, {"seed": 1}):
        assert not np.array_equal(once, run_of("wall", duration_s=0.8, **changes).trace.rows)


@pytest.mark.parametrize("device", ["touch", "omni", "six-dof"])
@pytest.mark.parametrize("law", ["penalty", "passivity", "proxy"])
def test_every_device_and_renderer_stays_within_its_limits(device, law):
    run, limits = run_of("wall", device=device, renderer=law, duration_s=0.8), device_parameters(device)
    assert 0.0 < played_N(run).max() <= limits.force_limit_N
    assert np.abs(run.trace.vectors("device_torque", "Nm")).max() <= limits.torque_limit_Nm
    assert run.trace["margin"][0] > 0.5


@pytest.mark.parametrize(("share", "settles"), [(0.95, True), (1.05, False)])
def test_the_whole_loop_is_stable_up_to_the_stiffness_that_is_judged(share, settles):
    """Device, tool on the wall, renderer, low-pass, delay: 5 % on either side of the eigenvalues' critical stiffness.

    Without what the judge leaves out: friction, encoders, noise and reflex. Coupling and wall are springs in series.
    """
    limits = replace(device_parameters("touch"), friction_N=0.0, encoder_step_m=0.0)
    still = dict.fromkeys(("endpoint_noise", "force_noise", "tremor_m", "reflex_share"), 0.0)
    person, wall = replace(hand_parameters("expert"), **still), 2e4
    critical = judge(limits.loop(1.0, filter_s=1e-3), [person.grip[:3]]).critical_N_m
    stiffness = 1.0 / (1.0 / (share * critical) - 1.0 / wall)
    line = np.array([[0.0, 0.0, 1e-3], [0.0, 0.0, -5e-3]])
    hand = Hand(person, waypoints(np.array([0.0, 0.1]), line), rng=np.random.default_rng(0))
    loop = limits.loop(stiffness, filter_s=1e-3)
    motion = HandMotion(
        SimulatedDevice(limits, hand, position_m=(0.0, 0.0, 1e-3)),
        PressingTool(stiffness, line[0]),
        renderer("proxy", loop),
        scripted=FollowPath(line, feed_m_s=0.06, axis=(0.0, 0.0, 1.0)),
        limits=limits,
        loop=loop,
        margin=1.0 - share,
    )
    _, measures, _ = meet(motion, WallModel(wall, radius_m=5e-3), 2.0)
    ripple = [np.std(measures[first : first + 200, 9]) for first in (1000, 1800)]
    assert ripple[1] < 0.7 * ripple[0] if settles else ripple[1] > 1.4 * ripple[0]


def test_samples_that_are_no_numbers_end_in_no_force():
    motion = held()
    motion.device = FaultyDevice(motion.device, [Fault("non-finite", 0.7, 5.0)])
    tips, measures, forces = meet(motion, WallModel(1e4, radius_m=5e-3), 1.0)
    assert np.isfinite(tips).all() and np.isfinite(forces).all()
    played = np.linalg.norm(measures[:, 7:10], axis=1)
    assert played[699] > 0.3 and not played[725:].any()
    assert (np.diff(played[699:725]) <= 1e-12).all()
    assert (tips[725:] == tips[700]).all()
    assert [what for _, what in motion.happened()] == ["a sample that is not finite: the force fades"]


def test_a_delay_holds_the_force_back_by_whole_ticks():
    tips, measures, _ = meet(held(coupling__delay_ms=7, output__low_pass_ms=0.0), WallModel(1e4, radius_m=5e-3), 0.8)
    stretch, filtered = 1e3 * tips[:, 2] - measures[:, 2], measures[:, 15]
    touched, answered = np.flatnonzero(stretch > 0.0)[0], np.flatnonzero(filtered)[0]
    assert answered == touched + 7


@pytest.mark.parametrize("changes", [{}, {"motion__kind": "thrust", "motion__thrust_N": 60.0}], ids=["path", "thrust"])
def test_a_hand_reams_a_glenoid_within_the_device_s_range(changes):
    run = run_of("glenoid", device="touch", voxels__spacing_mm=0.4, duration_s=4.0, **changes)
    assert run.summary()["removed_mm3"]["subchondral"] > 10.0
    force, model = played_N(run), np.linalg.norm(run.trace.vectors("model_force", "N"), axis=1)
    assert 0.3 < force.max() <= device_parameters("touch").force_limit_N
    # What the device plays is the tissue's force by the scene's scale, the force across the pull left out.
    late = run.trace["time_s"] > 3.5
    np.testing.assert_allclose(force[late].mean(), 0.03 * model[late].mean(), rtol=0.1)


def test_a_hand_presses_a_liver():
    run = run_of(
        "liver-press", device="touch", duration_s=1.6, **{k.replace(".", "__"): v for k, v in COARSE_LIVER.items()}
    )
    trace = run.trace
    late = (trace["time_s"] > 0.9) & (trace["time_s"] < 1.4)
    force = trace["device_force_z_N"][late]
    assert 0.1 < force.mean() < 1.0
    np.testing.assert_allclose(force, trace["model_force_z_N"][late], atol=0.05 * force.mean())


@pytest.mark.parametrize("delay_ms", [0, 4])
def test_the_energy_of_the_trace_is_that_of_the_motors(delay_ms):
    """Also where the delay is made here; and the supervised wall gives next to nothing."""
    for law, most in (("proxy", 1e-3), ("passivity", 3e-4)):
        run = run_of("wall", device="six-dof", renderer=law, coupling__delay_ms=delay_ms)
        energy = run.trace["passivity_J"]
        assert energy[-1] == pytest.approx(-run.parts.motion.device.translation.motor_work_J, abs=6e-5)
        assert -most < energy.min() < 0.0


def test_a_recorded_motion_by_a_hand_turns_with_it(tmp_path):
    path = tmp_path / "poses.csv"
    half = np.linspace(0.0, 0.2, 5)
    rows = [
        f"{t:g},0,0,20,0,0,{np.sin(h):.9f},{np.cos(h):.9f}" for t, h in zip(np.linspace(0, 0.8, 5), half, strict=True)
    ]
    path.write_text("time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw\n" + "\n".join(rows))
    run = run_of("wall", motion__kind="replay", motion__file=str(path), duration_s=0.9)
    np.testing.assert_allclose(run.trace["tool_qz"][-1], np.sin(0.2), atol=1e-6)
    np.testing.assert_allclose(run.trace["tool_qz"][400], np.sin(0.1), atol=1e-3)


def test_a_wall_is_for_a_ball_outside_it():
    with pytest.raises(InputError, match=r"tool\.kind must be sphere-probe for a wall"):
        load_scene("wall", {"tool.kind": "cylinder-probe"})
    scene = load_scene("wall", {"device": "none", "motion.points_mm": [[0, 0, -1], [0, 0, 5]]})
    parts = build(scene, step_s=STEP_S, compute="cpu", cores=None, report=silent)
    tool = ToolMotion()
    parts.motion.begin(tool)
    with pytest.raises(InputError, match="motion must start outside the wall, got a ball 1 mm inside"):
        parts.tissue.place(tool)


@pytest.mark.parametrize("speed_m_s", [0.1, 0.2, 0.5])
@pytest.mark.parametrize("wall_N_m", [1e3, 1e4, 4e4])
def test_the_first_contact_is_answered_in_its_tick_and_without_a_spike(speed_m_s, wall_N_m):
    """Spring and wall in series from the first tick on: F = depth of the device / (1 / k_c + 1 / k_w)."""
    motion = held(motion__feed_mm_s=1e3 * speed_m_s)
    times = np.array([0.0, 0.3])
    down = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.02 - 0.3 * speed_m_s]])
    motion.device = RecordedDevice(times, down)
    _, measures, forces = meet(motion, WallModel(wall_N_m, radius_m=5e-3), 0.3)
    depth = np.maximum(-1e-3 * measures[:, 2], 0.0)
    assert (depth > 0.0).sum() > 50
    np.testing.assert_allclose(forces[:, 2], depth / (1.0 / 400.0 + 1.0 / wall_N_m), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(measures[:, 21], forces[:, 2], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("speed_m_s", [0.05, 0.2])
def test_a_cutter_that_meets_bone_is_slowed_in_the_same_tick(speed_m_s):
    """A cut that would take v c at the device's speed takes what the spring pulls, and no more, from its first tick."""
    drag, edge, stiffness = 2e4, 5.0, 400.0 / 0.03

    class Cut(FreeSpace):
        """Resists below z = 0."""

        def respond(self, motion):
            deep, speed = motion.tip_m[2] < 0.0, motion.speed_m_s
            self._response.resistance[:3], self._response.edge[:3] = deep * drag * UP, deep * edge * UP
            self._response.wrench[2] = deep * (drag * speed + edge * (1.0 if speed > 0.0 else motion.pressed))
            return self._response

    motion = held("glenoid", device="touch")
    motion.device = RecordedDevice(np.array([0.0, 0.1]), np.array([[0, 0, 1e-3], [0, 0, 1e-3 - 0.1 * speed_m_s]]))
    tips, measures, forces = meet(motion, Cut(), 0.1)
    stretch = tips[:, 2] - 1e-3 * measures[:, 2]
    assert drag * speed_m_s > 500.0 and stretch.max() > 1e-3
    np.testing.assert_allclose(forces[:, 2], stiffness * stretch, rtol=0.02, atol=2e-3)


def test_torque_turns_the_tool_until_the_spring_balances_it_and_is_played():
    """A ball rolled aside of its tip on the wall: arm x F of the wall = k_r theta, at the device scaled by f / m."""
    tilt, scale, motion_factor = 0.3, 0.5, 2.0
    changes = {
        "coupling__stiffness_Nm_rad": 0.2,
        "coupling__force_scale": scale,
        "coupling__motion_scale": motion_factor,
    }
    motion = held(device="six-dof", motion__axis=[np.sin(tilt), 0, np.cos(tilt)], **changes)
    motion.device = RecordedDevice(np.array([0.0, 0.5, 1.5]), np.array([[0, 0, 20e-3], [0, 0, 7e-3], [0, 0, 7e-3]]))
    tool, response, wall = ToolMotion(), Response.empty(1), WallModel(1e4, radius_m=5e-3)
    motion.begin(tool)
    for index in range(1500):
        motion.advance(index * STEP_S, STEP_S, response, tool)
        response = wall.respond(tool)
        if motion.correct(response, tool):
            response = wall.respond(tool)
        motion.play(response)
    theta = np.array(logarithm(motion.tool.quaternion))
    assert abs(response.wrench[4]) > 5e-3
    np.testing.assert_allclose(0.2 * theta, scale / motion_factor * response.wrench[3:], rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(
        motion.measures[10:13], scale / motion_factor * response.wrench[3:], rtol=1e-2, atol=1e-9
    )
    np.testing.assert_allclose(motion.measures[7:10], scale * response.wrench[:3], rtol=1e-3, atol=1e-9)


def test_paths_and_forces_are_scaled_by_a_stated_law():
    """The hand goes 1 / m of the path; a tool of K is felt as m f K; the energy is that at the device."""
    run = run_of("wall", coupling__motion_scale=2.5, coupling__force_scale=0.4)
    trace = run.trace
    away = 1e-3 * (trace.vectors("tool", "mm") - [0, 0, 20]), 1e-3 * (trace.vectors("device", "mm") - [0, 0, 20])
    free = trace["depth_mm"] == 0.0
    np.testing.assert_allclose(away[0][free], 2.5 * away[1][free], atol=1e-12)
    stretch = away[0][:, 2] / 2.5 - away[1][:, 2]
    np.testing.assert_allclose(trace["raw_force_z_N"], 400.0 * stretch, atol=1e-9)
    np.testing.assert_allclose(trace["raw_force_z_N"], 0.4 * trace["model_force_z_N"], atol=1e-9)
    moved = np.diff(trace.vectors("device", "mm"), axis=0)
    assert abs(trace["passivity_J"][-1]) < 1e-3 * played_N(run).max() * np.abs(moved).sum()
    assert "2.5 m at the tool for each metre at the device: a stiffness at the tool is felt as 1 of it" in str(
        run.parts.notes["coupling"]
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
    deep = {"motion__points_mm": [[0, 0, 0.5], [0, 0, -8]], "motion__feed_mm_s": 5.0, "duration_s": 2.0}
    run = run_of("glenoid", device=device, tool__spin_rpm=0.0, voxels__spacing_mm=0.4, **deep)
    trace, limits = run.trace, device_parameters(device)
    touching = trace["contacts"] > 0.0
    assert touching.sum() > 500 and trace["removed_mm3"].max() == 0.0 and trace["behind"].mean() < 0.01
    assert trace["tool_z_mm"].min() > -0.5 and trace["device_z_mm"].min() < -1.2  # nothing pops through the face
    k = judged_loop(run.scene, step_s=STEP_S).stiffness_N_m
    stretch = 1e-3 * (trace.vectors("tool", "mm") - trace.vectors("device", "mm"))
    model = 0.03 * trace.vectors("model_force", "N")
    off = np.linalg.norm(k * stretch - model, axis=1)
    assert np.percentile(off, 99) < 2e-3 * np.linalg.norm(model, axis=1).max()
    assert 0.2 < played_N(run).max() <= limits.force_limit_N


def test_what_a_controller_adds_is_not_extrapolated():
    """Its one-tick pulses passed through a predictor were spikes of 0.9 N; what is left is a force that is let go of."""
    late = {"coupling__delay_ms": 4, "prediction": "koopman"}
    supervised, bare = run_of("wall", renderer="passivity", **late), run_of("wall", renderer="proxy", **late)
    steps = [np.abs(np.diff(run.trace.vectors("device_force", "N"), axis=0)).max() for run in (supervised, bare)]
    assert steps[0] < 0.2 and steps[1] < 0.1
    assert "6 ms ahead" in bare.parts.notes["prediction"]


def test_the_wall_s_hand_comes_as_deep_as_its_springs_let_it(on_the_wall):
    """Grip (250 N/m and a fifth by reflex) against coupling and wall in series: 5 mm x 300 / (300 + 385) = 2.2 mm.

    Friction of 0.26 N stops it up to 0.4 mm before or behind that.
    """
    trace, person = on_the_wall.trace, hand_parameters("expert")
    grip, coupled = (1.0 + person.reflex_share) * person.stiffness_N_m, 1.0 / (1.0 / 400.0 + 1.0 / 1e4)
    late = (trace["time_s"] > 0.75) & (trace["time_s"] < 1.05)
    assert -trace["device_z_mm"][late].mean() == pytest.approx(5.0 * grip / (grip + coupled), abs=0.4)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("glenoid", {"voxels__spacing_mm": 0.4, "duration_s": 3.5}),
        ("liver-press", {**{k.replace(".", "__"): v for k, v in COARSE_LIVER.items()}, "motion__axis": [0.3, 0, 1]}),
    ],
)
def test_a_device_that_plays_torque_is_given_that_of_its_spring(name, changes):
    """The spring of rotation balances the tissue's torque, which is played by the scene's scale: within 10 % late on."""
    run = run_of(name, device="six-dof", **{"duration_s": 1.2, **changes})
    trace, scale = run.trace, run.scene.force_scale
    late = slice(-300, None)
    played = trace.vectors("device_torque", "Nm")[late].mean(axis=0)
    tissue = scale * trace.vectors("model_torque", "Nm")[late].mean(axis=0)
    assert np.linalg.norm(tissue) > 2e-4
    np.testing.assert_allclose(played, tissue, atol=0.1 * np.linalg.norm(tissue))
    turned = trace["device_qz"] - trace["tool_qz"] if name == "glenoid" else trace["device_qy"] - trace["tool_qy"]
    assert np.abs(turned[late]).max() > 1e-4


def test_every_measure_lies_at_its_place():
    columns = MEASURES + PREDICTED + PERCEIVED
    for place, start in (
        (at.POSITION, "device_x_mm"), (at.QUATERNION, "device_qx"), (at.PLAYED_FORCE, "device_force_x_N"),
        (at.PLAYED_TORQUE, "device_torque_x_Nm"), (at.FILTERED_FORCE, "filtered_force_x_N"), (at.RAW_FORCE, "raw_force_x_N"),
        (at.PREDICTED_FORCE, "predicted_force_x_N"),
    ):  # fmt: skip
        assert columns[place][0] == start and len({name.split("_")[0] for name in columns[place]}) == 1
    single = {
        at.SATURATED: "saturated",
        at.ENERGY: "passivity_J",
        at.MARGIN: "margin",
        at.RESIDUAL: PREDICTED[3],
        at.PREDICTED_BY: PREDICTED[4],
    }
    assert all(columns[place] == name for place, name in single.items()) and columns[at.PERCEPTION] == PERCEIVED
