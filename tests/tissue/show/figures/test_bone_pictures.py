"""Pictures of carved bone: faces at the end of the simulated region, and the outline of the map."""

import numpy as np
import pytest

from meshes.voxels.volume import VoxelVolume
from tissue.show.figures.bone_pictures import _within
from tissue.simulation.bone_surface import DepthMap, bone_surface, cut_out

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


def test_the_outline_of_bone_is_looked_for_in_the_shown_part_of_the_map():
    bone = np.ones((10, 10), bool)
    bone[0] = False
    depth = DepthMap(2, 1, (0, 1), (0.0, 10.0, 0.0, 10.0), np.zeros((10, 10)), bone, bone, {})
    assert not bone[_within(depth, depth.extent_mm)].all()
    assert bone[_within(depth, (2.0, 10.0, 0.0, 10.0))].all()
