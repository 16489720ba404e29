"""A function that is called in every tick of a run, and ends it."""

import numpy as np

from tissue import load_scene, simulate

SHORT = {"duration_s": 0.05, "motion.feed_mm_s": 400.0}


def test_a_function_sees_every_row_of_the_trace():
    seen = []
    run = simulate(
        load_scene("wall", SHORT), on_tick=lambda index, row: seen.append((index, dict(row)))
    )
    assert [index for index, _ in seen] == list(range(50))
    assert list(seen[0][1]) == list(run.trace.columns) and len(seen[0][1]) == len(run.trace.columns)
    for column in ("time_s", "tool_z_mm", "model_force_z_N"):
        np.testing.assert_array_equal([row[column] for _, row in seen], run.trace[column])


def test_a_row_names_the_layer_as_the_trace_does():
    seen = []
    scene = load_scene("milling", {"voxels.spacing_mm": 0.5, "duration_s": 0.2})
    run = simulate(scene, on_tick=lambda index, row: seen.append(row["layer"]))
    assert seen == run.trace["layer"].tolist() and set(seen) == {"none", "cortical"}


def test_false_ends_the_run_after_its_tick():
    run = simulate(load_scene("wall", SHORT), on_tick=lambda index, row: index < 19)
    assert len(run.trace["time_s"]) == 20
    whole = simulate(load_scene("wall", SHORT), on_tick=lambda index, row: None)
    assert len(whole.trace["time_s"]) == 50
    np.testing.assert_array_equal(whole.trace.rows[:20], run.trace.rows)
