"""Bone from a surface of many triangles.

It equals the bone from a plain computation over all of its triangles.
"""

import numpy as np
import pytest
import trimesh

from meshes.surfaces.glenoid import surface_anatomy
from meshes.surfaces.repair import is_manifold, merge_vertices
from meshes.surfaces.site import place_site
from meshes.surfaces.surface import surface_from_triangles
from meshes.voxels.mesh_sampling import TriangleSampler, triangles_meeting
from meshes.voxels.volume import Grid
from meshes.voxels.voxelise import voxelise

REGION_M = np.array([[-4e-3, -4e-3, -3e-3], [4e-3, 4e-3, 2e-3]])


def soup(mesh):
    """Triangles that have corners of their own, as an STL holds them."""
    return mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)


@pytest.fixture
def ball():
    return trimesh.creation.icosphere(subdivisions=5, radius=30.0)


def voxels(vertices, faces):
    surface = surface_from_triangles(vertices, faces, scale_mm=1)
    site = place_site(surface, centre_mm=(0, 0, 30), normal=(0, 0, 1), along=(1, 0, 0))
    return voxelise(
        surface_anatomy(surface, site, cortical_thickness_mm=1.0), spacing_m=2e-4, region_m=REGION_M
    )


def test_voxels_do_not_depend_on_how_fine_the_triangles_of_a_body_are():
    """Flat triangles divided by four, three times: the same body. Of 1 in 255: lines through
    edges, rounding.
    """
    coarse = trimesh.creation.icosphere(subdivisions=3, radius=30.0)
    few, many = voxels(*soup(coarse)), voxels(*soup(coarse.subdivide().subdivide().subdivide()))
    assert np.abs(few.fraction.astype(int) - many.fraction).max() <= 1
    filled = few.fraction > 0
    assert np.mean(few.layer[filled] != many.layer[filled]) < 1e-4


def test_layers_are_those_of_the_exact_depth_everywhere(ball):
    vertices, faces = merge_vertices(*soup(ball), 1e-6)
    vertices = 1e-3 * vertices - [0.0, 0.0, 0.03]
    for spacing in (1e-4, 5e-4):
        count = round(8e-3 / spacing)
        grid = Grid(spacing, (-count // 2, -count // 2, -count * 3 // 4), (count, count, count))
        for threshold in (0.0, 3e-4, 1.9e-3):
            fraction, depth = TriangleSampler(vertices, faces, threshold)(grid)
            whole, exact = TriangleSampler(vertices, faces)(grid)
            np.testing.assert_array_equal(fraction, whole)
            filled = fraction > 0.0
            np.testing.assert_array_equal(depth[filled] >= threshold, exact[filled] >= threshold)


def test_triangles_meeting_an_interval_are_those_whose_box_does():
    random = np.random.default_rng(3)
    points, triangles = random.normal(size=(60, 3)), random.integers(0, 60, size=(500, 3))
    for axis in range(3):
        low, high = np.sort(random.normal(size=2))
        boxes = points[triangles][:, :, axis]
        wanted = triangles[(boxes.min(axis=1) <= high) & (boxes.max(axis=1) >= low)]
        np.testing.assert_array_equal(triangles_meeting(points, triangles, axis, low, high), wanted)


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


@pytest.mark.parametrize("inward", [False, True])
def test_two_bodies_next_to_each_other_stay_two(ball, inward):
    vertices, faces = soup(ball)
    second = faces[:, ::-1] if inward else faces
    both = (
        np.concatenate([vertices, vertices - [0.0, 0.0, 61.0]]),
        np.concatenate([faces, second + len(vertices)]),
    )
    report = surface_from_triangles(*both, scale_mm=1).report
    assert report.volume_mm3 == pytest.approx(2 * ball.volume, rel=1e-9)
    assert any("Turned" in repair for repair in report.repairs) == inward


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


def test_axes_do_not_depend_on_the_order_of_vertices(ball):
    vertices, faces = soup(ball)
    vertices = vertices * [1.0, 1.3, 1.0] + np.abs(vertices[:, :1]) * [0.4, 0.1, 0.0]
    one, two = (
        place_site(surface_from_triangles(*each, scale_mm=1), centre_mm=(0, 0, 30))
        for each in ((vertices, faces), (vertices[::-1], len(vertices) - 1 - faces))
    )
    np.testing.assert_allclose(one.rotation, two.rotation, rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.centre_m, two.centre_m, rtol=0, atol=1e-9)
