"""A hand that leads the tool out of the simulated region, compared with a larger region."""

import re

import numpy as np
import pytest
import tomli_w
import trimesh
from scipy.spatial.transform import Rotation

import tissue
from meshes.shapes.sdf import box
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.haptics.device.recorded import RecordedDevice
from tissue.models.bone.region_end import RegionEnd
from tissue.models.tissue_model import ToolMotion
from tissue.objects.html import figures_of
from tissue.show.figures.section import draw_section
from tissue.show.report.page import run_rows

BLOCK = {
    "name": "block",
    "anatomy": {"kind": "block", "size_mm": [8.0, 8.0, 10.0]},
    "voxels": {"spacing_mm": 0.3},
    "tool": {"kind": "ball-burr", "diameter_mm": 2.0, "spin_rpm": 40000.0},
    "motion": {"kind": "path", "points_mm": [[0, 0, 1], [0, 0, -1]], "feed_mm_s": 20.0},
    "device": {"kind": "touch", "coupling": {"stiffness_N_m": 300.0, "force_scale": 0.01}},
    "keep_clear": {"files": {"plate": "plate.stl"}},
    "duration_s": 0.5,
}
DEPTH_MM = 7.0
"""Depth to which the hand moves; the path has 1 mm."""


def by_hand(folder, margin_mm):
    plate = trimesh.creation.box((20.0, 20.0, 1.0))
    plate.apply_translation([0.0, 0.0, -5.5])
    plate.export(folder / "plate.stl")
    (folder / "scene.toml").write_text(tomli_w.dumps(BLOCK))
    scene = tissue.load_scene(folder / "scene.toml", {"voxels.margin_mm": margin_mm})
    times = 1e-3 * np.arange(501)
    path = np.zeros((501, 3))
    path[:, 2] = 1e-3 * np.interp(times, [0.0, 0.45], [1.0, -DEPTH_MM])
    return tissue.simulate(scene, device=RecordedDevice(times, path))


def reported(run, words):
    return [event["what"] for event in run.summary["events"] if words in event["what"]]


def reported_s(run, words):
    (time,) = [each["time_s"] for each in run.summary["events"] if words in each["what"]]
    return time


def test_a_tool_that_leaves_the_region_is_reported_once_and_breaks_or_breaches_nothing(tmp_path):
    run = by_hand(tmp_path, 0.5)
    assert run.trace["tool_z_mm"].min() < -5.0  # in the plate, below the end of the region
    assert len(reported(run, "left the simulated region")) == 1
    assert reported(run, "Use a voxels.margin_mm above 0.5")
    assert not reported(run, "breached") and not reported(run, "broke through")
    assert "break_through" not in run.summary
    least_mm = run.summary["keep_clear"]["plate"]["least_distance_mm"]
    assert least_mm > 0.0
    # the picture states the distance of the summary, although the tool enters the plate later
    assert run.trace["distance_plate_mm"].min() < 0.0
    draw_section(run, tmp_path / "section.svg")
    drawn = (tmp_path / "section.svg").read_text()
    assert f"{least_mm:.3f} mm away" in drawn
    # row, summary and picture state until when the distance holds
    left_s = reported_s(run, "left the simulated region")
    assert run.summary["left_region_s"] == left_s and f"up to {left_s:.3f} s" in drawn
    row = dict(run_rows(run.summary))["smallest distance to plate"]
    found = run.summary["keep_clear"]["plate"]
    x, y, z = (f"{round(each, 3) + 0.0:g}" for each in found["least_distance_tip_mm"])
    assert found["least_distance_at_s"] <= left_s
    assert row == (
        f"{least_mm:.3f} mm at {found['least_distance_at_s']:.3f} s, tip at ({x}, {y}, {z}) mm "
        f"(up to {left_s:.3f} s; the tool then left the simulated region)"
    )
    (layer,) = run.summary["removed_mm3"]
    removed = dict(run_rows(run.summary))[f"removed {layer}"]
    assert removed.endswith(f" mm³ (not valid after {left_s:.3f} s)")
    force = dict(run_rows(run.summary))["force, peak / mean in contact"]
    assert force.endswith(f" N (not valid after {left_s:.3f} s)")
    assert figures_of(run.summary)["left_region_s"] == left_s
    margin_mm = float(re.search(r"margin_mm = ([0-9.]+)", run.parts.notes["simulated region"])[1])
    deepest_mm = -run.trace["tool_z_mm"].min()
    # the region ends a margin below the path's depth of 1 mm, up to voxels of 0.3 mm
    assert margin_mm == pytest.approx(deepest_mm - 1.0, abs=0.7)
    assert "path_distance_mm" not in run.summary  # no simulated hand follows the path


