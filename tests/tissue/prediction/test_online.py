"""Adaptation in the loop: what it learns, what it forgets, and what it must survive."""

import numpy as np
import pytest

from tissue.prediction.delays import COORDINATES, HORIZON, DelayOperator, DelayPath, Moments
from tissue.prediction.online import AdaptivePath
from tissue.prediction.trained import Trained, general_operator, shipped_file

SPRING_N_M = 400.0


@pytest.fixture(scope="module")
def wall():
    return Trained.read(shipped_file("wall")).operator


def swing(hertz, ticks, seed=0):
    """Positions that swing along all axes, and stretches in proportion to them [m]."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 6.3, 3)
    position = 3e-3 * np.sin(2.0 * np.pi * hertz * 1e-3 * np.arange(ticks)[:, None] + phases)
    return position, -0.5 * position


def errors(path, position, stretch, lead=6):
    """Errors of the displacement [m], shape (ticks - lead,)."""
    missed = []
    for place, tension in zip(position, stretch, strict=True):
        path.observe(place, tension)
        missed.append(place + path.displacement_m(lead))
    return np.linalg.norm(np.array(missed[:-lead]) - position[lead:], axis=1)


def test_it_learns_a_motion_that_no_training_had(wall):
    """An even swing of 6 Hz is predicted to a tenth of the trained operator's error after 2 s."""
    position, stretch = swing(6.0, 3000)
    fixed = errors(DelayPath(wall), position, stretch)
    adapted = errors(AdaptivePath(wall), position, stretch)
    # before the first solution, both use the same operator
    np.testing.assert_array_equal(adapted[:29], fixed[:29])
    assert adapted[2000:].mean() < 0.1 * fixed[2000:].mean()


def test_at_rest_it_returns_to_the_operator_that_it_started_from(wall):
    path = AdaptivePath(wall)
    errors(path, *swing(6.0, 2000))
    learnt = path._weights.copy()
    for _ in range(20_000):
        path.observe(np.zeros(3), np.zeros(3))
    started = DelayPath(wall)._weights
    assert np.abs(learnt - started).max() > 0.1 * np.abs(started).max()
    # the ridge of the second fit changes the largest weight by a fiftieth
    np.testing.assert_allclose(path._weights, started, atol=0.03 * np.abs(started).max())


@pytest.mark.parametrize("wild", [1e5, 1e-3])
def test_a_wild_motion_does_not_change_it(wall, wild):
    """Jumps of the device are outside the training range: the fit leaves them out."""
    rng = np.random.default_rng(1)
    path = AdaptivePath(wall)
    position, stretch = swing(3.0, 1000)
    errors(path, position, stretch)
    for _ in range(500):
        path.observe(wild * rng.normal(size=3), np.zeros(3))
    assert np.isfinite(path._weights).all()
    assert not path.trusted or wild < 1.0
    path.pause()
    errors(path, *swing(3.0, 300))
    assert np.abs(path._weights).max() < 5.0 * np.abs(DelayPath(wall)._weights).max()


def test_its_memory_does_not_grow(wall):
    path = AdaptivePath(wall)
    before = {name: np.size(value) for name, value in vars(path).items()}
    errors(path, *swing(3.0, 3000))
    assert {name: np.size(value) for name, value in vars(path).items()} == before
    assert len(path._maps) <= 1


def test_the_sums_are_least_squares_with_forgetting():
    """After a run of white noise, the weights are those of a weighted fit with the prior's rows."""
    start = DelayOperator(Moments(np.eye(COORDINATES), np.zeros((COORDINATES, 2 * HORIZON))), 1e9)
    path = AdaptivePath(start)
    rng = np.random.default_rng(2)
    position = np.cumsum(rng.normal(size=(600, 3)), axis=0)
    errors(path, position, rng.normal(size=(600, 3)))
    sums = path._sums[:, :COORDINATES]
    np.testing.assert_allclose(sums, sums.T, rtol=1e-9, atol=1e-9 * np.abs(sums).max())
    assert np.linalg.eigvalsh(sums).min() > 0.0


def test_a_scene_without_a_file_starts_from_all_scenes():
    """Left out of the general operator, the wall is still predicted better than by no motion."""
    path = DelayPath(general_operator(without="wall"))
    position, stretch = swing(1.5, 1500)
    missed = errors(path, position, stretch)
    held = np.linalg.norm(position[6:] - position[:-6], axis=1)
    assert missed[200:].mean() < 0.4 * held[200:].mean()
