"""A mesh of facets given the volume of what it stands for."""

import numpy as np
import pytest

from meshes.shapes.sdf import sphere
from meshes.tets.stuffing import stuffed
from meshes.tets.tetrahedralise import with_volume

RADIUS_M = 0.05
VOLUME_M3 = 4.0 / 3.0 * np.pi * RADIUS_M**3


def test_a_ball_of_facets_gets_the_volume_of_the_ball():
    """Its nodes go out by what facets cut off, volume over area, to second order."""
    mesh = stuffed(sphere(RADIUS_M), 0.012)
    missing = VOLUME_M3 - float(mesh.volumes_m3.sum())
    assert missing > 0.005 * VOLUME_M3
    found = with_volume(mesh, VOLUME_M3, within_m=1e-3)
    assert found.volumes_m3.sum() == pytest.approx(VOLUME_M3, rel=1e-6)
    away = np.linalg.norm(found.nodes_m[found.surface_nodes], axis=1) - RADIUS_M
    assert away == pytest.approx(missing / (4.0 * np.pi * RADIUS_M**2), rel=0.1)
    inside = np.setdiff1d(np.arange(len(mesh.nodes_m)), mesh.surface_nodes)
    assert np.array_equal(found.nodes_m[inside], mesh.nodes_m[inside])


def test_a_surface_that_would_move_far_stays():
    mesh = stuffed(sphere(RADIUS_M), 0.012)
    assert with_volume(mesh, VOLUME_M3, within_m=1e-5) is mesh
    assert with_volume(mesh, 0.5 * VOLUME_M3, within_m=1.0) is mesh
