"""Tooth in a scene.

The separate stress solver does not change the trace, and reports stress for the state that it
belongs to.
"""

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.models.tooth import stress_process
from tissue.models.tooth.field import StressField

COARSE = {
    "voxels.spacing_mm": 0.1,
    "stress.cell_mm": 1.0,
    "stress.interval_ms": 50.0,
    "motion.points_mm": [[0, 0, 0.0], [0, 0, -2]],
    "motion.feed_mm_s": 3.0,
    "duration_s": 0.62,
}
MOVES = tuple(f"tooth_{part}_{c}_um" for part in ("centroid", "at_bur") for c in "xyz")
COLUMN = ("dentin_over_pulp_mm",)


def drill(**changes):
    """A short path into a coarse molar."""
    return simulate(
        load_scene(
            "molar", COARSE | {key.replace("__", "."): value for key, value in changes.items()}
        )
    )


@pytest.fixture(scope="module")
def seen():
    """Return the records of all solves: time, lost volume, force and point.

    The lost volume counts the steps of 1/65535 that the voxels had lost by then.
    """
    return []


@pytest.fixture(scope="module")
def run(seen):
    with pytest.MonkeyPatch.context() as patch:
        remove = StressField.remove
        solve = StressField.solve
        lost = []

        def removing(field, voxels, steps, **places):
            lost.append((lost[-1] if lost else 0) + int(steps.sum()))
            remove(field, voxels, steps, **places)

        def solving(field, time_s, force_N, point_m):
            seen.append((time_s, lost[-1], force_N.copy(), point_m.copy()))
            return solve(field, time_s, force_N, point_m)

        patch.setattr(stress_process, "StressProcess", stress_process.InlineStressSolver)
        patch.setattr(StressField, "remove", removing)
        patch.setattr(StressField, "solve", solving)
        return drill()


def test_frames_come_at_multiples_of_the_interval(run):
    frames = run.parts.tissue.fields.frames
    assert [frame.time_s for frame in frames] == pytest.approx(0.05 * np.arange(13), abs=1e-12)
    assert [record.time_s for record in run.parts.tissue.stress.records] == [
        frame.time_s for frame in frames
    ]


def test_a_solve_is_given_the_state_of_its_time(run, seen):
    """A solve gets the state of its time.

    Force, removed volume and the bur's face toward the force equal the trace's row.
    """
    force = run.trace.vectors("model_force", "N")
    tip = run.trace.vectors("tool", "mm")
    voxel_mm3 = run.parts.volume.voxel_volume_m3 * 1e9
    for time_s, lost, force_on_tooth, point_m in seen:
        row = round(time_s * 1e3)
        np.testing.assert_array_equal(force_on_tooth, -force[row])
        radius_mm = 0.5 * run.scene.tool.diameter_mm
        size = np.linalg.norm(force[row])
        away = force[row] / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
        np.testing.assert_allclose(
            1e3 * point_m, tip[row] + radius_mm * ([0.0, 0.0, 1.0] - away), atol=1e-5
        )
        assert lost / 65535 * voxel_mm3 == pytest.approx(
            run.trace["removed_mm3"][row], rel=1e-9, abs=1e-9
        )
    assert seen[-1][1] > 0


def test_a_frame_balances_the_force_of_its_time(run):
    """A frame balances the force of its time.

    The bed's springs carry the push of the bur at the frame's time, to the residual of the solve.
    """
    field = run.parts.tissue.stress.field
    force = run.trace.vectors("model_force", "N")
    loaded = 0
    for frame in field.series.frames:
        pushed = -force[round(frame.time_s * 1e3)]
        moved = 1e-6 * frame.points["displacement_um"].astype(np.float64)
        carried = field.body.product(moved).sum(axis=0)
        np.testing.assert_allclose(carried, pushed, atol=2e-3 * np.abs(pushed).max() + 1e-12)
        loaded += bool(pushed.any())
    assert loaded > 8


def bits(run):
    """Bytes of the trace and of all frames."""
    frames = [
        array.tobytes()
        for frame in run.parts.tissue.fields.frames
        for array in (*frame.points.values(), *frame.cells.values())
    ]
    return [run.trace.rows.tobytes(), *frames]


@pytest.mark.slow
def test_a_separate_process_gives_the_same_bits(run):
    """A separate process gives the same bits for solves of any duration.

    The run above was solved in this process, when the result was due.
    """
    assert bits(drill()) == bits(run)


def test_the_tooths_own_columns(run):
    """They are in the trace; the tooth is pushed down by the bur and back at rest without it."""
    assert run.parts.tissue.measure_names == COLUMN + MOVES
    at = run.trace.columns.index(COLUMN[0])
    assert run.trace.columns[at : at + 7] == COLUMN + MOVES
    pushed = run.trace["model_force_z_N"] > 0.1
    assert (run.trace["tooth_centroid_z_um"][pushed] < 0.0).all()
    assert not run.trace.vectors("tooth_centroid", "um")[run.trace["contact_mm2"] == 0.0].any()
