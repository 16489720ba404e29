"""Points along a line through corners."""

import numpy as np
import pytest

from meshes.paths.toolpath import kept_corners, points_along

CORNERS = [[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, -2.0]]


@pytest.mark.parametrize(
    ("length", "point"),
    [(0.0, (0, 0, 0)), (2.5, (1.5, 2, 0)), (6.0, (3, 4, -1)), (-1.0, (0, 0, 0)), (9.0, (3, 4, -2))],
)
def test_points_lie_on_the_legs_and_at_the_ends_beyond(length, point):
    assert points_along(CORNERS, [length])[0] == pytest.approx(
        np.array(point, dtype=float), abs=1e-15
    )


def test_corners_on_a_straight_leg_are_left_out():
    legs = points_along(CORNERS, np.linspace(0.0, 7.0, 71))
    assert kept_corners(legs, 1e-9).tolist() == [0, 50, 70]
    assert kept_corners(CORNERS[:2], 0.0).tolist() == [0, 1]


def test_every_corner_lies_within_the_distance_of_those_kept():
    t = np.linspace(0.0, 6.0, 400)
    spiral = np.column_stack([np.cos(t), np.sin(t), 0.1 * t])
    kept = kept_corners(spiral, 0.01)
    line = np.column_stack([np.interp(t, t[kept], spiral[kept, axis]) for axis in range(3)])
    assert len(kept) < 40 and np.linalg.norm(spiral - line, axis=1).max() < 0.011
    assert kept_corners(np.vstack([spiral, spiral[::-1]]), 0.01).tolist()[-1] == 799
