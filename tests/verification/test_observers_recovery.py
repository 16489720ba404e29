"""Calibration of people of known truth (case 25).

It recovers values, intervals and ranks; the number of needed trials is counted.
"""

import numpy as np
import pytest
from scipy.stats import chisquare
from staircase import Staircase

from tissue.evaluation.calibration.observers import SimulatedObservers, draw_observers
from tissue.perception.adaptive import (
    MAGNITUDE_FORCES_N,
    PRIOR_MEAN,
    PRIOR_SCALE,
    PRIOR_SHAPE,
    PRIOR_WEIGHT,
    AdaptiveThreshold,
    ThresholdPrior,
    comparisons,
    fit_magnitudes,
)
from tissue.perception.laws import D_PRIME_75, correct_of_d_prime, two_interval, with_lapse
from tissue.scene.registry import GROUPS

SMALL = ThresholdPrior(cells=41, offset_cells=5, lapse_cells=3)


def people(count, **given):
    """Equal people."""
    usual = {"alpha": 1.0, "beta": 1.7, "kappa": 0.07, "offset_N": 0.2, "lapse": 0.02, "sigma": 0.2}
    return SimulatedObservers(
        **{name: np.broadcast_to(given.get(name, value), count) for name, value in usual.items()}
    )


def calibrated(crowd, rng, *, trials, prior=SMALL, stimuli=None):
    """Thresholds of a crowd after some adaptive trials each."""
    found = AdaptiveThreshold(prior, stimuli, observers=len(crowd))
    for _ in range(trials):
        asked = found.propose()
        found.answer(asked, crowd.correct(found.base_N[asked], found.step_N[asked], rng))
    return found


@pytest.mark.slow
def test_weber_of_seven_percent_is_recovered():
    """A Weber fraction of seven percent is recovered.

    In 100 sessions of 120 trials the mean agrees to three standard errors and the prior's pull, one
    session to its spread.
    """
    found = calibrated(people(100), np.random.default_rng(0), trials=120)
    weber, spread = found.weber()
    errors = np.log(weber / 0.07)
    print(
        f"Weber fraction of 7 %: {7.0 * np.exp(errors.mean()):.2f} %, one session scatters "
        f"by {100 * errors.std():.0f} %"
    )
    assert abs(errors.mean()) < 3.0 * errors.std() / 10.0 + 0.02
    assert errors.std() < 0.2
    assert (np.abs(errors) < 3.5 * spread).all()


def test_stevens_of_1_7_is_recovered():
    """A Stevens exponent of 1.7 is recovered.

    In 200 sessions of 24 numbers the mean agrees to four standard errors, and intervals hold the
    truth as often as they claim.
    """
    crowd, rng = people(200), np.random.default_rng(1)
    forces = np.resize(MAGNITUDE_FORCES_N, 24)
    numbers = np.array([crowd.number(force, rng) for force in forces])
    fits = [fit_magnitudes(forces, column) for column in numbers.T]
    exponents = np.array([fit.mean[1] for fit in fits])
    # and the prior's pull
    assert exponents.mean() == pytest.approx(1.7, abs=4.0 * exponents.std() / 200**0.5 + 0.003)
    print(f"exponent of 1.7: {exponents.mean():.2f}, one session scatters by {exponents.std():.2f}")
    assert exponents.std() < 0.07
    held = np.mean(
        [low < 1.7 < high for low, high in (fit.exponent_at([0.025, 0.975]) for fit in fits)]
    )
    assert 0.91 < held < 0.995  # of 200: three standard errors around 95 %


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_claim():
    """Intervals hold the truth as often as they claim.

    800 people are drawn from the prior, between the grid's points: 92 to 98 % of their 95 %
    intervals hold it.
    """
    rng, count = np.random.default_rng(2), 800
    prior = ThresholdPrior(cells=61, offset_cells=9, lapse_cells=4)
    weber, offset, lapse, masses = prior.parameters()
    drawn = rng.choice(len(masses), size=count, p=masses)
    within = np.exp((rng.random(count) - 0.5) * np.log(prior.weber_edges[1] / prior.weber_edges[0]))
    crowd = people(count, kappa=weber[drawn] * within, offset_N=offset[drawn], lapse=lapse[drawn])
    found = calibrated(crowd, rng, trials=60, prior=prior)
    low, high = found.weber_quantiles(np.array([0.025, 0.975]))
    covered = np.mean((low < crowd.kappa) & (crowd.kappa < high))
    assert 0.92 < covered < 0.98
    held = []
    for _ in range(count):
        variance = PRIOR_SCALE / rng.gamma(PRIOR_SHAPE)
        alpha, beta = np.array(PRIOR_MEAN) + np.sqrt(variance / PRIOR_WEIGHT) * rng.standard_normal(
            2
        )
        forces = np.resize(MAGNITUDE_FORCES_N, 12)
        numbers = np.exp(
            alpha + beta * np.log(forces) + np.sqrt(variance) * rng.standard_normal(12)
        )
        least, most = fit_magnitudes(forces, numbers).exponent_at([0.025, 0.975])
        held.append(least < beta < most)
    print(
        f"95 % intervals hold {100 * covered:.1f} % of the Weber fractions, "
        f"{100 * np.mean(held):.1f} % of the exponents"
    )
    assert 0.92 < np.mean(held) < 0.98


