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
RESAMPLES = 400
"""Draws of trials and people anew for an interval."""
Picked = NDArray[np.int64]


@dataclass(frozen=True)
class FeltPair:
    """Forces at the skin over trials, what people differ by taken out.

    Attributes
    ----------
    less, more
        Of the softer and the stiffer of the two [N], shape (n,) and (m,).
    together
        Whether an entry of one and the same entry of the other are of one trial.
    """

    less: Array
    more: Array
    together: bool = False

    @property
    def levels(self) -> tuple[Stimulus, Stimulus]:
        """Means and scatters over trials."""
        return _level(self.less), _level(self.more)

    def felt_by(self, people: SimulatedObservers) -> tuple[Array, Array]:
        """Sensitivity d' and chance of a right answer of each person, shape (n,) each.

        Where the stiffer one has the smaller force at the skin, people who go by force are wrong: d' is below zero.
        """
        first, second = self.levels
        d, right = sensitivity(people, first, second), chance_right(people, first, second)
        return (d, right) if second.level_N >= first.level_N else (-d, 1.0 - right)

    def drawn(self, rng: np.random.Generator, count: tuple[int, int]) -> tuple[Picked, Picked]:
        """Trials drawn anew from as many of each."""
        first = rng.integers(count[0], size=count[0])
        return first, first if self.together else rng.integers(count[1], size=count[1])

    def of(self, picked: tuple[Picked, Picked]) -> "FeltPair":
        """The pair over drawn trials."""
        return FeltPair(self.less[picked[0]], self.more[picked[1]], self.together)


def changes_of(people: SimulatedObservers, plain: FeltPair, other: FeltPair, rng: np.random.Generator) -> Array:
    """Change against plain scaling: value, low, high of d', of d' in percent, of right answers in points, shape (3, 3).

    Of means over people. Intervals of 95 % are by drawing people and trials again, the same trials under both methods.
    """

    def change(one: FeltPair, two: FeltPair, who: Picked) -> Array:
        (d, right), (new_d, new_right) = ([each[who].mean() for each in pair.felt_by(people)] for pair in (one, two))
        return np.array([new_d - d, 100.0 * (new_d / d - 1.0) if d else 0.0, 100.0 * (new_right - right)])

    count = min(len(plain.less), len(other.less)), min(len(plain.more), len(other.more))
    value = change(plain, other, np.arange(len(people)))
    drawn = []
    for _ in range(RESAMPLES):
        picked = plain.drawn(rng, count)
        drawn.append(change(plain.of(picked), other.of(picked), rng.integers(len(people), size=len(people))))
    return np.column_stack([value, *np.quantile(drawn, [0.025, 0.975], axis=0)])


def specimens(part: TrialTable) -> FeltPair | None:
    """Forces at the skin on the first two specimens of a task, the softer first; None where trials are too few.

    A person compares for themselves: what people differ by, in pace and in how forces are scaled for them, is taken out
    by least squares of the force on person and specimen.
    """
    chosen = np.isin(part.values("specimen"), (0.0, 1.0))
    levels, second = part.values("skin_N")[chosen], part.values("specimen")[chosen] == 1.0
    if min(second.sum(), (~second).sum()) < 2:
        return None
    return _separated(levels, second, part.people()[chosen])


def sides(needle: TrialTable) -> FeltPair | None:
    """Forces at the skin after and before the capsule's puncture, people taken out; None of too few trials."""
    after, before = needle.values("parenchyma_N"), needle.values("capsule_N")
    second = np.repeat([False, True], len(after))
    return _separated(np.concatenate([after, before]), second, np.tile(needle.people(), 2), together=True)


def right_percent(pair: FeltPair, seed: int) -> dict[str, float]:
    """Right answers of simulated people by group [%]."""
    rngs = {group: np.random.default_rng([seed, index]) for index, group in enumerate(GROUPS)}
    people = {group: draw_observers(group, PEOPLE, rng) for group, rng in rngs.items()}
    return {group: 100.0 * float(pair.felt_by(each)[1].mean()) for group, each in people.items()}


def _separated(levels: Array, second: NDArray[np.bool_], people: NDArray[np.str_], *, together: bool = False) -> (
    FeltPair | None
):  # fmt: skip
    """Levels without what people differ by; None where trials do not separate the two from people."""
    names = sorted(set(people))
    design = np.column_stack([*((people == name) for name in names), second]).astype(float)
    if len(levels) <= len(names) + 1 or np.linalg.matrix_rank(design) <= len(names):
        return None
    effects, *_ = np.linalg.lstsq(design, levels, rcond=None)
    shares = np.sqrt((len(levels) - 2) / (len(levels) - len(names) - 1))  # a fit's residuals are less than the scatter
    fitted = effects[:-1].mean() + effects[-1] * second + shares * (levels - design @ effects)
    return FeltPair(fitted[~second], fitted[second], together)


def _level(values: Array) -> Stimulus:
    """Mean and scatter over trials."""
    return Stimulus(float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0)
