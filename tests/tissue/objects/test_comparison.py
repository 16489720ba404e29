"""Comparison of runs: figures, differences of their scenes, and their forces in one picture."""

import csv
import json
import shutil
from types import SimpleNamespace

import numpy as np
import pandas
import pytest
from matplotlib import pyplot
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

import tissue
from tissue import InputError
from tissue.objects.comparison import _notes, _stated
from tissue.objects.overlay import Curve, _band_ends, chosen_over, overlay
from tissue.simulation.trace import Table, TraceLayout


@pytest.fixture(scope="module")
def other(run):
    """Return a run of the same block, cut faster and in other voxels."""
    scene = tissue.load_scene(
        "milling", {"voxels.spacing_mm": 0.5, "duration_s": 0.3, "motion.feed_mm_s": 9.0}
    )
    made = tissue.simulate(scene)
    made.save(run.path.with_name("faster"), pictures=False)
    return made


@pytest.fixture(autouse=True)
def closed_figures():
    """No figure of pyplot outlives its test."""
    yield
    pyplot.close("all")


def test_figures_and_keys_that_differ(run, other):
    found = tissue.compare(run, other.path)
    assert (
        list(found.runs) == ["milling", "faster"]
        and repr(found) == "<comparison of milling, faster: 2 keys differ>"
    )
    assert found.scene_differences == {
        "voxels.spacing_mm": (0.4, 0.5),
        "motion.feed_mm_s": (5.0, 9.0),
    }
    table = found.to_pandas()
    peaks = [each.summary["force_N"]["peak"] for each in (run, other)]
    assert table.loc["peak_force_N"].to_list() == pytest.approx(
        [*peaks, peaks[1] - peaks[0], peaks[1] / peaks[0] - 1.0]
    )
    assert list(table.columns) == ["milling", "faster", "faster - milling", "faster / milling - 1"]
    assert table.attrs["scene_differences"] == found.scene_differences


def test_equal_runs_differ_in_nothing(run, back):
    found = tissue.compare(run, back)
    assert list(found.runs) == ["milling 1", "milling 2"]
    assert found.scene_differences == {} and found.lines()[0] == "the scenes are the same"
    assert all(apart == 0.0 for _, (_, _, apart, _) in found.rows()[1])


def test_events_of_parts_that_one_run_leaves_out_are_not_counted(run, tmp_path):
    shutil.copytree(run.path, tmp_path / "hot")
    summary = json.loads((tmp_path / "hot/summary.json").read_text())
    events = [*summary["events"], {"time_s": 0.1, "what": "the thermal dose of bone passes 16 min"}]
    (tmp_path / "hot/summary.json").write_text(json.dumps(summary | {"events": events}))
    scene = (tmp_path / "hot/scene.toml").read_text()
    (tmp_path / "hot/scene.toml").write_text(f"heat = true\n{scene.replace('heat = false', '')}")
    found = tissue.compare(run, tmp_path / "hot")
    assert [each["events"] for each in found.figures.values()] == [len(summary["events"])] * 2
    note = "the number of events leaves out events of heat, which not all runs compute"
    assert found.notes[-1] == note
    both = tissue.compare(tmp_path / "hot", tmp_path / "hot")
    assert [each["events"] for each in both.figures.values()] == [len(events)] * 2
    assert note not in both.notes


def pressing(force_N, *, speed_mm_s):
    """Return a trace of a tool that moves down against a force that depends on its depth alone."""
    layout = TraceLayout.of(("bone",))
    time = np.arange(0.0, 0.4, 1e-3)
    rows = np.zeros((len(time), len(layout.columns)))
    depth = speed_mm_s * time - 0.2
    at = {quantity: place.start for quantity, place in layout.at.items()}
    rows[:, at["time"]], rows[:, at["tip"] + 2] = time, -depth
    rows[:, at["quaternion"] + 3] = 1.0
    rows[:, at["contact"]] = depth > 0.0
    rows[:, at["wrench"] + 2] = np.where(depth > 0.0, force_N * depth, 0.0)
    return Table(layout.columns, rows, ("bone",))


