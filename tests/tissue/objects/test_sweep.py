"""A scene at all combinations of values: names, what is kept, what fails, tables and pictures."""

import csv
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot

import tissue
from tissue import InputError
from tissue.cli.sweep import parse_values
from tissue.objects import sweep as module
from tissue.objects.html import figures_of, intervals_of
from tissue.objects.sweep import SweptRun
from tissue.scene.load import DroppedKeyWarning, changed, saved_text

QUICK = {"voxels.spacing_mm": 0.5, "duration_s": 0.05}


@pytest.fixture(scope="module")
def scene():
    """A block in coarse voxels, for a moment."""
    return tissue.load_scene("milling", QUICK)


@pytest.fixture(scope="module")
def pressed():
    """A wall that a hand presses for a moment."""
    return tissue.load_scene("wall", {"duration_s": 0.05})


@pytest.fixture
def out(tmp_path):
    """A folder that is not there yet."""
    return tmp_path / "sweep"


def plan(scene, changes):
    return module.planned(scene, changes, Path("out"))


def test_the_warning_on_a_removed_key_names_the_line_that_starts_the_sweep(out):
    changes = {"device": ["touch"], "motion.axis": [[0.0, 0.0, 1.0]], "materials": ["none.toml"]}
    with (
        pytest.warns(DroppedKeyWarning, match="^motion.max_feed_mm_s of the scene has") as warned,
        pytest.raises(InputError, match="materials must exist"),
    ):
        tissue.sweep(tissue.load_scene("pedicle"), changes, out=out)
    assert [each.filename for each in warned] == [__file__]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a.b=1,2.5", [1, 2.5]),
        ("a.b=[1,2,3],[4,5,6]", [[1, 2, 3], [4, 5, 6]]),
        ("a.b=[[0,0],[1,1]]", [[[0, 0], [1, 1]]]),
        ("a.b=touch, omni", ["touch", "omni"]),
        ('a.b="one, two",three', ["one, two", "three"]),
        ("a.b={x=1,y=2}", [{"x": 1, "y": 2}]),
    ],
)
def test_commas_in_brackets_and_quotes_belong_to_a_value(text, values):
    assert parse_values([text]) == {"a.b": values}


@pytest.mark.parametrize("text", ["a", "a=", "a=1,,2", "a=1,"])
def test_values_that_are_missing_are_refused(text):
    with pytest.raises(InputError, match=r"^--set .*got a"):
        parse_values([text])
    with pytest.raises(InputError, match=r"^--set .*got a=3"):
        parse_values(["a=1,2", "a=3"])


def test_folders_are_named_by_the_swept_keys_alone(scene):
    grid = plan(
        scene,
        {"motion.feed_mm_s": [2.0, 4.0], "voxels.margin_mm": [4.0], "tool.spin_rpm": [800, 1200]},
    )
    assert [each.name for each in grid][:2] == [
        "feed_mm_s=2,spin_rpm=800",
        "feed_mm_s=2,spin_rpm=1200",
    ]
    assert len(grid) == 4 and all(each.scene.voxels.margin_mm == 4.0 for each in grid)
    assert grid[3].scene.motion.feed_mm_s == 4.0 and grid[3].scene.tool.spin_rpm == 1200.0
    paths = [[[0, 0, 0], [0, 0, -1]], [[0, 0, 0], [1, 0, -1]]]
    assert [each.name for each in plan(scene, {"motion.points_mm": paths})] == [
        "points_mm=no1",
        "points_mm=no2",
    ]
    assert [each.name for each in plan(scene, {"voxels.margin_mm": [4.0]})] == ["milling"]


@pytest.mark.slow
def test_a_sweep_is_gone_on_with_and_lists_what_fails(scene, out, monkeypatch):
    changes = {"voxels.spacing_mm": [0.5, 1.5], "tool.diameter_mm": [4.0, 9.0]}
    found = tissue.sweep(scene, changes, out=out)
    assert list(found.failures) == ["spacing_mm=1.5,diameter_mm=4"]
    assert {path.name for path in out.iterdir()} == {
        ".tissue.json",
        *(each.name for each in found.finished),
        "sweep.csv",
        "sweep.png",
        "compare.png",
    }
    rows = list(csv.DictReader((out / "sweep.csv").open()))
    run = tissue.open_run(out / "spacing_mm=0.5,diameter_mm=9")
    assert float(rows[1]["removed_mm3"]) == pytest.approx(run.summary["removed_mm3"]["cortical"])
    assert "voxels.spacing_mm" in rows[2]["problem"] and rows[2]["peak_force_N"] == ""
    table = found.to_pandas()
    assert table["removed_mm3"].iloc[1] > table["removed_mm3"].iloc[0]
    assert "got 1.5" in found._repr_html_()

    (run.path / "summary.json").write_text(
        json.dumps(run.summary | {"status": "interrupted", "problem": "Ctrl-C"})
    )
    ran = []
    simulated = module.simulate
    monkeypatch.setattr(
        module,
        "simulate",
        lambda scene, **options: ran.append(scene) or simulated(scene, **options),
    )
    wider = changes | {"tool.diameter_mm": [9.0, 12.0]}
    again = tissue.sweep(scene, wider, out=out)
    assert [each.tool.diameter_mm for each in ran] == [9.0, 12.0, 12.0]
    assert len(again.finished) == 4
    tissue.sweep(scene, changes, out=out, overwrite=True)
    assert len(ran) == 6


