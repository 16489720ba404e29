"""Displacements and forces between meshes of one block: polynomials are kept, work too."""

import numpy as np
import pytest

from meshes.tets.structured import box
from tissue.fem.assembly import surface_transfer
from tissue.fem.space import Space

SIZE_M = (0.04, 0.03, 0.02)


def on_surface(count: int, seed: int) -> np.ndarray:
    """Points on the six faces of the block."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, 1.0, (count, 3)) * SIZE_M
    axis = rng.integers(0, 3, count)
    side = rng.integers(0, 2, count)
    points[np.arange(count), axis] = side * np.array(SIZE_M)[axis]
    return points + box(SIZE_M, (1, 1, 1)).nodes_m.min(axis=0)


@pytest.mark.parametrize("order", [1, 2])
def test_fields_up_to_the_order_are_taken_over_exactly(order):
    space = Space(box(SIZE_M, (3, 2, 2)), order)
    points = on_surface(200, 0)

    def field(at: np.ndarray) -> np.ndarray:
        x, y, z = 1e2 * at.T
        return np.column_stack([x + 2.0 * y, 1.0 - z, x * y + z**2 if order == 2 else y])

    found = surface_transfer(space, points) @ field(space.nodes_m)
    np.testing.assert_allclose(found, field(points), atol=1e-12 * np.abs(field(points)).max())


def test_forces_and_their_moments_are_kept():
    space = Space(box(SIZE_M, (3, 2, 2)), 2)
    points = on_surface(100, 1)
    forces = np.random.default_rng(2).normal(size=points.shape)
    nodal = surface_transfer(space, points).T @ forces
    np.testing.assert_allclose(nodal.sum(axis=0), forces.sum(axis=0), atol=1e-12)
    np.testing.assert_allclose(
        np.cross(space.nodes_m, nodal).sum(axis=0), np.cross(points, forces).sum(axis=0), atol=1e-13
    )
