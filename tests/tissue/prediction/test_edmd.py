"""Dictionaries, the fit over episodes, and the choice by cross-validation."""

from itertools import pairwise

import numpy as np
import pytest
from koopman_systems import duffing, record

from tissue.prediction.edmd.dictionary import (
    Delays,
    GapProducts,
    Gaussians,
    Identity,
    Polynomials,
    ThinPlates,
)
from tissue.prediction.edmd.edmd import Edmd, Episode, horizon_errors, regress, triangle, window
from tissue.prediction.edmd.predictor_file import from_plain, to_plain

CENTRES = ((0.1, -0.2), (0.5, 0.4), (-0.7, 0.0))
DICTIONARIES = {
    "identity": Identity(),
    "polynomials": Polynomials(3),
    "some polynomials": Polynomials(2, columns=(1,)),
    "gaussians": Gaussians(CENTRES, scales=(0.5, 2.0), width=0.8),
    "thin plates": ThinPlates(CENTRES),
    "gap": GapProducts((-1.0,), distance=0.1, columns=(1,)),
    "one entry's gaussian": Gaussians(((0.2,),), columns=(1,)),
}


def swings(rng, count=10, rows=120, driven=True):
    inputs = rng.normal(size=(count, rows)) if driven else np.zeros((count, rows))
    return record(duffing, rng.uniform(-1.0, 1.0, (count, 2)), inputs, 0.02)


@pytest.mark.parametrize("dictionary", DICTIONARIES.values(), ids=DICTIONARIES)
def test_the_laws_of_a_dictionary(dictionary):
    rng = np.random.default_rng(0)
    states, rates = rng.normal(size=(2, 50, 2))
    lifted = dictionary.lift(states)
    assert lifted.shape == (50, dictionary.size(2))
    assert np.array_equal(lifted[:, :2], states)
    assert dictionary.lift(states[7]) == pytest.approx(lifted[7], rel=1e-12, abs=1e-13)
    step = 1e-6
    slopes = (dictionary.lift(states + step * rates) - dictionary.lift(states - step * rates)) / (
        2.0 * step
    )
    # Central differences: rounding over the step; no state lies within a step of a switch.
    assert dictionary.lift_rates(states, rates) == pytest.approx(slopes, rel=1e-6, abs=1e-7)
    assert from_plain(to_plain(dictionary)) == dictionary


@pytest.mark.parametrize(
    "inner",
    [Polynomials(2), Gaussians(CENTRES, columns=(0, 3)), GapProducts((-1.0,), columns=(5,))],
)
def test_delays_take_windows_newest_first(inner):
    rng = np.random.default_rng(1)
    delayed, windows = Delays(2, inner), rng.normal(size=(5, 6))
    lifted = delayed.lift(windows)
    assert lifted.shape == (5, delayed.size(2))
    assert np.array_equal(lifted, inner.lift(windows))
    assert from_plain(to_plain(delayed)) == delayed
    operator = Edmd(delayed, ridge=1e-6).fit(swings(rng, driven=False))
    assert operator.lift(windows[0].reshape(3, 2)[::-1]) == pytest.approx(lifted[0], rel=1e-12)


def test_monomials_are_those_of_the_order():
    x, y = 2.0, 3.0
    assert Polynomials(3).extra(np.array([x, y])) == pytest.approx([4, 6, 9, 8, 12, 18, 27])
    assert Polynomials(4).size(3) == 3 + 6 + 10 + 15


def test_radial_observables_have_their_values():
    centre = np.array([[1.0, 2.0]])
    states = np.array([[1.0, 2.0], [2.0, 4.0]])
    assert Gaussians(tuple(map(tuple, centre)), scales=(1.0, 2.0)).extra(states)[
        :, 0
    ] == pytest.approx([1.0, np.exp(-1)])
    assert ThinPlates(tuple(map(tuple, centre))).extra(states)[:, 0] == pytest.approx(
        [0.0, 5.0 * 0.5 * np.log(5.0)]
    )


