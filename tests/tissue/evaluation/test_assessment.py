"""A trainee's run held against a reference: alignment by place, breaches in time, and a picture."""

import ast
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue import models
from tissue.evaluation import assessment_files, ranking
from tissue.evaluation.assessment import NoSharedContactError, assess
from tissue.evaluation.assessment_files import assessed_section, assessment_lines
from tissue.evaluation.ranking import rank, ranking_lines, write_ranking
from tissue.evaluation.same_task import EVENTS_OF
from tissue.evaluation.statistics.metrics import aligned_rows, deviation_mm, followed_ticks
from tissue.scene.load import load_scene
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.trace import Table, TraceLayout, TraceWriter

COLUMNS = TraceLayout.of(()).columns
DEVICE = (("device", "mm"), ("device_force", "N"))
TICK_S = 1e-3
GRID_MM = 0.02
"""Tolerance of the alignment [mm].

Paths of 2 s are aligned over 800 samples, 2.5 ticks apart. At 20 mm/s that time covers 0.05 mm; the
refinement is finer.
"""


def reach(duration_s, *, pause_s=0.0, deeper_mm=0.0, aside_mm=0.0):
    """Return a path 10 mm down, 20 mm along, and up again.

    The tool's axis is z and the tissue begins below zero.
    """
    count = round(duration_s / TICK_S)
    s = np.linspace(0.0, 4.0, count)
    pause = np.full(round(pause_s / TICK_S), 2.0)
    s = np.concatenate([s[s < 2.0], pause, s[s >= 2.0]])
    x = np.interp(s, [0, 1, 3, 4], [0, 0, 20, 20])
    depth = np.interp(s, [0, 1, 3, 4], [-2, 5, 5, -2]) + deeper_mm * np.exp(
        -0.5 * ((s - 1.5) / 0.05) ** 2
    )
    y = aside_mm * np.exp(-0.5 * ((s - 2.5) / 0.1) ** 2)
    return np.column_stack([x, y, -depth])


def saved(folder, path, *, scene="block", force_scale=1.0, events=(), status="complete"):
    """A run's folder with a trace of that path and a force of 2 N per mm of depth."""
    folder.mkdir(parents=True)
    rows = np.zeros((len(path), len(COLUMNS)))
    at = {name: index for index, name in enumerate(COLUMNS)}
    rows[:, at["time_s"]] = np.arange(len(path)) * TICK_S
    rows[:, [at[f"tool_{c}_mm"] for c in "xyz"]] = path
    rows[:, at["tool_qw"]] = 1.0
    rows[:, [at[f"velocity_{c}_mm_s"] for c in "xyz"]] = np.gradient(path, axis=0) / TICK_S
    depth = np.maximum(0.0, -path[:, 2])
    rows[:, at["model_force_z_N"]] = 2.0 * force_scale * depth
    rows[:, at["contact_mm2"]] = depth > 0.0
    rows[:, at["layer"]] = -1
    writer = TraceWriter(folder / "trace.csv", Table(COLUMNS, rows))
    writer.flush(len(rows), force=True)
    writer.close()
    summary = {
        "format": 1,
        "status": status,
        "scene": scene,
        "layers": [],
        "simulated_s": len(rows) * TICK_S,
    }
    summary |= {"force_N": {"peak": 2.0 * force_scale * depth.max()}, "torque_Nm": {"peak": 0.0}}
    summary["events"] = [{"time_s": at_s, "what": what} for at_s, what in events]
    (folder / "summary.json").write_text(json.dumps(summary))
    return SavedRun(folder)


def test_a_slower_run_with_a_pause_is_no_deviation(tmp_path):
    reference = saved(tmp_path / "r", reach(2.0))
    found = assess(saved(tmp_path / "t", reach(2.7, pause_s=0.5)), reference)
    assert found.figures["deviation_mm"]["worst"] < GRID_MM
    assert found.figures["force_error"] < 0.01 and not found.breaches
    # Without alignment the same ticks lie millimetres apart.
    assert np.linalg.norm(reach(2.7, pause_s=0.5)[:2000] - reach(2.0), axis=1).max() > 5.0
    time = found.figures["time_in_contact_s"]
    assert time["trainee"] == pytest.approx(time["reference"] * 1.35 + 0.5, abs=0.01)
    assert "no limit was exceeded" in assessment_lines(found)