def test_ranks_of_simulated_calibrations_are_uniform():
    """Ranks of simulated calibrations are uniform.

    For 600 people from the prior, the posterior's mass below the truth, ties split at random, is
    uniform. A chi-square test over twelve bins at 0.1 % checks it. A posterior that is too narrow
    (answers counted twice) must fail it.
    """
    rng, count = np.random.default_rng(3), 600
    weber, offset, lapse, masses = SMALL.parameters()
    drawn = rng.choice(len(masses), size=count, p=masses)
    crowd = people(count, kappa=weber[drawn], offset_N=offset[drawn], lapse=lapse[drawn])
    found = calibrated(crowd, rng, trials=40)

    def p_value(posterior):
        cells = posterior.reshape(SMALL.cells, -1, count).sum(axis=1)
        cell = drawn // (SMALL.offset_cells * SMALL.lapse_cells)
        at = cells[cell, np.arange(count)]
        ranks = np.cumsum(cells, axis=0)[cell, np.arange(count)] - at + rng.random(count) * at
        return chisquare(np.histogram(ranks, bins=12, range=(0.0, 1.0))[0]).pvalue

    assert p_value(found.posterior) > 1e-3
    twice = found.posterior**2 / masses[:, None]
    assert p_value(twice / twice.sum(axis=0)) < 1e-3


def test_the_most_informative_comparison_is_the_one_of_least_expected_entropy():
    """The most informative comparison has the smallest expected entropy.

    It is checked against the definition, written out: every comparison, both answers, entropy of
    each posterior.
    """
    prior = ThresholdPrior(cells=9, offset_cells=3, lapse_cells=2)
    found = AdaptiveThreshold(prior, comparisons((0.5, 2.0)))
    rng = np.random.default_rng(5)
    weber, offset, lapse, _ = prior.parameters()
    for _ in range(12):
        entropies = []
        for base, step in zip(found.base_N, found.step_N, strict=True):
            right, entropy = two_interval(base, step, weber, offset, lapse), 0.0
            for likelihood in (right, 1.0 - right):
                joint = likelihood * found.posterior[:, 0]
                after = joint / joint.sum()
                entropy -= joint.sum() * (after[after > 0.0] * np.log(after[after > 0.0])).sum()
            entropies.append(entropy)
        asked = found.propose()
        assert entropies[asked[0]] == pytest.approx(min(entropies), abs=1e-12)
        found.answer(asked, rng.random(1) < 0.8)


def test_identical_forces_carry_no_information():
    """A step of zero is answered by chance, and leaves the prior as it was."""
    stimuli = (np.array([2.0]), np.array([0.0]))
    found = calibrated(people(50), np.random.default_rng(8), trials=30, stimuli=stimuli)
    np.testing.assert_allclose(found.posterior[:, 0], SMALL.parameters()[3], rtol=1e-9)


def test_comparisons_stay_below_the_device_s_limit_in_steps_of_one_ratio():
    """Comparisons stay below the device's limit in steps of one ratio.

    Of all steps only those are left out whose larger force the device cannot play.
    """
    bases, steps = comparisons((0.5, 2.0), force_limit_N=2.2)
    every = comparisons((0.5, 2.0), force_limit_N=100.0)
    assert (bases + steps <= 2.2).all() and len(bases) < len(every[0])
    fits = every[0] + every[1] <= 2.2
    assert bases.tolist() == every[0][fits].tolist() and steps.tolist() == every[1][fits].tolist()
    ratios = (
        every[1][:-1][every[0][:-1] == every[0][1:]] / every[1][1:][every[0][:-1] == every[0][1:]]
    )
    assert np.ptp(ratios) < 1e-12 and every[1][0] / every[1][len(every[1]) // 2] == pytest.approx(
        0.7 / 2.2, rel=0.1
    )


