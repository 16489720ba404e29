"""Pictures of carved bone: faces at the end of the simulated region."""

import numpy as np
import pytest

from meshes.voxels.volume import VoxelVolume
from tissue.simulation.bone_surface import bone_surface, cut_out

SIDE = 16
SPACING_M = 1e-3


@pytest.mark.parametrize(("voxels_inside", "is_cut"), [(0.0, True), (6.0, True), (-6.0, False)])
def test_faces_at_the_end_of_whole_bricks_are_cut_out(voxels_inside, is_cut):
    """A requested corner up to a brick inside the volume has bone beyond it."""
    full = np.full((SIDE, SIDE, SIDE), 255, np.uint8)
    volume = VoxelVolume(
        np.zeros(3), SPACING_M, full, np.zeros_like(full), full.astype(np.uint16), ("bone",)
    )
    low, high = volume.bounds_m
    shift = voxels_inside * SPACING_M
    surface = bone_surface(volume, volume.fraction)
    share = cut_out(surface, volume, (low + shift, high - shift)).mean()
    assert (share > 0.5) if is_cut else (share == 0.0)
