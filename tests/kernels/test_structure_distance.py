"""Distance between tools and a box, against its closed form."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from structure_poses import distance_m

from tissue.cutters import profile
from tissue.models.keep_clear import KeepClear, Structure

SIDES_M = np.array([8e-3, 6e-3, 4e-3])
BALL_M = 1.5e-3


def from_box(points_m):
    """Signed distance from a box about the origin."""
    out = np.abs(points_m) - 0.5 * SIDES_M
    return np.linalg.norm(np.maximum(out, 0.0), axis=-1) + np.minimum(out.max(axis=-1), 0.0)


@pytest.mark.parametrize("seed", range(2))
def test_a_ball_is_as_far_as_its_centre_less_its_radius(seed):
    """Outside, across the surface and with the centre inside the box."""
    box = trimesh.creation.box(1e3 * SIDES_M)
    structure = Structure(1e-3 * np.asarray(box.vertices), np.asarray(box.faces))
    clear = KeepClear(profile.ball_burr(diameter_m=2 * BALL_M), {"box": structure})
    rng = np.random.default_rng(seed)
    # Above the box, so that the shank, which points away from it, is never nearer than the ball.
    for centre in rng.uniform([-6e-3, -5e-3, 0.5e-3], [6e-3, 5e-3, 6e-3], (30, 3)):
        turn = Rotation.from_euler("xy", rng.uniform(-10, 10, 2), degrees=True)
        found = distance_m(clear, centre - turn.apply([0.0, 0.0, BALL_M]), turn)
        exact = from_box(centre) - BALL_M
        assert exact - 1e-5 <= found <= exact + 1e-9
