"""The grid-convergence index on answers that are known: right ones, wrong ones and none at all."""

import numpy as np
import pytest

from tissue.evaluation.reference.history import FORMAL_ORDER, SAFETY, grid_index

SPACINGS = (0.1, 0.06, 0.033)
"""Not of one ratio, so that the order has to be solved for."""


def truth(count=4000):
    """A force that grows, turns and ends."""
    time = np.linspace(0.0, 1.0, count)
    return np.column_stack([2.0 + np.sin(7.0 * time), time**2, np.where(time < 0.8, 5.0, 0.5)])


def error_shape(count=4000):
    """An error of another shape than the force."""
    time = np.linspace(0.0, 1.0, count)
    return np.column_stack([np.cos(40.0 * time), np.full(count, 0.6), np.sin(11.0 * time)])


def size(values):
    return float(np.linalg.norm(values))


@pytest.mark.parametrize("order", [0.6, 1.0, 1.5, 2.0])
def test_a_manufactured_error_gives_its_order_and_an_index_that_bounds_it(order):
    exact, shape = truth(), error_shape()
    forces = [exact + shape * h**order for h in SPACINGS]
    found = grid_index(forces, SPACINGS)
    assert found.asymptotic and found.order == pytest.approx(order, abs=1e-6)
    for k, force in enumerate(forces):
        error = size(force - exact) / size(forces[2])
        assert found.index[k] == pytest.approx(SAFETY * error, rel=1e-6)
    assert grid_index(forces[::-1], SPACINGS[::-1]) == found


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("order", [1.0, 2.0])
def test_errors_that_fall_but_share_no_shape_are_bounded_too(order, seed):
    """Independent errors that fall with the grid spacing are bounded too.

    The position of a tool on each grid is random, so the errors are independent, with sizes C h^p.

    Of 12,000 values a norm scatters by 0.7 %, so that of two the order does by 0.02.
    """
    exact, rng, spacings = truth(), np.random.default_rng(seed), (0.09, 0.03 * 3.0**0.5, 0.03)
    forces = [exact + rng.normal(size=exact.shape) * h**order for h in spacings]
    found = grid_index(forces, spacings)
    assert found.order == pytest.approx(order, abs=0.08)
    for k, force in enumerate(forces):
        assert size(force - exact) / size(forces[2]) < found.index[k]


def test_an_order_that_is_too_good_is_not_used():
    """An order that is too good is not used.

    Order 4 of a method of order 2 is an accident: the index is that of order 2 with the larger
    safety factor.
    """
    exact, shape = truth(), error_shape()
    forces = [exact + shape * h**4 for h in SPACINGS]
    found = grid_index(forces, SPACINGS)
    assert not found.asymptotic and found.order == pytest.approx(4.0, abs=1e-6)
    left = (
        size(forces[1] - forces[2])
        / size(forces[2])
        / ((SPACINGS[1] / SPACINGS[2]) ** FORMAL_ORDER - 1.0)
    )
    assert found.index[2] == pytest.approx(3.0 * left, rel=1e-9)


def test_equal_forces_have_no_error_and_the_finer_two_equal_leave_the_coarse_one():
    exact = truth()
    found = grid_index([exact] * 3, SPACINGS)
    assert found.index == (0.0, 0.0, 0.0)
    assert found.asymptotic and np.isnan(found.order)
    late = grid_index([1.01 * exact, exact, exact], SPACINGS)
    assert late.order == np.inf and not late.asymptotic
    assert late.distance == pytest.approx((0.01, 0.0, 0.0)) and late.index[2] == 0.0
    early = grid_index([exact, exact, 1.01 * exact], SPACINGS)
    assert early.order == -np.inf and early.index[2] > 0.01
    assert grid_index([np.zeros((60, 3))] * 3, SPACINGS).index == (0.0, 0.0, 0.0)


def test_an_error_that_all_grids_share_is_not_seen():
    """The index does not bound a bias that every grid has."""
    exact, shape = truth(), error_shape()
    found = grid_index([1.1 * exact + shape * h**2 for h in SPACINGS], SPACINGS)
    assert found.index[2] < 0.01