def test_in_a_larger_region_the_breach_is_reported(tmp_path):
    run = by_hand(tmp_path, 9.0)
    assert not reported(run, "left the simulated region")
    assert reported(run, "breached plate")
    assert "left_region_s" not in run.summary and "simulated region" not in run.parts.notes
    assert "up to" not in dict(run_rows(run.summary))["smallest distance to plate"]


@pytest.mark.parametrize("known", [True, False])
def test_only_tissue_beyond_the_region_counts(known):
    """Half a block, whose right half lies beyond the region; known exactly, or by its voxels."""
    shape = (20, 20, 20)
    fraction = np.full(shape, 255, np.uint8)
    fraction[:, :, 10:] = 0  # air from z = 0
    volume = VoxelVolume(
        np.full(3, -1e-3),
        1e-4,
        fraction,
        np.zeros(shape, np.uint8),
        np.full(shape, 1800.0, np.uint16),
        ("bone",),
    )
    whole = box((4e-3, 2e-3, 1e-3), (1e-3, 0.0, -0.5e-3)) if known else None
    cutter = Cutter(ball_burr(diameter_m=5e-4), 6, 1000.0)
    motion = ToolMotion()
    for tip_mm, left in (
        ((0.0, 0.0, -0.3), False),  # inside
        ((0.0, 0.0, 3.0), False),  # above the block
        ((0.9, 0.0, 0.3), False),  # next to the region, above the block
        ((0.9, 0.0, -0.3), True),  # next to the region, in the block
    ):
        watch = RegionEnd(volume, cutter, margin_mm=3.0, tissue=whole)
        motion.tip_m[:] = 1e-3 * np.array(tip_mm)
        assert bool(watch.check(0, motion)) == left
        assert watch.check(1, motion) == ""


def test_a_sufficient_margin_contains_a_motion():
    """A ball of 0.5 mm whose tip ends 3 mm below the middle of a full box of 2 mm."""
    volume = VoxelVolume(
        np.full(3, -1e-3),
        1e-4,
        np.full((20, 20, 20), 255, np.uint8),
        np.zeros((20, 20, 20), np.uint8),
        np.full((20, 20, 20), 1800.0, np.uint16),
        ("bone",),
    )
    cutter = Cutter(ball_burr(diameter_m=5e-4), 6, 1000.0)
    watch = RegionEnd(volume, cutter, margin_mm=3.0, tissue=None)
    tips_m = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -3e-3]])
    axes = np.array([[0.0, 0.0, 1.0]] * 2)
    # the outermost voxel of 0.1 mm does not count: the tip lies 2.1 mm beyond the region
    assert watch.sufficient_margin_mm(tips_m, axes) == pytest.approx(5.1)
    assert watch.sufficient_margin_mm(tips_m[:1], axes[:1]) == pytest.approx(3.0)


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
@pytest.mark.parametrize("margin_mm", [1.0, 4.0])
def test_the_region_contains_a_reamer_on_the_path(axis, margin_mm):
    """The quick test by a box finds the reamer and its peg in the region along the whole path.

    A margin of 1 mm is larger than a voxel at the edge plus the gaps between points on the tool.
    """
    changes = {
        "device": "touch",
        "duration_s": 0.002,
        "motion.axis": axis,
        "voxels.margin_mm": margin_mm,
        "voxels.spacing_mm": 0.3,
    }
    parts = tissue.simulate(tissue.load_scene("glenoid", changes)).parts
    end = parts.region_end
    tips_m = np.linspace(*parts.motion.sweep_m()[[0, -1]], 50)
    axes = np.tile(parts.motion.rotations()[0][:, 2], (50, 1))
    low_m, high_m = end._box(tips_m, axes)
    assert (low_m >= end._low_m).all() and (high_m <= end._high_m).all()
    assert end.sufficient_margin_mm(tips_m, axes) <= margin_mm


def test_the_box_of_a_tilted_tool_contains_all_its_points():
    cutter = Cutter(ball_burr(diameter_m=5e-4), 6, 1000.0)
    volume = VoxelVolume(
        np.full(3, -1e-3),
        1e-4,
        np.full((20, 20, 20), 255, np.uint8),
        np.zeros((20, 20, 20), np.uint8),
        np.full((20, 20, 20), 1800.0, np.uint16),
        ("bone",),
    )
    end = RegionEnd(volume, cutter, margin_mm=3.0, tissue=None)
    tip_m = np.array([1e-3, 2e-3, 3e-3])
    for rotation in Rotation.random(100, random_state=0).as_matrix():
        points_m = tip_m + end._points_m @ rotation.T
        low_m, high_m = end._box(tip_m, rotation[:, 2])
        # rounding of coordinates of a few mm
        assert (points_m >= low_m - 1e-17).all() and (points_m <= high_m + 1e-17).all()
