"""The parts are found by their names, run, and are judged."""

import numpy as np
import pytest

from tissue import InputError, load_scene, scene_names, simulate
from tissue.evaluation.stability_report import scene_stability
from tissue.prediction.guard import Guarded
from tissue.scene.registry import DEVICES, PREDICTORS


def test_the_scenes_and_parts_are_listed():
    assert {"toy-drilling", "toy-cushion"} <= set(scene_names())
    assert "toy-pen" in tuple(DEVICES) and "damped-line" in tuple(PREDICTORS)


def test_the_foam_is_drilled_by_the_pen_under_the_guard():
    # coarse and short: enough to remove some bone in a second of computing
    run = simulate(load_scene("toy-drilling", {"voxels.spacing_mm": 0.4, "duration_s": 0.4}))
    motion = run.parts.motion
    assert type(motion.device).__name__ == "ToyPen" and isinstance(motion.predictor, Guarded)
    assert run.trace["removed_mm3"][-1] > 1.0
    assert (
        run.parts.notes["specific cutting energy"]
        == "rigid-foam 0.015 (0.005-0.03) J/mm3 at 320 kg/m3, confidence L"
    )
    assert not motion.device.force_N.any()  # whatever ends a run, its last command is zero


def test_a_step_drill_removes_less_than_a_straight_one():
    changes = {"voxels.spacing_mm": 0.4, "device": "none", "duration_s": 0.6}
    stepped = simulate(load_scene("toy-drilling", changes)).trace["removed_mm3"][-1]
    # the step drill of the scene without its step
    cylinder = {
        "tool.kind": "cylinder",
        "tool.diameter_mm": 4.0,
        "tool.length_mm": 9.0,
        "tool.spin_rpm": 3000.0,
    }
    straight = simulate(load_scene("toy-drilling", changes | cylinder))
    # half of the diameter is a quarter of the section, and more once the wide part cuts
    assert (
        0.2 * straight.trace["removed_mm3"][-1] < stepped < 0.8 * straight.trace["removed_mm3"][-1]
    )


def test_the_cushion_hardens():
    trace = simulate(load_scene("toy-cushion")).trace
    depth_m = 1e-3 * trace["depth_mm"]
    # the stiffness and the hardening depth of `Cushion` by default
    np.testing.assert_allclose(
        trace["model_force_z_N"], 100.0 * depth_m * (1.0 + depth_m / 0.01), atol=1e-9
    )
    # 10 mm deep, where it is twice as stiff: 2 x 100 N/m x 10 mm
    assert trace["model_force_z_N"].max() == pytest.approx(2.0, rel=0.02)


def test_the_pens_loop_is_judged():
    found = scene_stability(load_scene("wall", {"device": "toy-pen", "prediction": "damped-line"}))
    assert found.verdict.stable and found.verdict.critical_N_m > 100.0
    with pytest.raises(
        InputError,
        match=r"^coupling.stiffness_N_m must be below \d+ to be stable with device = toy-pen",
    ):
        # 1e5 N/m is far above the critical stiffness of any such device
        simulate(load_scene("wall", {"device": "toy-pen", "coupling.stiffness_N_m": 1e5}))