def test_over_depth_the_pace_does_not_count():
    """Over depth the pace does not count.

    A force proportional to depth is run at two paces, and a third one is 1.5 times as large.
    """
    slow, fast, hard = (
        Curve("slow", pressing(3.0, speed_mm_s=4.0)),
        Curve("fast", pressing(3.0, speed_mm_s=6.0)),
        Curve("hard", pressing(4.5, speed_mm_s=4.0)),
    )
    assert chosen_over([slow, fast]) == "depth"
    # a tick of the depth between the first rows in contact
    assert overlay([slow, fast])[-1].lines[0].get_ydata().max() < 0.03
    place, gap = overlay([slow, hard])[-1].lines[0].get_xydata().T
    assert gap[-1] == pytest.approx(1.5 * place[-1], rel=0.02) and place[-1] > 1.0
    assert overlay([slow, fast], over="time")[-1].lines[0].get_ydata().max() > 1.0
    # thrust alone: no force across the tool, no torque, and no difference of three runs
    assert len(overlay([slow, fast, hard])) == 1
    above = Curve("above", pressing(3.0, speed_mm_s=0.1))
    assert chosen_over([above]) == "time"
    with pytest.raises(InputError, match="got above, which has no contact"):
        overlay([above], over="depth")


def test_a_tool_that_slides_is_drawn_over_time():
    trace = pressing(3.0, speed_mm_s=4.0)
    trace.rows[:, trace.columns.index("tool_x_mm")] = 10.0 * trace["time_s"]
    assert chosen_over([Curve("slides", trace)]) == "time"


def test_band_ends_are_quantiles_in_the_frame_of_the_tool():
    """The ends of a rotated tool are those of its components, not of the world's."""
    rng = np.random.default_rng(3)
    force, torque = rng.normal((1.0, -2.0, 3.0), size=(2, 400, 1, 3))
    sizes = [np.linalg.norm(each, axis=2, keepdims=True) for each in (force, torque)]
    loads = np.concatenate([force, sizes[0], torque, sizes[1]], axis=2)
    band = SimpleNamespace(quantiles=np.quantile(loads, (0.05, 0.25, 0.5, 0.75, 0.95), axis=0))
    turn = Rotation.from_euler("xz", [90.0, 90.0], degrees=True)
    low, high = _band_ends(band, turn.as_matrix()[None], np.arange(400), about_axis=True)
    local = turn.inv().apply(force[:, 0])
    expected = [local[:, 2], local[:, 0], local[:, 1], turn.inv().apply(torque[:, 0])[:, 2]]
    np.testing.assert_allclose(low[0], np.quantile(expected, 0.05, axis=1))
    np.testing.assert_allclose(high[0], np.quantile(expected, 0.95, axis=1))
    oblique = Rotation.from_euler("x", 20.0, degrees=True).as_matrix()[None]
    assert _band_ends(band, oblique, np.arange(400), about_axis=True) == (None, None)


def test_a_band_of_other_depths_is_drawn_over_time_alone():
    trace = pressing(3.0, speed_mm_s=4.0)
    quantiles = np.zeros((5, len(trace.rows), 8))
    band = SimpleNamespace(quantiles=quantiles)
    assert chosen_over([Curve("path", trace, band)]) == "depth"
    curve = Curve("held", trace, band, is_path_given=False)
    assert chosen_over([curve]) == "time"
    assert legend(overlay([curve])) == ["held"]
    assert legend(overlay([curve], over="depth")) == ["held (band not drawn)"]


def legend(panels):
    """Return the texts of the legend of a figure."""
    return [text.get_text() for text in panels[0].figure.legends[0].get_texts()]


def test_the_legend_states_what_differs(run, other):
    found = tissue.compare(run, other)
    assert legend(found.plot()) == [
        "milling: spacing 0.4 mm, feed 5 mm/s",
        "faster: spacing 0.5 mm, feed 9 mm/s",
    ]
    assert legend(tissue.compare(run, other, names=("a", "b")).plot()) == ["a", "b"]


def test_the_legend_names_the_folders_of_saved_runs(other, tmp_path):
    for name in ("p04", "p10"):
        shutil.copytree(other.path, tmp_path / name)
    two = [tissue.Run.load(tmp_path / name) for name in ("p04", "p10")]
    found = tissue.compare(*two)
    assert legend(found.plot()) == ["p04", "p10"]
    found.scene_differences = {"seed": (404, 610), "device.hand": ("novice", "expert")}
    assert legend(found.plot()) == ["p04: seed 404, hand novice", "p10: seed 610, hand expert"]
    for name in ("p04", "p10"):
        shutil.copytree(other.path, tmp_path / "class" / name / "attempt-1")
    attempts = [tmp_path / "class" / name / "attempt-1" for name in ("p04", "p10")]
    assert list(tissue.compare(*attempts).runs) == ["p04", "p10"]
    attempts[1] = attempts[1].rename(attempts[1].with_name("attempt-2"))
    assert list(tissue.compare(*attempts).runs) == ["p04/attempt-1", "p10/attempt-2"]


