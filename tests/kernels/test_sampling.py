"""Sampling of bricks at points against SciPy, by the kernel itself and in parts."""

import numpy as np
import pytest
import warp as wp
from scipy.ndimage import map_coordinates

from kernels.sampling import sample
from meshes.voxels.volume import VoxelVolume
from tissue.models.bone.bricks import BrickStore

SINGLE = 4e-6
"""Places of up to 30 voxels are known to 2e-6 voxel in float32."""


def test_fractions_against_scipy_from_an_offset_on():
    random = np.random.default_rng(0)
    shape, count, offset = (14, 19, 26), 600, 100
    fraction = random.integers(0, 256, shape, dtype=np.uint8)
    volume = VoxelVolume(
        np.zeros(3),
        1e-4,
        fraction,
        np.zeros(shape, np.uint8),
        np.full(shape, 1500, np.uint16),
        ("bone",),
    )
    store = BrickStore.from_volume(volume, device="cpu")
    points = random.uniform(-2.0, 28.0, (count, 3)).astype(np.float32)
    out = wp.full(count, -1.0, dtype=wp.float32, device="cpu")
    inputs = [
        wp.array(points, dtype=wp.vec3, device="cpu"),
        offset,
        store.brick_of,
        store.remaining,
    ]
    wp.launch(sample, dim=count - offset, inputs=inputs, outputs=[out], device="cpu")
    right = map_coordinates(
        np.pad(fraction / 255.0, 4), points.T.astype(float) - 0.5 + 4.0, order=1
    )
    assert out.numpy()[offset:] == pytest.approx(right[offset:], abs=SINGLE)
    assert (out.numpy()[:offset] == -1.0).all()
