"""Mixed models of a study against closed forms, strata and shuffling."""

import numpy as np
import pytest

from tissue.evaluation.statistics.comparison import across_tasks
from tissue.evaluation.statistics.mixed import mixed_model
from tissue.evaluation.statistics.strata import strata
from tissue.evaluation.statistics.trials import TrialTable

pytest.importorskip(
    "statsmodels", reason="statsmodels is not installed: pip install 'tissue-sim[study]'"
)


def study(seed, *, users=6, trials=5, user=1.0, taste=0.6, trial=0.7, rest=1.0, effect=0.3):
    """Trials of two groups under three methods with known variances."""
    rng = np.random.default_rng(seed)
    rows = []
    for group in ("expert", "novice"):
        for name in range(users):
            user_level, tastes = user * rng.normal(), taste * rng.normal(size=3)
            for number in range(trials):
                shared = trial * rng.normal()
                for index, method in enumerate(("a", "b", "c")):
                    value = (
                        5.0
                        + user_level
                        + tastes[index]
                        + shared
                        + rest * rng.normal()
                        + effect * index
                    )
                    rows.append(
                        {
                            "task": "wall",
                            "group": group,
                            "user": f"u{name}",
                            "trial": number,
                            "method": method,
                            "seed": number,
                            "force_error": value,
                        }
                    )
    return TrialTable.from_rows(rows)


def test_in_a_complete_design_it_is_the_exact_test_of_each_stratum():
    """In a complete design the test is the exact test of each stratum.

    Restricted likelihood has a closed form there, as long as no variance is estimated as zero.
    """
    table = study(1, users=8)
    fitted = mixed_model(table, "force_error")
    assert min(fitted.components.user, fitted.components.user_method, fitted.components.trial) > 0.0
    cells = table.cells("force_error")
    for test, (within, between) in zip(
        fitted.tests, (((), True), ((0,), False), ((0,), True)), strict=True
    ):
        exact = strata(cells.values, cells.groups, cells.sizes, within, between=between)
        assert test.degrees == exact.degrees
        # The likelihood is flat at its top: the optimiser leaves a per mille or so.
        assert test.statistic == pytest.approx(float(exact.F), rel=5e-3)


@pytest.mark.slow
def test_several_tasks_in_one_model():
    rng = np.random.default_rng(12)
    one = study(4, trials=3)
    rows = [
        {
            "task": task,
            "group": one.group[i],
            "user": one.user[i],
            "trial": one.trial[i],
            "method": one.method[i],
            "seed": 0,
            "force_error": one.metrics["force_error"][i] + shift + 0.5 * rng.normal(),
        }
        for task, shift in (("milling", 0.0), ("wall", 2.0))
        for i in range(len(one))
    ]
    model = across_tasks(TrialTable.from_rows(rows), "force_error", rng=rng)
    degrees = {each.question.split(": ")[1]: each.degrees for each in model.tests}
    assert (
        degrees["group"] == (1, 10)
        and degrees["task"] == (1, 10)
        and degrees["task x method"] == (2, 20)
    )
    assert model.tests[1].found and "task" in model.tests[1].question
    for each in model.tests:
        # Every term has its own stratum's exact test beside it, and one by shuffling, which rests
        # on neither.
        exact, shuffled = each.alternatives[:2]
        assert exact.test == "analysis of strata" and exact.degrees == each.degrees
        assert shuffled.test == "permutation" and abs(shuffled.p - exact.p) < 0.1


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_fit_that_wrongly_claims_to_converge_is_caught(seed):
    """A fit that wrongly claims to converge is detected.

    Trials that repeat exactly leave no residual; statsmodels then reports success with an F several
    times too large.
    """
    table = study(seed, trials=3, rest=0.0)
    model = mixed_model(table, "force_error")
    convergence = model.tests[0].assumptions[0]
    cells = table.cells("force_error")
    exact = strata(cells.values, cells.groups, cells.sizes, between=True)
    wrong = abs(model.tests[0].statistic / float(exact.F) - 1.0) > 0.05
    assert convergence.name == "convergence" and not (wrong and convergence.holds)
    assert not model.tests[0].sound