def test_the_section_of_a_report_names_trainee_and_reference(tmp_path):
    trainee = saved(tmp_path / "people/p01", reach(1.0))
    lines, picture = assessed_section(trainee, saved(tmp_path / "people/expert", reach(1.0)))
    assert lines[:2] == ["trainee: people/p01", "reference: people/expert"]
    assert picture.startswith(b"\x89PNG")


def test_a_run_that_ends_early_deviates_nowhere(tmp_path):
    """A run that ends early deviates nowhere.

    Its path lies on the reference's as far as it exists; a note reports that it is not complete.
    """
    whole = reach(2.0)
    rows = aligned_rows(whole[:400], whole)
    assert deviation_mm(whole[:400], whole, rows).max() < GRID_MM
    np.testing.assert_allclose(rows, np.arange(400), atol=4)
    assert deviation_mm(
        whole, whole[:400], aligned_rows(whole, whole[:400])
    ).max() == pytest.approx(np.linalg.norm(whole[-1] - whole[399]), rel=0.01)


def test_ticks_after_the_end_of_the_alignment_are_as_far_as_the_rest_of_the_path():
    """The trainee rests above the reference, so that the alignment ends before its deepest point."""
    depth = np.concatenate([np.linspace(0, 20.9, 400), np.linspace(20.9, 20.7, 20), [20.7] * 80])
    deeper = np.concatenate([np.linspace(0, 21.5, 400), np.linspace(21.5, 20.1, 50), [20.1] * 450])
    path = np.column_stack([np.full(900, 0.5), np.zeros(900), -deeper])
    model = np.column_stack([np.zeros((500, 2)), -depth])
    rows = aligned_rows(path, model)
    assert depth[rows].max() < 20.5
    assert deviation_mm(path, model, rows).max() == pytest.approx(np.hypot(0.5, 0.6), abs=1e-6)
    followed = followed_ticks(model, rows)
    assert followed[:370].all() and not followed[450:].any()
    assert followed_ticks(path, aligned_rows(path, path)).all()


def test_alignment_never_goes_back_and_keeps_crossings_apart():
    """Up and down one line: the nearest point would be on either leg, the moment is not."""
    there = np.linspace(0.0, 10.0, 500)
    path = np.concatenate([there, there[::-1]])[:, None]
    rows = aligned_rows(path[::2], path)
    assert (np.diff(rows) >= 0).all() and rows[0] == 0 and rows[-1] >= 997
    np.testing.assert_allclose(rows, np.arange(0, 1000, 2), atol=4)
    turned = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    line = np.column_stack([path, 0.3 * path, 0.0 * path])
    off, other = (
        deviation_mm(line[::2], line, rows),
        deviation_mm(line[::2] @ turned + 7.0, line @ turned + 7.0, rows),
    )
    np.testing.assert_allclose(off, other, atol=1e-9)