def without_lapses(count, **given):
    """Equal people who never answer by chance."""
    return people(count, **({"lapse": 0.0} | given))


def test_printed_values():
    """Reference case 25, to the digits that are printed."""
    # A Weibull function at its threshold, with a lapse of 2 %.
    assert with_lapse(-np.expm1(-1.0), 0.02) == pytest.approx(0.8034, abs=5e-5)
    assert pytest.approx(0.954, abs=5e-4) == D_PRIME_75
    for d_prime, share in ((D_PRIME_75, 0.75), (0.771, 0.5**0.5), (1.159, 0.5 ** (1.0 / 3.0))):
        assert correct_of_d_prime(d_prime) == pytest.approx(share, abs=2e-4)


def test_a_threshold_is_discriminated_in_three_of_four_trials():
    base = np.array([0.0, 0.3, 2.0, 7.0])
    np.testing.assert_allclose(two_interval(base, 0.07 * (base + 0.2), 0.07, 0.2), 0.75, rtol=1e-12)
    assert two_interval(2.0, 0.0, 0.07, 0.2, 0.04) == 0.5
    assert two_interval(2.0, 100.0, 0.07, 0.2, 0.04) == pytest.approx(0.96)


def test_people_answer_as_often_as_the_function_predicts():
    """40,000 answers: four standard errors."""
    crowd, rng = without_lapses(40_000, lapse=0.03), np.random.default_rng(1)
    for step in (0.0, 0.05, 0.154, 0.4):
        share = two_interval(2.0, step, 0.07, 0.2, 0.03)
        assert crowd.correct(2.0, step, rng).mean() == pytest.approx(
            float(share), abs=4.0 * 0.5 / 200.0
        )
    numbers = crowd.number(2.0, rng)
    assert np.exp(np.log(numbers).mean()) == pytest.approx(2.0**1.7, rel=4.0 * 0.2 / 200.0)


@pytest.mark.parametrize("group", GROUPS)
def test_people_of_a_group_are_drawn_by_their_seed(group):
    one, two = (draw_observers(group, 500, np.random.default_rng(3)) for _ in range(2))
    assert (one.kappa == two.kappa).all() and (one.beta == two.beta).all()
    median = {"novice": 0.09, "intermediate": 0.08, "expert": 0.07}[group]
    # four standard errors of the median of a log-normal of spread 0.3
    assert np.log(np.median(one.kappa) / median) == pytest.approx(
        0.0, abs=4.0 * 1.25 * 0.3 / 500**0.5
    )


@pytest.mark.parametrize(("down", "target"), [(2, 0.7071), (3, 0.7937)])
def test_a_staircase_settles_at_its_target(down, target):
    """A staircase settles at its target.

    It moves up as often as down: over all moves the mean of p^n is one half, exactly, and p lies
    close to its root. The first is a martingale's law and is kept to four standard errors. The
    second is biased by the size of a step and the curve's bend, and is kept to 1.5 points, which
    separates 70.7 from 79.4 %.
    """
    count, rng = 200, np.random.default_rng(4)
    crowd = without_lapses(count)
    stairs = Staircase(0.5, down=down, observers=count, fine=1.1)
    assert stairs.target == pytest.approx(target, abs=5e-5)
    moves, falls = 0, 0
    for trial in range(500):
        before = stairs.level.copy()
        stairs.answer(crowd.correct(2.0, stairs.level, rng))
        if trial >= 100:
            moves += int((stairs.level != before).sum())
            falls += int((stairs.level < before).sum())
    assert falls / moves == pytest.approx(0.5, abs=4.0 * 0.5 / moves**0.5)
    middle = np.exp(np.log(stairs.threshold()).mean())
    settled = two_interval(2.0, middle, 0.07, 0.2)
    print(f"staircase for {100 * target:.1f} %: settles at {100 * settled:.1f} %")
    assert settled == pytest.approx(target, abs=0.015)
