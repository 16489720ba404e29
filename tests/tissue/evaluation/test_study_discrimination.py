"""Discrimination at the skin and ratios of intensity.

The cases are perfect and wrong answers, null and planted changes, and their rates.
"""

import numpy as np
import pytest

from tissue.evaluation.calibration.observers import (
    Stimulus,
    chance_right,
    draw_observers,
    share_right,
)
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.discrimination import Felt, FeltPair, changes_of, sides, specimens
from tissue.evaluation.study.trial_metrics import intensity_ratios
from tissue.haptics.loop.filters import ForceRange
from tissue.perception.observer import Observer, reference_observer

WIDE = ForceRange(limit_N=1e4)
PAIRS = [
    (Stimulus(1.0), Stimulus(1.1)),
    (Stimulus(0.3, 0.02), Stimulus(0.36, 0.03)),
    (Stimulus(2.0, 0.2), Stimulus(2.0)),
]


@pytest.mark.parametrize("pair", PAIRS)
def test_the_chance_is_the_share_of_answers_that_people_give(pair):
    """The chance agrees with the share of people's right answers.

    It is simulated with 300 answers each; the closed form leaves out the threshold's own scatter
    with the force.
    """
    people = draw_observers("novice", 300, np.random.default_rng(0))
    answered = share_right(people, *pair, seed=1, trials=300, limits=WIDE)
    assert chance_right(people, *pair).mean() == pytest.approx(answered.mean(), abs=0.01)


PEOPLE, TRIALS = 12, 6


def felt(forces_N):
    """Of people in turn, shape (people, trials)."""
    people, trials = forces_N.shape
    return Felt.over(forces_N.ravel(), np.repeat(np.arange(people), trials), people)


def level(mean, scatter, rng, people=PEOPLE):
    return mean + scatter * rng.standard_normal((people, TRIALS))


def pair_of(first, second, scatter, rng):
    return FeltPair(felt(level(first, scatter, rng)), felt(level(second, scatter, rng)))


def scaled(pair, factor):
    return FeltPair(
        *(
            Felt(factor * each.means_N, factor**2 * each.squares_N2, each.free)
            for each in (pair.less, pair.more)
        )
    )


def doubled(pair):
    return scaled(pair, 2.0)


def test_the_same_forces_change_nothing_and_a_planted_gain_is_found():
    """Equal forces change nothing and a planted gain is found.

    If everything is doubled before the person's noise, d' grows by 2 (F + o) / (2 F + o) without
    scatter, by hand.
    """
    rng = np.random.default_rng(0)
    people = draw_observers("novice", 100, rng)
    pair = pair_of(0.1, 0.11, 0.0, rng)
    assert changes_of(people, pair, pair) == pytest.approx(np.zeros((3, 3)))
    found = changes_of(people, pair, doubled(pair))
    plain = 0.01 / (people.kappa * (0.1 + people.offset_N))
    twice = 0.02 / (people.kappa * (0.2 + people.offset_N))
    assert found[1, 0] == pytest.approx(100.0 * (twice.mean() / plain.mean() - 1.0), rel=1e-6)
    assert found[0, 0] == pytest.approx(0.954 * (twice.mean() - plain.mean()), rel=1e-3)
    assert (found[:, 1] > 0.0).all()
    # A fifth more of difference on the same weaker force is a fifth more of d'.
    wider = FeltPair(pair.less, felt(level(0.112, 0.0, rng)))
    assert changes_of(people, pair, wider)[1] == pytest.approx(np.full(3, 20.0), abs=1e-6)


def test_who_goes_by_force_is_wrong_where_the_stiffer_one_is_felt_as_weaker():
    """A person who judges by force is wrong where the stiffer specimen is felt as weaker.

    Two specimens in exchanged order have the opposite d' and the other answers; a single exchange
    is no gain.
    """
    rng = np.random.default_rng(3)
    people = draw_observers("expert", 60, rng)
    pair = pair_of(0.5, 0.6, 0.02, rng)
    (d, right), (turned, wrong) = (
        pair.felt_by(people),
        FeltPair(pair.more, pair.less).felt_by(people),
    )
    assert turned == pytest.approx(-d) and wrong == pytest.approx(1.0 - right) and (d > 0.0).all()
    assert changes_of(people, pair, FeltPair(pair.more, pair.less))[0, 2] < 0.0


