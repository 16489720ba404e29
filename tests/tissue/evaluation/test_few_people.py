"""Intervals and remarks of a study with few people."""

import numpy as np
import pytest

from tissue.evaluation.statistics.comparison import _pairs as pair_tests
from tissue.evaluation.statistics.comparison import compare
from tissue.evaluation.statistics.hypothesis_test import HypothesisTest, partial_eta_squared
from tissue.evaluation.statistics.sign_flips import SignTest, pair_scores, sign_test
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.tested import _outcomes, _pairs


def sign_test_of(people, groups, *, between):
    """Return the test of three methods or of groups, on random values."""
    rng = np.random.default_rng(0)
    group = np.repeat(np.arange(groups), people)
    scores = pair_scores(rng.normal(size=(len(group), 3)), (3,), () if between else (0,))
    return sign_test(scores, group, between=between, rng=rng)


@pytest.mark.parametrize(
    ("people", "groups", "between", "has_interval"),
    [
        (4, 1, False, False),
        (5, 1, False, False),
        (6, 1, False, True),
        (2, 2, False, False),
        (2, 3, False, True),
        (2, 2, True, False),
        (2, 3, True, False),
        (3, 2, True, True),
    ],
)
def test_too_few_people_have_no_interval(people, groups, between, has_interval):
    test = sign_test_of(people, groups, between=between)
    assert np.isfinite(test.critical) == has_interval


def comparison(people):
    """Compare two methods, of which the second has a larger force error for every person."""
    rng = np.random.default_rng(1)
    rows = [
        {
            "task": "T2",
            "group": group,
            "user": str(user),
            "trial": 0,
            "method": method,
            "seed": 0,
            "force_error": 0.1 * rng.random() + 0.2 * (method == "penalty"),
        }
        for group in ("expert", "novice")
        for user in range(people)
        for method in ("koopman", "penalty")
    ]
    return compare(TrialTable.from_rows(rows), "force_error", task="T2", rng=rng)


def test_the_report_states_why_pairs_have_no_interval():
    section = _pairs([comparison(2)])
    assert section.table[0]["size"].endswith(", no 95 % interval")
    assert "the smallest p value with n people is 2 / 2^n" in section.sentences[0]
    section = _pairs([comparison(4)])
    assert "no 95 %" not in section.table[0]["size"]
    assert "2 / 2^n" not in section.sentences[0]


def test_an_end_at_zero_has_no_rounding_error():
    """A flip that equals the measured t is the critical one, up to rounding errors."""
    tukey = HypothesisTest("Tukey HSD", "force_error: b minus a", "q", 1.0, (), 0.5)
    one = np.ones(1)
    for sign, rounded in ((1.0, 1.0 - 1e-15), (-1.0, 1.0 - 1e-15), (1.0, 1.0 + 1e-15)):
        signs = SignTest(1.0, 0.06, 0.3 * sign * one, 0.1 * one, 0.06 * one, 3.0 * rounded)
        [pair] = pair_tests(signs, [tukey])
        assert 0.0 in (pair.effect.low, pair.effect.high)


def test_the_report_states_what_the_interval_of_partial_eta_squared_is():
    found = comparison(3)
    section = _outcomes([("T2", each) for each in found.tests], [])
    assert any("(noncentral F, Steiger 2004)" in sentence for sentence in section.sentences)


def test_partial_eta_squared_of_a_small_f_lies_above_its_interval():
    """F of 0.1 with 6 and 9 degrees: the interval holds for the population, where it is zero."""
    effect = partial_eta_squared(0.1, 6, 9)
    assert effect.value == pytest.approx(0.0625)
    assert effect.low == effect.high == 0.0
