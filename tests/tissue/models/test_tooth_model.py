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


@pytest.mark.slow
def test_an_interval_is_counted_in_whole_ticks():
    """Of 12.5 ms it comes at the first tick that is not before it."""
    frames = drill(stress__interval_ms=12.5, duration_s=0.06).parts.tissue.fields.frames
    assert [frame.time_s for frame in frames] == pytest.approx([0.0, 0.013, 0.025, 0.038, 0.05])


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


def test_frames_have_the_meshs_shapes_and_stress_where_the_bur_pushes(run):
    series = run.parts.tissue.fields
    frame = series.frames[-1]
    assert frame.points["displacement_um"].shape == series.nodes_m.shape
    assert set(frame.cells) == {"von_mises_MPa", *(f"principal_{i}_MPa" for i in (1, 2, 3))}
    for values in frame.cells.values():
        assert values.shape == (len(series.cells),) == series.layer.shape
    principal = [frame.cells[f"principal_{i}_MPa"] for i in (1, 2, 3)]
    there = np.isfinite(frame.cells["von_mises_MPa"])
    assert there.mean() > 0.9
    assert (principal[0][there] >= principal[1][there]).all() and (
        principal[1][there] >= principal[2][there]
    ).all()
    middle = series.nodes_m[series.cells].mean(axis=1)
    tip = 1e-3 * run.trace.vectors("tool", "mm")[-1]
    top = np.flatnonzero(there)[np.argmax(frame.cells["von_mises_MPa"][there])]
    assert np.linalg.norm(middle[top] - tip) < 3e-3


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


@pytest.mark.slow
def test_the_end_of_the_other_process_is_reported_and_only_the_stress_is_lost(run, monkeypatch):
    begin = stress_process.StressProcess.begin

    def killed(self, state):
        begin(self, state)
        if state.time_s > 0.1:
            self._helper.kill()

    monkeypatch.setattr(stress_process.StressProcess, "begin", killed)
    lost = drill()
    message = [
        what for _, what in lost.events if "process that solves the stress was ended by" in what
    ]
    assert len(message) == 1 and message[0].endswith(
        "this run has no stress and no frames, everything else goes on"
    )
    np.testing.assert_array_equal(lost.trace.rows, run.trace.rows)
    np.testing.assert_array_equal(lost.remaining, run.remaining)
    assert not lost.parts.tissue.fields.frames


def test_stress_leaves_the_force_alone(run):
    """Stress leaves the force unchanged.

    A scene without it builds none, has no columns of it, and gives the same trace in all others.
    """

    def never(*_, **__):
        raise AssertionError("a field of stress was built")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StressField, "__init__", never)
        changes = {key: value for key, value in COARSE.items() if not key.startswith("stress.")}
        plain = simulate(load_scene("molar", changes | {"stress": None}))
    assert plain.parts.tissue.fields is None and plain.parts.tissue.stress is None
    assert set(run.trace.columns) - set(plain.trace.columns) == set(MOVES)
    for name in plain.trace.columns:
        np.testing.assert_array_equal(plain.trace[name], run.trace[name])


def test_the_tooths_own_columns(run):
    """They are in the trace; the tooth is pushed down by the bur and back at rest without it."""
    assert run.parts.tissue.measure_names == COLUMN + MOVES
    at = run.trace.columns.index(COLUMN[0])
    assert run.trace.columns[at : at + 7] == COLUMN + MOVES
    pushed = run.trace["model_force_z_N"] > 0.1
    assert (run.trace["tooth_centroid_z_um"][pushed] < 0.0).all()
    assert not run.trace.vectors("tooth_centroid", "um")[run.trace["contact_mm2"] == 0.0].any()


@pytest.mark.slow
def test_a_pulp_out_of_reach_is_not_measured():
    """A pulp outside the voxels has no column in the trace, rather than a meaningless number."""
    run = drill(
        voxels__margin_mm=0.5,
        **{"motion__points_mm": [[0, 0, 0.2], [0, 0, -0.4]], "duration_s": 0.2},
    )
    assert run.trace["removed_mm3"][-1] > 0.0
    assert run.parts.tissue.measure_names == MOVES
    assert np.isfinite(run.trace.rows).all()
    # a busy machine may report late stress
    assert not any("pulp" in what for _, what in run.events)


@pytest.mark.parametrize(
    ("scene", "overrides", "sentence"),
    [
        (
            "glenoid",
            ("stress.cell_mm=0.5",),
            (
                "stress must be left out for a glenoid, got a table: set anatomy.kind = molar, "
                "or remove it"
            ),
        ),
        (
            "milling",
            ("stress={}",),
            (
                "stress must be left out for a block, got a table: set anatomy.kind = molar, or "
                "remove it"
            ),
        ),
        (
            "molar",
            ("stress.cell_mm=0.45",),
            (
                "stress.cell_mm must be an even multiple of voxels.spacing_mm (0.05), got 0.45: "
                "use 0.4"
            ),
        ),
        (
            "molar",
            ("stress.cell_mm=0.2", "voxels.spacing_mm=0.03"),
            (
                "stress.cell_mm must be an even multiple of voxels.spacing_mm (0.03), got 0.2: "
                "use 0.24"
            ),
        ),
        (
            "molar",
            ("stress.cell_mm=0.3", "voxels.spacing_mm=0.2"),
            "stress.cell_mm must be an even multiple of voxels.spacing_mm (0.2), got 0.3: use 0.4",
        ),
        (
            "molar",
            ("stress.cell_mm=1.5", "voxels.spacing_mm=0.8", "tool.diameter_mm=4"),
            (
                "stress.cell_mm must be an even multiple of voxels.spacing_mm (0.8), got 1.5: "
                "use voxels.spacing_mm = 0.1"
            ),
        ),
        (
            "molar",
            ("stress.cell_mm=2",),
            "stress.cell_mm must be at least 0.2 and at most 1.5, got 2: use 0.5",
        ),
        (
            "molar",
            ("stress.interval_ms=0",),
            "stress.interval_ms must be at least 10 and at most 10000, got 0: use 100",
        ),
        (
            "molar",
            ("stress.cells_mm=0.5",),
            "stress.cells_mm must be one of cell_mm, interval_ms, got cells_mm (did you mean "
            "cell_mm?): rename or "
            "remove it",
        ),
        (
            "molar",
            ("stress=5",),
            (
                "stress must be a table with entries such as cell_mm, interval_ms, got 5: see "
                "`tissue scenes NAME`"
            ),
        ),
    ],
)
def test_a_stress_that_does_not_fit_is_refused_in_one_sentence(
    refused, here, scene, overrides, sentence
):
    sets = [part for override in overrides for part in ("--set", override)]
    assert refused("run", scene, *sets) == sentence
    assert not (here / "runs").exists()
