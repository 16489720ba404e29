"""Voxels under a triangle surface, and the glenoid found on bones where it is known."""

import math

import numpy as np
import pytest
import trimesh
from voxel_surface import voxel_surface

from meshes.base.grid import Grid
from meshes.base.placement import Placement
from meshes.shapes import sdf
from meshes.surfaces.glenoid import glenoid, surface_anatomy
from meshes.surfaces.landmarks import find_glenoid
from meshes.surfaces.site import place_site
from meshes.surfaces.surface import read_surface, surface_from_triangles
from meshes.voxels.mesh_sampling import TriangleSampler
from meshes.voxels.voxelise import voxelise


def as_surface(mesh):
    return surface_from_triangles(np.array(mesh.vertices), np.array(mesh.faces), scale_mm=1)


def sampled(mesh, spacing, half):
    grid = Grid(spacing, (-half,) * 3, (2 * half,) * 3)
    return TriangleSampler(np.array(mesh.vertices), np.array(mesh.faces))(grid)


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_volume_and_depth_under_triangles(turn):
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=5e-3)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, (1, 2, 3)))
    fraction, depth = sampled(mesh, 2e-4, 32)
    # nine lines a voxel over 2000 columns
    assert fraction.sum() * 2e-4**3 == pytest.approx(mesh.volume, rel=1e-4)
    exact = 5e-3 - np.linalg.norm((np.indices(fraction.shape) - 31.5) * 2e-4, axis=0)
    shell = (fraction > 0.5) & (exact < 2.5e-3)
    # (0.4 mm)^2/4 over a radius of 2.5 mm, and the facets' sagitta
    assert np.abs(depth - exact)[shell].max() < 3e-5


def test_box_on_the_lattice_is_exact_though_lines_meet_edges():
    fraction, _ = sampled(trimesh.creation.box((4e-3, 4e-3, 4e-3)), 2e-4, 16)
    expected = np.zeros((32, 32, 32))
    expected[6:26, 6:26, 6:26] = 1
    assert np.abs(fraction - expected).max() < 1e-6


def synthetic_scapula():
    """The procedural glenoid on a thin blade, turned and moved."""
    blade = sdf.box((6e-3, 110e-3, 70e-3), (0.0, -35e-3, -60e-3), rounding_m=2e-3)
    spike = sdf.capsule(6e-3, (-2e-3, 20e-3, -12e-3), (-22e-3, 32e-3, 18e-3))
    bone = sdf.union(glenoid(vault_depth_mm=30).shape, blade, blend_m=4e-3) | spike
    from meshes.shapes.anatomy import Anatomy, cortical_block

    vertices, faces = voxel_surface(
        voxelise(Anatomy("scapula", bone, ("bone",), cortical_block().classify), spacing_m=1e-3)
    )
    turn = trimesh.transformations.rotation_matrix(2.1, (1, -2, 0.5))[:3, :3]
    move = np.array([0.1, -0.05, 0.2])
    return surface_from_triangles((vertices @ turn.T + move) * 1e3, faces, scale_mm=1), turn, move


def test_glenoid_is_found_where_it_was_put():
    surface, turn, move = synthetic_scapula()
    site = find_glenoid(surface)
    assert np.linalg.norm(site.centre_m - move) < 2.5e-3
    # rings of 1 mm at 14 mm: 4.1
    assert math.degrees(math.acos(site.rotation[:, 2] @ turn[:, 2])) < 5.0
    assert site.rotation[:, 1] @ turn[:, 1] > 0.9
    assert np.allclose(site.rotation.T @ site.rotation, np.eye(3)) and np.linalg.det(
        site.rotation
    ) == pytest.approx(1)
    assert site.confidence.startswith("found by search: face 2") and "concave" in site.confidence


def test_site_as_given_lies_on_the_surface():
    surface = as_surface(trimesh.creation.icosphere(subdivisions=4, radius=30.0))
    site = place_site(surface, centre_mm=(0, 0, 27), normal=(0, 0, 2))
    assert site.centre_m == pytest.approx([0, 0, 30e-3], abs=2e-4)
    assert site.rotation[:, 2] == pytest.approx([0, 0, 1])
    assert site.confidence == "centre and normal as given"


def test_without_a_normal_it_is_that_of_the_surface_and_x_lies_along_the_direction_given():
    surface = as_surface(trimesh.creation.icosphere(subdivisions=4, radius=30.0))
    out, along = np.array([2.0, -1.0, 2.0]) / 3.0, np.array([0.3, 0.9, 0.1])
    site = place_site(surface, centre_mm=29e0 * out, along=5.0 * along)
    # facets of 2.6 mm lean by 2.5 degrees
    assert site.rotation[:, 2] @ out > math.cos(math.radians(1.5))
    across = along - (along @ site.rotation[:, 2]) * site.rotation[:, 2]
    assert site.rotation[:, 0] == pytest.approx(across / np.linalg.norm(across))
    assert np.linalg.det(site.rotation) == pytest.approx(1.0)
    assert (
        site.confidence
        == "centre as given, normal of the surface around it, x along the direction given"
    )
    placed = site.placement(1.0)
    corner = placed.to_scene(1e3 * (site.centre_m + 2e-3 * site.rotation[:, 0])[None])[0]
    assert corner == pytest.approx([2, 0, 0], abs=1e-12)
    assert placed.to_file(corner[None])[0] == pytest.approx(
        1e3 * site.centre_m + 2 * site.rotation[:, 0]
    )
    again = Placement.from_record(placed.to_record())
    assert again.origin_mm == pytest.approx(placed.origin_mm) and again.rotation == pytest.approx(
        placed.rotation
    )


@pytest.mark.parametrize(
    ("name", "scale_mm", "centre_mm", "axis"),
    [
        # read off rendered pictures: middle of the facet within 3 mm, axis within 15 degrees
        ("openforge_scapula_left.stl", 50, (-35.7, 7.5, 33.7), (-0.92, 0.38, -0.13)),
        ("myosim_scapula.stl", None, (-28.5, -36.7, -16.6), (0.52, -0.06, 0.85)),
    ],
)
@pytest.mark.slow
def test_real_scapulae(anatomy, name, scale_mm, centre_mm, axis):
    surface = read_surface(anatomy / "scapula" / name, scale_mm=scale_mm)
    site = find_glenoid(surface)
    assert np.linalg.norm(site.centre_m * 1e3 - centre_mm) < 3.0
    axis = np.array(axis) / np.linalg.norm(axis)
    assert site.rotation[:, 2] @ axis > math.cos(math.radians(15))
    volume = voxelise(
        surface_anatomy(surface, site), spacing_m=4e-4, region_m=((-8e-3,) * 3, (8e-3,) * 3)
    )
    middle = volume.fraction[20, 20]
    # solid 2 mm below the face, free 2 mm above
    assert (middle[:15] == 255).all() and (middle[25:] == 0).all()
