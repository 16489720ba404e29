"""The surface of an image volume at a threshold."""

import numpy as np
import pytest
from image_surface import image_surface

from meshes.base.errors import InputError
from meshes.images.reading import Image

RADIUS_MM, SPACING_MM = 6.0, (0.5, 0.5, 0.8)


def ball(cut_at_mm: float = 30.0) -> Image:
    """A ball of grey value 1000 with a soft rim, in an image that ends at ``cut_at_mm`` along z."""
    axes = [
        np.arange(int(size / s)) * s
        for size, s in zip((16.0, 16.0, cut_at_mm), SPACING_MM, strict=True)
    ]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    distance = np.sqrt((x - 8.0) ** 2 + (y - 8.0) ** 2 + (z - 8.0) ** 2) - RADIUS_MM
    return Image(500.0 - 500.0 * np.clip(distance, -1.0, 1.0), SPACING_MM, "ball", ())


def test_ball_has_its_volume_and_place():
    """1 %: marching cubes inscribes its facets."""
    surface = image_surface(ball(), threshold=500.0)
    assert surface.report.volume_mm3 == pytest.approx(4.0 / 3.0 * np.pi * RADIUS_MM**3, rel=0.01)
    assert 1e3 * 0.5 * (
        surface.vertices_m.min(axis=0) + surface.vertices_m.max(axis=0)
    ) == pytest.approx([8.0, 8.0, 8.0], abs=0.05)
    assert not any("Turned" in repair for repair in surface.report.repairs)


def test_bone_cut_by_the_edge_of_the_image_is_closed_there():
    surface = image_surface(ball(cut_at_mm=8.0), threshold=500.0)
    assert len(surface.caps_m) == 1 and not image_surface(ball(), threshold=500.0).caps_m
    assert surface.report.volume_mm3 == pytest.approx(2.0 / 3.0 * np.pi * RADIUS_MM**3, rel=0.15)


def test_threshold_above_everything_is_refused():
    with pytest.raises(
        InputError, match=r"anatomy.threshold must leave bone, got 2000 where ball holds .* to 1000"
    ):
        image_surface(ball(), threshold=2000.0)
