"""Bone before any cut, compared with plain NumPy.

The cases are random bytes, three layers that touch, and missing bricks.
"""

import numpy as np
import pytest
import warp as wp
from bone_in_numpy import bone_of, stored_voxels

from kernels.bone_lookup import Bone, bone_at
from kernels.bricks import Bricks, voxel_column, voxel_row
from meshes.voxels.distances import FAR, INSIDE, OUTSIDE, SURFACE_ZERO, surface_steps
from meshes.voxels.volume import VoxelVolume
from tissue.models.bone.bricks import BrickStore

SINGLE = 2e-5
"""[voxel]: places of up to 24 voxels in float32, distances that change by up to 4 a voxel."""
SHAPE, MISSING = (24, 16, 32), (slice(8, 16), slice(0, 8), slice(16, 24))


@wp.kernel
def evaluate(
    bricks: Bricks,
    point: wp.array(dtype=wp.vec3),
    number_out: wp.array2d(dtype=float),
    slope_out: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    at = point[i]
    ix = int(wp.floor(at[0]))
    iy = int(wp.floor(at[1]))
    iz = int(wp.floor(at[2]))
    row = voxel_row(bricks.brick_of, ix, iy, iz)
    bone = Bone()
    bone.layer = -1
    if row >= 0:
        bone = bone_at(bricks, row, voxel_column(ix, iy, iz), at)
    number_out[i, 0] = bone.distance
    number_out[i, 1] = float(bone.layer)
    number_out[i, 2] = bone.density
    slope_out[i] = bone.slope


def volume_of(surface, boundary, layer, density):
    fraction = np.where(surface < SURFACE_ZERO, 255, 0).astype(np.uint8)
    return VoxelVolume(
        np.zeros(3), 1e-4, fraction, layer, density, ("a", "b", "c"), None, surface, boundary
    )


def look_up(volume, points):
    store = BrickStore.from_volume(volume, device="cpu")
    numbers = wp.zeros((len(points), 3), dtype=float, device="cpu")
    slopes = wp.zeros(len(points), dtype=wp.vec3, device="cpu")
    inputs = [store.on_device, wp.array(points, dtype=wp.vec3, device="cpu")]
    wp.launch(evaluate, dim=len(points), inputs=inputs, outputs=[numbers, slopes], device="cpu")
    distance, layer, density = numbers.numpy().T
    return store, distance, layer.astype(int), density, slopes.numpy()


def random_points(random, count, shape):
    return random.uniform(1e-3, np.array(shape) - 1e-3, (count, 3)).astype(np.float32).astype(float)


def test_random_bytes_against_numpy():
    """Random bytes agree with NumPy.

    Three layers touch in every cell, a brick is left out, and bytes lie on both sides of every
    threshold.
    """
    random = np.random.default_rng(0)
    surface = random.integers(INSIDE, OUTSIDE + 1, SHAPE).astype(np.uint8)
    boundary, layer = (
        random.integers(1, FAR + 1, SHAPE).astype(np.uint8),
        random.integers(0, 3, SHAPE).astype(np.uint8),
    )
    density = random.integers(300, 1900, SHAPE).astype(np.uint16)
    surface[MISSING] = OUTSIDE
    volume, points = (
        volume_of(surface, boundary, layer, density),
        random_points(random, 20000, SHAPE),
    )
    store, distance, kind, kg_m3, slope = look_up(volume, points)
    stored = stored_voxels(store.brick_of.numpy(), SHAPE)
    assert (~stored[MISSING]).all() and stored.sum() == stored.size - 512
    held = stored[tuple(points.astype(int).T)]
    wanted = bone_of(volume, stored, points[held])
    assert distance[held] == pytest.approx(wanted.distance, abs=SINGLE)
    assert slope[held] == pytest.approx(wanted.slope, abs=2 * SINGLE)
    inside, clear = wanted.distance < 2.0, wanted.clear
    assert clear.mean() > 0.999  # elsewhere two shares are closer than single precision resolves
    assert (kind[held] == wanted.layer)[clear & inside].all()
    assert all((wanted.layer == index)[inside].mean() > 0.1 for index in range(3))
    assert kg_m3[held][clear & inside] == pytest.approx(wanted.density[clear & inside], rel=1e-5)


def test_far_from_surface_and_layers_the_nearest_voxel_answers():
    random = np.random.default_rng(1)
    layer, density = (
        random.integers(0, 3, SHAPE).astype(np.uint8),
        random.integers(300, 1900, SHAPE),
    )
    full = np.ones(SHAPE, dtype=np.uint8)
    volume = volume_of(INSIDE * full, FAR * full, layer, density.astype(np.uint16))
    points = random_points(random, 500, SHAPE)
    _, distance, found, kg_m3, slope = look_up(volume, points)
    at = tuple(points.astype(int).T)
    assert (distance == -2.0).all() and (slope == 0.0).all()
    assert (found == layer[at]).all() and (kg_m3 == density[at]).all()


def test_planes_between_layers_and_at_the_surface_lie_where_they_are():
    """Planes between layers and at the surface lie at their true place.

    They are stored to 1/63 and 1/127 voxel. Every point farther than that from a plane reaches it
    within a step.
    """
    random = np.random.default_rng(3)
    for _ in range(5):
        normal, across = random.normal(size=(2, 3))
        normal, across = normal / np.linalg.norm(normal), across / np.linalg.norm(across)
        centres = np.stack(np.indices(SHAPE), axis=-1) + 0.5 - np.array(SHAPE) / 2
        surface, change = centres @ normal, centres @ across
        boundary = np.rint(np.clip(127 * np.abs(change), 0, FAR)).astype(np.uint8)
        volume = volume_of(
            surface_steps(surface),
            boundary,
            (change > 0).astype(np.uint8),
            np.full(SHAPE, 1000, np.uint16),
        )
        points = random_points(random, 4000, SHAPE)
        points = points[((points > 1) & (points < np.array(SHAPE) - 1)).all(axis=1)]
        _, distance, layer, _, _ = look_up(volume, points)
        offset = points - np.array(SHAPE) / 2
        near = (np.abs(offset @ normal) < 0.3) & (distance > -1.9) & (distance < 1.9)
        assert near.sum() > 20
        assert distance[near] == pytest.approx((offset @ normal)[near], abs=0.5 / 63 + SINGLE)
        clear = (np.abs(offset @ across) > 1 / 127) & (distance < 0)
        assert (layer[clear] == (offset @ across > 0)[clear]).all()
