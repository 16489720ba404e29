"""The first guess of a solve against the exact projection on earlier solutions."""

import numpy as np
import pytest

from tissue.models.tooth.recovery import FirstGuess


def system(count=12, seed=0):
    """Return a random symmetric positive definite matrix, loads and their solutions.

    The loads have three components a node.
    """
    random = np.random.default_rng(seed)
    half = random.normal(size=(3 * count, 3 * count))
    matrix = half @ half.T + np.eye(3 * count)
    loads = random.normal(size=(10, count, 3))
    solutions = np.linalg.solve(matrix, loads.reshape(10, -1).T).T.reshape(loads.shape)
    return matrix, loads, solutions


def test_a_load_within_the_known_ones_is_solved():
    """A load within the known ones is solved.

    The tolerance is rounding of sums over a few dozen terms, times the condition of ten random
    solutions' energies.
    """
    _, loads, solutions = system()
    guess = FirstGuess(list(zip(solutions[:2], loads[:2], strict=True)), recent=3)
    for moved, load in zip(solutions[2:5], loads[2:5], strict=True):
        guess.add(moved, load)
    shares = np.array([0.3, -1.0, 2.0, 0.5, -0.2])
    found = guess(np.einsum("i,ijk->jk", shares, loads[:5]))
    assert found == pytest.approx(
        np.einsum("i,ijk->jk", shares, solutions[:5]), rel=1e-8, abs=1e-10
    )


def test_any_other_load_is_projected_in_energy():
    """Any other load is projected in energy.

    The remaining error is orthogonal, in energy, to all known solutions; the oldest recent solution
    is forgotten.
    """
    matrix, loads, solutions = system(seed=1)
    guess = FirstGuess([(solutions[0], loads[0])], recent=3)
    for moved, load in zip(solutions[1:6], loads[1:6], strict=True):
        guess.add(moved, load)
    left = loads[9].ravel() - matrix @ guess(loads[9]).ravel()
    for known in (0, 3, 4, 5):
        assert abs(left @ solutions[known].ravel()) < 1e-9
    assert abs(left @ solutions[1].ravel()) > 1e-6


def test_without_earlier_solutions_the_guess_is_zero():
    guess = FirstGuess([])
    _, loads, solutions = system()
    assert np.array_equal(guess(loads[0]), np.zeros(loads[0].shape))
    guess.add(solutions[0], loads[0])
    assert guess(loads[0]) == pytest.approx(solutions[0], rel=1e-12)
