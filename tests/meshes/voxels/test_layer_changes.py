"""Stored distances to the nearest change of layer against planes, balls, blocks and thin sheets."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.voxels.distances import FAR, boundary_of_layers, layer_boundary

SHAPE = (24, 24, 24)
CENTRES = np.stack(np.indices(SHAPE), axis=-1) + 0.5 - 12.0
KNOWN = np.ones(SHAPE, dtype=bool)
INNER = (slice(5, -5),) * 3
"""Away from the array's faces, where what lies beyond is not a plane's."""
WIDE = np.stack(np.indices((40,) * 3), axis=-1) + 0.5 - 20.0


def directions(count, seed=0):
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    return [*np.eye(3), *(normals / np.linalg.norm(normals, axis=1)[:, None])]


@pytest.mark.parametrize("kind", ["plane", "ball"])
def test_a_change_of_layer_is_found_to_a_thirtieth_of_a_voxel(kind):
    """A change of layer is found to a thirtieth of a voxel.

    This holds for 90 % of the points within a voxel of it; the rest look in a direction that voxels
    give to ten degrees.
    """
    random, off = np.random.default_rng(2), []
    for normal in directions(12, seed=3):
        shift = random.uniform(-0.5, 0.5)

        def change(points, normal=normal, shift=shift):
            points = np.asarray(points, dtype=float)
            return (
                points @ normal - shift
                if kind == "plane"
                else np.linalg.norm(points - shift, axis=-1) - 7.0
            )

        stored = layer_boundary(
            (change(CENTRES) > 0).astype(np.uint8),
            KNOWN,
            lambda at: (change(at - 12.0) > 0).astype(np.uint8),
        )
        distance = np.abs(change(CENTRES))
        near = distance[INNER] < 1.0
        off.append(stored[INNER][near] / 127.0 - distance[INNER][near])
        assert (stored[INNER][distance[INNER] > 2.5] == FAR).all()
    off = np.concatenate(off)
    print(
        f"\n{kind}: mean {off.mean():+.4f}, 90 % {np.percentile(np.abs(off), 90):.4f}, max "
        f"{np.abs(off).max():.4f}"
    )
    assert np.percentile(np.abs(off), 90) < 1 / 30
    assert off.min() > -1 / 30  # along no direction is a change nearer than it is


def corners_of_mixed_cells(layer):
    """Return True for each voxel with a surrounding cell that holds two layers."""
    cells = np.lib.stride_tricks.sliding_window_view(np.pad(layer, 1, mode="edge"), (2, 2, 2))
    mixed = cells.min(axis=(3, 4, 5)) != cells.max(axis=(3, 4, 5))
    return np.lib.stride_tricks.sliding_window_view(mixed, (2, 2, 2)).any(axis=(3, 4, 5))


def crossings(stored, layer):
    """Return places [voxel] on the grid's edges where two layers' distances cross, shape (n, 3)."""
    distance, found = np.where(layer == 1, 1.0, -1.0) * stored, []
    for axis in range(3):
        a, b = (np.moveaxis(distance, axis, 0)[part] for part in (slice(0, -1), slice(1, None)))
        low, high = np.nonzero((a < 0) != (b < 0)), np.moveaxis(WIDE, axis, 0)
        share = (a[low] / (a[low] - b[low]))[:, None]
        found.append((1.0 - share) * high[:-1][low] + share * high[1:][low])
    found = np.concatenate(found)
    return found[np.abs(found).max(axis=1) < 14.0]


def distance_to_plane(points, turn, shift):
    return points @ turn[2] - shift[2]


def distance_to_ball(points, turn, shift):
    return 8.0 - np.linalg.norm(points - shift, axis=-1)


def distance_to_block(points, turn, shift):
    beyond = np.abs((points - shift) @ turn) - [11.0, 9.0, 7.0]
    return -np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) - np.minimum(beyond.max(axis=-1), 0.0)


@pytest.mark.parametrize(
    ("distance", "root_mean_square", "mean"),
    [
        (distance_to_plane, 0.07, 0.01),
        (distance_to_ball, 0.09, 0.02),
        (distance_to_block, 0.2, 0.08),
    ],
)
def test_a_boundary_from_layers_alone_lies_where_it_is(distance, root_mean_square, mean):
    """A boundary from layers alone lies at its true place.

    The error is taken over eight rotations and places: steps of the labels leave 0.05 of a voxel, a
    block's edges are rounded. If a voxel's share of a cube were taken as a plane's, the boundary
    would be 0.24 off on this ball, all of it inward.
    """
    off = []
    for seed in range(8):
        turn = Rotation.random(random_state=seed).as_matrix()
        shift = np.random.default_rng(seed).uniform(-0.5, 0.5, 3)
        layer = (distance(WIDE, turn, shift) > 0.0).astype(np.uint8)
        stored = boundary_of_layers(layer, np.ones(layer.shape, dtype=bool)).astype(float)
        off.append(distance(crossings(stored, layer), turn, shift))
    off = np.concatenate(off)
    rms = np.sqrt(np.mean(off**2))
    print(
        f"\n{distance.__name__}: mean {off.mean():+.4f}, rms {rms:.4f}, max "
        f"{np.abs(off).max():.3f} voxel"
    )
    assert rms < root_mean_square
    assert abs(off.mean()) < mean


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.3, 0.2, 1.0), (1.0, 1.0, 1.0)])
@pytest.mark.parametrize("thickness", [1.0, 2.0])
def test_a_thin_layer_keeps_its_place(normal, thickness):
    """A thin layer keeps its place.

    A sheet a voxel or two thick measures at least 0.4 of its thickness on a line across it, and at
    most two voxels more. No boundary leaves the edge between two centres of different layers, so
    that each side moves by half a voxel at most.
    """
    normal = np.array(normal) / np.linalg.norm(normal)
    layer = (np.abs(CENTRES @ normal - 0.5 * normal[2]) <= 0.5 * thickness).astype(np.uint8)
    stored = boundary_of_layers(layer, KNOWN)
    assert (stored[corners_of_mixed_cells(layer)] > 0).all()
    distance = np.where(layer == 1, 1.0, -1.0) * stored
    parts = (np.arange(4) + 0.5) / 4
    inside = [
        np.einsum("...ijk,i,j,k->...", cells(distance), *([1.0 - t, t] for t in at)) > 0.0
        for at in np.stack(np.meshgrid(parts, parts, parts), axis=-1).reshape(-1, 3)
    ]
    found = np.mean(inside) * (SHAPE[0] - 1) * normal[2]
    print(f"\n{thickness:g} voxels along {np.round(normal, 2)}: {found:.2f}")
    assert 0.4 * thickness < found < thickness + 2.0


def cells(values):
    """Return the eight values around each cell, away from the array's faces.

    The shape is (nx - 1, ny - 1, nz - 1, 2, 2, 2).
    """
    return np.lib.stride_tricks.sliding_window_view(values, (2, 2, 2))
