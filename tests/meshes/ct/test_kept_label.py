"""The surface of a label to keep clear of: all of its pieces, each of its size, thin ones too."""

import numpy as np
import pytest
from ct_ball import ball_mask

from meshes.ct.extraction import kept_label
from meshes.ct.labels import Labels
from meshes.images.frame import Image
from meshes.surfaces.surface import surface_from_triangles
from meshes.voxels.mesh_sampling import triangle_distance

SPACING_MM = (0.5, 0.5, 0.8)
ORIGIN_MM = (-30.0, -12.0, -15.0)
EMPTY = Image(np.zeros((120, 48, 40), np.uint8), SPACING_MM, "labels", (), ORIGIN_MM)


def distance_mm(mask, points_mm):
    (vertices, faces), _ = kept_label(EMPTY, mask, "canal")
    surface = surface_from_triangles(vertices, faces, scale_mm=1.0, every_piece=True)
    return 1e3 * triangle_distance(surface.vertices_m, surface.faces, 1e-3 * np.asarray(points_mm))


@pytest.mark.parametrize("small_mm", [4.0, 0.9])
def test_the_smaller_of_two_pieces_is_where_it_is(small_mm):
    near, far = np.array([-18.0, 0.0, 0.0]), np.array([15.0, 0.0, 0.0])
    mask = ball_mask(EMPTY, centre_mm=far, radius_mm=10.0) | ball_mask(
        EMPTY, centre_mm=near, radius_mm=small_mm
    )
    points = near + np.array([[-9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 9.0], [5.0, 5.0, 5.0]])
    exact = np.linalg.norm(points - near, axis=1) - small_mm
    assert np.abs(distance_mm(mask, points) - exact).max() < 0.5 * min(SPACING_MM)
    assert kept_label(EMPTY, mask, "canal")[1][0].startswith("canal: 2 pieces of 4.1")


def test_a_thread_of_one_voxel_that_hangs_on_a_thick_piece_stays():
    mask = ball_mask(EMPTY, centre_mm=np.zeros(3), radius_mm=8.0)
    mask[10:60, 24, 19] = True
    centres = np.argwhere(mask) * SPACING_MM + ORIGIN_MM
    assert distance_mm(mask, centres).max() < 0.5 * max(SPACING_MM)
    assert distance_mm(mask, centres[centres[:, 0] < -9.0]).max() < 0.0


def test_labels_of_one_name_are_one():
    values = np.arange(8, dtype=np.uint8).reshape(2, 2, 2) % 4
    labels = Labels(Image(values, SPACING_MM, "labels", ()), {1: "nerve", 2: "bone", 3: "nerve"})
    assert np.array_equal(labels.mask("nerve"), values % 2 == 1) and np.array_equal(
        labels.mask("2"), values == 2
    )
