"""Orders and slopes of errors.

The claim of Theorem 1 for one step is compared with the measured order, and errors fall with
samples.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from koopman_systems import (
    Gaussians,
    Generator,
    advance,
    contact,
    duffing,
    horizon_errors,
    lifted_rates,
    record,
    slow_manifold,
    slow_manifold_at,
    van_der_pol,
)

from tissue.prediction.edmd import Edmd, Episode
from tissue.prediction.operator import (
    Delays,
    GapProducts,
    Identity,
    Polynomials,
    cap_spectrum,
    spectral_radius,
)

PRINTED_ORDER = 2.0
"""Order that the paper's Theorem 1 claims for every dictionary."""
STEPS_S = np.array([1e-3, 5e-4, 2.5e-4, 1.25e-4])


@dataclass(frozen=True)
class StepErrors:
    """Mean one-step errors over some states against the step, in scaled observables.

    `euler` is the update that the paper's Theorem 1 calls O(h²), `exact` that of the exponential,
    `defect` |Lφ - Kφ|.
    """

    steps_s: np.ndarray
    euler: np.ndarray
    exact: np.ndarray
    defect: float


def closure_defects(generator, states, rates):
    """|Lφ - Kφ| at each state, in scaled observables [1/s], shape (n,); Lφ = ∇φ · dx/dt."""
    true = lifted_rates(generator.dictionary, states, rates)
    fitted = generator.dictionary.lift(states) @ generator.A.T + generator.offset
    return np.linalg.norm((true - fitted) / generator.scale, axis=1)


def step_errors(generator, states, rates, flow, steps_s):
    """Return one-step errors of a generator by Euler's rule and by the exponential.

    The errors are taken from given states for several steps. By Taylor, φ(x(t + h)) = φ + h Lφ +
    O(h²), so the error is h |Lφ - Kφ| + O(h²). It is of second order only where the dictionary is
    closed, and then zero with the exact exponential. `flow` leads from a step [s] to the states
    after it.
    """
    lifted = generator.dictionary.lift(states)
    fitted = lifted @ generator.A.T + generator.offset
    sizes = []
    for step in steps_s:
        advanced = generator.dictionary.lift(flow(step))
        missed = (
            advanced - lifted - step * fitted,
            advanced - generator.advance(lifted, step),
        )
        sizes.append([np.linalg.norm(each / generator.scale, axis=1).mean() for each in missed])
    euler, exact = np.array(sizes).T
    defect = float(closure_defects(generator, states, rates).mean())
    return StepErrors(np.asarray(steps_s), euler, exact, defect)


def slope(steps, errors):
    """Slope of log error over log step."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_closed_dictionary_keeps_the_claim_and_has_no_error_with_the_exponential(seed):
    states = np.random.default_rng(seed).uniform(-1.0, 1.0, (400, 2))
    generator = Generator.fit(Polynomials(2, columns=(0,)), states, slow_manifold(states))
    found = step_errors(
        generator,
        states,
        slow_manifold(states),
        lambda step: slow_manifold_at(states, np.array([step]))[:, 0],
        STEPS_S * 100,
    )
    assert found.defect < 1e-12
    order = slope(found.steps_s, found.euler)
    print(f"closed dictionary, step by Euler: order {order:.2f}")
    assert order == pytest.approx(PRINTED_ORDER, abs=0.05)
    assert found.exact.max() < 1e-13


@pytest.mark.parametrize(
    ("field", "spread"),
    [(duffing, (1.0, 1.0)), (van_der_pol, (1.0, 1.0)), (contact, (0.01, 1.0))],
    ids=["duffing", "van der pol", "contact"],
)
@pytest.mark.parametrize("lifted", ["polynomials", "gaussians"])
def test_other_dictionaries_are_of_first_order_whatever_the_theorem_states(field, spread, lifted):
    rng = np.random.default_rng(5)
    states = rng.uniform(-1.0, 1.0, (400, 2)) * spread
    dictionary = {
        "polynomials": Polynomials(3),
        "gaussians": Gaussians(states[:10], states.std(axis=0)),
    }[lifted]
    generator = Generator.fit(dictionary, states, field(states))
    # A spring of 500 N/m under 0.1 kg moves in 0.1 s: finer steps show the limit there.
    steps = STEPS_S * (0.1 if field is contact else 1.0)
    found = step_errors(
        generator,
        states,
        field(states),
        lambda step: advance(field, states, step, substeps=8),
        steps,
    )
    orders = [slope(found.steps_s, each) for each in (found.euler, found.exact)]
    print(
        f"{field.__name__}, {lifted}: orders {orders[0]:.2f} (Euler), {orders[1]:.2f} (exponential)"
    )
    assert found.defect > 0.1
    for errors, order in zip((found.euler, found.exact), orders, strict=True):
        assert order == pytest.approx(1.0, abs=0.05)
        assert order < PRINTED_ORDER - 0.5
        assert errors[-1] / steps[-1] == pytest.approx(found.defect, rel=0.05)


def test_the_defect_is_where_the_rates_are_missed():
    """The defect lies where the rates are missed.

    For a linear fit to the Duffing oscillator it is the rate of the speed alone, and its size is
    the nonlinear part of x³.
    """
    states = np.random.default_rng(7).uniform(-1.0, 1.0, (400, 2))
    generator = Generator.fit(Identity(), states, duffing(states))
    missed = duffing(states) - states @ generator.A.T - generator.offset
    assert np.abs(missed[:, 0]).max() < 1e-12
    found = closure_defects(generator, states, duffing(states))
    assert found == pytest.approx(np.abs(missed[:, 1]) / generator.scale[1], rel=1e-9)


def noisy_fit_errors(samples, rng, process, measured, runs=30):
    """Root mean square error of the operator of a noisy linear system, over runs."""
    truth, errors = np.array([[0.95, 0.1], [-0.1, 0.9]]), []
    for _ in range(runs):
        states = [rng.normal(size=2)]
        for noise in process * rng.normal(size=(samples, 2)):
            states.append(truth @ states[-1] + noise)
        table = np.array(states) + measured * rng.normal(size=(samples + 1, 2))
        errors.append(
            np.linalg.norm(Edmd(Identity(), cap=None).fit([Episode(table, None, 1e-3)]).A - truth)
        )
    return float(np.sqrt(np.mean(np.square(errors))))


def test_errors_fall_with_the_root_of_the_samples():
    """Noise that acts on the system averages out as M^-1/2 (Nüske et al. 2023)."""
    rng, counts = np.random.default_rng(11), [100, 400, 1600, 6400]
    errors = [noisy_fit_errors(count, rng, process=1.0, measured=0.0) for count in counts]
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    print(f"error over noisy samples: slope {slope:.2f}")
    # Thirty runs a count leave a standard error of about 0.04 in the slope.
    assert slope == pytest.approx(-0.5, abs=0.12)


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
