"""Travel after a puncture of people of whom some never notice it.

Nobody is left out for missing it.
"""

from math import inf

import numpy as np
import pytest

from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.cases import median_interval, travel_by_people

METHODS = ("penalty", "koopman")


def row(user, trial, method, travel_mm, *, noticed=True, **other):
    made = {
        "excess_mm": travel_mm,
        "noticed": float(noticed),
        "capsule_N": 2.1 + 0.01 * user,
        "parenchyma_N": 1.6,
    }
    key = {
        "task": "needle",
        "group": "novice",
        "user": f"{user:02d}",
        "trial": trial,
        "seed": 1,
        "method": method,
    }
    return key | made | other


def study(unnoticed=0, people=9):
    """Return a study of nine people with two trials each.

    Under penalty some never notice, under Koopman all do, 1 mm earlier.
    """
    return TrialTable.from_rows(
        row(
            user,
            trial,
            method,
            40.0 if missed else 5.0 + user - (method == "koopman"),
            noticed=not missed,
        )
        for user in range(people)
        for trial in range(2)
        for method in METHODS
        if (missed := method == "penalty" and user < unnoticed) is not None
    )


def test_people_who_notice_nothing_count_as_the_longest():
    whole, missed = study(), study(unnoticed=3)
    assert sorted(travel_by_people(whole, "penalty")) == [5.0 + user for user in range(9)]
    # The three shortest travels become the longest: the median goes up by three places and stays
    # finite.
    assert median_interval(travel_by_people(whole, "penalty"))[0] == 9.0
    middle, low, high = median_interval(travel_by_people(missed, "penalty"))
    assert (middle, low, high) == (12.0, 9.0, inf)
    assert median_interval(travel_by_people(study(unnoticed=5), "penalty"))[0] == inf


@pytest.mark.parametrize("people", [6, 17])
def test_the_interval_of_a_median_holds_it_at_its_rate(people):
    """The interval of a median holds it at its rate.

    By drawing, it holds the median in 95 % or more, and in less if it is narrower by one rank.
    """
    values = np.random.default_rng(people).standard_exponential((4000, people))
    bounds = np.array([median_interval(each)[1:] for each in values])
    inside = (bounds[:, 0] <= np.log(2.0)) & (np.log(2.0) <= bounds[:, 1])
    assert inside.mean() > 0.94
    ordered = np.sort(values, axis=1)
    rank = int(np.argmax(ordered[0] == bounds[0, 0])) + 1
    closer = (ordered[:, rank] <= np.log(2.0)) & (np.log(2.0) <= ordered[:, -rank - 1])
    assert closer.mean() < 0.955


def test_methods_are_compared_on_the_same_trials():
    """Methods are compared on equal trials.

    A trial that failed under one method is left out under all, so that rows of two methods belong
    together.
    """
    rows = [row(user, 0, method, 5.0 + user) for user in range(4) for method in METHODS]
    rows[2] = {
        name: rows[2][name] for name in ("task", "group", "user", "trial", "seed", "method")
    } | {"failure": "x"}
    shared = TrialTable.from_rows(rows).shared()
    for method in METHODS:
        assert shared.where(method=method).user.tolist() == ["00", "02", "03"]
