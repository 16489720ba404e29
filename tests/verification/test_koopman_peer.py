"""Our operators and pykoop's from the same data."""

import warnings

import numpy as np
import pytest

from tissue.prediction.edmd import Edmd, Episode
from tissue.prediction.operator import Delays, Identity, Polynomials

# pykoop takes seconds to import; test_koopman_exact holds the same operators
pytestmark = pytest.mark.slow

SAME = 1e-8
"""Of the contract. pykoop solves normal equations, so that it loses twice the digits of the
condition number.
"""


@pytest.fixture(scope="module")
def pykoop():
    return pytest.importorskip(
        "pykoop", reason="pykoop is not installed: pip install 'tissue-sim[dev]'"
    )


def recorded(seed, scaled=False):
    """Episodes of a weakly nonlinear driven system, and pykoop's table of them."""
    rng = np.random.default_rng(seed)
    episodes = []
    for _ in range(4):
        states, inputs = [rng.normal(size=2)], rng.normal(size=(60, 1))
        for now in inputs[:-1, 0]:
            first, second = states[-1]
            turned = np.array(
                [0.9 * first + 0.1 * second + 0.2 * now, -0.1 * first + 0.95 * second + 0.1 * now]
            )
            states.append(turned + 0.05 * np.array([first * second, -(first**2)]))
        episodes.append(Episode(np.array(states), inputs, 0.01))
    if scaled:
        before = np.vstack([np.hstack((each.states, each.inputs))[:-1] for each in episodes])
        size = np.sqrt((before**2).mean(axis=0))
        episodes = [
            Episode(each.states / size[:2], each.inputs / size[2:], 0.01) for each in episodes
        ]
    marks = [np.full((60, 1), float(index)) for index in range(4)]
    table = np.vstack(
        [np.hstack((mark, e.states, e.inputs)) for mark, e in zip(marks, episodes, strict=True)]
    )
    return episodes, table


def theirs(pykoop, table, lifting, alpha=0.0):
    """pykoop's [A B]."""
    pipeline = pykoop.KoopmanPipeline(lifting_functions=lifting, regressor=pykoop.Edmd(alpha=alpha))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its own, about newer releases of what it builds on
        pipeline.fit(table, n_inputs=1, episode_feature=True)
    return pipeline.regressor_.coef_.T


def ours(episodes, dictionary, ridge=0.0):
    operator = Edmd(dictionary, ridge=ridge, cap=None, offset=False).fit(episodes)
    return np.hstack((operator.A, operator.B))


def split(pykoop, function):
    """A function of the state alone."""
    return [("of the state", pykoop.SplitPipeline(lifting_functions_state=[("it", function)]))]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("order", [2, 3])
def test_polynomials(pykoop, seed, order):
    episodes, table = recorded(seed)
    found = theirs(pykoop, table, split(pykoop, pykoop.PolynomialLiftingFn(order=order)))
    off = np.abs(ours(episodes, Polynomials(order)) - found).max()
    print(f"pykoop, polynomials of order {order}: {off:.0e}")
    assert off < SAME


@pytest.mark.parametrize("lags", [1, 2, 3])
def test_delays(pykoop, lags):
    episodes, table = recorded(0)
    found = theirs(
        pykoop, table, [("delays", pykoop.DelayLiftingFn(n_delays_state=lags, n_delays_input=0))]
    )
    off = np.abs(ours(episodes, Delays(lags)) - found).max()
    print(f"pykoop, {lags} delays: {off:.0e}")
    assert off < SAME


def test_ridge(pykoop):
    """Ridge regression agrees with pykoop.

    Its weight applies to the sum over samples of unscaled data, ours to the mean over scaled data.
    """
    episodes, table = recorded(1, scaled=True)
    samples = sum(len(each.states) - 1 for each in episodes)
    assert (
        np.abs(
            ours(episodes, Identity(), ridge=0.05)
            - theirs(pykoop, table, None, alpha=0.05 * samples)
        ).max()
        < SAME
    )
