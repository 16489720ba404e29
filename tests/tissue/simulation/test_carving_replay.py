"""Bone at a tick, carved again from the poses of a run, against runs that stopped there."""

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.motion.replay import poses_of_trace
from tissue.simulation.bone_surface import tool_axes
from tissue.simulation.run import Run

COARSE = {"voxels.spacing_mm": 0.5}
DEEP = {"motion.points_mm": [[-3, 0, 0.0], [-3, 0, -0.8], [3, 0, -0.8]], "motion.feed_mm_s": 60.0}
SCENES = {
    "slow and spread over ticks": (
        "glenoid",
        COARSE | {"motion.points_mm": [[0, 0, 0.0], [0, 0, -2.0]], "motion.feed_mm_s": 5.0},
    ),
    "binary": ("milling", COARSE | DEEP | {"voxels.removal": "binary"}),
    "thrust": (
        "milling",
        COARSE | {"motion": {"kind": "thrust", "thrust_N": 20.0, "start_mm": [0, 0, 0.1]}},
    ),
    "a tooth": ("molar", {"voxels.spacing_mm": 0.2, "motion.feed_mm_s": 9.0, "stress": None}),
    "by a hand": ("milling", COARSE | DEEP | {"device": "touch", "hand": "novice"}),
}
TICKS = 240
STOPS = (53, 140)


def scene_of(kind, ticks):
    name, changes = SCENES[kind]
    return load_scene(name, changes | {"duration_s": 1e-3 * ticks})


@pytest.fixture(scope="module", params=SCENES)
def cut(request):
    """A kind of scene and its run."""
    return request.param, simulate(scene_of(request.param, TICKS))


@pytest.mark.slow
def test_the_bone_at_a_tick_is_that_of_a_run_stopped_there(cut):
    kind, run = cut
    replay = run.replay()
    assert (run.remaining < run.volume.fraction).any()
    for stop in STOPS:
        stopped = simulate(scene_of(kind, stop))
        # it looks ahead to the end of its motion, and the ticks after it are the hand's delay
        if kind == "by a hand":
            assert len(stopped.trace.rows) >= stop
        np.testing.assert_array_equal(
            stopped.trace.rows[:stop, 1:8],
            run.trace.rows[:stop, 1:8],
            "the runs take the same path",
        )
        np.testing.assert_array_equal(replay.at(len(stopped.trace.rows) - 1), stopped.remaining)


@pytest.mark.slow
def test_the_last_tick_is_the_run_itself_whatever_was_asked_before(cut):
    _, run = cut
    replay = run.replay()
    last = len(run.trace.rows) - 1
    seen = {}
    for tick in (last, 10, 150, 151, 151, 80, last, -1, last):
        bone = replay.at(tick).copy()
        np.testing.assert_array_equal(seen.setdefault(tick, bone), bone)
        np.testing.assert_array_equal(replay.fraction, bone)
    np.testing.assert_array_equal(seen[last], run.remaining)
    assert (
        (seen[150] <= seen[80]).all()
        and (seen[80] <= seen[10]).all()
        and (seen[10] <= run.volume.fraction).all()
    )


def test_a_trace_alone_gives_the_bone_within_what_the_tool_goes_between_two_cuts(cut):
    kind, run = cut
    trace = run.trace
    axes = tool_axes(np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"]))
    again = Run(
        run.scene,
        run.parts,
        trace,
        run.timing,
        events=[],
        poses=poses_of_trace(1e-3 * trace.vectors("tool", "mm"), axes),
    )
    bone = again.replay().at(len(trace.rows) - 1)
    # 20 µm of a voxel of 0.5 mm are 10 steps of 255; in a binary voxel it is all or nothing.
    differ = np.abs(bone.astype(int) - run.remaining)
    assert differ.max() <= (255 if kind == "binary" else 11)
    assert (differ > 0).mean() < 1e-3
