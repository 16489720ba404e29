"""Bad input about teeth: one sentence, exit code 2, through the command."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.voxels.volume import VoxelVolume


def blocks(*labels):
    """Return voxels of 0.5 mm with a block of 6 x 4 x 9 of dentin in air.

    Named layers are added as blocks.
    """
    layers, names = np.zeros((16, 14, 30), np.uint8), ("dentin", "bone")
    fraction = np.zeros(layers.shape, np.uint8)
    fraction[5:11, 5:9, 8:17] = 255
    for part, name in labels:
        fraction[part], layers[part] = 255, names.index(name)
    return VoxelVolume(
        (0.0, 0.0, 0.0), 5e-4, fraction, layers, np.full(layers.shape, 2100, np.uint16), names
    )


def springs(volume):
    """Springs of a volume's dentin [N/m], summed over the points at each height."""
    from tissue.models.tooth.field import _ligament_springs

    solid = (volume.fraction > 0) & (volume.layer == 0)
    found = _ligament_springs(volume, solid, 2e-4)
    heights = np.floor(found.position_m[:, 2] / 5e-4)
    return {
        height: found.stiffness_N_m[heights == height].sum(axis=0) for height in np.unique(heights)
    }


def test_a_tooth_whose_bone_does_not_touch_it_is_refused():
    with pytest.raises(InputError, match="anatomy must contain a tooth with a support, got none"):
        springs(blocks((np.s_[:, :, 26:], "bone")))


def test_a_tooth_without_a_bed_is_held_at_its_lower_third_whether_or_not_it_fills_its_volume():
    volume = blocks()
    arrays = (volume.fraction, volume.layer, volume.density_kg_m3)
    cut = [np.ascontiguousarray(array[5:11, 5:9, 8:17]) for array in arrays]
    filled = VoxelVolume((25e-4, 25e-4, 40e-4), 5e-4, *cut, ("dentin", "bone"))
    wanted, found = springs(volume), springs(filled)
    assert found.keys() == wanted.keys() and min(found) == 8
    for height, sums in wanted.items():
        np.testing.assert_allclose(found[height], sums, rtol=1e-6, atol=1e-6 * sums.max())
    assert sorted(wanted) == [8, 9]
