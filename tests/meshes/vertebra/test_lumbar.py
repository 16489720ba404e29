"""Procedural lumbar vertebra. Its dimensions are the requested ones, and its canal is free."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from meshes.vertebra.lumbar import lumbar_vertebra

AXIS = np.deg2rad(17.7)
"""By which the site's z leans from straight backward."""


def run_inside(shape, start, direction, *, reach_m=60e-3):
    """Return the length [m] of the stretch inside a shape through a point.

    It is measured along a direction and against it.
    """
    direction = np.asarray(direction) / np.linalg.norm(direction)
    at = np.linspace(-reach_m, reach_m, 24001)
    inside = shape.distance(np.asarray(start) + at[:, None] * direction) < 0.0
    middle = len(at) // 2
    assert inside[middle]
    low, high = np.flatnonzero(~inside[:middle])[-1], middle + np.flatnonzero(~inside[middle:])[0]
    return at[high] - at[low]


def test_the_canal_is_the_ellipse_that_was_asked_for():
    canal = lumbar_vertebra().structures["canal"]
    rng = np.random.default_rng(0)
    points = rng.uniform(-40e-3, 40e-3, (40, 3))
    found = canal.distance(points)
    # Back into the frame of the body, by what the middle of the canal is: its distance is least
    # there.
    grid = np.stack(
        np.meshgrid(*[np.linspace(-50e-3, 50e-3, 401)] * 2, indexing="ij"), axis=-1
    ).reshape(-1, 2)
    flat = np.column_stack([grid[:, 0], np.zeros(len(grid)), grid[:, 1]])
    inside = flat[canal.distance(flat) < 0.0]
    centre = inside.mean(axis=0)
    left, back = (
        np.array([-np.cos(AXIS), 0.0, np.sin(AXIS)]),
        np.array([np.sin(AXIS), 0.0, np.cos(AXIS)]),
    )
    assert run_inside(canal, centre, left) == pytest.approx(25.4e-3, abs=0.1e-3)
    assert run_inside(canal, centre, back) == pytest.approx(18.6e-3, abs=0.1e-3)
    for point, distance in zip(points, found, strict=True):
        x, y = (point - centre) @ left, (point - centre) @ back

        def away(angle, x=x, y=y):
            return float(np.hypot(x - 12.7e-3 * np.cos(angle), y - 9.3e-3 * np.sin(angle)))

        starts = np.linspace(0.0, 2.0 * np.pi, 9)
        nearest = min(
            minimize_scalar(away, bounds=pair, method="bounded", options={"xatol": 1e-9}).fun
            for pair in pairwise(starts)
        )
        # the centre is that of a grid of 0.25 mm
        assert abs(distance) == pytest.approx(nearest, abs=0.1e-3)


def test_pedicle_has_its_width_and_height():
    """The pedicle has its width and height at its isthmus.

    The isthmus lies next to the canal, about 15 mm before the entry's plane.
    """
    whole = lumbar_vertebra(pedicle_width_mm=10.0, pedicle_height_mm=14.0).shape
    widths = [
        run_inside(whole, (0.0, 0.0, -depth), (1, 0, 0)) for depth in np.arange(8e-3, 24e-3, 1e-3)
    ]
    heights = [
        run_inside(whole, (0.0, 0.0, -depth), (0, 1, 0)) for depth in np.arange(8e-3, 24e-3, 1e-3)
    ]
    assert min(heights) == pytest.approx(14e-3, abs=0.1e-3)
    # blends with body and arch fill its medial corners
    assert min(widths) == pytest.approx(10e-3, abs=1.5e-3)


def test_distances_never_exceed_the_true_ones():
    rng = np.random.default_rng(1)
    points = rng.uniform(-80e-3, 60e-3, (100_000, 3))
    nearby = points + rng.normal(size=points.shape) * 1e-4
    anatomy = lumbar_vertebra()
    for shape in (anatomy.shape, anatomy.structures["canal"]):
        steps = np.abs(shape.distance(points) - shape.distance(nearby)) / np.linalg.norm(
            points - nearby, axis=1
        )
        assert steps.max() < 1.001


def test_no_bone_in_the_canal_and_layers_by_depth():
    anatomy = lumbar_vertebra()
    points = np.random.default_rng(2).uniform(-40e-3, 20e-3, (50_000, 3))
    inside = anatomy.structures["canal"].distance(points) < -1e-5
    assert (anatomy.shape.distance(points[inside]) > 0.0).all()
    depth = np.linspace(0.1e-3, 12e-3, 60)
    layer, density = anatomy.classify(np.column_stack([0 * depth, 0 * depth, -depth]), depth)
    assert (layer == np.where(depth < 1e-3, 0, 2)).all()
    assert set(density) == {1800.0, 280.0}