def test_breaches_are_found_where_they_were_planted(tmp_path):
    reference = saved(tmp_path / "r", reach(2.0), events=[(0.9, "wall punctured with 2 N")])
    trainee = saved(
        tmp_path / "t",
        reach(2.0, deeper_mm=1.5, aside_mm=1.8),
        events=[(0.8, "pulp exposed")],
        status="interrupted",
    )
    found = assess(trainee, reference, force_limit_N=12.0)
    by_what = {each.what: each for each in found.breaches}
    # The dip leaves the path too, so that distance is passed twice; its second time is aside.
    assert len(found.breaches) == 4
    assert set(by_what) == {"force", "distance from the path", "depth"}
    depth, aside, force = by_what["depth"], by_what["distance from the path"], by_what["force"]
    # s = 1.5 is at 0.75 s, s = 2.5 at 1.25 s of 2 s.
    assert depth.worst_at_s == pytest.approx(0.75, abs=0.002) and depth.worst == pytest.approx(
        6.5, abs=0.01
    )
    assert aside.worst_at_s == pytest.approx(1.25, abs=0.01) and aside.worst == pytest.approx(
        1.8, abs=GRID_MM
    )
    # Deeper than 0.5 mm beyond the plan while exp(-x^2 / 2) > 1/3.
    assert depth.end_s - depth.start_s == pytest.approx(
        2.0 * np.sqrt(2.0 * np.log(3.0)) * 0.05 / 2.0, abs=0.003
    )
    assert force.limit == 12.0 and force.worst == pytest.approx(13.0, abs=0.01)
    assert found.figures["overshoot_mm"] == pytest.approx(1.5, abs=0.01)
    lines = assessment_lines(found)
    assert "only in the reference, at 0.900 s: wall punctured with 2 N" in lines
    assert any("pulp exposed" in line for line in lines) and "the trainee was cut short" in lines


def of_scene(run, **changes):
    """A run as one of the built-in scene of milling with some changes."""
    run.scene = load_scene(
        "milling", {name.replace("__", "."): value for name, value in changes.items()}
    )
    run.summary["layers"] = ["cortical"]
    return run


def constants(path, *, table, name, value):
    """Write a file with one constant, and return its path as text."""
    entry = f"{{ value = {value}, range = [0.0, 100.0], source = 'x', confidence = 'L' }}"
    path.write_text(f"[{table}]\n{name} = {entry}\n")
    return str(path)


@pytest.mark.parametrize(
    "change",
    [
        {"tool__diameter_mm": 5.0},
        {"anatomy__density_kg_m3": 1500.0},
        {"cutting__density_exponent": 1.0},
        {"materials": "m"},
    ],
)
def test_runs_of_two_tasks_are_not_assessed(tmp_path, change):
    """Runs of two tasks are not assessed.

    With another tool, tissue or material another force is right, so that no breach means anything.
    """
    if "materials" in change:
        file = tmp_path / "m.toml"
        change = {
            "materials": constants(file, table="cutting.bone", name="radial_chip_N_mm2", value=40.0)
        }
    reference = of_scene(saved(tmp_path / "r", reach(1.0)))
    with pytest.raises(InputError, match=r"run and reference must be runs of the same task, got"):
        assess(of_scene(saved(tmp_path / "t", reach(1.0)), **change), reference)
    found = assess(
        of_scene(saved(tmp_path / "o", reach(1.0)), hand="novice", device="touch", seed=3),
        reference,
    )
    assert found.notes == ()
    # The trace of this run was made without the columns of a device.
    assert found.steadiness is None and "no device whose constants are known" in found.unscored


def test_the_name_of_the_scene_may_differ(tmp_path):
    trainee = of_scene(saved(tmp_path / "t", reach(1.0), scene="deep"), name="deep")
    reference = of_scene(saved(tmp_path / "r", reach(1.0)))
    (note,) = assess(trainee, reference).notes
    assert note == "the scenes have different names: trainee deep, reference milling"
    # without the scene of a run, only the name is known
    trainee.scene = None
    with pytest.raises(InputError, match="got scene = deep in the run and block in the reference"):
        assess(trainee, reference)


def test_events_of_heat_are_compared_only_if_both_runs_compute_it(tmp_path):
    warm = "the pulp is 5.5 K warmer than at the start"
    events = [(0.5, warm), (0.6, "the pulp is exposed")]
    trainee = of_scene(saved(tmp_path / "t", reach(1.0)))
    reference = of_scene(saved(tmp_path / "r", reach(1.0), events=events), heat=True)
    assert assess(trainee, reference).missing == ((0.6, "the pulp is exposed"),)
    assert assess(reference, trainee).events == ((0.6, "the pulp is exposed"),)
    cold = of_scene(trainee, heat=True)
    assert assess(cold, reference).missing == tuple(events)


