"""Bones whose inside is known: by the density of a CT, or by a second surface around the core."""

import numpy as np
import pytest
import trimesh
from ct_ball import CENTRE_MM, RADIUS_MM, SHELL_MM, ball

from meshes.ct.bone_inside import cored_anatomy, imaged_anatomy
from meshes.ct.density import DensityLaw
from meshes.ct.extraction import by_threshold
from meshes.images.frame import Image
from meshes.surfaces.site import place_site
from meshes.surfaces.surface import surface_from_triangles
from meshes.voxels.voxelise import voxelise

LAW = DensityLaw(1.0, 500.0)
TOP = CENTRE_MM + np.array([0.0, 0.0, RADIUS_MM])
HALF_KG_M3 = 1075.0
"""Between 1400 of the shell and 750 of the core: where a blurred boundary is where it was."""


def sphere(radius_mm, *, inward=False, centre_mm=CENTRE_MM):
    body = trimesh.creation.icosphere(subdivisions=4, radius=radius_mm)
    faces = body.faces[:, ::-1] if inward else body.faces
    return body.vertices + centre_mm, np.asarray(faces)


def closed(*parts):
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate(
        [faces + start for (_, faces), start in zip(parts, starts, strict=False)]
    )
    return surface_from_triangles(vertices, faces, scale_mm=1.0)


def layers_of(volume):
    return {name: 1e9 * volume.volume_m3(name) for name in volume.layer_names}


def ball_mm3(radius_mm):
    return 4.0 / 3.0 * np.pi * radius_mm**3


@pytest.fixture(scope="module")
def imaged():
    bone = by_threshold(ball(), 475.0)
    surface = surface_from_triangles(*bone.triangles, scale_mm=1.0)
    return surface, bone.density(LAW)


def test_layers_follow_from_density_and_depth(imaged):
    surface, density = imaged
    normal = np.array([1.0, 0.5, -0.3])
    site = place_site(
        surface,
        centre_mm=(CENTRE_MM + RADIUS_MM * normal / np.linalg.norm(normal)).tolist(),
        normal=normal,
    )
    anatomy = imaged_anatomy(
        surface, site, density, cortical_above_kg_m3=HALF_KG_M3, articular_radius_mm=6.0
    )
    volume = voxelise(anatomy, spacing_m=0.5e-3)
    found = layers_of(volume)
    shell = ball_mm3(RADIUS_MM) - ball_mm3(RADIUS_MM - SHELL_MM)
    assert found["cortical"] + found["subchondral"] == pytest.approx(shell, rel=0.02)
    assert found["trabecular"] == pytest.approx(ball_mm3(RADIUS_MM - SHELL_MM), rel=0.02)
    cap = 2.0 * np.pi * (1.0 - np.sqrt(1.0 - (6.0 / (RADIUS_MM - SHELL_MM)) ** 2))
    assert 0.5 * cap < found["subchondral"] / shell * 4.0 * np.pi < 1.5 * cap
    held = volume.fraction == 255
    dense = np.isin(volume.layer, (0, 1)) & held
    assert np.median(volume.density_kg_m3[dense]) == pytest.approx(1400.0, rel=0.02)
    assert np.median(volume.density_kg_m3[held & ~dense]) == pytest.approx(750.0, rel=0.02)


@pytest.mark.parametrize("off_mm", [-1e-4, 1e-4])
def test_a_bone_that_the_edge_cuts_off_is_covered_up_to_there(off_mm):
    """A bone that the edge cuts off is covered up to the edge.

    Its face lies on the edge itself, half a voxel beyond the first centre, give or take rounding.
    """
    box = trimesh.creation.box((6.0, 6.0, 6.0)).subdivide().subdivide()
    surface = closed((box.vertices + np.array([5.0, 5.0, 3.0 + off_mm]), np.asarray(box.faces)))
    density = Image(
        np.full((10, 10, 10), 1400, np.uint16),
        (1.0, 1.0, 1.0),
        "box",
        (),
        origin_mm=(0.5, 0.5, 0.5),
    )
    site = place_site(surface, centre_mm=(5.0, 5.0, 6.0))
    found = layers_of(voxelise(imaged_anatomy(surface, site, density), spacing_m=0.5e-3))
    assert found["cortical"] == pytest.approx(216.0, rel=0.01)


@pytest.mark.parametrize("hollow", [False, True])
def test_a_pair_of_surfaces_is_cortical_around_trabecular(hollow):
    inner = RADIUS_MM - SHELL_MM
    outer = (
        closed(sphere(RADIUS_MM), sphere(inner, inward=True))
        if hollow
        else closed(sphere(RADIUS_MM))
    )
    core = closed(sphere(inner))
    site = place_site(outer, centre_mm=TOP.tolist(), normal=(0.0, 0.0, 1.0))
    found = layers_of(voxelise(cored_anatomy(outer, core, site), spacing_m=0.5e-3))
    assert found["trabecular"] == pytest.approx(ball_mm3(inner), rel=0.01)
    assert found["cortical"] == pytest.approx(ball_mm3(RADIUS_MM) - ball_mm3(inner), rel=0.01)
