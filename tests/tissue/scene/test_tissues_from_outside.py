"""Tables of parts that accept tools, motions and tissues from outside.

A scene names one and runs with it.
"""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from outside_tissue import CHANGES, ENTRY
from pydantic import Field

from tissue import InputError, Scene, load_scene, simulate
from tissue.cutters.profile import cylinder
from tissue.evaluation.charts.frontier import frontier_of
from tissue.evaluation.charts.pictures import draw_frontiers
from tissue.models.needle.parameters import needle_tissue
from tissue.models.organ.probe import SphereProbe
from tissue.motion.motion import Motion
from tissue.scene.anatomy import Part
from tissue.scene.registry import (
    ANATOMIES,
    CUTTERS,
    MOTIONS,
    NEEDLES,
    PROBES,
    CutterEntry,
    MotionEntry,
    ProbeEntry,
)
from tissue.show.figures.tool_mesh import faces_of
from tissue.simulation.builders.force_met import chosen_scale
from tissue.simulation.run_folder import SavedRun
from tissue.system.offscreen import draw_apart


def test_a_cutter_from_outside_cuts(added):
    """A cutter from outside cuts.

    It is a cylinder by another name, half as wide: it removes less than its namesake and reads a
    length.
    """
    half = lambda diameter_m, length_m: cylinder(diameter_m=0.5 * diameter_m, length_m=length_m)  # noqa: E731
    added(CUTTERS, "half-cylinder", CutterEntry(half, ("length_mm",)))
    changes = {"voxels.spacing_mm": 0.5, "duration_s": 1.0, "tool.length_mm": 5.0}
    changes |= {"tool.diameter_mm": 6.0, "tool.spin_rpm": 500.0}
    thin, thick = (
        simulate(load_scene("milling", changes | {"tool.kind": kind}))
        for kind in ("half-cylinder", "cylinder")
    )
    assert 0.0 < thin.trace["removed_mm3"][-1] < 0.7 * thick.trace["removed_mm3"][-1]
    assert Scene.model_validate(thin.scene.model_dump()).tool.kind == "half-cylinder"
    with pytest.raises(
        InputError,
        match=r"tool.kind must be one of ball-burr, .*, half-cylinder, .*, got half-cylindr \(did",
    ):
        load_scene("milling", {"tool.kind": "half-cylindr"})
    with pytest.raises(
        InputError, match=r"tool.point_angle_deg must be left out for a half-cylinder, got 90"
    ):
        load_scene(
            "milling", changes | {"tool.kind": "half-cylinder", "tool.point_angle_deg": 90.0}
        )
    with pytest.raises(
        InputError, match=r"^tool.length_mm must be greater than 0 and at most 200, got -1"
    ):
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
    added(
        PROBES,
        "wide-ball",
        ProbeEntry(lambda tool: SphereProbe(1e-3 * tool.diameter_mm), ("diameter_mm",)),
    )
    touch = {"anatomy.touch_edge_mm": 5.0, "motion.feed_mm_s": 20.0}
    wide, same, half = (
        simulate(
            load_scene(
                "palpation", SLAB | touch | {"tool.kind": kind, "tool.diameter_mm": diameter_mm}
            )
        )
        for kind, diameter_mm in (
            ("wide-ball", 20.0),
            ("sphere-probe", 40.0),
            ("sphere-probe", 20.0),
        )
    )
    assert wide.trace["model_force_z_N"].max() > 1.1 * half.trace["model_force_z_N"].max() > 0.01
    np.testing.assert_array_equal(wide.trace["model_force_z_N"], same.trace["model_force_z_N"])
    for changes, refusal in (
        (
            {"tool.kind": "wide-bal"},
            r"^tool.kind must be one of ball-burr, .*, wide-ball, needle, got wide-bal \(did",
        ),
        (
            {"tool.kind": "wide-ball", "tool.length_mm": 5.0},
            r"^tool.length_mm must be left out for a wide-ball, got 5",
        ),
        (
            {"tool.kind": "wide-ball", "tool.file": "a.stl"},
            r"^tool.file must be left out for a wide-ball, got",
        ),
    ):
        with pytest.raises(InputError, match=refusal):
            load_scene("palpation", SLAB | {"tool.diameter_mm": 20.0} | changes)


