"""The fraction of a cube behind a plane, against closed cases, symmetry and Monte Carlo."""

import math

import numpy as np
import pytest

from meshes.voxels.distances import cube_fraction

FORMULA = 3e-5  # components below 1e-5 are raised to it: less than 2e-5 of a voxel, and rounding


@pytest.mark.parametrize(
    ("distance", "normal", "fraction"),
    [
        (0.0, (0, 0, 1), 0.5),
        (0.25, (1, 0, 0), 0.25),
        (-0.25, (0, -1, 0), 0.75),
        (0.6, (0, 0, 1), 0.0),
        (-0.6, (0, 0, 1), 1.0),
        (0.25 * math.sqrt(2), (math.sqrt(0.5), math.sqrt(0.5), 0), 0.125),  # prism of legs 1/2
        # plane through three corners: a tetrahedron
        (math.sqrt(3) / 6, (3**-0.5, 3**-0.5, 3**-0.5), 1 / 6),
        (math.sqrt(3) / 3, (3**-0.5, 3**-0.5, -(3**-0.5)), 1 / 48),  # tetrahedron of legs 1/2
    ],
)
def test_closed_cases(distance, normal, fraction):
    assert cube_fraction(np.array([distance]), np.array([normal]))[0] == pytest.approx(
        fraction, abs=FORMULA
    )


def test_monte_carlo():
    rng = np.random.default_rng(11)
    normal = rng.normal(size=(40, 3))
    normal[:10, 0] *= 1e-3
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    distance = rng.uniform(-0.8, 0.8, 40)
    inside = rng.uniform(-0.5, 0.5, (200_000, 3)) @ normal.T <= -distance
    sampling = 5 * 0.5 / math.sqrt(200_000)  # five standard deviations of a fair coin
    assert np.abs(cube_fraction(distance, normal) - inside.mean(axis=0)).max() < sampling