@pytest.fixture(scope="module")
def notices():
    """Source of every event sentence that the tissue models report."""
    return [
        ast.unparse(node.args[0])
        for file in Path(models.__file__).parent.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("notices.append")
    ]


@pytest.mark.parametrize("phrase", [each for phrases in EVENTS_OF.values() for each in phrases])
def test_each_phrase_of_a_part_is_in_an_event_of_the_models(notices, phrase):
    assert any(phrase in notice for notice in notices)


def near(run, distance_mm):
    """Give a run a distance to a nerve in every tick."""
    rows = np.column_stack([run.trace.rows, distance_mm])
    run.trace = Table((*run.trace.columns, "distance_nerve_mm"), rows)
    return clear(run, float(distance_mm.min()), name="nerve")


def test_the_margin_of_the_reference_is_a_limit(tmp_path, monkeypatch):
    path = shaken(reach(1.5), 0.1)
    # below 1 mm from 0.4805 to 0.7195 s, 0.4 mm at 0.6 s
    time_s = np.arange(len(path)) * TICK_S
    distance_mm = np.minimum(3.0, 0.4 + 5.02 * np.abs(time_s - 0.6))
    kept = {"keep_clear__names": ["nerve"]}
    margin = kept | {"keep_clear__margin_mm": 1.0}
    people = tmp_path / "people"
    trainee = near(scored(people, saved(people / "ben", path), **kept), distance_mm)
    reference = near(scored(tmp_path, saved(tmp_path / "r", path), **margin), distance_mm + 1.0)
    found = assess(trainee, reference)
    (breach,) = found.breaches
    assert breach.sentence == (
        "distance to nerve below 1 mm from 0.481 to 0.719 s, at worst 0.4 mm at 0.600 s"
    )
    lines = assessment_lines(found)
    assert "smallest distance to nerve: 0.400 mm against 1.400 (margin 1 mm)" in lines
    assert f"limit exceeded: {breach.sentence}" in lines
    (limits,) = (line for line in lines if line.startswith("limits: "))
    assert limits.endswith(", distance to nerve at least 1 mm")
    charts = []
    monkeypatch.setattr(assessment_files, "save", lambda chart, path: charts.append(chart))
    assessment_files.draw_assessment(found, tmp_path / "a.png")
    assert charts[0].axes[3].get_ylabel() == "distance to nerve / mm"
    ranked = rank(people, reference, lambda folder: trainee)
    assert "   distance to nerve below the limit: ben" in ranking_lines(ranked)
    write_ranking(ranked, tmp_path / "out", overwrite=False)
    header, row = (tmp_path / "out" / "ranking.csv").read_text().splitlines()
    written = dict(zip(header.split(","), row.split(","), strict=True))
    assert (written["margin_nerve_mm"], written["intervals_below_margin_nerve"]) == ("1.0", "1")
    # Distances are not valid after the tool left the simulated region.
    trainee.summary["left_region_s"] = 0.55
    (breach,) = assess(trainee, reference).breaches
    assert (breach.end_s, breach.worst) == (0.55, pytest.approx(0.651))
    # The margin of the trainee is no limit.
    assert not assess(reference, trainee).clearances


def test_times_of_saved_fields_may_differ(tmp_path):
    trainee = saved(tmp_path / "t", reach(1.0))
    reference = saved(tmp_path / "r", reach(1.0))
    trainee.scene = load_scene("needle", {"anatomy.interval_ms": 0.0})
    reference.scene = load_scene("needle")
    assert assess(trainee, reference).notes == ()


@pytest.mark.parametrize(
    ("table", "name"),
    [("hands.novice", "tremor_m"), ("devices.touch", "friction_N"), ("needle.liver", "cutting_N")],
)
def test_constants_that_the_task_does_not_use_may_differ(tmp_path, table, name):
    file = constants(tmp_path / "m.toml", table=table, name=name, value=2e-4)
    trainee = of_scene(saved(tmp_path / "t", reach(1.0)), materials=file, device="touch")
    reference = of_scene(saved(tmp_path / "r", reach(1.0)), device="touch")
    assert assess(trainee, reference).notes == ()


