"""Points along a line through corners."""

import numpy as np
import pytest

from meshes.shapes.polyline import arc_length, points_along

CORNERS = [[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, -2.0]]


def test_arc_lengths_are_sums_of_lengths():
    assert arc_length(CORNERS).tolist() == [0.0, 5.0, 5.0, 7.0]


@pytest.mark.parametrize(
    ("length", "point"),
    [(0.0, (0, 0, 0)), (2.5, (1.5, 2, 0)), (6.0, (3, 4, -1)), (-1.0, (0, 0, 0)), (9.0, (3, 4, -2))],
)
def test_points_lie_on_the_legs_and_at_the_ends_beyond(length, point):
    assert points_along(CORNERS, [length])[0] == pytest.approx(np.array(point, dtype=float), abs=1e-15)