def test_gap_products_switch():
    gap = GapProducts((-1.0,), distance=0.5, columns=(1,))
    assert gap.extra(np.array([[0.2, 3.0], [0.9, 3.0]])) == pytest.approx(
        np.array([[0, 0, 0, 0], [0.4, 0.16, 1.2, 3.0]])
    )


def test_centres_lie_where_the_data_do_and_follow_the_seed():
    rng = np.random.default_rng(1)
    clouds = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    rows = (clouds[:, None] + 0.1 * rng.normal(size=(3, 200, 2))).reshape(-1, 2)
    made, again = (Gaussians.from_states(rows, 3, np.random.default_rng(5)) for _ in range(2))
    found = np.array(made.centres)
    assert made == again
    # The mean of 200 points with deviation 0.1 lies within 0.03 of its cloud's middle.
    assert np.abs(found[np.lexsort(found.T)] - clouds[np.lexsort(clouds.T)]).max() < 0.05


@pytest.mark.parametrize("name", ["polynomials", "gaussians", "thin plates"])
@pytest.mark.parametrize("ridge", [0.0, 1e-3])
def test_the_fit_is_least_squares_whatever_the_blocks(name, ridge):
    """Against the normal equations of all rows at once, in the same scaled coordinates."""
    episodes, dictionary = swings(np.random.default_rng(2)), DICTIONARIES[name]
    found = Edmd(dictionary, ridge=ridge, cap=None).fit(episodes)
    before = np.vstack([np.hstack((dictionary.lift(e.states), e.inputs))[:-1] for e in episodes])
    after = np.vstack([dictionary.lift(e.states)[1:] for e in episodes])
    middle, scale = before.mean(axis=0), before.std(axis=0)
    known, count = (before - middle) / scale, after.shape[1]
    wanted = (after - after.mean(axis=0)) / scale[:count]
    weights = np.linalg.solve(
        known.T @ known + ridge * len(known) * np.eye(len(scale)), known.T @ wanted
    ).T
    assert found.A / found.scale[:, None] * found.scale == pytest.approx(
        weights[:, :count], abs=1e-7
    )
    predicted = found.advance(before[:, :count], before[:, count:])
    assert predicted.mean(axis=0) == pytest.approx(after.mean(axis=0), abs=1e-10)
    assert found.statistics.residual_rms == pytest.approx(
        np.sqrt(((predicted - after) ** 2).mean(axis=0)), rel=1e-6
    )
    assert found.statistics.samples == 10 * 119 and found.statistics.episodes == 10


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
    after, middle = (
        np.vstack([each[1:] for each in lifted]),
        np.concatenate((found.middle, found.input_middle)),
    )
    before = np.vstack(
        [np.hstack((x[:-1], e.inputs[2:-1])) for x, e in zip(lifted, episodes, strict=True)]
    )
    scale, count = np.concatenate((found.scale, found.input_scale)), after.shape[1]
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
    assert found.B / found.scale[:, None] * found.input_scale == pytest.approx(
        weights[:, count : len(scale)], abs=1e-11
    )
    missed = found.advance(before[:, :count], before[:, count:]) - after
    assert found.statistics.residual_rms == pytest.approx(
        np.sqrt((missed**2).mean(axis=0)), rel=1e-6, abs=1e-12
    )
    if ridge == 0.0:
        assert found.A[2:known, : known - 2] == pytest.approx(np.eye(known - 2), abs=1e-11)


def test_block_by_block_is_all_at_once():
    rng = np.random.default_rng(3)
    known, wanted = rng.normal(size=(1000, 6)), rng.normal(size=(1000, 4))
    cuts = [0, 3, 4, 400, 1000]
    factor, samples = triangle(np.hstack((known, wanted))[a:b] for a, b in pairwise(cuts))
    found = regress(factor, samples, size=6, ridge=0.0, rank=None, free=1)
    weights, squares, *_ = np.linalg.lstsq(known, wanted)
    assert found.weights == pytest.approx(weights, abs=1e-12)
    assert found.residual_rms == pytest.approx(np.sqrt(squares / 1000), rel=1e-10)
    assert found.moments == pytest.approx(known.T @ known / 1000, abs=1e-12)