def test_runs_with_and_without_heat_are_of_one_task(tmp_path):
    """Neither temperatures nor the constants that only they need change the task."""
    reference = of_scene(saved(tmp_path / "r", reach(1.0)), heat=True)
    trainee = of_scene(saved(tmp_path / "t", reach(1.0)))
    note = "the scenes differ in heat: trainee false, reference true"
    assert assess(trainee, reference).notes == (note,)


def test_a_note_names_scales_of_the_coupling_that_differ(tmp_path):
    reference = of_scene(saved(tmp_path / "r", reach(1.0)), device="touch")
    trainee = of_scene(
        saved(tmp_path / "t", reach(1.0)), device="touch", coupling__motion_scale=0.5
    )
    end = "in the reference: the scores of these runs are not comparable"
    assert assess(trainee, reference).notes == (f"coupling.motion_scale is 0.5, and 1 {end}",)
    # Both scenes leave the force scale to the run, and the runs chose different scales.
    other = of_scene(saved(tmp_path / "o", reach(1.0)), device="touch")
    other.summary["force_scale"] = 0.4
    reference.summary["force_scale"] = 0.78
    assert assess(other, reference).notes == (f"coupling.force_scale is 0.4, and 0.78 {end}",)


def scored(path, run, **changes):
    """A run with a device that moves as the tool, so that it has a score."""
    run = of_scene(run, device="touch", **changes)
    axes = [f"{name}_{c}_{unit}" for name, unit in DEVICE for c in "xyz"]
    path_mm = run.trace.vectors("tool", "mm")
    extra = np.column_stack([path_mm, np.zeros_like(path_mm)])
    run.trace = Table((*run.trace.columns, *axes), np.column_stack([run.trace.rows, extra]))
    run.path = path
    return run


def shaken(path, size_mm):
    """Add a tremor of 10 Hz across a path."""
    time_s = TICK_S * np.arange(len(path))
    moved = path.copy()
    moved[:, 1] += size_mm * np.sin(2.0 * np.pi * 10.0 * time_s)
    return moved


def clear(run, least_mm, *, name="pulp"):
    """Give a run a distance to a structure; a negative distance is a breach."""
    depth = max(0.0, -least_mm)
    first = 0.7 if depth else None
    run.summary["keep_clear"] = {
        name: {
            "least_distance_mm": least_mm,
            "breach_depth_mm": depth,
            "breach_s": 0.1 * bool(depth),
            "first_breach_s": first,
        }
    }
    return run


def test_a_breached_structure_exceeds_a_limit(tmp_path):
    run = clear(saved(tmp_path / "r", reach(1.0)), -0.98)
    found = assess(run, run)
    assert not found.breaches and found.breached == ("pulp",)
    lines = assessment_lines(found)
    assert "breach: the tool was 0.98 mm deep in pulp, first at 0.700 s" in lines
    assert "no limit was exceeded" not in lines


def test_a_stopped_run_breaches_by_the_distances_of_its_trace(tmp_path):
    run = saved(tmp_path / "r", reach(1.0))
    distance_mm = 0.5 - 0.001 * np.arange(len(run.trace.rows))
    rows = np.column_stack([run.trace.rows, distance_mm])
    run.trace = Table((*run.trace.columns, "distance_pulp_mm"), rows)
    found = assess(run, run)
    assert found.breached == ("pulp",)
    kept = found.figures["keep_clear"]["pulp"]
    assert kept["least_distance_mm"] == distance_mm.min() == -kept["breach_depth_mm"]
    assert kept["first_breach_s"] == run.trace["time_s"][distance_mm < 0.0][0]


