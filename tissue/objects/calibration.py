"""Calibration of a person's force perception, and simulated persons: `tissue.calibration`."""

from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, enumerated
from meshes.base.hints import suggests_arguments
from tissue.evaluation.calibration.answers import Answer, simulated_answers
from tissue.evaluation.calibration.observers import (
    SimulatedObservers,
    Stimulus,
    calibrated_commands,
    draw_observers,
    gain_of,
)
from tissue.evaluation.calibration.observers import share_right as shares_right
from tissue.evaluation.calibration.session import Comparison, Magnitude, Plan, Session, TrialLog
from tissue.evaluation.statistics.hypothesis_test import Effect
from tissue.perception.adaptive import AdaptiveThreshold
from tissue.perception.observer import reference_observer

__all__ = [
    "Answer",
    "Comparison",
    "Effect",
    "Magnitude",
    "Plan",
    "Session",
    "SimulatedObservers",
    "alike",
    "change_percent",
    "estimated_webers",
    "people",
    "run",
    "share_right",
    "simulated_answers",
]


@suggests_arguments
def people(group: str, count: int, *, seed: int = 0) -> SimulatedObservers:
    """Return simulated observers of a user group, with random parameters.

    A simulated observer is a model of a person's force perception. Its parameters are drawn from
    distributions in the literature. The groups are novice, intermediate and expert.
    """
    return draw_observers(group, count, np.random.default_rng(seed))


def alike(count: int, **truth: float) -> SimulatedObservers:
    """Return identical copies of a default observer, with some attributes replaced.

    Parameters
    ----------
    count
        Number of observers.
    truth
        Values that replace attributes of `SimulatedObservers`, such as ``kappa=0.07, beta=1.7``.

    Raises
    ------
    InputError
        If an attribute is unknown.
    """
    typical = reference_observer()
    names = ("alpha", "beta", "kappa", "offset_N", "lapse", "sigma")
    if strange := sorted(set(truth) - set(names)):
        raise InputError(
            "truth",
            f"have only the keys {enumerated(names)}",
            f"the key {strange[0]}",
            "rename or remove it",
        )
    values: dict[str, Any] = {}
    for name in names:
        value = truth.get(name, getattr(typical, name))
        values[name] = np.full(count, value, dtype=np.float64)
    return SimulatedObservers(**values)


@suggests_arguments
def run(
    answer: Answer,
    log: str | Path,
    *,
    name: str = "simulated",
    plan: Plan | None = None,
    trials: int | None = None,
) -> Session:
    """Run or continue a calibration session, as `tissue calibrate` does.

    Parameters
    ----------
    answer
        Function that answers one question. It is called with the question (a `Comparison` or a
        `Magnitude`) and the number of the trial. ``simulated_answers(people, seed)`` returns such a
        function. Your own function may play the forces on a device and return the answer of a
        person.
    log
        File to which each answer is written before the next question. If the file exists, the
        session continues after the last answer in it.
    name
        Name of the person who answers.
    plan
        Plan of the questions. The default has 120 comparisons of two forces, and 24 forces to be
        rated by a number.
    trials
        Number of trials after which the session stops; default all trials. A later call continues
        the session.

    Raises
    ------
    InputError
        If the log belongs to another session, or `answer` returns an invalid answer.
    """
    kept = TrialLog(Path(log), name, plan or Plan())
    try:
        while not kept.session.complete and (trials is None or kept.session.trial < trials):
            asked = kept.session.ask()
            kept.take(asked, answer(asked, kept.session.trial))
    finally:
        kept.close()
    return kept.session


@suggests_arguments
def estimated_webers(crowd: SimulatedObservers, *, trials: int = 120, seed: int = 0) -> Array:
    """Estimate the Weber fraction of each observer, shape (n,), from simulated comparisons."""
    rng = np.random.default_rng(seed)
    found = AdaptiveThreshold(observers=len(crowd))
    for _ in range(trials):
        asked = found.propose()
        found.answer(asked, crowd.correct(found.base_N[asked], found.step_N[asked], rng))
    return found.weber()[0]


@suggests_arguments
def share_right(
    crowd: SimulatedObservers,
    first_N: float,
    second_N: float,
    *,
    seed: int,
    calibrated_by: int | None = None,
) -> Array:
    """Simulate 100 comparisons for each observer; return the shares of correct answers, shape (n,).

    An answer is correct if it names the larger of the two forces.

    Parameters
    ----------
    crowd
        Observers that compare the two forces.
    first_N, second_N
        The two forces at the device [N], at most 3.3 N.
    seed
        Seed of the observers' noise and of their ratings in a calibration.
    calibrated_by
        Number of forces that each observer rates in a calibration before the comparisons. The
        result of this calibration scales the two forces for the observer. With 0, the true exponent
        and factor of the observer's power law scale the forces. With None, the forces are not
        scaled.
    """
    commands = None
    if calibrated_by is not None:
        # The calibration has a random stream of its own, so it does not change the answers below.
        commands = calibrated_commands(
            crowd, np.random.default_rng([seed, 2]), numbers=calibrated_by
        )
    return shares_right(crowd, Stimulus(first_N), Stimulus(second_N), seed=seed, commands=commands)


@suggests_arguments
def change_percent(before: Array, after: Array, *, seed: int = 0) -> Effect:
    """Compute the change [%] of the mean share of correct answers, with a 95 % interval.

    `before` and `after` contain the share of each of n observers, shape (n,), in the same order.
    The result has the change as ``value``, and the ends of the interval as ``low`` and ``high``.
    """
    return gain_of(before, after, np.random.default_rng(seed))
