"""Two forces at the skin that people discriminate: their levels over trials, sensitivity d', right answers, changes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from tissue.evaluation.calibration.force_discrimination import Stimulus, chance_right, sensitivity
from tissue.evaluation.calibration.simulated_observer import SimulatedObservers, draw_observers
from tissue.evaluation.statistics.trials import TrialTable
from tissue.scene.registry import GROUPS

__all__ = ["PEOPLE", "FeltPair", "changes_of", "right_percent", "sides", "specimens"]

PEOPLE = 200
"""Simulated people of each group who compare; none of them is one whom a method was tuned to."""
Picked = NDArray[np.int64]


@dataclass(frozen=True)
class Felt:
    """A force at the skin over the trials of people.

    Attributes
    ----------
    means_N
        Of each person's trials [N], shape (people,).
    squares_N2
        Sums of squared differences of a person's trials from their mean [N2], shape (people,).
    free
        Trials of each person but one, shape (people,).
    """

    means_N: Array
    squares_N2: Array
    free: Array

    @classmethod
    def over(cls, forces_N: Array, person: Picked, count: int) -> "Felt":
        """Of trials, each of a person by number below ``count`` who all have one, shape (n,)."""
        trials: Array = np.bincount(person, minlength=count).astype(np.float64)
        means = np.bincount(person, forces_N, count).astype(np.float64) / trials
        squares = np.bincount(person, (forces_N - means[person]) ** 2, count)
        return cls(np.asarray(means), np.asarray(squares, dtype=np.float64), trials - 1.0)

    def of(self, who: Picked) -> "Felt":
        """Of some people, who may come several times."""
        return Felt(self.means_N[who], self.squares_N2[who], self.free[who])

    @property
    def stimulus(self) -> Stimulus:
        """Mean over people, and scatter over one person's trials."""
        return Stimulus(float(self.means_N.mean()), float(np.sqrt(self.squares_N2.sum() / max(self.free.sum(), 1.0))))


@dataclass(frozen=True)
class FeltPair:
    """Two forces at the skin that each person compares for themselves: people's own levels are no scatter.

    Attributes
    ----------
    less, more
        The softer and the stiffer of the two, of the same people.
    """

    less: Felt
    more: Felt

    def of(self, who: Picked) -> "FeltPair":
        """The pair of some people, who may come several times."""
        return FeltPair(self.less.of(who), self.more.of(who))

    def felt_by(self, people: SimulatedObservers) -> tuple[Array, Array]:
        """Sensitivity d' and chance of a right answer of each observer, shape (n,) each.

        Where the stiffer one has the smaller force at the skin, people who go by force are wrong: d' is below zero.
        """
        first, second = self.less.stimulus, self.more.stimulus
        d, right = sensitivity(people, first, second), chance_right(people, first, second)
        return (d, right) if second.level_N >= first.level_N else (-d, 1.0 - right)


def changes_of(observers: SimulatedObservers, plain: FeltPair, other: FeltPair) -> Array:
    """Change against plain scaling: value, low, high of d', of d' in percent, of right answers in points, shape (3, 3).

    Of means over observers. Intervals of 95 % are by Student's t of what the change becomes with each of the people of
    the trials left out in turn, the same under both methods (jackknife, Efron 1982).
    """
    from scipy.stats import t

    def change(one: FeltPair, two: FeltPair) -> Array:
        (d, right), (new_d, new_right) = ([each.mean() for each in pair.felt_by(observers)] for pair in (one, two))
        return np.array([new_d - d, 100.0 * (new_d / d - 1.0) if d else 0.0, 100.0 * (new_right - right)])

    who = np.arange(len(plain.less.means_N))
    value, count = change(plain, other), len(who)
    without = np.array([change(plain.of(kept), other.of(kept)) for kept in (np.delete(who, each) for each in who)])
    error = np.sqrt((count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    reach = float(t.ppf(0.975, max(count - 1, 1))) * error
    return np.column_stack([value, value - reach, value + reach])


def specimens(part: TrialTable) -> FeltPair | None:
    """Forces at the skin on the first two specimens of a task, the softer first, of people who met both.

    None where nobody met both, or nobody met one of them twice.
    """
    chosen = np.isin(part.values("specimen"), (0.0, 1.0))
    forces, people = part.values("skin_N")[chosen], part.people()[chosen]
    second: NDArray[np.bool_] = part.values("specimen")[chosen] == 1.0
    known = np.isin(people, np.intersect1d(people[second], people[~second]))
    first, second = known & ~second, known & second
    return _pair((forces[first], people[first]), (forces[second], people[second]))


def sides(needle: TrialTable) -> FeltPair | None:
    """Forces at the skin after and before the capsule's puncture; None where nobody has two trials."""
    people = needle.people()
    return _pair((needle.values("parenchyma_N"), people), (needle.values("capsule_N"), people))


def right_percent(pair: FeltPair, seed: int) -> dict[str, float]:
    """Right answers of simulated people by group [%]."""
    rngs = {group: np.random.default_rng([seed, index]) for index, group in enumerate(GROUPS)}
    people = {group: draw_observers(group, PEOPLE, rng) for group, rng in rngs.items()}
    return {group: 100.0 * float(pair.felt_by(each)[1].mean()) for group, each in people.items()}


def _pair(less: tuple[Array, NDArray[np.str_]], more: tuple[Array, NDArray[np.str_]]) -> FeltPair | None:
    """Two forces by trial with the people of their trials, the same people in both; None without any scatter."""
    names = np.unique(less[1])
    first, second = (Felt.over(forces, np.searchsorted(names, people), len(names)) for forces, people in (less, more))
    return FeltPair(first, second) if first.free.sum() > 0.0 and second.free.sum() > 0.0 else None
