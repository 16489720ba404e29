"""Dictionaries, the fit over episodes, and the choice by cross-validation."""

import numpy as np
import pytest
from koopman_systems import duffing, horizon_errors, predict, record

from tissue import InputError
from tissue.prediction.edmd import Edmd, Episode, regress, triangle, window
from tissue.prediction.operator import Delays, GapProducts, Identity, Polynomials
from tissue.prediction.trained import from_plain, to_plain

DICTIONARIES = {
    "identity": Identity(),
    "polynomials": Polynomials(3),
    "some polynomials": Polynomials(2, columns=(1,)),
    "gap": GapProducts((-1.0,), distance=0.1, columns=(1,)),
}


def swings(rng, count=10, rows=120, driven=True):
    inputs = rng.normal(size=(count, rows)) if driven else np.zeros((count, rows))
    return record(duffing, rng.uniform(-1.0, 1.0, (count, 2)), inputs, 0.02)


@pytest.mark.parametrize("dictionary", DICTIONARIES.values(), ids=DICTIONARIES)
def test_the_laws_of_a_dictionary(dictionary):
    rng = np.random.default_rng(0)
    states = rng.normal(size=(50, 2))
    lifted = dictionary.lift(states)
    assert lifted.shape == (50, dictionary.size(2))
    assert np.array_equal(lifted[:, :2], states)
    assert dictionary.lift(states[7]) == pytest.approx(lifted[7], rel=1e-12, abs=1e-13)
    assert from_plain(to_plain(dictionary)) == dictionary


@pytest.mark.parametrize("inner", [Polynomials(2), GapProducts((-1.0,), columns=(5,))])
def test_delays_take_windows_newest_first(inner):
    rng = np.random.default_rng(1)
    delayed, windows = Delays(2, inner), rng.normal(size=(5, 6))
    lifted = delayed.lift(windows)
    assert lifted.shape == (5, delayed.size(2))
    assert np.array_equal(lifted, inner.lift(windows))
    assert from_plain(to_plain(delayed)) == delayed


def test_monomials_are_those_of_the_order():
    x, y = 2.0, 3.0
    assert Polynomials(3).extra(np.array([x, y])) == pytest.approx([4, 6, 9, 8, 12, 18, 27])
    assert Polynomials(4).size(3) == 3 + 6 + 10 + 15


def test_gap_products_switch():
    gap = GapProducts((-1.0,), distance=0.5, columns=(1,))
    assert gap.extra(np.array([[0.2, 3.0], [0.9, 3.0]])) == pytest.approx(
        np.array([[0, 0, 0, 0], [0.4, 0.16, 1.2, 3.0]])
    )


@pytest.mark.parametrize("offset", [True, False])
@pytest.mark.parametrize("ridge", [0.0, 1e-3])
def test_delayed_states_are_fitted_as_any_other_target(offset, ridge):
    """Delayed states are fitted like any other target.

    The reference is least squares of all windows at once, with the targets written out; the delayed
    ones are known exactly.
    """
    rng, dictionary, known = np.random.default_rng(11), Delays(2, Polynomials(2, columns=(0, 1))), 6
    episodes = [
        Episode(rng.normal(size=(120, 2)), rng.normal(size=(120, 1)), 1e-3) for _ in range(10)
    ]
    found = Edmd(dictionary, ridge=ridge, cap=None, offset=offset).fit(episodes)
    lifted = [dictionary.lift(window(e.states, 2)) for e in episodes]
    after = np.vstack([each[1:] for each in lifted])
    before = np.vstack(
        [np.hstack((x[:-1], e.inputs[2:-1])) for x, e in zip(lifted, episodes, strict=True)]
    )
    middle, scale = before.mean(axis=0) * offset, before.std(axis=0)
    if not offset:
        scale = np.sqrt((before**2).mean(axis=0))
    count = after.shape[1]
    regressors, targets = (before - middle) / scale, (after - found.middle) / found.scale
    if offset:
        regressors = np.hstack((regressors, np.ones((len(before), 1))))
    penalty = np.sqrt(ridge * len(before)) * np.eye(len(scale), regressors.shape[1])
    weights = np.linalg.lstsq(
        np.vstack((regressors, penalty)), np.pad(targets, ((0, len(scale)), (0, 0)))
    )[0].T
    # Noise, as good as orthogonal: both keep all but two or three of sixteen digits.
    assert found.A / found.scale[:, None] * found.scale == pytest.approx(
        weights[:, :count], abs=1e-11
    )
    assert found.B / found.scale[:, None] * scale[count:] == pytest.approx(
        weights[:, count : len(scale)], abs=1e-11
    )
    missed = before[:, :count] @ found.A.T + before[:, count:] @ found.B.T + found.offset - after
    assert found.statistics.residual_rms == pytest.approx(
        np.sqrt((missed**2).mean(axis=0)), rel=1e-6, abs=1e-12
    )
    if ridge == 0.0:
        assert found.A[2:known, : known - 2] == pytest.approx(np.eye(known - 2), abs=1e-11)


