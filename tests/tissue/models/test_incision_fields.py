"""Opening of a cut: split mesh, width against an edge crack, frames, what is not drawn."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue.models.incision.fields import NEAR_M, IncisionFields, Track
from tissue.models.incision.model import IncisionModel
from tissue.models.incision.parameters import Blade, IncisedTissue
from tissue.models.tissue_model import ToolMotion

BLADE = Blade(width_m=2e-3, thickness_m=4e-4, edge_rad=0.5 * np.pi)
TISSUE = IncisedTissue(
    name="skin",
    toughness_J_m2=100.0,
    friction_Pa=0.0,
    stiffness_N_m=1e6,
    young_Pa=1e6,
    poisson_ratio=0.3,
    prestrain=0.1,
)
"""Tissue that hardly gives way, so that the cut is as deep as the tool."""
CORNERS_M = 1e-3 * np.array([(-20, 0, 2), (-20, 0, -4), (20, 0, -4), (20, 0, 2)], float)


def cut_along(corners_m, rotation, *, planned_m=None):
    """Cut along corners; return the fields with a frame before and after."""
    planned = corners_m if planned_m is None else planned_m
    track = Track.first_of(TISSUE, BLADE, planned, np.broadcast_to(rotation, (len(planned), 3, 3)))
    fields = IncisionFields(track, TISSUE, interval_s=1.0)
    model = IncisionModel(TISSUE, BLADE, fields=fields)
    motion = ToolMotion(tip_m=corners_m[0].copy(), rotation=rotation)
    model.place(motion)
    model.start_background(0.0, motion)
    for start, end in pairwise(corners_m):
        count = max(round(np.linalg.norm(end - start) / 5e-5), 1)
        for share in np.arange(1, count + 1) / count:
            motion.tip_m[:] = start + share * (end - start)
            model.advance(motion)
    model.start_background(1.0, motion)
    model.finish()
    return model.fields


@pytest.fixture(scope="module")
def series():
    """A straight cut of 40 mm."""
    return cut_along(CORNERS_M, np.eye(3))


def on_plane(series):
    """Nodes of the two faces of the plane, in pairs."""
    half = len(series.nodes_m) // 2
    left = np.flatnonzero(series.nodes_m[:half, 1] == 0.0)
    return left, left + half


@pytest.mark.slow
def test_both_faces_lie_together_until_they_are_cut(series):
    left, right = on_plane(series)
    np.testing.assert_array_equal(series.nodes_m[left], series.nodes_m[right])
    before, after = (frame.points["displacement_mm"] for frame in series.frames)
    assert not before.any()
    opening = after[left, 1] - after[right, 1]
    at = 1e3 * series.nodes_m[left]
    inside = (at[:, 2] > -4.0 + 1e-6) & (at[:, 0] > -20.0 + 1e-6) & (at[:, 0] < 22.0 - 1e-6)
    assert (opening[inside] > 0.01).all()
    assert np.abs(opening[~inside]).max() < 1e-4
    np.testing.assert_allclose(after[left, 0], after[right, 0], atol=1e-6)


def test_the_middle_opens_like_an_edge_crack(series):
    """4 V s d / E' with V = 1.454 and s / E' the prestrain (Tada, Paris and Irwin 2000).

    The coarse cells make it 19 % narrower.
    """
    left, right = on_plane(series)
    after = series.frames[1].points["displacement_mm"]
    middle = (np.abs(series.nodes_m[left, 0] - 1e-3) < 1e-3) & (series.nodes_m[left, 2] == 0.0)
    opening = (after[left, 1] - after[right, 1])[middle].max()
    assert opening == pytest.approx(4.0 * 1.454 * TISSUE.prestrain * 4.0, rel=0.2)


def test_all_cells_have_their_volume(series):
    corners = series.nodes_m[series.cells]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    assert (volumes > 0.0).all()


@pytest.mark.slow
def test_a_turned_cut_near_the_planned_one_is_drawn_there_with_the_turned_opening(series):
    turn = Rotation.from_euler("z", 0.8).as_matrix()
    near = CORNERS_M + np.array([0.0, 0.5 * NEAR_M, 0.0])
    other = cut_along(near @ turn.T, turn, planned_m=CORNERS_M @ turn.T)
    np.testing.assert_allclose(other.nodes_m, series.nodes_m @ turn.T, atol=1e-12)
    np.testing.assert_allclose(
        other.frames[1].points["displacement_mm"],
        series.frames[1].points["displacement_mm"] @ turn.T,
        atol=1e-4,
    )


@pytest.mark.slow
def test_a_block_follows_a_leaning_blade():
    """Its plane is the one of the blade, and its top lies at z = 0."""
    lean = Rotation.from_euler("x", 25, degrees=True).as_matrix()
    other = cut_along(CORNERS_M, lean)
    left = np.abs((other.nodes_m - CORNERS_M[1]) @ lean[:, 1]) < 1e-9
    assert left.sum() > 500
    assert other.nodes_m[:, 2].max() == 0.0
    assert other.frames[1].points["displacement_mm"].any()


def test_a_cut_far_from_the_planned_one_is_not_drawn():
    far = CORNERS_M + np.array([0.0, 1.5 * NEAR_M, 0.0])
    found = cut_along(far, np.eye(3), planned_m=CORNERS_M)
    assert not found.frames[1].points["displacement_mm"].any()


def test_a_motion_that_stays_outside_has_no_track():
    turns = np.broadcast_to(np.eye(3), (2, 3, 3))
    assert Track.first_of(TISSUE, BLADE, np.array([[0, 0, 0.01], [0.01, 0, 0.01]]), turns) is None