OWN = '[{}]\nvalue = 5\nrange = [4, 6]\nsource = "a test"\nconfidence = "L"\n'


def test_values_and_files_are_checked_before_the_first_run(scene, out, tmp_path):
    own, other = tmp_path / "own.toml", tmp_path / "other.toml"
    own.write_text(OWN.format("cutting.bone.radial_edge_N_mm"), "utf-8")
    other.write_text(OWN.format("soft.liver.modulus_kPa"), "utf-8")
    for key, values, words in [
        ("motion.feed_mm_s", [3.0, -6.0], "motion.feed_mm_s must be .* got -6"),
        ("materials", [str(own), str(tmp_path / "none.toml")], "materials must exist, got .*none"),
        ("materials", [str(own), str(other)], r"Use cutting\.bone\..*_kg_m3; or remove"),
    ]:
        with pytest.raises(InputError, match=words):
            tissue.sweep(scene, {key: values}, out=out)
    assert not out.exists()


def test_figures_have_distances_and_intervals():
    loads = {"peak": 2.0, "mean_in_contact": 1.0}
    quantiles = {name: {"p05": 1.0, "p95": 3.0} for name in loads}
    summary = {
        "status": "complete",
        "simulated_s": 1.0,
        "force_N": loads,
        "torque_Nm": loads,
        "tick_us": {"median": 90.0, "p99": 100.0},
        "cuts": False,
        "keep_clear": {"canal": {"least_distance_mm": 6.13}},
        "events": [],
        "missed_deadlines": 0,
    }
    found = figures_of(summary)
    assert found["least_distance_canal_mm"] == 6.13
    assert not [name for name in found if name.startswith(("below_margin", "largest_rise"))]
    kept = {"canal": {"least_distance_mm": 6.13, "below_margin_s": 0.25}}
    rise = {"tissue": "pulp", "rise_K": 5.7, "time_s": 0.9, "rising_at_end": True}
    found = figures_of(summary | {"keep_clear": kept, "largest_rise": rise})
    assert found["below_margin_canal_s"] == 0.25 and found["largest_rise_pulp_K"] == 5.7
    assert intervals_of(summary) == {}
    band = {"force_N": quantiles, "torque_Nm": quantiles}
    assert intervals_of(summary | {"band": band})["mean_torque_Nm"] == (1.0, 3.0)


def test_a_legend_names_files_without_their_folders(out):
    runs = []
    for name, seed in (("a", 1), ("b", 2)):
        runs.append(SweptRun(name, {"seed": seed, "materials": f"/long/path/{name}.toml"}, out))
        vars(runs[-1]).update({"figures": {"peak_force_N": float(seed)}, "intervals": {}})
    (panel,) = module.Sweep(["seed", "materials"], runs).plot()
    assert panel.get_legend_handles_labels()[1] == ["a.toml", "b.toml"]
    pyplot.close(panel.figure)
    assert module.shortened("materials", ("a/own.toml", "b/own.toml")) == (
        "a/own.toml",
        "b/own.toml",
    )


def test_formats_are_written_and_runs_of_other_scenes_are_not_replaced(pressed, out):
    found = tissue.sweep(pressed, {"seed": [1, 2]}, out=out, formats=("svg", "npz"))
    assert {path.name for path in out.iterdir() if path.is_file()} >= {
        "sweep.csv",
        "compare.svg",
        "traces.npz",
    }
    assert not (out / "compare.png").exists()
    with np.load(out / "traces.npz") as table:
        assert table["run"].tolist() == [each.name for each in found.runs for _ in range(50)]
        assert set(table["seed"]) == {1.0, 2.0}
    with pytest.raises(InputError, match=r"format must be one of png, .*, got docx"):
        tissue.sweep(pressed, {"seed": [1, 2]}, out=out / "other", formats=("docx",))
    assert not (out / "other").exists()
    with pytest.raises(InputError, match=r"^seed must have different values, got 2 twice\."):
        tissue.sweep(pressed, {"seed": [1, 2, 2]}, out=out / "other")
    other = tissue.load_scene("wall", {"duration_s": 0.05, "hand": "novice"})
    with pytest.raises(
        InputError,
        match=r"out must contain only runs of this scene, got a run of another scene in .*seed=1",
    ):
        tissue.sweep(other, {"seed": [1, 2]}, out=out)
    foreign = out / "seed=3"
    foreign.mkdir()
    (foreign / "trace.csv").write_text("mine")
    found = tissue.sweep(pressed, {"seed": [2, 3]}, out=out)
    assert "seed=3" in found.failures
    assert (foreign / "trace.csv").read_text() == "mine"