def test_a_run_that_breached_a_structure_is_never_ranked_above_one_that_did_not(tmp_path):
    """The steadier hand breaches the pulp. A third run is of another task."""
    path = reach(1.5)
    runs = {
        "careful": (saved(tmp_path / "people" / "careful", shaken(path, 0.2)), 0.91, {}),
        "steady": (
            saved(tmp_path / "people" / "steady", shaken(path, 0.05)),
            -0.07,
            {"coupling__motion_scale": 0.5},
        ),
        "wide": (
            saved(tmp_path / "people" / "wide", path),
            1.0,
            {"tool__diameter_mm": 5.0},
        ),
    }
    loaded = {
        name: clear(scored(tmp_path / name, run, **changes), least_mm)
        for name, (run, least_mm, changes) in runs.items()
    }
    # The reference is a scripted run, so the trainees are compared with each other.
    reference = of_scene(saved(tmp_path / "r", path))
    found = rank(tmp_path / "people", reference, lambda folder: loaded[folder.name])
    assert [person.name for person in found.people] == ["careful", "steady"]
    assert found.people[1].mean > found.people[0].mean
    (left_out,) = found.left_out
    assert (
        "wide is of another task than the reference: tool.diameter_mm = 5 in the run and 6 "
        in left_out
    )
    ((note, noted),) = found.notes.items()
    assert note == (
        "coupling.motion_scale is 0.5, and 1 in careful: the scores of these runs are not "
        "comparable"
    )
    assert noted == ("steady",)
    lines = ranking_lines(found)
    assert "   smallest distance to pulp: -0.070 mm (breached)" in lines
    assert lines[lines.index(f"note: {note}") + 1] == "   steady"
    write_ranking(found, tmp_path / "out", overwrite=False)
    header, *rows = (tmp_path / "out" / "ranking.csv").read_text().splitlines()
    assert header.endswith(",least_distance_pulp_mm,breached_pulp")
    assert rows[0].endswith(",0.91,False") and rows[1].endswith(",-0.07,True")
    only = {"wide": loaded["wide"]}
    for name in ("careful", "steady"):
        shutil.rmtree(tmp_path / "people" / name)
    with pytest.raises(InputError, match=r"another task .* Run the scene of the reference"):
        rank(tmp_path / "people", reference, lambda folder: only[folder.name])


def test_a_drilling_is_scored_until_the_tip_reaches_its_depth(tmp_path):
    """The hand rests after the drilling for four times as long."""
    depth = np.linspace(-1.0, 20.0, 1500)
    path = np.column_stack([np.zeros((1500, 2)), -depth])
    path = np.concatenate([shaken(path, 0.1), np.broadcast_to(path[-1], (6000, 3))])
    run = scored(tmp_path, saved(tmp_path / "r", path))
    assert "6.3 mm/s or faster for" in assess(run, run).unscored
    run.scene = load_scene("pedicle", {"device": "touch"})
    assert assess(run, run).steadiness is not None


def test_the_removed_volume_is_compared_with_the_reference(tmp_path):
    runs = []
    for name, removed_mm3 in (("t", 1.3), ("r", 2.0)):
        run = saved(tmp_path / name, reach(1.0))
        run.trace.rows[:, run.trace.columns.index("removed_mm3")] = removed_mm3
        runs.append(run)
    found = assess(*runs)
    assert found.figures["removed_mm3"] == {"trainee": 1.3, "reference": 2.0}
    assert "removed: 1.3 mm3 against 2, 65 % of the reference volume" in assessment_lines(found)


def test_constants_of_a_trainee_do_not_change_the_scale_of_the_score(tmp_path):
    path = shaken(reach(1.5), 0.1)
    file = constants(tmp_path / "m.toml", table="hands.novice", name="tremor_m", value=2e-4)
    reference = scored(tmp_path, saved(tmp_path / "r", path))
    trainee = scored(tmp_path, saved(tmp_path / "t", path), materials=file)
    own, cited = (assess(run, reference).steadiness for run in (trainee, reference))
    assert own.score == cited.score