def test_truncated_singular_values_are_the_pseudoinverse():
    rng = np.random.default_rng(4)
    known, wanted = rng.normal(size=(200, 6)) * np.logspace(0, -4, 6), rng.normal(size=(200, 2))
    factor, samples = triangle([np.hstack((known, wanted))])
    found = regress(factor, samples, size=6, ridge=0.0, rank=3, free=0)
    left, values, right = np.linalg.svd(known, full_matrices=False)
    assert found.weights == pytest.approx(
        right[:3].T @ (left[:, :3].T @ wanted / values[:3, None]), abs=1e-10
    )
    assert found.rank == 3 and found.condition == pytest.approx(values[0] / values[2])


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
    predicted = (other.predict(start * scales + shift, 7.0 * push, 20) - shift) / scales
    # 1000 beside 0.01 leaves eleven digits of it.
    assert predicted == pytest.approx(one.predict(start, push, 20), abs=1e-8)


def test_episodes_are_not_glued_together():
    """The last sample of one is not followed by the first of the next."""
    episodes = swings(np.random.default_rng(6), driven=False)
    found, turned = Edmd(Delays(1)).fit(episodes), Edmd(Delays(1)).fit(episodes[::-1])
    assert np.abs(turned.A - found.A).max() < 1e-6
    assert found.statistics.samples == 10 * (120 - 2)


def test_predictions_of_one_start_are_those_of_many():
    episodes = swings(np.random.default_rng(7))
    for dictionary in (Polynomials(2), Delays(2, Polynomials(2))):
        operator, lags = Edmd(dictionary, ridge=1e-8).fit(episodes), dictionary.lags
        states, inputs = episodes[0].states, episodes[0].inputs
        missed = []
        for start in range(lags, 120 - 5):
            predicted = operator.predict(
                states[start - lags : start + 1], inputs[start : start + 5], 5
            )
            missed.append(predicted - states[start + 1 : start + 6])
        found = horizon_errors(operator, episodes[:1], 5)
        assert found.starts == len(missed)
        assert found.rms == pytest.approx(np.sqrt((np.array(missed) ** 2).mean(axis=0)), rel=1e-9)
        held = operator.predict(states[: lags + 1], inputs[0], 3)
        assert held == pytest.approx(
            operator.predict(states[: lags + 1], np.tile(inputs[0], (3, 1)), 3)
        )


def test_the_training_box_holds_the_training_states():
    episodes = swings(np.random.default_rng(8))
    operator, states = (
        Edmd(Identity()).fit(episodes),
        np.concatenate([each.states for each in episodes]),
    )
    assert np.array_equal(operator.lowest, states.min(axis=0))
    assert np.array_equal(operator.highest, states.max(axis=0))


def test_one_step_with_inputs_is_the_matrices_written_out():
    """One step with inputs equals the matrices written out.

    phi' = A phi + B u + c, for one state and for rows of them, and without inputs as with inputs of
    zero.
    """
    rng = np.random.default_rng(11)
    operator = Edmd(Polynomials(2), offset=True).fit(swings(rng))
    lifted, inputs = rng.normal(size=(4, len(operator.offset))), rng.normal(size=(4, 1))
    wanted = [
        operator.A @ row + operator.B @ acting + operator.offset
        for row, acting in zip(lifted, inputs, strict=True)
    ]
    assert np.abs(operator.B).max() > 1e-3
    assert operator.advance(lifted, inputs) == pytest.approx(np.array(wanted), rel=1e-12, abs=1e-12)
    assert operator.advance(lifted[2], inputs[2]) == pytest.approx(wanted[2], rel=1e-12, abs=1e-12)
    assert operator.advance(lifted) == pytest.approx(
        operator.advance(lifted, 0.0 * inputs), rel=1e-12, abs=1e-12
    )


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
