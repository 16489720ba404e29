"""Few points that do the work of all: exact rules, the error asked for, and what cannot be reached."""

import numpy as np
import pytest

from tissue.fem.cubature import few_points


def powers(count: int, points: int) -> np.ndarray:
    """Work of points spread over (0, 1): powers 0 to count - 1."""
    place = (np.arange(points) + 0.5) / points
    return place ** np.arange(count)[:, None] / points


def test_powers_need_no_more_points_than_there_are_of_them():
    """Caratheodory: as many as sums, with positive weights; their sums are those of all."""
    work = powers(5, 400)
    points, weights, error = few_points(work, 1e-6, 50)
    assert len(points) <= 5 and (weights > 0.0).all()
    assert error <= 1e-6
    np.testing.assert_allclose(work[:, points] @ weights, work.sum(axis=1), rtol=1e-5)


@pytest.mark.parametrize("tolerance", [0.1, 0.02, 0.005])
def test_the_error_is_that_of_the_sum_and_within_what_is_asked(tolerance):
    work = np.random.default_rng(1).normal(0.2, 1.0, (60, 500))
    points, weights, error = few_points(work, tolerance, 500)
    goal = work.sum(axis=1)
    assert error == pytest.approx(np.linalg.norm(work[:, points] @ weights - goal) / np.linalg.norm(goal), rel=1e-9)
    assert error <= tolerance
    assert (weights > 0.0).all() and len(points) == len(set(points.tolist())) < 100


def test_more_points_than_allowed_are_not_taken_and_the_error_is_stated():
    work = np.random.default_rng(2).normal(0.2, 1.0, (60, 500))
    points, _, error = few_points(work, 1e-6, 10)
    assert len(points) == 10
    assert 0.01 < error < 1.0


def test_what_no_positive_weights_reach_ends():
    """Two points against each other: one bears all that can be borne."""
    points, weights, error = few_points(np.array([[2.0, -1.0], [0.0, 1.0]]), 1e-9, 10)
    assert (weights > 0.0).all() and len(points) <= 2
    assert error < 1e-6
    points, weights, error = few_points(np.array([[1.0, 0.1], [-0.5, 0.0]]), 1e-9, 10)
    assert (weights > 0.0).all()
    assert error == pytest.approx(np.linalg.norm(np.array([[1.0, 0.1], [-0.5, 0.0]])[:, points] @ weights
                                  - [1.1, -0.5]) / np.linalg.norm([1.1, -0.5]), abs=1e-12)  # fmt: skip
