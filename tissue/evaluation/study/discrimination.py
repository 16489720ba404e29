"""Discrimination of two forces at the skin: levels over trials, sensitivity d', right answers,
and their changes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from textwrap import wrap

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.calibration.observers import (
    SimulatedObservers,
    Stimulus,
    chance_right,
    draw_observers,
    sensitivity,
)
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.section import (
    Section,
    drawing,
    grouped_bars,
    image,
    legend,
    methods_of,
    tasks_of,
)
from tissue.scene.registry import GROUPS

__all__ = [
    "PEOPLE",
    "Felt",
    "FeltPair",
    "case_table",
    "changes_of",
    "discrimination_section",
    "right_percent",
    "sides",
    "specimens",
]

PEOPLE = 200
"""Simulated people per group who compare forces. No method was tuned to them."""
PLAIN = "koopman"
"""Method of plain scaling, the baseline of the other methods."""
WIDEST = 12
"""Letters of a line below a group of bars."""
LEAST_D = 0.5
"""Sensitivity under plain scaling below which no relative change is given.

A change in percent would be a division by almost zero.
"""
Picked = NDArray[np.int64]


@dataclass(frozen=True)
class Felt:
    """Force at the skin over the trials of people.

    Attributes
    ----------
    means_N
        Mean of each person's trials [N], shape (people,).
    squares_N2
        Sums of squared differences of a person's trials from their mean [N2], shape (people,).
    free
        Number of trials of each person minus one, shape (people,).
    """

    means_N: Array
    squares_N2: Array
    free: Array

    @classmethod
    def over(cls, forces_N: Array, person: Picked, count: int) -> "Felt":
        """Return the summary of trials, each by a person number below ``count``, shape (n,).

        Every person has at least one trial.
        """
        trials: Array = np.bincount(person, minlength=count).astype(np.float64)
        means = np.bincount(person, forces_N, count).astype(np.float64) / trials
        squares = np.bincount(person, (forces_N - means[person]) ** 2, count)
        return cls(np.asarray(means), np.asarray(squares, dtype=np.float64), trials - 1.0)

    def of(self, who: Picked) -> "Felt":
        """Return the forces of some people. A person may occur several times."""
        return Felt(self.means_N[who], self.squares_N2[who], self.free[who])

    @property
    def stimulus(self) -> Stimulus:
        """Mean over people, and scatter over one person's trials."""
        return Stimulus(
            float(self.means_N.mean()),
            float(np.sqrt(self.squares_N2.sum() / max(self.free.sum(), 1.0))),
        )


@dataclass(frozen=True)
class FeltPair:
    """Two forces at the skin that each person compares.

    Differences between people's levels are not scatter.

    Attributes
    ----------
    less, more
        Forces on the softer and the stiffer specimen, of the same people.
    """

    less: Felt
    more: Felt

    def of(self, who: Picked) -> "FeltPair":
        """Return the pair of some people. A person may occur several times."""
        return FeltPair(self.less.of(who), self.more.of(who))

    def felt_by(self, people: SimulatedObservers) -> tuple[Array, Array]:
        """Return the sensitivity d' and chance of a right answer of each observer, shape (n,) each.

        If the stiffer specimen has the smaller force at the skin, people who judge by force are
        wrong, and d' is below zero.
        """
        first = self.less.stimulus
        second = self.more.stimulus
        d = sensitivity(people, first, second)
        right = chance_right(people, first, second)
        return (d, right) if second.level_N >= first.level_N else (-d, 1.0 - right)