def test_the_machine_is_no_figure_of_a_sweep(pressed, out):
    figures = {"peak_force_N": 60.447, "mean_force_N": 3.0, "tick_median_us": 90.0}
    others = {"peak_force_N": 60.447 * (1.0 + 1e-12), "mean_force_N": 3.3, "tick_median_us": 95.0}
    runs = [SweptRun("a", {"seed": 1}, out), SweptRun("b", {"seed": 2}, out)]
    for each, found in zip(runs, (figures, others), strict=True):
        vars(each).update({"figures": found, "intervals": {"mean_force_N": (2.0, 4.0)}})
    (panel,) = module.Sweep(["seed"], runs).plot()
    bars = [each.get_segments()[0].tolist() for each in panel.collections]
    assert bars == [[[1.0, 2.0], [1.0, 4.0]], [[2.0, 2.0], [2.0, 4.0]]]
    assert panel.get_ylim()[0] == 0.0 and panel.get_title(loc="left") == "mean force / N"
    pyplot.close(panel.figure)


def test_the_simulated_time_is_no_result_of_a_sweep(pressed, out):
    figures = {"simulated_s": 1.9, "peak_force_N": 0.6}
    others = {"simulated_s": 0.95, "peak_force_N": 1.2, "left_region_s": 0.4}
    runs = [SweptRun("a", {"seed": 1}, out), SweptRun("b", {"seed": 2}, out)]
    for each, found in zip(runs, (figures, others), strict=True):
        vars(each).update({"figures": found, "intervals": {}})
    made = module.Sweep(["seed"], runs)
    (panel,) = made.plot()
    assert panel.get_title(loc="left") == "peak force / N"
    pyplot.close(panel.figure)
    (panel,) = made.plot(["simulated_s"])
    assert panel.get_title(loc="left") == "simulated / s"
    pyplot.close(panel.figure)


def test_long_names_on_the_axis_do_not_overlap(out):
    runs = []
    for number, name in enumerate(("density_minus20", "density", "density_plus20")):
        runs.append(SweptRun(name, {"anatomy.density_file": f"/hip/{name}.nrrd"}, out))
        figures = {f"{part}_N": 1.0 + number for part in "abcd"}
        vars(runs[-1]).update({"figures": figures, "intervals": {}})
    panels = module.Sweep(["anatomy.density_file"], runs).plot()
    chart = panels[0].figure
    for panel in panels:
        assert all(text.get_rotation() > 0.0 for text in panel.get_xticklabels())
    assert len({panel.get_subplotspec().rowspan.start for panel in panels}) == 2
    assert len({panel.get_subplotspec().colspan.start for panel in panels}) == 2
    pyplot.close(chart)


@pytest.mark.slow
def test_a_band_of_each_run(scene, out):
    """Runs without the requested band are run again; runs with it are kept."""
    changes = {"motion.feed_mm_s": [3.0, 9.0]}
    tissue.sweep(scene, changes, out=out)
    shares = []
    found = tissue.sweep(
        scene, changes, out=out, band=16, progress=lambda _, share: shares.append(share)
    )
    assert shares == sorted(shares)
    assert not found.failures
    assert [each.open().summary["band"]["samples"] for each in found.runs] == [16, 16]
    assert all(len(each.intervals) == 4 for each in found.runs)
    before = [(each.path / "band.csv").stat().st_mtime_ns for each in found.runs]
    tissue.sweep(scene, changes, out=out, band=16)
    assert [(each.path / "band.csv").stat().st_mtime_ns for each in found.runs] == before
    with pytest.raises(InputError, match=r"band must be in \[16, 65536\]"):
        tissue.sweep(scene, changes, out=out, band=3)