def test_the_margin_to_a_structure_is_no_part_of_the_task(tmp_path):
    kept = {"keep_clear__names": ["nerve"]}
    trainee = of_scene(saved(tmp_path / "t", reach(1.0)), **kept)
    reference = of_scene(saved(tmp_path / "r", reach(1.0)), keep_clear__margin_mm=1.0, **kept)
    (note,) = assess(trainee, reference).notes
    assert note == "the scenes differ in keep_clear.margin_mm: trainee 0, reference 1"


def test_breaches_of_runs_that_are_left_out_are_reported(tmp_path):
    path = reach(1.5)
    runs = {
        "anna": clear(scored(tmp_path, saved(tmp_path / "people" / "anna", path)), 0.9),
        "carl": clear(of_scene(saved(tmp_path / "people" / "carl", path)), -0.1),
        "dora": saved(tmp_path / "people" / "dora", path + np.array([0.0, 0.0, 10.0])),
    }
    runs["carl"].scene = load_scene("milling", {"tool.diameter_mm": 5.0})
    clear(runs["dora"], -0.2)
    found = rank(tmp_path / "people", runs["anna"], lambda folder: runs[folder.name])
    carl, dora = found.left_out
    assert "carl breached pulp and is of another task" in carl
    assert dora.endswith("dora breached pulp and touches nothing")


def test_a_missing_limit_and_a_limit_of_zero_are_told_apart(tmp_path):
    trainee = saved(tmp_path / "t", reach(1.0))
    with pytest.raises(
        InputError, match=r"force_limit_N must be positive and finite, got 0\.0\. Use"
    ):
        assess(trainee, trainee, force_limit_N=0.0)
    reference = saved(tmp_path / "r", reach(1.0), force_scale=0.0)
    with pytest.raises(InputError, match="the force of the reference run is zero"):
        assess(trainee, reference)


def test_a_ranking_names_the_limits_and_the_trainees_over_a_limit(tmp_path, monkeypatch):
    """The second attempt of Anna is too deep, and no run finished its path."""
    path = reach(1.5)
    runs = {
        "anna/attempt-1": shaken(path, 0.1),
        "anna/attempt-2": shaken(reach(1.5, deeper_mm=1.5), 0.1),
        "ben": shaken(path, 0.1),
    }
    people = tmp_path / "people"
    loaded = {
        people / name: scored(people / name, saved(people / name, each))
        for name, each in runs.items()
    }
    for depth_mm, run in enumerate(loaded.values()):
        run.summary["notes"] = {
            "path": f"not finished: the tip reached a depth of {depth_mm} mm, and motion.depth_mm "
            "is 4; raise duration_s"
        }
    reference = scored(tmp_path / "r", saved(tmp_path / "r", path))
    found = rank(people, reference, loaded.get)
    lines = ranking_lines(found)
    (limits,) = (line for line in lines if line.startswith("limits: force 12.5 N, distance"))
    assert limits.endswith(" mm from the first contact of the reference")
    assert "   depth over the limit: anna (1 of 2 attempts)" in lines
    notes = [line for line in lines if "not finished" in line]
    assert notes == [
        "note: the path of the trainee is not finished: the tip reached a depth of 0 to 2 mm, and "
        "motion.depth_mm is 4; raise duration_s"
    ]
    for run in loaded.values():
        run.summary["notes"] = {"path": "not finished: the tip reached a depth of 0.5 mm"}
    (note,) = rank(people, reference, loaded.get).notes
    assert note.endswith("is not finished: the tip reached a depth of 0.5 mm")
    for height_mm, run in enumerate(loaded.values()):
        run.summary["notes"] = {"path": f"not finished: it ends at z = {height_mm - 4}.5 mm"}
    (note,) = rank(people, reference, loaded.get).notes
    assert note.endswith("it ends at z = -4.5 to -2.5 mm")
    assert not any(line.startswith("hint") for line in lines)
    charts = []
    monkeypatch.setattr(ranking, "save", lambda chart, path: charts.append(chart))
    write_ranking(found, tmp_path / "out", overwrite=False)
    (chart,) = charts
    assert limits in chart.get_suptitle()
    assert chart.axes[0].get_xlabel() == "score (x: one attempt)"
    crosses = [line.get_xdata() for line in chart.axes[0].lines if line.get_marker() == "x"]
    assert [len(each) for each in crosses] == [2]
    attempts = ranking_lines(rank(people / "anna", reference, loaded.get))
    assert any(line.startswith("hint: every folder counts as a trainee") for line in attempts)


