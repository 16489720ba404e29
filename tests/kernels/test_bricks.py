"""Brick storage and sampling against plain NumPy and SciPy."""

import numpy as np
import pytest
import warp as wp

from kernels.bricks import BRICK, cube_behind_plane, plane_of, voxel_column, voxel_row
from meshes.base.grid import BLOCK
from meshes.voxels.distances import INSIDE, OUTSIDE, SURFACE_ZERO
from meshes.voxels.volume import VoxelVolume
from tissue.models.bone.bricks import BrickStore


@wp.kernel
def evaluate_cut(
    normal: wp.array(dtype=wp.vec3),
    distance: wp.array(dtype=float),
    volume_out: wp.array(dtype=float),
):
    i = wp.tid()
    volume_out[i] = cube_behind_plane(plane_of(normal[i]), distance[i])


@wp.kernel
def locate(
    brick_of: wp.array3d(dtype=int),
    voxel: wp.array(dtype=wp.vec3i),
    place_out: wp.array2d(dtype=int),
):
    i = wp.tid()
    place_out[i, 0] = voxel_row(brick_of, voxel[i][0], voxel[i][1], voxel[i][2])
    place_out[i, 1] = voxel_column(voxel[i][0], voxel[i][1], voxel[i][2])


def cut_volumes(normals, distances):
    out = wp.zeros(len(distances), dtype=float, device="cpu")
    arrays = [
        wp.array(normals, dtype=wp.vec3, device="cpu"),
        wp.array(distances, dtype=float, device="cpu"),
    ]
    wp.launch(evaluate_cut, dim=len(distances), inputs=arrays, outputs=[out], device="cpu")
    return out.numpy()


def test_bricks_have_the_size_of_the_blocks_in_which_voxels_are_made():
    assert BRICK == BLOCK


def random_volume(shape=(21, 17, 30), seed=3):
    """Return random voxels with their distances.

    One brick is empty, and a brick near it lies near the surface alone.
    """
    random = np.random.default_rng(seed)
    fraction = random.integers(0, 256, shape, dtype=np.uint8)
    fraction[8:16, 8:16, 8:24] = 0
    surface, boundary = random.integers(INSIDE, OUTSIDE, (2, *shape), dtype=np.uint8)
    surface[8:16, 8:16, 8:16] = OUTSIDE
    layer = random.integers(0, 3, shape, dtype=np.uint8)
    density = random.integers(100, 2000, shape).astype(np.uint16)
    return VoxelVolume(
        np.zeros(3), 1e-4, fraction, layer, density, ("a", "b", "c"), None, surface, boundary
    )


def test_plane_through_a_cube_against_counting():
    """Volume behind a plane against 60^3 points of the cube; 2e-3 is what the counting resolves."""
    random = np.random.default_rng(0)
    normals = random.normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    distances = random.uniform(-0.8, 0.8, 40)
    at = (np.arange(60) + 0.5) / 60 - 0.5
    points = np.stack(np.meshgrid(at, at, at), axis=-1).reshape(-1, 3)
    counted = (points @ normals.T < -distances).mean(axis=0)
    assert cut_volumes(normals, distances) == pytest.approx(counted, abs=2e-3)


def test_plane_along_the_axes_is_exact():
    normals = np.repeat(np.eye(3), 5, axis=0)
    distances = np.tile([-0.6, -0.25, 0.0, 0.25, 0.6], 3)
    assert cut_volumes(normals, distances) == pytest.approx(
        np.tile([1.0, 0.75, 0.5, 0.25, 0.0], 3), abs=2e-4
    )


def test_store_keeps_every_voxel():
    volume = random_volume()
    store = BrickStore.from_volume(volume, device="cpu")
    assert (store.fraction() == volume.fraction).all()
    for index in range(3):
        steps = volume.fraction[volume.layer == index].astype(np.int64).sum() * 257
        assert store.steps_by_layer()[index] == steps


def test_empty_bricks_are_not_stored():
    store = BrickStore.from_volume(random_volume(), device="cpu")
    brick_of = store.brick_of.numpy()
    assert brick_of[1, 1, 1] == -1
    assert len(store.remaining) == brick_of.size - 1
    near = brick_of[1, 1, 2]  # no bone, and within two voxels of its surface
    assert (
        near >= 0
        and store.alive.numpy()[near] == 2**64 - 1
        and not store.remaining.numpy()[near].any()
    )


def test_rows_and_columns_point_at_the_voxels():
    volume = random_volume()
    store = BrickStore.from_volume(volume, device="cpu")
    voxels = np.random.default_rng(2).integers(-2, 32, (500, 3))
    places = wp.zeros((500, 2), dtype=int, device="cpu")
    inputs = [store.brick_of, wp.array(voxels, dtype=wp.vec3i, device="cpu")]
    wp.launch(locate, dim=500, inputs=inputs, outputs=[places], device="cpu")
    remaining, material, nearby = (
        store.remaining.numpy(),
        store.material.numpy(),
        store.nearby.numpy(),
    )
    for voxel, (row, column) in zip(voxels, places.numpy(), strict=True):
        inside = all(0 <= v < n for v, n in zip(voxel, volume.shape, strict=True))
        if row < 0:
            assert not inside or volume.fraction[tuple(voxel)] == 0
        elif inside:
            at = tuple(voxel)
            assert remaining[row, column] == int(volume.fraction[at]) * 257
            assert material[row, column] == (int(volume.density_kg_m3[at]) << 16) | int(
                volume.layer[at]
            )
            assert nearby[row, column] == (int(volume.layer_distance[at]) << 8) | int(
                volume.surface_distance[at]
            )
        else:  # fills up the last brick: air
            assert remaining[row, column] == 0 and nearby[row, column] & 255 > SURFACE_ZERO
    assert (store.swept.numpy() == 65535).all()


def test_a_voxel_outside_the_grid_on_any_side_has_no_row():
    """A voxel outside the grid on any side has no row.

    Of two bricks along each axis all are stored: the inside has rows, and one voxel beyond every
    face has -1.
    """
    brick_of = np.arange(8, dtype=np.int32).reshape(2, 2, 2)
    voxels = np.array(list(np.ndindex(18, 18, 18))) - 1
    places = wp.zeros((len(voxels), 2), dtype=int, device="cpu")
    inputs = [
        wp.array(brick_of, dtype=int, device="cpu"),
        wp.array(voxels, dtype=wp.vec3i, device="cpu"),
    ]
    wp.launch(locate, dim=len(voxels), inputs=inputs, outputs=[places], device="cpu")
    inside = ((voxels >= 0) & (voxels < 16)).all(axis=1)
    rows = np.full(len(voxels), -1)
    rows[inside] = brick_of[tuple(voxels[inside].T // 8)]
    assert (places.numpy()[:, 0] == rows).all()
    columns = places.numpy()[inside, 1].reshape(-1)
    assert all(sorted(columns[rows[inside] == brick]) == list(range(512)) for brick in range(8))