def test_keys_are_stated_in_words():
    keys = ("device.kind", "tool.spin_rpm", "anatomy.length_mm", "tool.length_mm")
    values = ("omni", 800.0, 2.0, None)
    stated = [_stated(key, value, keys) for key, value in zip(keys, values, strict=True)]
    assert stated == ["device omni", "spin 800 rpm", "anatomy length 2 mm", "no tool length"]


def test_an_empty_file_of_constants_is_named_built_in(run, other):
    found = tissue.compare(run, other)
    found.scene_differences = {"materials": ("", "mine.toml"), "description": ("", "a")}
    first, second = found.runs
    assert found.lines()[:2] == [
        f"materials: {first} built-in, {second} mine.toml",
        f"description: {first} , {second} a",
    ]
    assert "built-in" in found._repr_html_()
    assert _stated("materials", "", ("materials",)) == "materials built-in"


def test_figures_that_are_equal_are_named_in_one_line(run, back):
    found = tissue.compare(run, back)
    assert found.texts()[1] == []
    assert found.lines()[1].startswith("the same in all runs: simulated_s, peak_force_N")
    assert ", number of events" in found.lines()[1]


def test_the_traces_of_all_runs_are_one_table(run, other, tmp_path):
    found = tissue.compare(run, other, names=("a", "b"))
    written = found.save(tmp_path / "out", formats=("svg", "pdf", "mat", "parquet"))
    assert [path.name for path in written] == [
        "compare.csv",
        "compare.svg",
        "compare.pdf",
        "traces.mat",
        "traces.parquet",
    ]
    table = pandas.read_parquet(written[-1])
    assert table["run"].unique().tolist() == ["a", "b"]
    for name, one in (("a", run), ("b", other)):
        mine = table[table["run"] == name]
        assert set(mine["motion_feed_mm_s"]) == {one.scene.motion.feed_mm_s}
        np.testing.assert_array_equal(mine["model_force_z_N"], one.trace["model_force_z_N"])
        assert mine["layer"].tolist() == one.trace["layer"].tolist()
    held = loadmat(written[-2])["trace"][0, 0]
    np.testing.assert_array_equal(held["time_s"].ravel(), table["time_s"])
    with pytest.raises(InputError, match="format must be one of png, svg, pdf, parquet"):
        found.save(tmp_path / "other", formats=("xlsx",))


def test_files_are_written_once(run, other, tmp_path):
    found = tissue.compare(run, other)
    table, picture = found.save(tmp_path / "out", over="depth")
    rows = list(csv.DictReader(table.open()))
    assert float(
        next(row["faster"] for row in rows if row["figure"] == "removed_mm3")
    ) == pytest.approx(other.summary["removed_mm3"]["cortical"])
    assert picture.stat().st_size > 20_000 and not pyplot.get_fignums()
    with pytest.raises(InputError, match="out must not contain another comparison"):
        found.save(tmp_path / "out")


def test_lengths_are_compared_to_the_tick(run):
    figures = {name: {"simulated_s": length_s} for name, length_s in (("a", 10.001), ("b", 10.002))}
    notes = _notes(dict.fromkeys(figures, run), figures)
    assert any("a 10.001 s, b 10.002 s" in note for note in notes)


def test_a_run_that_was_stopped_has_the_time_and_loads_of_its_trace(run):
    stopped = run.path.with_name("stopped")
    shutil.copytree(run.path, stopped)
    rows = (stopped / "trace.csv").read_text().splitlines(keepends=True)
    (stopped / "trace.csv").write_text("".join(rows[:201]))
    early = {"format": 1, "tissue": "0.2.0", "scene": "milling", "layers": run.summary["layers"]}
    (stopped / "summary.json").write_text(json.dumps(early | {"status": "interrupted"}))
    found = tissue.compare(run, stopped)
    size = np.linalg.norm(run.trace.vectors("model_force", "N"), axis=1)[:200]
    assert found.figures["stopped"]["simulated_s"] == pytest.approx(0.2)
    assert found.figures["stopped"]["peak_force_N"] == pytest.approx(size.max(), rel=1e-6)
    assert "milling 0.3 s, stopped 0.2 s" in " ".join(found.notes)
    (stopped / "trace.csv").write_text("".join([*rows[:100], f"?{rows[100]}", *rows[101:]]))
    with pytest.raises(InputError, match=r"in line 101 of .*stopped.trace\.csv"):
        tissue.compare(run, stopped)
    (stopped / "trace.csv").unlink()
    found = tissue.compare(run, stopped)
    assert found.figures["stopped"] == {} and not any("loads are from" in n for n in found.notes)
    without = "Its trace.csv is missing or holds no tick, so it has no figures"
    assert any(note.endswith(without) for note in found.notes)
