"""Lifted operators against closed forms.

They are the slow manifold, generators and their exponentials, and Van der Pol as published.
"""

import numpy as np
import pytest
from koopman_systems import (
    SLOW_GENERATOR,
    SLOW_OPERATOR,
    SLOW_STEP_S,
    Generator,
    ThinPlates,
    predict,
    record,
    slow_manifold,
    slow_manifold_at,
    van_der_pol,
)
from scipy.linalg import expm

from tissue.prediction.edmd import Edmd, Episode
from tissue.prediction.operator import Delays, Identity, Polynomials

CLOSED = Polynomials(2, columns=(0,))
"""x1, x2 and x1²: closed under the slow manifold's flow."""
EXACT = 1e-10
"""Tolerance of the contract, case 24.

The error is four orders smaller, because the data are exact and the factor is orthogonal.
"""
PRINTED = 5e-9
"""Half of the last printed digit."""


def slow_episodes(rng, count=20, rows=50):
    times = SLOW_STEP_S * np.arange(rows)
    starts = rng.uniform(-1.0, 1.0, (count, 2))
    return [Episode(states, None, SLOW_STEP_S) for states in slow_manifold_at(starts, times)]


@pytest.mark.parametrize("offset", [True, False], ids=["offset", "bare"])
@pytest.mark.parametrize("seed", range(3))
def test_the_slow_manifold_has_its_printed_operator(seed, offset):
    fitted = Edmd(CLOSED, offset=offset).fit(slow_episodes(np.random.default_rng(seed)))
    assert np.abs(SLOW_OPERATOR - expm(SLOW_STEP_S * SLOW_GENERATOR)).max() < PRINTED
    assert np.abs(fitted.A - expm(SLOW_STEP_S * SLOW_GENERATOR)).max() < EXACT
    assert np.abs(fitted.offset).max() < EXACT
    assert fitted.statistics.capped == 0
    off = np.abs(fitted.A - expm(SLOW_STEP_S * SLOW_GENERATOR)).max()
    print(f"operator of the slow manifold off by {off:.0e}")


def test_500_steps_on_the_slow_manifold():
    fitted = Edmd(CLOSED).fit(slow_episodes(np.random.default_rng(0)))
    predicted = predict(fitted, np.array([1.0, -0.5]), None, 500)
    off = np.abs(predicted - slow_manifold_at([1.0, -0.5], SLOW_STEP_S * np.arange(1, 501))).max()
    print(f"500 steps on it: {off:.0e}")
    assert off < 1e-8
    assert predicted[49] == pytest.approx([0.77880078, 0.66306737], abs=PRINTED)


def test_a_generator_from_rates_is_the_slow_manifolds_own_and_leads_to_its_operator():
    """gEDMD gives L itself (Klus et al. 2020)."""
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2))
    generator = Generator.fit(CLOSED, states, slow_manifold(states))
    assert np.abs(generator.A - SLOW_GENERATOR).max() < EXACT
    operator = Edmd(CLOSED).fit(slow_episodes(np.random.default_rng(0)))
    lifted = CLOSED.lift(states)
    advanced = lifted @ operator.A.T + operator.offset
    assert np.abs(generator.advance(lifted, SLOW_STEP_S) - advanced).max() < EXACT


def driven(rng, steps_s, rows=40, count=6):
    """A damped mass on a spring under held random forces, with the exact block exponential."""
    A, B = np.array([[0.0, 1.0], [-40.0, -3.0]]), np.array([[0.0], [2.0]])
    whole = expm(steps_s * np.block([[A, B], [np.zeros((1, 3))]]))
    episodes = []
    for _ in range(count):
        inputs, states = rng.normal(size=(rows, 1)), [rng.normal(size=2)]
        for now in inputs[:-1]:
            states.append(whole[:2, :2] @ states[-1] + whole[:2, 2] * now)
        table = np.array(states)
        episodes.append(Episode(table, inputs, steps_s))
    return whole, episodes


def test_held_inputs_are_exact():
    whole, episodes = driven(np.random.default_rng(1), 0.02)
    operator = Edmd(Identity()).fit(episodes)
    assert np.abs(operator.A - whole[:2, :2]).max() < EXACT
    assert np.abs(operator.B[:, 0] - whole[:2, 2]).max() < EXACT


def test_delays_make_up_for_a_speed_that_is_not_measured():
    """A linear system of second order is closed over two samples of its place."""
    whole, _ = driven(np.random.default_rng(0), 0.02)
    states = [np.array([[1.0, 0.0], [0.2, 3.0]])]
    for _ in range(60):
        states.append(states[-1] @ whole[:2, :2].T)
    table = np.stack(states, axis=1)
    operator = Edmd(Delays(1)).fit([Episode(each[:, :1], None, 0.02) for each in table])
    predicted = predict(operator, table[0, :2, :1], None, 40)
    assert np.abs(predicted - table[0, 2:42, :1]).max() < 1e-9
    assert np.sort(operator.eigenvalues) == pytest.approx(
        np.sort(np.linalg.eigvals(whole[:2, :2])), abs=EXACT
    )


@pytest.mark.slow
def test_van_der_pol_as_korda_and_mezic():
    """Van der Pol is predicted as by Korda and Mezic.

    It has 200 trajectories of 10 s at 10 ms with random inputs, then 3 s under a square wave of 0.3
    s, from 100 starts.
    """
    found = {5: [], 100: []}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        episodes = record(
            van_der_pol, rng.uniform(-1, 1, (200, 2)), rng.uniform(-1, 1, (200, 1001)), 0.01
        )
        square = np.where(0.01 * np.arange(301) % 0.3 < 0.15, 1.0, -1.0)
        unseen = record(van_der_pol, rng.uniform(-1, 1, (100, 2)), np.tile(square, (100, 1)), 0.01)
        for count, errors in found.items():
            centres = rng.uniform(-1.0, 1.0, (count, 2))
            operator = Edmd(ThinPlates(centres), offset=False).fit(episodes)
            assert np.abs(operator.eigenvalues).max() <= 1.0 + 1e-9
            missed = []
            for each in unseen:
                predicted = predict(operator, each.states[0], each.inputs[:-1], 300)
                missed.append(
                    np.linalg.norm(predicted - each.states[1:]) / np.linalg.norm(each.states[1:])
                )
            errors.append(100.0 * np.mean(missed))
    # Measured: 27, 29 and 32 % of 100 centres; 97, 81 and 56 % of five, where the centres' luck
    # decides.
    for count, errors in found.items():
        print(f"Van der Pol, {count} functions: {', '.join(f'{each:.0f}' for each in errors)} %")
    assert all(20.0 < each < 35.0 for each in found[100])
    assert min(found[5]) > max(found[100])
