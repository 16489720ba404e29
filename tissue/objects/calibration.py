"""Calibration of force perception, and simulated observers: `tissue.calibration`."""

from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
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


def people(group: str, count: int, *, seed: int = 0) -> SimulatedObservers:
    """Return simulated observers of a group, drawn from cited spreads.

    The groups are novice, intermediate and expert.
    """
    return draw_observers(group, count, np.random.default_rng(seed))


def alike(count: int, **truth: float) -> SimulatedObservers:
    """Return identical simulated observers: the reference observer with given changes.

    Parameters
    ----------
    count
        Number of observers.
    truth
        Changed attributes of `SimulatedObservers`: ``kappa=0.07, beta=1.7``.

    Raises
    ------
    InputError
        If there is no such attribute.
    """
    typical = reference_observer()
    names = ("alpha", "beta", "kappa", "offset_N", "lapse", "sigma")
    if strange := sorted(set(truth) - set(names)):
        raise InputError("truth", f"hold only {', '.join(names)}", strange[0], "use one of these")
    alpha, beta, kappa, offset, lapse, sigma = (
        np.full(count, truth.get(name, getattr(typical, name)), dtype=np.float64) for name in names
    )
    return SimulatedObservers(
        alpha=alpha, beta=beta, kappa=kappa, offset_N=offset, lapse=lapse, sigma=sigma
    )


def run(
    answer: Answer,
    log: str | Path,
    *,
    name: str = "simulated",
    plan: Plan | None = None,
    trials: int | None = None,
) -> Session:
    """Run a session as `tissue calibrate` does, starting at the end of its log.

    Parameters
    ----------
    answer
        Called with the question, a `Comparison` or a `Magnitude`, and the trial's number.
        ``simulated_answers(people, seed)`` returns such a function; another one may play both
        forces to a person.
    log
        File that receives every answer before the next question.
    name
        Name of the person who answers.
    plan
        Plan of the questions; default 120 comparisons and 24 numbers.
    trials
        Trials after which the session stops and can be continued later; default at its end.

    Raises
    ------
    InputError
        If the log is of another session, or an answer is impossible.
    """
    kept = TrialLog(Path(log), name, plan or Plan())
    try:
        while not kept.session.complete and (trials is None or kept.session.trial < trials):
            asked = kept.session.ask()
            kept.take(asked, answer(asked, kept.session.trial))
    finally:
        kept.close()
    return kept.session


def estimated_webers(crowd: SimulatedObservers, *, trials: int = 120, seed: int = 0) -> Array:
    """Estimate the Weber fractions of observers by a session of comparisons, shape (n,)."""
    rng = np.random.default_rng(seed)
    found = AdaptiveThreshold(observers=len(crowd))
    for _ in range(trials):
        asked = found.propose()
        found.answer(asked, crowd.correct(found.base_N[asked], found.step_N[asked], rng))
    return found.weber()[0]


def share_right(
    crowd: SimulatedObservers,
    first_N: float,
    second_N: float,
    *,
    seed: int,
    calibrated_by: int | None = None,
) -> Array:
    """Return each observer's share of correct answers in 100 comparisons, shape (n,).

    An answer is correct if it names the larger of the two forces.

    Parameters
    ----------
    crowd
        Observers; equal seeds give them the same noise.
    first_N, second_N
        The two forces at the device [N], whose limit is 3.3 N.
    seed
        Seed of the noise, and of the numbers of a calibration.
    calibrated_by
        Number of magnitudes given by each person, from which the force is scaled for the person. 0
        scales by the true exponent; None leaves the force unscaled.
    """
    commands = None
    if calibrated_by is not None:
        # A random stream of its own: the answers below draw from the seed alone.
        commands = calibrated_commands(
            crowd, np.random.default_rng([seed, 2]), numbers=calibrated_by
        )
    return shares_right(crowd, Stimulus(first_N), Stimulus(second_N), seed=seed, commands=commands)


def change_percent(before: Array, after: Array, *, seed: int = 0) -> Effect:
    """Compute the change of the mean of paired shares [%], each of shape (n,).

    The result has the estimate as ``value`` and its 95 % interval as ``low`` to ``high``.
    """
    return gain_of(before, after, np.random.default_rng(seed))
