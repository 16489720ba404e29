"""Reports of a calibration session: posterior, and notes on answers and priors that do not fit."""

import numpy as np
import pytest
from calibration_sessions import answered

from tissue.evaluation.calibration.answers import simulated_answers, simulated_observer
from tissue.evaluation.calibration.session import Magnitude, Plan


def simulated(seed, prior=None, **plan):
    people, observer_seed = simulated_observer(f"simulated:{seed}")
    given = {"prior": prior} if prior else {}
    return answered(Plan(**plan, **given), simulated_answers(people, observer_seed))


def test_an_ordinary_session_has_no_notes():
    for seed in range(5):
        assert simulated(seed, trials=60, numbers=6).notes() == []


def answer_with(share):
    """Answers of which a share is right whatever is asked; a number in proportion to the force."""
    rng = np.random.default_rng(1)
    return lambda asked, _: (
        asked.force_N
        if isinstance(asked, Magnitude)
        else asked.greater
        if rng.random() < share
        else 3 - asked.greater
    )


def test_all_right_only_bounds_the_threshold():
    session = answered(Plan(trials=60, numbers=2), answer_with(1.0))
    assert any(
        "all 60 comparisons were right" in note and "only an upper limit" in note
        for note in session.notes()
    )
    assert any("lies at the prior's lowest Weber fraction" in note for note in session.notes())
    assert session.observer("x").kappa > 0.0


@pytest.mark.parametrize("share", [0.5, 0.0])
def test_guesses_and_mixed_up_answers_are_reported(share):
    notes = answered(Plan(trials=60), answer_with(share)).notes()
    assert any("no more than by guessing" in note for note in notes)


@pytest.mark.parametrize(
    ("lowest", "highest", "side"), [(0.3, 0.6, "lowest"), (0.005, 0.02, "highest")]
)
def test_a_prior_that_excludes_the_truth_is_reported(lowest, highest, side):
    from tissue.perception.adaptive import ThresholdPrior

    prior = ThresholdPrior(lowest=lowest, highest=highest)
    assert any(
        f"the prior's {side} Weber fraction" in note
        for note in simulated(1, prior, trials=200, numbers=6).notes()
    )


def test_no_numbers_leave_the_exponent_to_the_prior():
    session = answered(Plan(trials=5, numbers=0), answer_with(1.0))
    assert any("Stevens' exponent has the value of the prior" in note for note in session.notes())
    assert session.observer("x").beta == pytest.approx(1.4)