def test_a_stop_keeps_what_is_finished(pressed, out, monkeypatch):
    simulated = module.simulate

    def stopped(scene, **options):
        if scene.seed == 2:
            raise KeyboardInterrupt
        return simulated(scene, **options)

    monkeypatch.setattr(module, "simulate", stopped)
    with pytest.raises(KeyboardInterrupt):
        tissue.sweep(pressed, {"seed": [1, 2]}, out=out)
    monkeypatch.setattr(module, "simulate", simulated)
    before = (out / "seed=1/trace.csv").stat().st_mtime_ns
    assert len(tissue.sweep(pressed, {"seed": [1, 2]}, out=out).finished) == 2
    assert (out / "seed=1/trace.csv").stat().st_mtime_ns == before


@pytest.mark.slow
def test_the_command_runs_in_processes_and_names_what_failed(command, out):
    values = ("voxels.spacing_mm=0.5,1.5", "tool.diameter_mm=4,9", "duration_s=0.05")
    words = [word for each in values for word in ("--set", each)]
    code, printed, err = command("sweep", "milling", *words, "--out", out, "--workers", 2)
    assert (
        code == 1
        and "milling: 3 of 4 runs" in printed
        and "spacing_mm=1.5,diameter_mm=4: voxels.spacing_mm must be" in err
    )
    run = tissue.open_run(out / "spacing_mm=0.5,diameter_mm=9")
    assert "sweep.csv" in printed and run.status == "complete"
    alone = tissue.simulate(tissue.load_scene("milling", QUICK | {"tool.diameter_mm": 9.0}))
    assert (run.trace.rows == alone.trace.rows).all()


SCRIPT = """
import tissue
LIGHT = {{"mass_kg": 0.03, "damping_N_s_m": 0.2, "force_limit_N": 1.0}}
{top}
if __name__ == "__main__":
    {below}
    found = tissue.sweep("wall", {{"device": ["sprung"], "duration_s": [0.01, 0.02]}}, out="out", workers=2)
    print([each.problem for each in found.runs])
"""
CALL = 'tissue.register.device("sprung", LIGHT)'


@pytest.mark.slow
def test_processes_know_the_parts_that_a_script_registers_at_its_top(tmp_path):
    """Processes know the parts that a script registers at its top, because they import it.

    Runs with parts that are registered below its last lines fail with a sentence.
    """
    ended = []
    for name, calls in (
        ("top", {"top": CALL, "below": "pass"}),
        ("below", {"top": "", "below": CALL}),
    ):
        (tmp_path / name).mkdir()
        file = tmp_path / name / "script.py"
        file.write_text(SCRIPT.format(**calls))
        ended.append(
            subprocess.run(
                [sys.executable, file], capture_output=True, text=True, check=False, cwd=file.parent
            )
        )
    assert (ended[0].returncode, ended[0].stdout) == (0, "['', '']\n")
    assert "device.kind must be one of" in ended[1].stdout and "got sprung" in ended[1].stdout
    assert not list((tmp_path / "below" / "out").glob("*/trace*"))


def test_a_sweep_with_a_fidelity_is_continued(pressed, out, monkeypatch):
    def at_settings(scene, **_):
        delay_ms = 1 if scene.fidelity.force_error == 0.5 else 0
        return changed(scene, {"fidelity": None, "coupling.delay_ms": delay_ms}), "a later force"

    monkeypatch.setattr("tissue.evaluation.charts.frontier.with_fidelity", at_settings)
    demanding = changed(pressed, {"device": "touch", "fidelity.force_error": 0.5})
    assert not tissue.sweep(demanding, {"seed": [1, 2]}, out=out).failures
    before = (out / "seed=1/trace.csv").stat().st_mtime_ns
    assert len(tissue.sweep(demanding, {"seed": [1, 2]}, out=out).finished) == 2
    assert (out / "seed=1/trace.csv").stat().st_mtime_ns == before
    stricter = changed(demanding, {"fidelity.force_error": 0.1})
    with pytest.raises(
        InputError,
        match=r"out must contain only runs of this scene, got a run of another scene in .*seed=1",
    ):
        tissue.sweep(stricter, {"seed": [1, 2]}, out=out)


def test_a_run_of_a_scene_with_more_tables_is_another(tmp_path):
    whole = tissue.load_scene("molar")
    (tmp_path / "scene.toml").write_text(saved_text(whole) + "\n# centre_mm = [0.0, 0.0, 0.0]\n")
    (tmp_path / "summary.json").write_text('{"status": "complete"}')
    run = SweptRun("molar", {}, tmp_path, scene=whole)
    assert module._unfinished([run], overwrite=False) == []
    part = replace(run, scene=changed(whole, {"stress": None}))
    with pytest.raises(InputError, match="out must contain only runs of this scene, got"):
        module._unfinished([part], overwrite=False)
    with pytest.raises(InputError, match=r"summary\.json"):
        _ = run.figures
