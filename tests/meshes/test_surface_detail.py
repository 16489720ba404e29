"""A surface of very many triangles is as it is where the tool goes."""

import numpy as np
import pytest
import trimesh

from meshes import surface_detail
from meshes.errors import InputError
from meshes.repair import vertex_bodies
from meshes.site import place_site
from meshes.surface import surface_from_triangles
from meshes.surface_anatomy import surface_anatomy
from meshes.surface_detail import surface_at_site
from meshes.voxelise import voxelise

REGION_M = np.array([[-4e-3, -4e-3, -3e-3], [4e-3, 4e-3, 2e-3]])


def find(surface):
    return place_site(surface, centre_mm=(0, 0, 30), normal=(0, 0, 1), along=(1, 0, 0))


@pytest.fixture
def ball(monkeypatch):
    """A ball of 30 mm whose triangles have corners of their own, as an STL holds them, and count as many."""
    monkeypatch.setattr(surface_detail, "_CELLS", 20)
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=30.0)
    return mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)


def test_many_triangles_are_joined_outside_the_region_only(ball):
    whole = surface_from_triangles(*ball, scale_mm=1)
    surface, site = surface_at_site(*ball, find, 2.0 * REGION_M, source="ball", scale_mm=1, most=1000)
    assert len(surface.faces) < len(whole.faces) / 3
    assert surface.report.size_mm == pytest.approx(whole.report.size_mm, abs=1e-9)
    assert surface.report.volume_mm3 == pytest.approx(whole.report.volume_mm3, rel=0.05)
    one, two = (
        voxelise(surface_anatomy(each, at, cortical_thickness_mm=1.0), spacing_m=2e-4, region_m=REGION_M)
        for each, at in ((whole, find(whole)), (surface, site))
    )
    np.testing.assert_array_equal(one.fraction, two.fraction)
    np.testing.assert_array_equal(one.layer[one.fraction > 0], two.layer[one.fraction > 0])


@pytest.mark.parametrize(("towards", "near"), [((0, 0, 1), True), ((0, 0, -1), False)])
def test_a_large_hole_of_many_triangles_is_found_where_it_is(ball, towards, near):
    vertices, faces = ball
    middle = vertices[faces].mean(axis=1) @ np.array(towards, dtype=float)
    height = 12 if near else 30

    def site(surface):
        return place_site(surface, centre_mm=(0, 0, height), normal=(0, 0, 1), along=(1, 0, 0))

    opened = faces[middle < 12.0]
    options = {"source": "cup", "scale_mm": 1, "most": 1000}
    surface, at = surface_at_site(vertices, opened, site, 2.0 * REGION_M, cut_off=True, **options)
    assert (near or len(surface.faces) < len(opened)) and len(surface.caps_m) == 1
    points = at.to_site(surface.caps_m[0])
    within = (points.min(axis=0) < REGION_M[1]).all() and (points.max(axis=0) > REGION_M[0]).all()
    assert within == near
    with pytest.raises(InputError, match="must enclose a solid"):
        surface_at_site(vertices, opened, site, 2.0 * REGION_M, **options)


def test_mixed_winding_is_mended_on_all_triangles(ball):
    vertices, faces = ball
    turned = faces.copy()
    turned[::5] = turned[::5, ::-1]
    surface, _ = surface_at_site(vertices, turned, find, REGION_M, source="mixed", scale_mm=1, most=1000)
    assert len(surface.faces) == len(faces)
    assert surface.report.volume_mm3 == pytest.approx(4 / 3 * np.pi * 30**3, rel=5e-3)


@pytest.mark.parametrize("site", [{"normal": (0, 0, 1)}, {}])
def test_axes_that_nobody_gave_come_from_all_triangles(ball, site):
    vertices, faces = ball
    vertices = vertices * [1.0, 1.3, 1.0] + np.abs(vertices[:, :1]) * [0.4, 0.1, 0.0]

    def place(surface):
        return place_site(surface, centre_mm=(0, 0, 30), **site)

    whole, wanted = surface_at_site(vertices, faces, place, REGION_M, source="egg", scale_mm=1)
    surface, found = surface_at_site(vertices, faces, place, REGION_M, source="egg", scale_mm=1, most=1000)
    assert len(surface.faces) < len(whole.faces) / 2
    np.testing.assert_allclose(found.rotation, wanted.rotation, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.centre_m, wanted.centre_m, rtol=0, atol=1e-9)


@pytest.mark.parametrize("inward", [False, True])
def test_bodies_closer_than_what_is_joined_stay_apart(ball, inward):
    vertices, faces = ball
    second = faces[:, ::-1] if inward else faces
    both = np.concatenate([vertices, vertices - [0.0, 0.0, 61.0]]), np.concatenate([faces, second + len(vertices)])
    surface, _ = surface_at_site(*both, find, REGION_M, source="two", scale_mm=1, most=1000)
    assert inward or len(surface.faces) < len(faces)
    assert surface.report.volume_mm3 == pytest.approx(2 * 4 / 3 * np.pi * 30**3, rel=0.05)
    assert vertex_bodies(surface.vertices_m, surface.faces, 1e-9).max() == 1
