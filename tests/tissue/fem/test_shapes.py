"""Shape functions of simplices, against polynomials that are written out here.

They are integrated by a fine rule.
"""

import numpy as np
import pytest

from tissue.fem.space import (
    EDGES,
    TRIANGLE_EDGES,
    gauss_points,
    gradient_products,
    gradient_slopes,
    mean_shape,
)

NODES = {(3, 1): 3, (3, 2): 6, (4, 1): 4, (4, 2): 10}


def rule(corners, parts=24):
    """Return barycentric midpoints of a fine division of a simplex by collapsed cubes.

    Their weights add up to 1.
    """
    line = (np.arange(parts) + 0.5) / parts
    axes = np.stack(np.meshgrid(*[line] * (corners - 1), indexing="ij"), axis=-1).reshape(
        -1, corners - 1
    )
    left = np.ones(len(axes))
    places = []
    for at in range(corners - 1):
        places.append(left * axes[:, at])
        left = left * (1.0 - axes[:, at])
    weights = np.prod(
        [(1.0 - axes[:, at]) ** (corners - 2 - at) for at in range(corners - 1)], axis=0
    )
    return np.column_stack([*places, left]), weights / weights.sum()


def values(corners, order, places):
    """Shape functions by their textbook formulas."""
    if order == 1:
        return places
    edges = EDGES if corners == 4 else TRIANGLE_EDGES
    return np.column_stack(
        [places * (2.0 * places - 1.0), *(4.0 * places[:, [i]] * places[:, [j]] for i, j in edges)]
    )


@pytest.mark.parametrize(("corners", "order"), NODES)
def test_means_of_shape_functions(corners, order):
    places, weights = rule(corners)
    means = mean_shape(corners, order)
    assert means.shape == (NODES[corners, order],)
    # midpoints 1/24 apart
    assert means == pytest.approx(weights @ values(corners, order, places), abs=2e-3)
    assert means.sum() == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize(("corners", "order"), NODES)
def test_slopes_and_products_of_gradients(corners, order):
    """Slopes and products of gradients agree with differences.

    d N_A / d l_c comes from central differences, exact for quadratics; their products' means come
    from the rule.
    """
    places, weights = rule(corners)
    slopes = gradient_slopes(corners, order)
    step = 1e-3
    chosen = places[:: len(places) // 50]
    gradients = np.zeros((len(places), *slopes.shape[:2]))
    for c in range(corners):
        shift = step * np.eye(corners)[c]
        change = (
            values(corners, order, chosen + shift) - values(corners, order, chosen - shift)
        ) / (2.0 * step)
        by_slopes = np.einsum("ai,pi->pa", slopes[:, c], chosen)
        # N_A = l_A (2 l_A - 1) has the slope 4 l_A - 1; a linear one has 1 = sum l_i.
        assert by_slopes == pytest.approx(change, abs=1e-9)
        gradients[:, :, c] = np.einsum("ai,pi->pa", slopes[:, c], places)
    means = np.einsum("p,pac,pbd->abcd", weights, gradients, gradients)
    assert gradient_products(corners, order) == pytest.approx(means, abs=2e-2)


@pytest.mark.parametrize("order", [1, 2])
def test_gauss_points_integrate_what_their_order_needs(order):
    points = gauss_points(order)
    assert points.sum(axis=1) == pytest.approx(1.0)
    assert points.mean(axis=0) == pytest.approx(np.full(4, 0.25))
    if order == 2:  # mean of l_i l_j is (1 + delta_ij) / 20
        assert np.einsum("pi,pj->ij", points, points) / 4.0 == pytest.approx(
            (1.0 + np.eye(4)) / 20.0
        )
