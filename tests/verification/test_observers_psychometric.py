"""Psychometric functions, staircases and people of known truth (case 25).

They are compared with printed and exact values.
"""

import numpy as np
import pytest
from staircase import Staircase

from tissue.evaluation.calibration.observers import SimulatedObservers, draw_observers
from tissue.perception.laws import D_PRIME_75, correct_of_d_prime, two_interval, with_lapse
from tissue.scene.registry import GROUPS


def people(count, **given):
    """Equal people."""
    usual = {"alpha": 1.0, "beta": 1.7, "kappa": 0.07, "offset_N": 0.2, "lapse": 0.0, "sigma": 0.2}
    arrays = {name: np.full(count, given.pop(name, value)) for name, value in usual.items()}
    return SimulatedObservers(**arrays, **given)


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
    crowd, rng = people(40_000, lapse=0.03), np.random.default_rng(1)
    for step in (0.0, 0.05, 0.154, 0.4):
        share = two_interval(2.0, step, 0.07, 0.2, 0.03)
        assert crowd.correct(2.0, step, rng).mean() == pytest.approx(
            float(share), abs=4.0 * 0.5 / 200.0
        )
    numbers = crowd.number(2.0, rng)
    assert np.exp(np.log(numbers).mean()) == pytest.approx(2.0**1.7, rel=4.0 * 0.2 / 200.0)


def test_tired_people_and_heavy_tails():
    rng = np.random.default_rng(2)
    tired = people(40_000, fatigue=0.5)
    assert tired.correct(2.0, 0.231, rng, trial=100).mean() == pytest.approx(0.75, abs=0.01)
    heavy = people(40_000, freedom=3.0)
    # at equal variance most of the noise is smaller
    assert heavy.correct(2.0, 0.154, rng).mean() > 0.77


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
    crowd = people(count)
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
