"""Eigenvalues beyond the unit circle and second-order polynomials of contact.

The tests show the effect of the cap on both.
"""

import numpy as np
import pytest
from koopman_systems import contact, record

from tissue.prediction.edmd.dictionary import Delays, GapProducts, Polynomials
from tissue.prediction.edmd.edmd import Edmd, horizon_errors
from tissue.prediction.edmd.episodes import Episode
from tissue.prediction.edmd.lifted import cap_spectrum, spectral_radius

STEP_S = 1e-3
SENSORS = (1e-5, 5e-3)
"""Noise of place [m] and force [N]: an encoder's step, a good force sensor."""


def spread(rng, radii):
    """Return a matrix with real eigenvalues of these sizes.

    Its eigenvectors are far from orthogonal.
    """
    size = len(radii)
    vectors = rng.normal(size=(size, size)) + np.eye(size)
    return vectors @ np.diag(radii) @ np.linalg.inv(vectors)


@pytest.mark.parametrize("seed", range(5))
def test_a_stable_matrix_is_left_alone(seed):
    matrix = np.random.default_rng(seed).normal(size=(8, 8))
    matrix *= 0.99 / spectral_radius(matrix)
    capped, count = cap_spectrum(matrix)
    assert capped is matrix and count == 0


@pytest.mark.parametrize("seed", range(10))
def test_what_is_stable_moves_as_before(seed):
    rng = np.random.default_rng(seed)
    radii = np.concatenate([rng.uniform(0.2, 0.95, 6), rng.uniform(1.05, 1.3, 2)])
    matrix = spread(rng, radii * rng.choice([-1, 1], 8))
    capped, count = cap_spectrum(matrix)
    values, vectors = np.linalg.eig(matrix)
    stable = np.abs(values) < 1.0
    assert count == 2
    assert capped @ vectors[:, stable] == pytest.approx(matrix @ vectors[:, stable], abs=1e-10)
    after = np.linalg.eigvals(capped)
    # Two eigenvalues at 1 that share an eigenvector: rounding moves them by the square root of its
    # size.
    assert spectral_radius(capped) == pytest.approx(1.0, abs=1e-6)
    assert np.sort(np.abs(after))[:6] == pytest.approx(np.sort(np.abs(values[stable])), rel=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_real_eigenvalues_change_the_matrix_by_no_more_than_their_excess(seed):
    rng = np.random.default_rng(seed)
    radii = np.concatenate([rng.uniform(0.2, 0.95, 4), 1.0 + rng.uniform(1e-4, 1e-2, 3)])
    matrix = spread(rng, radii)
    capped, _ = cap_spectrum(matrix)
    assert np.linalg.norm(capped - matrix) == pytest.approx(
        np.linalg.norm(radii[4:] - 1.0), rel=1e-5
    )


def test_turning_modes_keep_their_frequency():
    angle, growth = 0.3, 1.02
    turn = growth * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = np.block([[turn, np.ones((2, 1))], [np.zeros((1, 2)), np.full((1, 1), 0.5)]])
    values = np.linalg.eigvals(cap_spectrum(matrix)[0])
    assert np.abs(np.angle(values)).max() == pytest.approx(angle, abs=1e-12)
    assert np.sort(np.abs(values)) == pytest.approx([0.5, 1.0, 1.0], abs=1e-12)


def test_a_matrix_without_eigenvectors_is_capped_all_the_same():
    """Two Jordan blocks, where an eigendecomposition would divide by nothing."""
    block = np.diag(np.full(4, 1.01)) + np.diag(np.full(3, 1.0), 1)
    capped, count = cap_spectrum(block, 0.99)
    assert count == 4
    # Four equal eigenvalues: rounding moves them by the fourth root of its size.
    assert spectral_radius(capped) < 0.99 + 1e-3
    assert np.linalg.norm(capped - block) < 0.05


def touching(rng, count, rows=1001):
    """Return position and wall force of a mass that a slow random force presses against a wall.

    They are sampled at 1 kHz, as sensors read them.
    """
    times = STEP_S * np.arange(rows)
    pushes = np.zeros((count, rows))
    for _ in range(3):
        size, rate, phase = (
            rng.uniform(*ends, (count, 1)) for ends in ((0.2, 1.0), (0.5, 5.0), (0.0, 2.0 * np.pi))
        )
        pushes += size * np.sin(2.0 * np.pi * rate * times + phase)
    starts = np.column_stack([rng.uniform(-0.02, 0.0, count), np.zeros(count)])
    seen = []
    for each in record(contact, starts, pushes, STEP_S, substeps=4):
        place, speed = each.states.T
        force = np.where(place > 0.0, np.maximum(0.0, 500.0 * place + speed), 0.0)
        noise = SENSORS * rng.normal(size=(rows, 2))
        seen.append(Episode(np.column_stack([place, force]) + noise, each.inputs, STEP_S))
    return seen


def growth(operator, start, rows=20_000):
    """Return the largest state in training deviations over each half of 20 s of free running.

    The inputs are two sines.
    """
    times = STEP_S * np.arange(rows)
    push = 0.7 * np.sin(2.0 * np.pi * 1.3 * times) + 0.5 * np.sin(2.0 * np.pi * 3.7 * times)
    away = (
        np.abs(operator.predict(start, push[:, None], rows) - operator.middle[:2])
        / operator.scale[:2]
    )
    return away[: rows // 2].max(), away[rows // 2 :].max()


@pytest.mark.slow
def test_second_order_polynomials_of_contact_diverge_without_the_cap_and_hold_with_it():
    diverged = 0
    for seed in range(3):
        episodes = touching(np.random.default_rng(seed), 6)
        wild = Edmd(Delays(3, Polynomials(2)), cap=None).fit(episodes)
        start = episodes[0].states[200:204]
        radius = wild.statistics.radius_before
        first, second = growth(wild, start)
        if radius > 1.0 + 3e-4:  # e^3 in 10 s
            diverged += 1
            assert second > 5.0 * first
            # The mode beyond the circle grows as its power, E2.
            assert np.log(second / first) == pytest.approx(10_000 * np.log(radius), rel=0.2)
        first, second = growth(wild.capped(1.0 - 1e-4), start)
        assert second < 30.0 and second < 2.0 * first + 1.0
        # At exactly 1 a constant force still drifts in proportion to time: twice as far in twice
        # the time.
        first, second = growth(wild.capped(1.0), start)
        assert second < 2.5 * first + 1.0
    print(f"second-order polynomials on contact: {diverged} of 3 fits diverge without the cap")
    assert diverged >= 2


def test_the_cap_turns_about_the_mean_of_training():
    """The cap changes nothing where the training data are densest."""
    operator = Edmd(Delays(3, Polynomials(2)), cap=None).fit(touching(np.random.default_rng(1), 6))
    capped = operator.capped(0.99)
    assert capped.statistics.capped > 0
    before, after = (each.advance(each.middle, each.input_middle) for each in (operator, capped))
    # Delayed samples being almost alike, weights of thousands cancel.
    assert np.abs((after - before) / operator.scale).max() < 1e-9


def test_the_gap_as_an_observable_helps_over_one_step():
    """The gap as an observable helps over one step.

    The wall's force is linear in the overlap. The future of the gap is not linear, so the help
    fades with the horizon.
    """
    rng = np.random.default_rng(4)
    episodes, unseen = touching(rng, 8), touching(rng, 4)
    plain, gap = (
        horizon_errors(Edmd(each).fit(episodes), unseen, 10, columns=(1,)).relative
        for each in (Delays(1), Delays(1, GapProducts((-1.0,))))
    )
    assert gap[0] < plain[0]