def trials(
    per_person, *, scatter=0.02, nested=False, people=10, seed=0, difference=0.1, differ=0.0
):
    """Return trials of people whose forces differ by up to a factor of three.

    Each has three specimens in turn, in steps that differ.
    """
    rng, rows = np.random.default_rng(seed), []
    for user in range(people):
        usual, step = 0.3 * 3.0 ** (user / people), difference * (1.0 + differ * (-1) ** user)
        for trial in range(per_person):
            specimen = float((user if nested else user + trial) % 3)
            rows.append(
                {
                    "task": "T1",
                    "group": "novice",
                    "user": f"{user:02d}",
                    "trial": trial,
                    "seed": 0,
                    "method": "koopman",
                    "specimen": specimen,
                    "skin_N": usual + step * specimen + scatter * rng.standard_normal(),
                    "capsule_N": usual + 0.4 + scatter * rng.standard_normal(),
                    "parenchyma_N": usual + scatter * rng.standard_normal(),
                }
            )
    return TrialTable.from_rows(rows)


@pytest.mark.parametrize("differ", [0.0, 0.5], ids=["steps-alike", "steps-that-differ"])
def test_what_people_differ_by_is_no_scatter(differ):
    pair = specimens(trials(30, differ=differ))
    less, more = pair.less.stimulus, pair.more.stimulus
    assert more.level_N - less.level_N == pytest.approx(0.1, abs=0.006)
    assert less.scatter_N == pytest.approx(0.02, rel=0.2) == more.scatter_N
    pair = sides(trials(9))
    assert pair.more.stimulus.level_N - pair.less.stimulus.level_N == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize(
    ("find", "count"), [(specimens, 4), (specimens, 9), (sides, 2), (sides, 4)]
)
def test_the_scatter_that_is_stated_is_on_the_average_the_planted_one(find, count):
    found = [find(trials(count, seed=seed)) for seed in range(200)]
    squares = [each.stimulus.scatter_N**2 for pair in found for each in (pair.less, pair.more)]
    assert np.sqrt(np.mean(squares)) == pytest.approx(0.02, rel=0.05)


def test_people_who_met_one_specimen_each_compare_nothing():
    assert specimens(trials(9, nested=True)) is None
    assert specimens(trials(1)) is None and sides(trials(1)) is None


@pytest.mark.slow
def test_null_changes_are_called_at_their_nominal_rate():
    """Null changes are called at their nominal rate.

    Two methods have scatters of their own and no difference: 5 % of intervals exclude zero, here 3
    to 8.
    """
    called, studies = 0, 600
    for seed in range(studies):
        rng = np.random.default_rng(seed)
        people = draw_observers("novice", 50, rng)
        plain, other = (pair_of(0.5, 0.6, 0.05, rng) for _ in range(2))
        _, low, high = changes_of(people, plain, other)[0]
        called += low > 0.0 or high < 0.0
    assert 0.03 <= called / studies <= 0.08


def person(beta):
    return Observer.known(
        "someone", alpha=1.7, beta=beta, kappa=0.07, offset_N=0.2, lapse=0.01, sigma=0.2
    )


def forces(ticks=3000):
    time = np.arange(ticks) * 1e-3
    return np.column_stack([np.zeros(ticks), np.zeros(ticks), 0.6 + 0.4 * np.sin(1.5 * time)])


def test_a_perfect_force_has_no_error_of_ratios_whatever_its_factor():
    ideal, beta = forces(), reference_observer().beta
    for factor in (0.5, 1.0, 3.0):
        found = intensity_ratios(factor * ideal, ideal, ideal, person(beta))
        assert found["ratio_error"] == pytest.approx(0.0, abs=1e-12) == found["ratio_floor"]


def test_a_person_of_another_exponent_is_wrong_by_the_spread_of_the_force_and_right_when_mapped():
    ideal, beta = forces(), reference_observer().beta
    size = np.array([part.mean() for part in np.array_split(ideal[:, 2], 30)])
    other = person(beta + 0.3)
    assert intensity_ratios(ideal, ideal, ideal, other)["ratio_error"] == pytest.approx(
        0.3 * np.log(size).std(), rel=1e-9
    )
    held = np.repeat(size, 100)[:, None] * [0.0, 0.0, 1.0]
    mapped = np.repeat(size ** (beta / other.beta), 100)[:, None] * [0.0, 0.0, 1.0]
    assert intensity_ratios(mapped, held, held, other)["ratio_error"] == pytest.approx(
        0.0, abs=1e-12
    )


def test_windows_that_are_half_in_contact_take_no_part_in_ratios():
    """Windows that are half in contact take no part in ratios.

    A force at the skin that is wrong in free motion alone, like friction, has perfect ratios.
    """
    ideal = forces()
    ideal[:1050] = ideal[2950:] = 0.0
    skin = ideal + np.where((ideal == 0.0).all(axis=1), 0.2, 0.0)[:, None] * [1.0, 0.0, 0.0]
    found = intensity_ratios(skin, ideal, ideal, person(reference_observer().beta))
    assert found["ratio_error"] == pytest.approx(0.0, abs=1e-12)
