"""Depth of a tool in a structure, against depths by construction."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from structure_poses import distance_m

from tissue.cutters import profile
from tissue.models.keep_clear import KeepClear, Structure

SIDE_M = 40e-3


@pytest.fixture(scope="module")
def wall():
    """A block whose upper face is the plane z = 0."""
    block = trimesh.creation.box(3 * [1e3 * SIDE_M])
    return Structure(
        1e-3 * np.asarray(block.vertices) - [0.0, 0.0, 0.5 * SIDE_M], np.asarray(block.faces)
    )


@pytest.mark.parametrize("tilt_deg", [0.0, 5.0, 30.0])
def test_an_end_mill_is_as_deep_as_its_lowest_point(wall, tilt_deg):
    """In a half space every point of the mill's rim that is d below the plane is d deep."""
    radius = 1.5e-3
    clear = KeepClear(profile.cylinder(diameter_m=2 * radius, length_m=8e-3), {"wall": wall})
    turn = Rotation.from_euler("y", tilt_deg, degrees=True)
    for depth in (0.05e-3, 0.4e-3, 1.0e-3):
        lowest = -radius * np.sin(np.radians(tilt_deg))
        found = distance_m(clear, [0.0, 0.0, -depth - lowest], turn)
        assert -depth - 1e-5 <= found <= -depth + 1e-9
