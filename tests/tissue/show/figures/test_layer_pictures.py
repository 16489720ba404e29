"""The section through a run's deepest point and the force over depth, and what goes into them."""

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.show.figures.force_depth import first_descent
from tissue.show.figures.section import _handles, draw_section, section_of

pytest.importorskip("pyvista")

SPACING_MM = 0.4


@pytest.fixture(scope="module")
def run():
    """A coarse drilling into bone of three layers."""
    changes = {"voxels.spacing_mm": SPACING_MM, "motion.feed_mm_s": 5.0, "duration_s": 0.6}
    return simulate(load_scene("glenoid", changes))


def test_section_holds_the_voxels_at_the_deepest_point(run):
    last = len(run.trace.rows) - 1
    section = section_of(run, last)
    volume = run.parts.volume
    *_, normal = section.axes
    assert sorted(section.axes) == [0, 1, 2] and section.row == last
    deepest = run.trace["tool_z_mm"].argmin()
    assert section.place_mm == run.trace[f"tool_{'xyz'[normal]}_mm"][deepest]
    index = int((section.place_mm * 1e-3 - volume.origin_m[normal]) / volume.spacing_m)
    np.testing.assert_array_equal(section.layer, np.take(volume.layer, index, axis=normal))
    removed = np.take(volume.fraction - run.remaining, index, axis=normal) / 255
    np.testing.assert_allclose(section.start - section.left, removed, atol=1e-12)
    assert removed.sum() > 10.0
    u0, u1, v0, v1 = section.extent_mm
    assert section.start.shape == (round((u1 - u0) / SPACING_MM), round((v1 - v0) / SPACING_MM))


def test_legend_and_title_of_a_section_name_what_is_drawn(run, tmp_path):
    section = section_of(run, len(run.trace.rows) - 1)
    labels = [each.get_label() for each in _handles(run, section)]
    gone = (section.start >= 0.5) & (section.start - section.left >= 0.5)
    layers = [f"removed {run.volume.layer_names[i]}" for i in np.unique(section.layer[gone])]
    assert layers and [each for each in labels if each.startswith("removed")] == layers
    draw_section(run, tmp_path / "section.svg")
    title = (tmp_path / "section.svg").read_text()
    assert "tool and bone at" in title and "through the deepest point in contact" in title


def test_descent_ends_where_the_tool_is_deepest_before_it_rises():
    down = np.linspace(1.0, -2.0, 301)
    shaken = down + 0.05 * np.sin(np.arange(301))
    for descent in (down, shaken):
        path = np.concatenate(
            [
                descent,
                np.full(50, descent[-1]),
                np.linspace(descent[-1], 0.0, 100),
                np.linspace(0.0, -5.0, 100),
            ]
        )
        rows = first_descent(path, path < 0.5)
        assert path[rows.start] == pytest.approx(path[np.argmax(path < 0.5)] + 0.2, abs=0.1)
        assert path[rows.stop - 1] == descent.min()
        assert rows.stop <= 351
    assert first_descent(down, np.zeros(301, dtype=bool)) == slice(0, 0)
    assert first_descent(down, np.ones(301, dtype=bool)) == slice(0, 301)
