"""Levels and distances that the proxy reads, against SciPy and the geometry of `meshes`."""

import numpy as np
import pytest
from field_distance import distance_to, half_space
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from kernels.voxmap import SURFACE
from meshes.shapes import sdf
from meshes.voxels.volume import VoxelVolume
from tissue.haptics.proxy.proxy import Box, ContactField
from tissue.models.bone.bricks import BrickStore

SPACING, ORIGIN = 1e-4, np.array([-1e-3, 2e-3, 0.5e-3])


def volume_of(fraction):
    return VoxelVolume(
        ORIGIN,
        SPACING,
        fraction,
        np.zeros_like(fraction),
        np.full(fraction.shape, 1800, np.uint16),
        ("bone",),
    )


def random_volume(seed=3):
    random = np.random.default_rng(seed)
    fraction = random.integers(0, 256, (21, 17, 30), dtype=np.uint8)
    fraction[8:16, 8:16, 8:16] = 0  # an empty brick
    return volume_of(fraction)


def level_by_scipy(volume, points):
    """The level in NumPy and SciPy: nothing outside the grid."""
    padded = np.pad(volume.fraction / 255.0, 2)
    at = (points - volume.origin_m) / volume.spacing_m - 0.5 + 2.0
    return (SURFACE - map_coordinates(padded, at.T, order=1, cval=0.0)) * volume.spacing_m


def test_level_against_scipy_across_bricks_and_borders():
    volume = random_volume()
    field = ContactField(store=BrickStore.from_volume(volume, device="cpu"))
    random = np.random.default_rng(0)
    points = random.uniform(ORIGIN - 0.9 * SPACING, volume.bounds_m[1] + 0.9 * SPACING, (4000, 3))
    found, normal = distance_to(field, points)
    # else the bound of the border
    inside = (np.abs(points - np.clip(points, *volume.bounds_m)) == 0.0).all(axis=1)
    assert found[inside] == pytest.approx(
        level_by_scipy(volume, points[inside]), abs=1e-7 * SPACING
    )
    assert inside.sum() > 3000
    lengths = np.linalg.norm(normal, axis=1)
    assert (np.isclose(lengths, 1.0) | (lengths == 0.0)).all()


def test_exit_direction_is_the_gradient_of_the_level():
    """The exit direction is the gradient of the level.

    Central differences are taken inside cells, where the level is smooth; their error is of second
    order in the step.
    """
    volume = random_volume(4)
    field = ContactField(store=BrickStore.from_volume(volume, device="cpu"))
    random = np.random.default_rng(1)
    cell = random.integers(0, (20, 16, 29), (500, 3))
    points = ORIGIN + SPACING * (cell + 0.5 + random.uniform(0.05, 0.95, (500, 3)))
    step = 1e-2 * SPACING
    slope = np.stack(
        [
            (level_by_scipy(volume, points + e) - level_by_scipy(volume, points - e)) / (2 * step)
            for e in step * np.eye(3)
        ],
        axis=1,
    )
    keep = np.linalg.norm(slope, axis=1) > 0.1
    expected = slope[keep] / np.linalg.norm(slope[keep], axis=1)[:, None]
    assert distance_to(field, points)[1][keep] == pytest.approx(expected, abs=1e-6)


def test_clearance_never_exceeds_the_distance_to_bone():
    random = np.random.default_rng(2)
    fraction = np.zeros((60, 44, 50), np.uint8)
    held = random.integers(0, fraction.shape, (12, 3))
    fraction[tuple(held.T)] = 200
    field = ContactField(store=BrickStore.from_volume(volume_of(fraction), device="cpu"))
    points = random.uniform(
        ORIGIN - 2e-3, ORIGIN + SPACING * np.array(fraction.shape) + 2e-3, (3000, 3)
    )
    low = ORIGIN + SPACING * (held - 0.5)  # a voxel is felt up to the centres of its neighbours
    beyond = np.maximum(
        np.maximum(low - points[:, None], points[:, None] - low - 2.0 * SPACING), 0.0
    )
    true = np.linalg.norm(beyond, axis=2).min(axis=1)
    found, _ = distance_to(field, points)
    far = found > SURFACE * SPACING * (1 + 1e-9)
    assert (found[far] <= true[far] + 1e-9 * SPACING).all()
    assert far.mean() > 0.5
    assert np.median(found[far] / true[far]) > 0.4  # a bound that is of use


def test_solids_against_signed_distance_shapes():
    random = np.random.default_rng(3)
    points = random.uniform(-0.02, 0.02, (2000, 3))
    turn = Rotation.random(random_state=4)
    centre, size = np.array([1e-3, -2e-3, 3e-3]), np.array([0.01, 0.02, 0.005])
    cases = (
        (Box(centre, size, turn.as_matrix()), sdf.box(size), turn.inv().apply(points - centre)),
        (half_space(centre, (1.0, 2.0, -2.0)), sdf.half_space((1.0, 2.0, -2.0), centre), points),
    )
    for solid, shape, local in cases:
        distance, normal = distance_to(ContactField(solid), points)
        assert distance == pytest.approx(shape.distance(local), abs=1e-15)
        step = 1e-7
        outside = distance_to(ContactField(solid), points + step * normal)[0]
        assert outside - distance == pytest.approx(np.full(len(points), step), rel=1e-6)


def test_plane_surface_is_found_within_a_quarter_voxel():
    """A plane surface at any height is found within a quarter voxel.

    With the surface sunk by the difference of the levels, the touching point is never in the bone.
    """
    for part in np.linspace(0.0, 1.0, 18):
        fraction = np.zeros((16, 16, 32), np.uint8)
        fraction[:, :, :16], fraction[:, :, 16] = 255, round(255 * part)
        field = ContactField(store=BrickStore.from_volume(volume_of(fraction), device="cpu"))
        height = ORIGIN[2] + SPACING * (16 + np.arange(-0.7, 1.5, 0.001))
        points = np.column_stack(
            [np.full_like(height, ORIGIN[0] + 8e-4), np.full_like(height, ORIGIN[1] + 8e-4), height]
        )
        touching = height[np.argmax(distance_to(field, points)[0] >= 0.0)] - field.sink_m
        error = (touching - ORIGIN[2]) / SPACING - 16 - part
        assert -0.02 < error < 0.27  # a thousandth voxel of sampling, 1/255 of the fraction
