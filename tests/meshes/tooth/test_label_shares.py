"""Surface and layers between labels: the places for a plane and a ball, which no grid moves."""

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.tooth.label_sampling import PlacedLabels
from meshes.tooth.label_volume import LabelledTooth
from meshes.tooth.layers import CARIES, DENTIN, ENAMEL
from meshes.voxels.distances import SURFACE_STEPS, SURFACE_ZERO

VOXEL_M = 34e-6
TURN = Rotation.from_euler("xyz", [20.0, 35.0, 50.0], degrees=True).as_matrix()
DECAY = np.array([-1e-4, 0.0, -2e-4])
BOX = np.array([[-0.4e-3] * 3, [0.4e-3] * 3])


def layer_of(points):
    """Return the layer at points: enamel over dentin with a ball of decay in it.

    The tooth ends at a slanted plane and at a ball next to it.
    """
    layer = np.where(points[:, 0] - 0.3 * points[:, 1] > 0.0, ENAMEL, DENTIN).astype(np.uint8)
    layer[np.linalg.norm(points - DECAY, axis=1) < 1.7e-4] = CARIES
    layer[surface(points) > 0.0] = 255
    return layer


def surface(points):
    """Distance to the surface [m]."""
    normal = np.array([0.2, -0.3, 1.0])
    plane = points @ (normal / np.linalg.norm(normal)) - 1e-4
    return np.maximum(plane, 3e-4 - np.linalg.norm(points - [3e-4, 3e-4, 4e-4], axis=1))


def tooth(voxel_m=VOXEL_M, shift=(0.0, 0.0, 0.0)):
    """Labels in a frame turned against the site's, the site's origin in their middle."""
    count = int(2.4e-3 / voxel_m)
    origin = 0.5 * count * voxel_m + np.array(shift) * voxel_m
    index = np.stack(np.indices((count,) * 3), axis=-1).reshape(-1, 3)
    labels = layer_of((index * voxel_m - origin) @ TURN).reshape((count,) * 3)
    for axis in range(3):
        labels[(slice(None),) * axis + ((0, -1),)] = 255
    placed = PlacedLabels(labels, np.full(3, voxel_m), np.zeros(3), origin, TURN)
    return LabelledTooth(placed, True, 1e3 * voxel_m, ())


def centres(volume):
    return np.stack(
        np.meshgrid(*(volume.centres_m(k) for k in range(3)), indexing="ij"), axis=-1
    ).reshape(-1, 3)


def test_distances_are_those_of_the_surface_that_was_labelled():
    """Distances agree with the surface that was labelled.

    The error is at most 0.1 label voxels rms and 0.03 on average, at engine voxels of twice, once
    and half the labels'.
    """
    labelled = tooth(shift=np.random.default_rng(0).uniform(-0.5, 0.5, 3))
    for ratio in (2.0, 1.0, 0.5):
        volume = labelled.volume(resample_mm=1e3 * ratio * VOXEL_M, region_m=tuple(BOX))
        exact = surface(centres(volume)) / VOXEL_M
        found = (
            ratio * (volume.surface_distance.ravel().astype(float) - SURFACE_ZERO) / SURFACE_STEPS
        )
        inner = (np.abs(centres(volume)) < 0.4e-3 - 3.0 * ratio * VOXEL_M).all(axis=1)
        off = (found - exact)[inner & (np.abs(exact) < 0.5 * ratio)]
        print(
            f"\nvoxels {ratio:g} labels: {len(off)}, mean {off.mean():+.3f}, rms "
            f"{np.sqrt((off**2).mean()):.3f}"
        )
        assert np.sqrt((off**2).mean()) < 0.1 and abs(off.mean()) < 0.03