def test_a_breach_of_a_run_without_a_score_is_reported(tmp_path):
    path = reach(1.5)
    runs = {
        "anna": clear(scored(tmp_path, saved(tmp_path / "people" / "anna", path)), 0.9),
        "ben": clear(of_scene(saved(tmp_path / "people" / "ben", path)), -0.1),
    }
    found = rank(tmp_path / "people", runs["anna"], lambda folder: runs[folder.name])
    assert "ben breached pulp and has no score: the run has no device" in found.left_out[0]


def test_the_depth_axis_contains_the_reference(tmp_path, monkeypatch):
    """The reference rises further out of the tissue than the trainee."""
    higher = reach(1.0)
    higher[:, 2] += np.where(higher[:, 2] > 0.0, 1.0, 0.0)
    reference = saved(tmp_path / "r", higher)
    found = assess(saved(tmp_path / "t", reach(1.0)), reference)
    charts = []
    monkeypatch.setattr(assessment_files, "save", lambda chart, path: charts.append(chart))
    assessment_files.draw_assessment(found, tmp_path / "a.png")
    low, high = charts[0].axes[2].get_ylim()
    assert low <= found.depth.reference.min() < found.depth.values.min()
    assert high > found.depth.reference.max()


def test_trainees_of_a_ranking_differ_in_colour_or_marker():
    assert len({ranking._look(place) for place in range(49)}) == 49


def test_a_distance_from_the_path_in_free_air_exceeds_no_limit(tmp_path):
    path = reach(2.0)
    aside = path.copy()
    # Both paths leave the tissue at 1.86 s.
    aside[1900:, 1] += 2.0
    found = assess(saved(tmp_path / "t", aside), saved(tmp_path / "r", path))
    assert found.figures["deviation_mm"]["worst"] > 1.9 and not found.breaches


def test_least_distances_to_structures_of_both_runs_are_listed(tmp_path):
    runs = []
    for name, distances in (("t", {"canal": 0.4, "root": 3.0}), ("r", {"canal": 1.5})):
        run = saved(tmp_path / name, reach(1.0))
        clear = {key: {"least_distance_mm": value} for key, value in distances.items()}
        run.summary["keep_clear"] = clear
        runs.append(run)
    found = assess(*runs)
    assert found.figures["least_distance_mm"] == {"canal": {"trainee": 0.4, "reference": 1.5}}
    assert "smallest distance to canal: 0.400 mm against 1.500" in assessment_lines(found)


@pytest.mark.parametrize(
    ("shift_mm", "reason"),
    [(10.0, "touches nothing"), (0.0, "touches only where the reference run does not")],
)
def test_a_run_without_shared_contact_is_refused_and_left_out_of_a_ranking(
    tmp_path, shift_mm, reason
):
    """The path ends above the tissue, or the force begins where the reference has already left."""
    path = reach(1.0)
    reference = saved(tmp_path / "r", path)
    folder = tmp_path / "people" / "clara"
    run = saved(folder, path[:50] + np.array([0.0, 0.0, shift_mm]))
    if not shift_mm:
        at = run.trace.columns.index("model_force_z_N")
        run.trace.rows[:, at] = 1.0
    with pytest.raises(
        NoSharedContactError,
        match=f"run must touch the tissue where the reference run does, got a run that {reason}",
    ):
        assess(run, reference)
    with pytest.raises(InputError, match=f"clara {reason}"):
        rank(tmp_path / "people", reference, lambda _: run)
