"""Break-through and plunge of a drill, held to a block of known thickness."""

import numpy as np
import pytest

import tissue

THICKNESS_MM = 4.0
DRILL = {
    "name": "wall",
    "anatomy": {"kind": "block", "size_mm": [8.0, 8.0, THICKNESS_MM]},
    "voxels": {"spacing_mm": 0.3},
    "tool": {"kind": "twist-drill", "diameter_mm": 2.0, "length_mm": 10.0, "spin_rpm": 1000.0},
    "motion": {
        "kind": "path",
        "points_mm": [[0, 0, 1], [0, 0, -6.5], [0, 0, 1]],
        "feed_mm_s": 20.0,
    },
}


def drilled(**changes):
    return tissue.simulate(tissue.Scene.model_validate(DRILL | changes))


def break_throughs(run):
    """Events of a run that report a hole through the bone."""
    return [event["what"] for event in run.summary["events"] if "broke through" in event["what"]]


def test_the_plunge_is_the_travel_beyond_the_far_face():
    run = drilled()
    (found,) = run.summary["break_through"]
    assert found["plunge_mm"] == pytest.approx(6.5 - THICKNESS_MM, abs=0.05)
    assert found["time_s"] == pytest.approx((1.0 + THICKNESS_MM) / 20.0, abs=2e-3)
    assert break_throughs(run) == [f"broke through, {found['plunge_mm']:.2f} mm of plunge"]


def test_a_tilted_drill_breaks_through_along_its_axis():
    tilt = np.radians(20.0)
    axis = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    points = [(-(s * axis)).tolist() for s in (-1.0, 6.0)]
    run = drilled(
        motion={"kind": "path", "points_mm": points, "feed_mm_s": 20.0, "axis": axis.tolist()}
    )
    (found,) = run.summary["break_through"]
    assert found["plunge_mm"] == pytest.approx(6.0 - THICKNESS_MM / np.cos(tilt), abs=0.1)


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0, 1], [0, 0, -3]],
        [[0, 0, 1], [0, 0, -2], [0, 0, 1]],
        [[0, 0, 1], [0, 0, -1], [7, 0, -1]],
    ],
)
def test_a_drill_that_stays_goes_back_or_leaves_aside_breaks_nothing(points):
    run = drilled(motion={"kind": "path", "points_mm": points, "feed_mm_s": 40.0})
    assert "break_through" not in run.summary and not break_throughs(run)


def test_pecking_breaks_through_once_a_hole():
    """Pecking breaks through once a hole.

    Three passes go through one hole, the last the deepest, then a hole of its own 3 mm away: two
    events, each with its plunge.
    """
    first = [[0, 0, 1], [0, 0, -4.5], [0, 0, -2], [0, 0, -5], [0, 0, 0.5], [0, 0, -6]]
    second = [[0, 0, 1], [3, 0, 1], [3, 0, -5.5]]
    run = drilled(motion={"kind": "path", "points_mm": first + second, "feed_mm_s": 40.0})
    plunges = [found["plunge_mm"] for found in run.summary["break_through"]]
    assert plunges == pytest.approx([6.0 - THICKNESS_MM, 5.5 - THICKNESS_MM], abs=0.05)
    assert [found["time_s"] for found in run.summary["break_through"]] == pytest.approx(
        [
            (1.0 + THICKNESS_MM) / 40.0,
            (5.5 + 2.5 + 3.0 + 5.5 + 6.5 + 7.0 + 3.0 + 1.0 + THICKNESS_MM) / 40.0,
        ],
        abs=2e-3,
    )
    assert len(break_throughs(run)) == 2
