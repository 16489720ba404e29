"""Points of a tool's whole body, by which it keeps clear of structures."""

import numpy as np

from tissue.cutters.body import body_points
from tissue.cutters.profile import ball_burr, hemispherical_reamer, twist_drill

DIRECTIONS = np.random.default_rng(0).normal(size=(200, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]


def test_body_reaches_as_far_as_its_profile():
    """A body reaches as far as its profile.

    Support of the points in every direction is compared with a ball, a cone on a cylinder, and a
    peg.
    """
    ball = body_points(ball_burr(diameter_m=4e-3), spacing_m=2e-4)
    assert np.abs((ball @ DIRECTIONS.T).max(axis=0) - 2e-3 * DIRECTIONS[:, 2] - 2e-3).max() < 1e-5
    drill = body_points(
        twist_drill(diameter_m=3.2e-3, length_m=20e-3, point_angle_rad=2.06), spacing_m=2e-4
    )
    shoulder = 1.6e-3 / np.tan(1.03)
    across = 1.6e-3 * np.hypot(DIRECTIONS[:, 0], DIRECTIONS[:, 1])
    ends = [0.0 * across, across + shoulder * DIRECTIONS[:, 2], across + 20e-3 * DIRECTIONS[:, 2]]
    assert np.abs((drill @ DIRECTIONS.T).max(axis=0) - np.maximum.reduce(ends)).max() < 1e-5
    reamer = hemispherical_reamer(diameter_m=30e-3, peg_diameter_m=6e-3, peg_length_m=8e-3)
    assert body_points(reamer, spacing_m=1e-3)[:, 2].min() == -8e-3
