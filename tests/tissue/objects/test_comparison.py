"""Comparison of runs: figures, differences of their scenes, and their forces in one picture."""

import csv
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib import pyplot

import tissue
from tissue import InputError
from tissue.objects.comparison import _notes
from tissue.objects.plots import overlay
from tissue.simulation.trace import Table, TraceLayout


@pytest.fixture(scope="module")
def other(run, tmp_path_factory):
    """Return a run of the same block, cut faster and in other voxels."""
    scene = tissue.load_scene(
        "milling", {"voxels.spacing_mm": 0.5, "duration_s": 0.3, "motion.feed_mm_s": 9.0}
    )
    made = tissue.simulate(scene)
    made.save(tmp_path_factory.mktemp("runs") / "faster", pictures=False)
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


def pressing(force_N, *, speed_mm_s):
    """Return a trace of a tool that moves down against a force that depends on its depth alone."""
    layout = TraceLayout.of(("bone",))
    time = np.arange(0.0, 0.4, 1e-3)
    rows = np.zeros((len(time), len(layout.columns)))
    depth = speed_mm_s * time - 0.2
    rows[:, layout.time], rows[:, layout.tip.start + 2] = time, -depth
    rows[:, layout.quaternion.stop - 1] = 1.0
    rows[:, layout.contact] = depth > 0.0
    rows[:, layout.wrench.start + 2] = np.where(depth > 0.0, force_N * depth, 0.0)
    return Table(layout.columns, rows, ("bone",))


def test_over_depth_the_pace_does_not_count():
    """Over depth the pace does not count.

    A force proportional to depth is run at two paces, and a third one is 1.5 times as large.
    """
    slow, fast, hard = (
        pressing(3.0, speed_mm_s=4.0),
        pressing(3.0, speed_mm_s=6.0),
        pressing(4.5, speed_mm_s=4.0),
    )
    apart = [
        line.get_xydata()
        for line in overlay({"slow": slow, "fast": fast, "hard": hard}, over="depth")[2].lines
    ]
    assert apart[0][:, 1].max() < 0.03  # a tick of the depth between the first rows in contact
    place, gap = apart[1].T
    assert gap[-1] == pytest.approx(1.5 * place[-1], rel=0.02) and place[-1] > 1.0
    assert overlay({"slow": slow, "fast": fast})[2].lines[0].get_ydata().max() > 1.0
    with pytest.raises(InputError, match="above without contact"):
        overlay({"above": pressing(3.0, speed_mm_s=0.1)}, over="depth")


def test_files_are_written_once(run, other, tmp_path):
    found = tissue.compare(run, other)
    table, picture = found.save(tmp_path / "out", over="depth")
    rows = list(csv.DictReader(table.open()))
    assert float(
        next(row["faster"] for row in rows if row["figure"] == "removed_mm3")
    ) == pytest.approx(other.summary["removed_mm3"]["cortical"])
    assert picture.stat().st_size > 20_000 and not pyplot.get_fignums()
    with pytest.raises(InputError, match="out must not hold another comparison"):
        found.save(tmp_path / "out")


def test_lengths_are_compared_to_the_tick(run):
    runs = {
        name: SimpleNamespace(status="complete", scene=run.scene, summary={"simulated_s": length_s})
        for name, length_s in (("a", 10.001), ("b", 10.002))
    }
    assert any("a 10.001 s, b 10.002 s" in note for note in _notes(runs))
