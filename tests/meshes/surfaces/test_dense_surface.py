"""Bone from a surface of many triangles.

It equals the bone from a plain computation over all of its triangles.
"""

import numpy as np
import pytest
import trimesh

from meshes.base.grid import Grid
from meshes.surfaces.repair import is_manifold, merge_vertices
from meshes.surfaces.site import place_site
from meshes.surfaces.surface import surface_from_triangles
from meshes.voxels.mesh_sampling import TriangleSampler

REGION_M = np.array([[-4e-3, -4e-3, -3e-3], [4e-3, 4e-3, 2e-3]])


def soup(mesh):
    """Triangles that have corners of their own, as an STL holds them."""
    return mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)


@pytest.fixture
def ball():
    return trimesh.creation.icosphere(subdivisions=5, radius=30.0)


def test_layers_are_those_of_the_exact_depth_everywhere(ball):
    vertices, faces = merge_vertices(*soup(ball), 1e-6)
    vertices = 1e-3 * vertices - [0.0, 0.0, 0.03]
    for spacing in (1.25e-4, 5e-4):
        count = round(8e-3 / spacing)
        grid = Grid(spacing, (-count // 2, -count // 2, -count * 3 // 4), (count, count, count))
        whole, exact = TriangleSampler(vertices, faces)(grid)
        for threshold in (0.0, 3e-4, 1.9e-3):
            fraction, depth = TriangleSampler(vertices, faces, threshold)(grid)
            np.testing.assert_array_equal(fraction, whole)
            filled = fraction > 0.0
            np.testing.assert_array_equal(depth[filled] >= threshold, exact[filled] >= threshold)


@pytest.mark.parametrize("stretch", [1.0, 1e7])
def test_vertices_are_merged_as_a_plain_sort_does(ball, stretch):
    """Stretched, the lattice has more points than a number of 64 bits counts."""
    vertices, faces = soup(ball)
    order = np.random.default_rng(5).permutation(len(vertices))
    vertices, faces = stretch * vertices[order], np.argsort(order)[faces]
    merged, kept = merge_vertices(vertices, faces, 1e-4)
    keys = np.round((vertices - vertices.min(axis=0)) / 1e-4)
    _, first, where = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(merged, vertices[first])
    np.testing.assert_array_equal(kept, where.reshape(-1)[faces])
    assert (
        is_manifold(kept)
        and not is_manifold(kept[1:])
        and not is_manifold(kept[[*range(len(kept)), 0]])
    )


@pytest.mark.parametrize("height", [12.0, 30.0])
def test_a_large_hole_of_many_triangles_is_found_where_it_is(ball, height):
    vertices, faces = soup(ball)
    opened = faces[
        vertices[faces][:, :, 2].mean(axis=1) < 12.0
        if height == 12.0
        else ball.triangles_center[:, 2] > -12.0
    ]
    surface = surface_from_triangles(vertices, opened, scale_mm=1, cut_off=True)
    site = place_site(surface, centre_mm=(0, 0, height), normal=(0, 0, 1), along=(1, 0, 0))
    assert len(surface.caps_m) == 1
    points = site.to_site(surface.caps_m[0])
    within = (points.min(axis=0) < REGION_M[1]).all() and (points.max(axis=0) > REGION_M[0]).all()
    assert within == (height == 12.0)