def changes_of(observers: SimulatedObservers, plain: FeltPair, other: FeltPair) -> Array:
    """Return changes against plain scaling as value, low and high, shape (3, 3).

    The rows are d', d' in percent, and right answers in percentage points, each of means over
    observers. The 95 % intervals use Student's t of the changes with each person of the trials left
    out in turn, the same person under both methods (jackknife, Efron 1982).
    """
    from scipy.stats import t

    def change(one: FeltPair, two: FeltPair) -> Array:
        (d, right), (new_d, new_right) = (
            [each.mean() for each in pair.felt_by(observers)] for pair in (one, two)
        )
        return np.array(
            [new_d - d, 100.0 * (new_d / d - 1.0) if d else 0.0, 100.0 * (new_right - right)]
        )

    who = np.arange(len(plain.less.means_N))
    value = change(plain, other)
    count = len(who)
    without = np.array(
        [change(plain.of(kept), other.of(kept)) for kept in (np.delete(who, each) for each in who)]
    )
    error = np.sqrt((count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    reach = float(t.ppf(0.975, max(count - 1, 1))) * error
    return np.column_stack([value, value - reach, value + reach])


def specimens(part: TrialTable) -> FeltPair | None:
    """Return the forces at the skin on the first two specimens of a task, the softer first.

    Only people with trials on both are included. The result is None if there is no such person, or
    nobody has two trials on one of them.
    """
    chosen = np.isin(part.values("specimen"), (0.0, 1.0))
    forces = part.values("skin_N")[chosen]
    people = part.people()[chosen]
    second: NDArray[np.bool_] = part.values("specimen")[chosen] == 1.0
    known = np.isin(people, np.intersect1d(people[second], people[~second]))
    first = known & ~second
    second = known & second
    return _pair((forces[first], people[first]), (forces[second], people[second]))


def sides(needle: TrialTable) -> FeltPair | None:
    """Return the forces at the skin after and before the capsule's puncture.

    The result is None if nobody has two trials.
    """
    people = needle.people()
    return _pair((needle.values("parenchyma_N"), people), (needle.values("capsule_N"), people))


def right_percent(pair: FeltPair, seed: int) -> dict[str, float]:
    """Return the right answers of simulated people by group [%]."""
    rngs = {group: np.random.default_rng([seed, index]) for index, group in enumerate(GROUPS)}
    people = {group: draw_observers(group, PEOPLE, rng) for group, rng in rngs.items()}
    return {group: 100.0 * float(pair.felt_by(each)[1].mean()) for group, each in people.items()}


def _pair(
    less: tuple[Array, NDArray[np.str_]], more: tuple[Array, NDArray[np.str_]]
) -> FeltPair | None:
    """Return two forces by trial with the people of their trials, the same people in both.

    The result is None without any scatter.
    """
    names = np.unique(less[1])
    first, second = (
        Felt.over(forces, np.searchsorted(names, people), len(names))
        for forces, people in (less, more)
    )
    return FeltPair(first, second) if first.free.sum() > 0.0 and second.free.sum() > 0.0 else None


def discrimination_section(folder: StudyFolder, table: TrialTable, seed: int) -> Section:
    """Report sensitivity d' and right answers for every pair, group and method.

    Their change against plain scaling is included.
    """
    taken: list[tuple[str, Callable[[TrialTable], FeltPair | None], TrialTable]] = [
        (f"{task}: softer or usual", specimens, table.where(task=task)) for task in tasks_of(table)
    ]
    if (needle := case_table(folder, "needle")) is not None:
        taken.append(("capsule or parenchyma", sides, needle))
    if (drilling := case_table(folder, "drilling")) is not None:
        taken.append(("carious or sound", specimens, drilling))
    rows: list[tuple[str, ...]] = []
    shown: dict[tuple[str, str, str], float] = {}
    changes: dict[tuple[str, str, str], Array] = {}
    for what, pair_of, part in taken:
        part = part.shared()
        pairs = {method: pair_of(part.where(method=method)) for method in methods_of(part)}
        found = {method: pair for method, pair in pairs.items() if pair is not None}
        for group in GROUPS if found else ():
            people = draw_observers(
                group, PEOPLE, np.random.default_rng([seed, GROUPS.index(group)])
            )
            plain = found[PLAIN].felt_by(people)[0].mean() if PLAIN in found else 0.0
            for method, pair in found.items():
                d, right = (float(each.mean()) for each in pair.felt_by(people))
                shown[what, group, method] = 100.0 * right
                stimuli = (pair.less.stimulus, pair.more.stimulus)
                levels = [f"{each.level_N:.3f} ± {each.scatter_N:.3f}" for each in stimuli]
                row = [what, group, method, *levels, f"{d:.2f}", f"{100.0 * right:.1f}"]
                if method != PLAIN and PLAIN in found:
                    change = changes_of(people, found[PLAIN], pair)
                    if plain < LEAST_D:
                        change[1] = np.nan
                    changes[what, group, method] = change
                    row += [
                        f"{value:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"
                        if np.isfinite(value)
                        else ""
                        for digits, (value, low, high) in zip((2, 1, 1), change, strict=True)
                    ]
                rows.append((*row, *[""] * (10 - len(row))))
    if not rows:
        return Section(
            "discrimination",
            "Discrimination",
            ("People have too few trials on two specimens each.",),
        )
    header = (
        "what",
        "group",
        "method",
        "softer N",
        "stiffer N",
        "d′",
        "right %",
        "change of d′",
        "in %",
        "change of right, points",
    )
    sentences, headline = _sentences(changes)
    picture = _right_answers(shown)
    return Section(
        "discrimination", "Discrimination", sentences, header, tuple(rows), picture, headline
    )


def case_table(folder: StudyFolder, task: str) -> TrialTable | None:
    """Return the trials of a case study that did not fail, or None."""
    try:
        table = folder.table(task).complete()
    except InputError:
        return None
    return table if len(table) else None


def _sentences(changes: dict[tuple[str, str, str], Array]) -> tuple[tuple[str, ...], str]:
    """Return the findings and the main finding from the changes by pair, group and method."""
    short = []
    sentences = [
        f"Right answers of {PEOPLE} simulated people of each group in two intervals, 50 % "
        "being chance. Forces are "
        "those that reach the hand in the runs of each method: after latency, low-pass, "
        "range, amplifier and friction "
        "of the device. Their scatter is that over a person's trials, and the person's own "
        "noise comes after it."
    ]
    for method in dict.fromkeys(key[2] for key in changes):
        part = {key: each for key, each in changes.items() if key[2] == method}
        d, percent, right = (np.array([each[row] for each in part.values()]) for row in range(3))
        more = int((d[:, 1] > 0.0).sum())
        fewer = int((d[:, 2] < 0.0).sum())
        known = percent[np.isfinite(percent[:, 0]), 0]
        shares = f" ({known.min():+.0f} to {known.max():+.0f} %)" if len(known) else ""
        short.append(f"under {method} by {d[:, 0].min():+.2f} to {d[:, 0].max():+.2f}{shares}")
        sentences.append(
            f"{method} changes d′ by {d[:, 0].min():+.2f} to {d[:, 0].max():+.2f}{shares} "
            f"against {PLAIN} and right "
            f"answers by {right[:, 0].min():+.1f} to {right[:, 0].max():+.1f} points; by its "
            "interval d′ is greater in "
            f"{more} and smaller in {fewer} of {len(part)} pairs and groups; the paper "
            "prints +18 to +22 %."
        )
    if weak := list(
        dict.fromkeys(key[0] for key, each in changes.items() if not np.isfinite(each[1, 0]))
    ):
        sentences.append(
            f"No change in percent is given for {', '.join(weak)}: under {PLAIN} d′ is below "
            f"{LEAST_D} there, so that "
            "hardly anybody discriminates the two by force."
        )
    sentences.append(
        "A map that rises with the force adds no information to the scatter of tissue, hand "
        "and device, which goes "
        "through it. It changes how far a difference lies above the person's own noise."
    )
    headline = (
        f"Sensitivity d′ at the skin changes against {PLAIN} {', '.join(short)}." if short else ""
    )
    return tuple(sentences), headline


def _right_answers(shown: dict[tuple[str, str, str], float]) -> bytes:
    """Draw right answers by pair, group and method: means over groups, and lines that span the
    groups.
    """
    names = list(dict.fromkeys(key[0] for key in shown))
    methods = list(dict.fromkeys(key[2] for key in shown))

    def over_groups(index: int, method: str) -> tuple[float, float, float] | None:
        values = [
            shown[names[index], group, method]
            for group in GROUPS
            if (names[index], group, method) in shown
        ]
        return (float(np.mean(values)), min(values), max(values)) if values else None

    figure, (axes,) = drawing(11.0, 4.4)
    grouped_bars(axes, ["\n".join(wrap(name, WIDEST)) for name in names], methods, over_groups)
    axes.axhline(50.0, color="black", lw=0.8, ls=":")
    axes.set_ylim(40.0, 100.0)
    axes.set_ylabel("right answers / %; dotted: by guessing")
    legend(figure, axes)
    return image(figure)