def test_a_needle_from_outside_pierces(added):
    """One that cuts twice as hard is held back more once it is in."""
    added(NEEDLES, "blunt", lambda walls: replace(needle_tissue(), cutting_N=5.0))
    blunt, sharp = (
        simulate(
            load_scene("needle", {"tool.kind": kind, "anatomy.interval_ms": 0.0, "device": "none"})
        )
        for kind in ("blunt", "needle")
    )
    assert blunt.trace["model_force_z_N"].max() > 1.5 * sharp.trace["model_force_z_N"].max() > 0.5
    with pytest.raises(
        InputError, match=r"^tool.kind must be one of needle, blunt for a layers, got sphere-probe"
    ):
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
        motion.tip_m[:], motion.rotation[:], motion.heading[0] = (
            self.sweep_m()[0],
            np.eye(3),
            (0.0, 0.0, -1.0),
        )

    def advance(self, time_s, step_s, response, motion):
        motion.tip_m[2], motion.speed_m_s = 1e-3 - self.speed_m_s * time_s, self.speed_m_s


def test_a_motion_from_outside_moves(added):
    added(MOTIONS, "dip", MotionEntry(Dip, Dipping))
    changes = {
        "device": "none",
        "motion.kind": "dip",
        "motion.speed_mm_s": 20.0,
        "duration_s": None,
    }
    run = simulate(load_scene("wall", changes))
    assert (
        len(run.trace["time_s"]) == 200
        and Scene.model_validate(run.scene.model_dump()) == run.scene
    )
    np.testing.assert_allclose(run.trace["tool_z_mm"], 1.0 - 20.0 * run.trace["time_s"], atol=1e-12)
    for key, value, refusal in (
        (
            "motion.kind",
            "dipp",
            r"^motion.kind must be one of path, thrust, replay, dip, got dipp \(did you mean dip",
        ),
        (
            "motion.speed_mm_s",
            0.0,
            r"^motion.speed_mm_s must be greater than 0 and at most 100, got 0",
        ),
        ("motion.feed_mm_s", 1.0, r"^motion.feed_mm_s must be left out for a dip, got 1"),
    ):
        with pytest.raises(InputError, match=refusal):
            load_scene("wall", changes | {key: value})


def test_a_tissue_from_outside_is_met(added):
    added(ANATOMIES, "jelly", ENTRY)
    changes = CHANGES
    run = simulate(load_scene("palpation", changes))
    force, depth = run.trace["model_force_z_N"], run.trace["depth_mm"]
    np.testing.assert_allclose(force, 0.1 * depth, atol=1e-12)
    # 0.35 of 3.3 N for 40 N
    assert chosen_scale(load_scene("palpation", changes | {"device": "touch"}))[0] == 0.028
    assert (
        depth[-1] > 1.0
        and chosen_scale(run.scene)[0] == 1.0
        and run.parts.notes["jelly"] == "it is soft"
    )
    assert Scene.model_validate(run.scene.model_dump()) == run.scene
    for key, value, refusal in (
        (
            "anatomy.kind",
            "jely",
            r"^anatomy.kind must be one of glenoid, .*, wall, jelly, got jely \(did you mean jelly",
        ),
        (
            "anatomy.stiffness_N_m",
            0.5,
            r"^anatomy.stiffness_N_m must be at least 1 and at most 10000, got 0.5",
        ),
        ("anatomy.stiff", 2.0, r"^anatomy.stiff must be one of kind, stiffness_N_m, got stiff"),
        (
            "tool.kind",
            "needle",
            r"^tool.kind must be one of sphere-probe, .*, shell-probe for a jelly, got needle",
        ),
    ):
        with pytest.raises(InputError, match=refusal):
            load_scene("palpation", changes | {key: value})


@pytest.mark.slow
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
    assert [point.setting for point in frontier.points] == ["as it is"] and frontier.points[
        0
    ].force_error == 0.0
    draw_frontiers([frontier], tmp_path / "chart.png")
    for path in (tmp_path / "view.png", tmp_path / "chart.png", *(out / "pictures").iterdir()):
        with Image.open(path) as picture:
            assert (
                len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3)[::37], axis=0)) > 20
            ), path
