"""Calibration of force perception, and simulated observers: `tissue.calibration`."""

from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
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
    """Return simulated observers of a group, drawn from the distributions in the literature.

    A simulated observer is a model of a person's perception. The groups are novice, intermediate
    and expert.
    """
    return draw_observers(group, count, np.random.default_rng(seed))


def alike(count: int, **truth: float) -> SimulatedObservers:
    """Return identical simulated observers: copies of the reference observer with given changes.

    Parameters
    ----------
    count
        Number of observers.
    truth
        Attributes of `SimulatedObservers` to change, such as ``kappa=0.07, beta=1.7``.

    Raises
    ------
    InputError
        If an attribute is unknown.
    """
    typical = reference_observer()
    names = ("alpha", "beta", "kappa", "offset_N", "lapse", "sigma")
    if strange := sorted(set(truth) - set(names)):
        raise InputError("truth", f"hold only {', '.join(names)}", strange[0], "use one of these")
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
        Function that answers a question. The function is called with the question (a `Comparison`
        or a `Magnitude`) and the number of the trial. ``simulated_answers(people, seed)`` returns
        such a function. A function of your own may play the forces to a person.
    log
        File that receives every answer before the next question. The session continues after the
        last answer in this file.
    name
        Name of the person who answers.
    plan
        Plan of the questions; default 120 comparisons and 24 magnitudes.
    trials
        Number of trials after which the session stops, to be continued later; default all trials.

    Raises
    ------
    InputError
        If the log belongs to another session, or an answer is impossible.
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
    """Estimate the Weber fractions of n observers, shape (n,), from a session of comparisons."""
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
    """Compute each observer's share of correct answers, shape (n,), in 100 comparisons.

    An answer is correct if it names the larger of the two forces.

    Parameters
    ----------
    crowd
        Observers. Equal seeds give the observers the same noise.
    first_N, second_N
        The two forces at the device [N], at most 3.3 N.
    seed
        Seed of the noise, and of the magnitudes in a calibration.
    calibrated_by
        Number of magnitudes that each observer reports in a calibration. The forces are scaled for
        the observer by the result of this calibration. With 0 the forces are scaled by the
        observer's true exponent and factor. With None the forces are not scaled.
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
    """Compute the change [%] of the mean from the shares `before` to the paired shares `after`.

    Both arrays have shape (n,). The attribute ``value`` of the result is the estimate; ``low`` and
    ``high`` are the ends of its 95 % interval.
    """
    return gain_of(before, after, np.random.default_rng(seed))
