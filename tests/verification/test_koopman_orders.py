"""Orders and slopes of errors.

The claim of Theorem 1 for one step is compared with the measured order, and errors fall with
samples.
"""

from dataclasses import dataclass, replace

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
from tissue.prediction.operator import Identity, Polynomials

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


def test_noise_of_the_sensor_does_not_average_out():
    """Noise of the sensor does not average out.

    It is in the regressors too, so that least squares is biased towards zero for any number of
    samples.
    """
    rng = np.random.default_rng(12)
    few, many = (
        noisy_fit_errors(count, rng, process=1.0, measured=1.0, runs=10) for count in (1600, 6400)
    )
    assert many > 0.7 * few
    assert many > 5.0 * noisy_fit_errors(6400, rng, process=1.0, measured=0.0, runs=10)


@pytest.mark.parametrize("seed", range(3))
def test_a_nonlinear_system_learnt_from_noisy_runs(seed):
    """x1² drifts up by the noise's variance, which the offset learns."""
    rng, sigma, count = np.random.default_rng(seed), 0.05, 8000
    states, noise = np.zeros((count + 1, 2)), sigma * rng.normal(size=(count, 2))
    for k in range(count):
        first, second = states[k]
        states[k + 1] = (0.9 * first, 0.7 * second + 0.5 * first**2) + noise[k]
    operator = Edmd(Polynomials(2, columns=(0,))).fit([Episode(states, None, 1e-3)])
    # Four standard errors: of the weights about sqrt((1 - 0.7²) / 8000), of a variance sqrt(2 /
    # 8000), each relative.
    assert np.abs(operator.A[:2, :2] - np.diag([0.9, 0.7])).max() < 0.032
    assert operator.offset[2] == pytest.approx(sigma**2, rel=0.1)


def test_more_horizon_more_error_and_never_the_printed_power():
    """A longer horizon has more error, and never the printed power.

    E2: the n-step error does not follow a law; an operator beyond the circle is off by its radius
    to the power n.
    """
    rng = np.random.default_rng(13)
    episodes = record(duffing, rng.uniform(-1.0, 1.0, (20, 2)), np.zeros((20, 200)), 0.02)
    honest = Edmd(Polynomials(3)).fit(episodes)
    wild = replace(honest, A=1.05 * honest.A / np.abs(honest.eigenvalues).max())
    growing = horizon_errors(wild, episodes, 150)
    slope = np.polyfit(np.arange(100, 150), np.log(growing[100:]), 1)[0]
    assert slope == pytest.approx(np.log(1.05), rel=0.1)
    held = horizon_errors(wild.capped(1.0), episodes, 150)
    assert held.max() < 5.0 < growing[-1]
    assert horizon_errors(honest, episodes, 150).max() < 1.0
