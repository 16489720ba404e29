"""Rules of pictures.

Flickering values make no stripes, and SVG files have words and vectors.
"""

from xml.etree import ElementTree

import numpy as np
import pytest

import tissue
from meshes.base.errors import InputError
from tissue.show.figures import force_time
from tissue.show.figures.force_depth import draw_force_depth
from tissue.show.figures.force_time import constant_intervals, draw_force_torque, joined_events
from tissue.simulation.run_folder import picture_format

SVG = "{http://www.w3.org/2000/svg}"


def test_a_contact_that_flickers_is_one_band():
    names = np.repeat(["none", "in", "none", "in", "none", "in", "none"], [50, 2, 3, 4, 1, 200, 40])
    assert constant_intervals(names, shortest=20) == [
        (0, 60, "none"),
        (60, 260, "in"),
        (260, 300, "none"),
    ]
    assert len(constant_intervals(names)) == 7
    starts = np.repeat(["in", "none", "in"], [3, 30, 30])
    assert constant_intervals(starts, shortest=20) == [(0, 33, "none"), (33, 63, "in")]
    assert constant_intervals(names[:0], shortest=20) == []


def test_an_event_that_comes_again_at_once_is_marked_once():
    events = [
        (0.1, "pressed 1 mm"),
        (0.11, "pressed 2 mm"),
        (0.125, "pressed 3 mm"),
        (0.5, "pressed 3 mm"),
        (0.5, "b"),
    ]
    assert joined_events(events) == [events[0], events[3], events[4]]


@pytest.fixture(scope="module")
def molar():
    """The first part of the drilling of a molar, without stress, in coarse voxels."""
    changes = {"voxels.spacing_mm": 0.25, "stress": None, "duration_s": 0.8}
    return tissue.simulate(tissue.load_scene("molar", changes))


def test_the_force_picture_names_every_line(molar, tmp_path):
    file = tmp_path / "force.svg"
    draw_force_torque(molar, file)
    words = _words(file)
    assert words >= {"along x", "along y", "along z", "force / N", "time / s"}
    # The shade is the column `layer`, the layer of the largest contact area.
    assert "largest contact: enamel" in words and "tip in enamel" not in words
    first = file.read_bytes()
    draw_force_torque(molar, file)
    assert file.read_bytes() == first


def test_the_force_over_depth_has_the_mean_of_the_ticks_of_each_layer(molar, tmp_path):
    file = tmp_path / "depth.svg"
    assert draw_force_depth(molar, file) is None
    force = np.linalg.norm(molar.trace.vectors("model_force", "N"), axis=1)
    mean = force[molar.trace["layer"] == "enamel"].mean()
    assert f"enamel: mean {mean:.2g} N over the whole run" in _words(file)
    assert not any("in the run: " in word for word in _words(file))


def test_the_force_over_depth_states_an_extreme_that_it_does_not_draw(tmp_path):
    changes = {"motion.points_mm": [[0, 0, 0.3], [0, 0, -1], [1, 0, -1]], "motion.feed_mm_s": 5.0}
    coarse = {"voxels.spacing_mm": 0.25, "stress": None}
    run = tissue.simulate(tissue.load_scene("molar", coarse | changes))
    least = run.trace["dentin_over_pulp_mm"]
    time_s = run.trace["time_s"][least.argmin()]
    # the path is at a depth of 1 mm from 0.26 s on
    assert time_s > 0.3
    file = tmp_path / "depth.svg"
    draw_force_depth(run, file)
    assert f"smallest in the run: {least.min():.3g} mm at {time_s:.3g} s" in _words(file)


def test_the_steepest_change_of_the_played_force_is_in_contact(monkeypatch, tmp_path):
    run = tissue.simulate(tissue.load_scene("wall", {"duration_s": 0.6}))
    # a hand that accelerates before the contact
    run.trace.rows[2:4, run.trace.columns.index("raw_force_z_N")] = 100.0
    charts = []
    monkeypatch.setattr(force_time, "save", lambda chart, path: charts.append(chart))
    force_time.draw_played(run, tmp_path / "played.png")
    shown_s = charts[0].axes[1].lines[0].get_xdata()
    touched_s = run.trace["time_s"][run.trace["contact_mm2"] > 0.0]
    assert shown_s[0] > 0.003 and shown_s[-1] > touched_s[0]


def test_an_unknown_format_is_refused_before_anything_is_written(molar, tmp_path):
    with pytest.raises(InputError, match="jpeg"):
        molar.save(tmp_path / "run", pictures="jpeg")
    assert not (tmp_path / "run").exists()
    assert [picture_format(each) for each in (True, False, "pdf")] == ["png", None, "pdf"]


def _words(file):
    """Texts of an SVG file."""
    return {
        "".join(each.itertext()) for each in ElementTree.parse(file).getroot().iter(f"{SVG}text")
    }
