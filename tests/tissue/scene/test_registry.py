"""Every table of parts takes one from outside the package: a scene names it, runs with it, and messages list it."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from outside_tissue import CHANGES, ENTRY
from pydantic import Field

from tissue import InputError, Scene, load_scene, simulate
from tissue.cli.calibrate import calibrate
from tissue.cli.study import run
from tissue.cutters import cylinder
from tissue.evaluation.charts.frontier import frontier_of
from tissue.evaluation.charts.picture import draw_frontiers
from tissue.evaluation.charts.prediction import Interval, PredictorComparison, comparison_lines
from tissue.evaluation.charts.prediction_picture import draw_tasks
from tissue.evaluation.training.evaluation import HORIZONS
from tissue.models.needle.parameters import needle_tissue
from tissue.models.organ.probe import SphereProbe
from tissue.motion.motion import Motion
from tissue.scene.anatomy import Part
from tissue.scene.named_parts import Registry
from tissue.scene.registry import (
    ANATOMIES,
    CUTTERS,
    DEVICES,
    GROUPS,
    HANDS,
    MOTIONS,
    NEEDLES,
    PERCEPTIONS,
    PREDICTORS,
    PROBES,
    RENDERERS,
    CutterEntry,
    MotionEntry,
    PredictorEntry,
    ProbeEntry,
)
from tissue.simulation.run_folder import SavedRun
from tissue.system.offscreen import draw_apart
from tissue.viewer.run import faces_of


@pytest.fixture
def added():
    """Add a part to a table until the test ends."""
    places = []

    def add(table, name, part):
        table.add(name, part)
        places.append((table, name))

    yield add
    for table, name in places:
        table.remove(name)


def run_of(**changes):
    """A short run of a ball that a hand presses on a wall."""
    given = {"device": "touch", "duration_s": 0.6, "coupling.stiffness_N_m": 300.0}
    return simulate(load_scene("wall", given | {key.replace("__", "."): value for key, value in changes.items()}))


def force_N(run):
    """Force across the wall over time."""
    return np.abs(run.trace["device_force_z_N"])


def test_a_table_loads_lists_and_refuses():
    table = Registry("renderer", {"proxy": "tissue.haptics.renderer:proxy"})
    assert list(table) == ["proxy"] and len(table) == 1 and "proxy" in table and callable(table["proxy"])
    with pytest.raises(
        InputError, match=r"^renderer must be one of proxy, got prox \(did you mean proxy\?\): choose one"
    ):
        table["prox"]
    with pytest.raises(
        InputError, match=r"^name must be none of proxy, got proxy: choose another name for this renderer$"
    ):
        table.add("proxy", "elsewhere:proxy")
    table.remove("proxy")
    assert table.names == ()
    with pytest.raises(InputError, match=r"^renderer must be one of"):
        table.remove("proxy")


def test_a_device_from_outside_is_held(added):
    """One of 0.2 N and a third of the mass; it plays no torque, so that a stiffness of turns has no effect."""
    added(
        DEVICES, "feather", {"mass_kg": 0.03, "damping_N_s_m": 0.2, "force_limit_N": 0.2, "stiffness_limit_N_m": 400.0}
    )
    weak, strong = run_of(device="feather"), run_of(device="touch")
    assert 0.19 < force_N(weak).max() <= 0.2 and force_N(strong).max() > 0.5
    with pytest.raises(
        InputError, match=r"device must be one of none, touch, omni, six-dof, feather, got fether \(did"
    ):
        load_scene("wall", {"device": "fether"})
    with pytest.raises(
        InputError, match=r"stiffness_Nm_rad must be left out with a device that plays no torque, got 0.3"
    ):
        load_scene("wall", {"device": "feather", "coupling.stiffness_Nm_rad": 0.3})


def test_a_hand_from_outside_holds(added):
    added(HANDS, "limp", HANDS["expert"] | {"stiffness_N_m": 30.0})
    limp, firm = run_of(hand="limp"), run_of(hand="expert")
    assert force_N(limp).max() < 0.5 * force_N(firm).max()
    with pytest.raises(InputError, match=r"hand must be one of novice, intermediate, expert, limp, got lim \(did you"):
        load_scene("wall", {"hand": "lim"})


class Half:
    """A spring of half the stiffness that it was given."""

    def __init__(self, loop):
        self.stiffness_N_m = 0.5 * loop.stiffness_N_m

    def render(self, device, device_velocity, proxy, proxy_velocity, dt):
        return self.stiffness_N_m * (proxy - device)

    def pause(self):
        pass


def test_a_renderer_from_outside_plays(added):
    added(RENDERERS, "half", Half)
    soft, stiff = run_of(renderer="half"), run_of(renderer="penalty")
    assert force_N(soft).max() > 0.05
    assert not np.array_equal(force_N(soft), force_N(stiff))
    with pytest.raises(
        InputError, match=r"renderer must be one of penalty, passivity, proxy, half, got halv \(did you"
    ):
        load_scene("wall", {"renderer": "halv"})
    assert Scene.model_json_schema()["properties"]["renderer"]["enum"][-1] == "half"


class Third:
    """Expects a third of the last force at any time ahead."""

    residual_N, is_primary = 0.0, True

    def __init__(self):
        self.force_N = np.zeros(3)

    def observe(self, position_m, velocity_m_s, force_N):
        self.force_N = self.force_N if force_N is None else force_N.copy()

    def predict(self, ticks):
        return self.force_N / 3.0 if ticks else self.force_N

    def pause(self):
        pass


def test_a_predictor_from_outside_predicts_and_is_charted(added, tmp_path):
    added(PREDICTORS, "third", PredictorEntry(lambda trained, force_limit_N: Third(), colour="0.2", marker="h"))
    third, held = run_of(prediction="third"), run_of(prediction="hold")
    assert force_N(third).max() < 0.8 * force_N(held).max()
    with pytest.raises(
        InputError, match=r"prediction must be one of none, hold, .*, koopman, third, got thirt \(did you"
    ):
        load_scene("wall", {"prediction": "thirt"})
    with pytest.raises(
        InputError, match=r"coupling.predictor_file must be left out unless a trained prediction is used"
    ):
        load_scene("wall", {"prediction": "third", "coupling.predictor_file": "mine.npz"})
    errors = {kind: np.linspace(0.1, 0.2, 8)[:, None] * np.ones(len(HORIZONS)) for kind in PREDICTORS}
    costs, nothing = dict.fromkeys(PREDICTORS, (1.0, 2.0)), Interval(0.0, 0.0, 0.0)
    found = PredictorComparison("wall", errors, costs, np.array([1.0 + 0j]), {1: nothing}, {})
    assert any("third" in line for line in comparison_lines([found]))
    draw_tasks([found], tmp_path / "tasks.png")
    assert (tmp_path / "tasks.png").stat().st_size > 1000


class Share:
    """Makes felt so much of every force."""

    steepest, above, estimated_N, perceived, perceived_spread = 1.0, False, 0.0, 0.0, 0.0

    def __init__(self, argument, *, rng, force_limit_N, tick_s, friction_N):
        assert force_limit_N == pytest.approx(3.3) and tick_s == pytest.approx(1e-3)
        self.share, self.sentence = float(argument), f"felt by a share of {argument}"

    def step(self, force_N):
        return self.share * force_N

    def pause(self):
        pass


def test_a_perceptual_map_from_outside_scales(added):
    added(PERCEPTIONS, "share:NUMBER", Share)
    quarter, whole = run_of(perception="share:0.25"), run_of(perception="share:1")
    assert force_N(quarter).max() < 0.5 * force_N(whole).max()
    for refused in ("share:", "share", "shares:1"):
        with pytest.raises(
            InputError, match=r"^perception must be one of none, population, observer:FILE, share:NUMBER, got share"
        ):
            load_scene("wall", {"perception": refused})
    pattern = Scene.model_json_schema()["properties"]["perception"]["pattern"]
    assert pattern == "^(none|population|observer:.+|share:.+)$"


def test_a_cutter_from_outside_cuts(added):
    """A cylinder by another name, half as wide: it removes less than its namesake and reads a length."""
    half = lambda diameter_m, length_m: cylinder(diameter_m=0.5 * diameter_m, length_m=length_m)  # noqa: E731
    added(CUTTERS, "half-cylinder", CutterEntry(half, ("length_mm",)))
    changes = {"voxels.spacing_mm": 0.5, "duration_s": 1.0, "tool.length_mm": 5.0}
    changes |= {"tool.diameter_mm": 6.0, "tool.spin_rpm": 500.0}
    thin, thick = (
        simulate(load_scene("milling", changes | {"tool.kind": kind})) for kind in ("half-cylinder", "cylinder")
    )
    assert 0.0 < thin.trace["removed_mm3"][-1] < 0.7 * thick.trace["removed_mm3"][-1]
    assert Scene.model_validate(thin.scene.model_dump()).tool.kind == "half-cylinder"
    with pytest.raises(
        InputError, match=r"tool.kind must be one of ball-burr, .*, half-cylinder, .*, got half-cylindr \(did"
    ):
        load_scene("milling", {"tool.kind": "half-cylindr"})
    with pytest.raises(InputError, match=r"tool.point_angle_deg must be left out for a half-cylinder, got 90"):
        load_scene("milling", changes | {"tool.kind": "half-cylinder", "tool.point_angle_deg": 90.0})
    with pytest.raises(InputError, match=r"^tool.length_mm must be greater than 0 and at most 200, got -1"):
        load_scene("milling", changes | {"tool.kind": "half-cylinder", "tool.length_mm": -1.0})


SLAB = {
    "anatomy.kind": "slab",
    "anatomy.size_mm": [60.0, 60.0, 20.0],
    "anatomy.edge_mm": 10.0,
    "anatomy.nodule_diameter_mm": 0.0,
    "organ.order": 1,
    "organ.interval_ms": 0.0,
    "device": "none",
    "motion.points_mm": [[0, 0, 1], [0, 0, -2]],
    "duration_s": 0.15,
    "tool.diameter_mm": 20.0,
}


def test_a_probe_from_outside_presses(added):
    """A ball of twice the stated diameter is the ball of that diameter."""
    added(PROBES, "wide-ball", ProbeEntry(lambda tool: SphereProbe(1e-3 * tool.diameter_mm), ("diameter_mm",)))
    touch = {"anatomy.touch_edge_mm": 5.0, "motion.feed_mm_s": 20.0}
    wide, same, half = (
        simulate(load_scene("palpation", SLAB | touch | {"tool.kind": kind, "tool.diameter_mm": diameter_mm}))
        for kind, diameter_mm in (("wide-ball", 20.0), ("sphere-probe", 40.0), ("sphere-probe", 20.0))
    )
    assert wide.trace["model_force_z_N"].max() > 1.1 * half.trace["model_force_z_N"].max() > 0.01
    np.testing.assert_array_equal(wide.trace["model_force_z_N"], same.trace["model_force_z_N"])
    for changes, refusal in (
        (
            {"tool.kind": "wide-bal"},
            r"^tool.kind must be one of ball-burr, .*, wide-ball, needle, got wide-bal \(did",
        ),
        ({"tool.kind": "wide-ball", "tool.length_mm": 5.0}, r"^tool.length_mm must be left out for a wide-ball, got 5"),
        ({"tool.kind": "wide-ball", "tool.file": "a.stl"}, r"^tool.file must be left out for a wide-ball, got"),
    ):
        with pytest.raises(InputError, match=refusal):
            load_scene("palpation", SLAB | {"tool.diameter_mm": 20.0} | changes)


def test_a_needle_from_outside_pierces(added):
    """One that cuts twice as hard is held back more once it is in."""
    added(NEEDLES, "blunt", lambda vessel_wall_depth_m: replace(needle_tissue(), cutting_N=5.0))
    blunt, sharp = (
        simulate(load_scene("needle", {"tool.kind": kind, "anatomy.interval_ms": 0.0, "device": "none"}))
        for kind in ("blunt", "needle")
    )
    assert blunt.trace["model_force_z_N"].max() > 1.5 * sharp.trace["model_force_z_N"].max() > 0.5
    with pytest.raises(InputError, match=r"^tool.kind must be one of needle, blunt for a layers, got sphere-probe"):
        load_scene("needle", {"tool.kind": "sphere-probe"})


class Dip(Part):
    """Straight down at a speed, from 1 mm above."""

    kind: Literal["dip"] = "dip"
    speed_mm_s: float = Field(10.0, gt=0.0, le=100.0)


class Dipping(Motion):
    """A dip of 0.2 s."""

    duration_s = 0.2

    def __init__(self, dip, step_s):
        self.speed_m_s = 1e-3 * dip.speed_mm_s

    def sweep_m(self):
        return np.array([[0.0, 0.0, 1e-3], [0.0, 0.0, 1e-3 - self.duration_s * self.speed_m_s]])

    def rotations(self):
        return np.stack([np.eye(3)] * 2)

    def begin(self, motion):
        motion.tip_m[:], motion.rotation[:], motion.heading[0] = self.sweep_m()[0], np.eye(3), (0.0, 0.0, -1.0)

    def advance(self, time_s, step_s, response, motion):
        motion.tip_m[2], motion.speed_m_s = 1e-3 - self.speed_m_s * time_s, self.speed_m_s


def test_a_motion_from_outside_moves(added):
    added(MOTIONS, "dip", MotionEntry(Dip, Dipping))
    changes = {"device": "none", "motion.kind": "dip", "motion.speed_mm_s": 20.0, "duration_s": None}
    run = simulate(load_scene("wall", changes))
    assert len(run.trace["time_s"]) == 200 and Scene.model_validate(run.scene.model_dump()) == run.scene
    np.testing.assert_allclose(run.trace["tool_z_mm"], 1.0 - 20.0 * run.trace["time_s"], atol=1e-12)
    for key, value, refusal in (
        ("motion.kind", "dipp", r"^motion.kind must be one of path, thrust, replay, dip, got dipp \(did you mean dip"),
        ("motion.speed_mm_s", 0.0, r"^motion.speed_mm_s must be greater than 0 and at most 100, got 0"),
        ("motion.feed_mm_s", 1.0, r"^motion.feed_mm_s must be one of kind, speed_mm_s, got feed_mm_s"),
    ):
        with pytest.raises(InputError, match=refusal):
            load_scene("wall", changes | {key: value})


def test_a_tissue_from_outside_is_met(added):
    added(ANATOMIES, "jelly", ENTRY)
    changes = CHANGES
    run = simulate(load_scene("palpation", changes))
    force, depth = run.trace["model_force_z_N"], run.trace["depth_mm"]
    np.testing.assert_allclose(force, 0.1 * depth, atol=1e-12)
    assert depth[-1] > 1.0 and run.scene.force_scale == 0.5 and run.parts.notes["jelly"] == "it is soft"
    assert Scene.model_validate(run.scene.model_dump()) == run.scene
    for key, value, refusal in (
        (
            "anatomy.kind",
            "jely",
            r"^anatomy.kind must be one of glenoid, .*, wall, jelly, got jely \(did you mean jelly",
        ),
        ("anatomy.stiffness_N_m", 0.5, r"^anatomy.stiffness_N_m must be at least 1 and at most 10000, got 0.5"),
        ("anatomy.stiff", 2.0, r"^anatomy.stiff must be one of kind, stiffness_N_m, got stiff"),
        ("tool.kind", "needle", r"^tool.kind must be one of sphere-probe, .*, shell-probe for a jelly, got needle"),
    ):
        with pytest.raises(InputError, match=refusal):
            load_scene("palpation", changes | {key: value})


def test_a_tissue_from_outside_is_saved_drawn_viewed_and_charted(added, tmp_path, monkeypatch):
    from PIL import Image

    added(ANATOMIES, "jelly", ENTRY)
    scene = load_scene("palpation", CHANGES)
    run = simulate(scene)
    out = run.save(tmp_path / "run")
    if "pictures" in run.parts.notes:
        pytest.skip(run.parts.notes["pictures"])  # without OpenGL only the flat ones are there
    drawn = {path.name for path in (out / "pictures").iterdir()}
    assert drawn == {"force_torque.png", "press.png", "held.png", "jelly.png"}
    assert SavedRun(out).scene == scene and list(faces_of(scene)) == ["jelly"]
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2] / "fixtures"), prepend=":")
    assert draw_apart("outside_tissue", str(out), str(tmp_path / "view.png")) is None
    frontier = frontier_of(scene, quick=True)
    assert [point.setting for point in frontier.points] == ["as it is"] and frontier.points[0].force_error == 0.0
    draw_frontiers([frontier], tmp_path / "chart.png")
    for path in (tmp_path / "view.png", tmp_path / "chart.png", *(out / "pictures").iterdir()):
        with Image.open(path) as picture:
            assert len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3)[::37], axis=0)) > 20, path


def test_a_part_that_was_removed_is_refused():
    with pytest.raises(InputError, match="renderer must be one of penalty, passivity, proxy, got half: choose one of"):
        load_scene("wall", {"device": "touch", "renderer": "half"})


def test_the_page_and_the_help_texts_list_every_name():
    page = (Path(__file__).parents[3] / "docs" / "commands.md").read_text("utf-8")
    for table in (ANATOMIES, CUTTERS, PROBES, NEEDLES, MOTIONS, DEVICES, HANDS, PERCEPTIONS, PREDICTORS, RENDERERS):
        row = f"| `{table.key}` | {', '.join(f'`{name}`' for name in table)} |"
        assert row in page
    for name in (*DEVICES, *GROUPS):
        assert name in calibrate.__doc__
    for name in GROUPS:
        assert name in run.__doc__