def test_truncated_singular_values_are_the_pseudoinverse():
    rng = np.random.default_rng(4)
    known, wanted = rng.normal(size=(200, 6)) * np.logspace(0, -4, 6), rng.normal(size=(200, 2))
    factor, samples = triangle([np.hstack((known, wanted))])
    found, _ = regress(factor, samples, size=6, ridge=0.0, rank=3, free=0)
    left, values, right = np.linalg.svd(known, full_matrices=False)
    assert found == pytest.approx(
        right[:3].T @ (left[:, :3].T @ wanted / values[:3, None]), abs=1e-10
    )


@pytest.mark.parametrize("shift", [0.0, 1e3])
def test_units_and_offsets_do_not_matter(shift):
    """Units and offsets do not change eigenvalues and predictions.

    The same system is used in millimetres and about another zero.
    """
    episodes = swings(np.random.default_rng(5))
    scales = np.array([1e3, 1e-2])
    moved = [Episode(e.states * scales + shift, 7.0 * e.inputs, e.step_s) for e in episodes]
    one, other = Edmd(Identity()).fit(episodes), Edmd(Identity()).fit(moved)
    assert other.eigenvalues == pytest.approx(one.eigenvalues, abs=1e-9)
    start, push = episodes[0].states[3], episodes[0].inputs[3:23]
    predicted = (predict(other, start * scales + shift, 7.0 * push, 20) - shift) / scales
    # 1000 beside 0.01 leaves eleven digits of it.
    assert predicted == pytest.approx(predict(one, start, push, 20), abs=1e-8)


def test_a_fit_does_not_grow_unless_it_is_asked_for():
    """Data that double every 14 steps: eigenvalues up to 1 by default, and 1.05 without a cap."""
    states = (
        1.05 ** np.arange(60.0)[:, None] * [[1.0, -0.5]]
        + np.random.default_rng(0).normal(size=(60, 2)) * 1e-9
    )
    episodes = [Episode(states * size, None, 0.02) for size in (0.1, 0.2)]
    largest = [
        np.abs(Edmd(Identity(), ridge=1e-9, **options).fit(episodes).eigenvalues).max()
        for options in ({}, {"cap": None})
    ]
    assert largest == pytest.approx([1.0, 1.05], rel=1e-3)


def row(states, inputs=None):
    return Episode(np.asarray(states, dtype=float), inputs, 0.02)


SWING = swings(np.random.default_rng(0), count=2, rows=60, driven=False)
STATES = SWING[0].states
BAD = {
    "states of episode 1": (Identity(), [SWING[0], row([[0.0, np.nan], [1.0, 2.0]])]),
    "column 2 of states": (Identity(), [row(np.column_stack([STATES, np.full(60, 0.3)]))]),
    "column 0 of inputs": (Identity(), [row(STATES, inputs=np.full((60, 1), 0.5))]),
    "observables and inputs": (
        Identity(),
        [row(np.column_stack([STATES, 3.0 * STATES[:, 0] + 1]))],
    ),
    "episode 1": (Delays(5), [SWING[0], row(STATES[:6])]),
    "episodes must hold": (Polynomials(4), [row(STATES[:9])]),
    "observables": (Polynomials(9), [row(1e40 * STATES)]),
}


@pytest.mark.parametrize(("argument", "case"), BAD.items(), ids=BAD)
def test_bad_data_are_refused(argument, case):
    dictionary, episodes = case
    with pytest.raises(InputError, match=f"^{argument}"):
        Edmd(dictionary).fit(episodes)


def test_collinear_data_can_be_had_with_ridge_or_rank():
    episodes = [row(np.column_stack([e.states, e.states[:, 0] * 3.0 + 1.0])) for e in SWING]
    for edmd in (Edmd(Identity(), ridge=1e-10), Edmd(Identity(), rank=3)):
        assert horizon_errors(edmd.fit(episodes), episodes, 1)[0] < 0.01


def test_the_ridge_spares_the_free_regressors():
    """The reference is the solution of the normal equations with a penalty on the slope alone."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=200)
    y = 0.7 * x + 3.0 + rng.normal(size=200)
    rows = np.column_stack([x, np.ones(200)])
    factor, samples = triangle([np.column_stack([rows, y])])
    weights, _ = regress(factor, samples, size=2, ridge=0.5, rank=None, free=1)
    gram = rows.T @ rows + 0.5 * 200 * np.diag([1.0, 0.0])
    assert weights.ravel() == pytest.approx(np.linalg.solve(gram, rows.T @ y), rel=1e-10)
