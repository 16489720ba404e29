"""Report section: how well simulated people can discriminate two forces in a study.

From the forces at the skin in all trials, the sensitivity d' and the fraction of right answers are
computed. Methods are compared with a method that scales forces by a constant (plain scaling).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from textwrap import wrap

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Flags, Ints
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
from tissue.evaluation.study.plan import PERSONAL
from tissue.evaluation.study.section import (
    Section,
    drawing,
    grouped_points,
    image,
    legend,
    methods_of,
    tasks_of,
)
from tissue.scene.registry import GROUPS

PEOPLE = 200
"""Number of simulated people per group who compare forces.

No method was tuned to these people.
"""
PLAIN = "koopman"
"""Method that scales forces by a constant (plain scaling). Other methods are compared with it."""
WIDEST = 12
"""Largest number of letters in a line of an axis label."""
LEAST_D = 0.5
"""Smallest sensitivity d' under plain scaling for which a relative change is reported.

For a smaller d', the relative change would be a division by almost zero. At d' = 0.5, only 64 % of
the answers are right.
"""
CHANGES = (("change of d′", 2), ("in %", 1), ("change of right, points", 1))
"""Names and decimal digits of the table columns with changes relative to plain scaling."""


@dataclass(frozen=True)
class Felt:
    """Mean and scatter of the force at the skin over the trials of each person.

    Attributes
    ----------
    means_N
        Mean force over the trials of each person [N], shape (people,).
    squares_N2
        Sum of squared deviations [N2] of each person's trial forces from the person's mean force,
        shape (people,).
    free
        Degrees of freedom: number of trials of each person minus one, shape (people,).
    """

    means_N: Array
    squares_N2: Array
    free: Array

    @classmethod
    def over(cls, forces_N: Array, person: Ints, count: int) -> "Felt":
        """Compute the statistics of each person from the forces [N], shape (n,), of n trials.

        `person`, shape (n,), contains the index of the person in each trial. ``count`` is the
        number of people.

        Every person has at least one trial.
        """
        trials: Array = np.bincount(person, minlength=count).astype(np.float64)
        means = np.bincount(person, forces_N, count).astype(np.float64) / trials
        squares = np.bincount(person, (forces_N - means[person]) ** 2, count)
        return cls(means, np.asarray(squares, dtype=np.float64), trials - 1.0)

    def of(self, who: Ints) -> "Felt":
        """Return the statistics of the people with the indices `who`, which may repeat."""
        return Felt(self.means_N[who], self.squares_N2[who], self.free[who])

    @property
    def stimulus(self) -> Stimulus:
        """Stimulus with the mean force over all people, and the pooled scatter within people."""
        return Stimulus(
            self.means_N.mean(),
            np.sqrt(self.squares_N2.sum() / max(self.free.sum(), 1.0)),
        )


@dataclass(frozen=True)
class FeltPair:
    """Two forces that each person feels at the skin and compares.

    The scatter of a force is within each person; differences between people's mean forces do not
    count.

    Attributes
    ----------
    less, more
        Smaller and larger force, such as the forces on a softer and on a stiffer specimen. Both
        contain the same people.
    """

    less: Felt
    more: Felt

    def of(self, who: Ints) -> "FeltPair":
        """Return the forces of the people with the indices `who`, which may repeat."""
        return FeltPair(self.less.of(who), self.more.of(who))

    def felt_by(self, people: SimulatedObservers) -> tuple[Array, Array]:
        """Return each observer's sensitivity d' and probability of a right answer, shape (n,).

        If the stiffer specimen gives the smaller force at the skin, people who judge by force
        answer wrongly, and d' is negative.
        """
        first = self.less.stimulus
        second = self.more.stimulus
        d = sensitivity(people, first, second)
        right = chance_right(people, first, second)
        return (d, right) if second.level_N >= first.level_N else (-d, 1.0 - right)


def changes_of(observers: SimulatedObservers, plain: FeltPair, other: FeltPair) -> Array:
    """Return changes of d' and right answers relative to plain scaling, shape (3, 3).

    The rows are the change of d', the change of d' in percent, and the change of right answers in
    percentage points. All are computed from means over the observers. The columns are the change,
    and the lower and upper end of its 95 % interval. The interval is computed by leaving out each
    person once (jackknife, Efron 1982).
    """
    from scipy.stats import t

    def change(one: FeltPair, two: FeltPair) -> Array:
        """Return the changes of d', of d' in percent and of right answers, shape (3,)."""
        d, right = (each.mean() for each in one.felt_by(observers))
        new_d, new_right = (each.mean() for each in two.felt_by(observers))
        # a d' of 0 has no ratio; below `LEAST_D` the caller gives none either
        percent = 100.0 * (new_d / d - 1.0) if d else 0.0
        return np.array([new_d - d, percent, 100.0 * (new_right - right)])

    who = np.arange(len(plain.less.means_N))
    value = change(plain, other)
    count = len(who)
    without = np.array(
        [change(plain.of(kept), other.of(kept)) for kept in (np.delete(who, each) for each in who)]
    )
    error = np.sqrt((count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    # two-sided 95 % interval; a single person has no interval
    reach = t.ppf(0.975, max(count - 1, 1)) * error
    return np.column_stack([value, value - reach, value + reach])


def specimens(part: TrialTable) -> FeltPair | None:
    """Return the forces at the skin on the first two specimens of a task.

    Only people with trials on both specimens are used. The smaller force belongs to the softer
    specimen. The result is None if no person has trials on both specimens, or nobody has two trials
    on the same specimen.
    """
    chosen = np.isin(part.values("specimen"), (0.0, 1.0))
    forces = part.values("skin_N")[chosen]
    people = part.people()[chosen]
    second: Flags = part.values("specimen")[chosen] == 1.0
    known = np.isin(people, np.intersect1d(people[second], people[~second]))
    first = known & ~second
    second = known & second
    return _pair((forces[first], people[first]), (forces[second], people[second]))


def sides(needle: TrialTable) -> FeltPair | None:
    """Return the two forces at the skin: after and before a needle punctures the organ's capsule.

    The result is None if no person has two trials.
    """
    people = needle.people()
    return _pair((needle.values("parenchyma_N"), people), (needle.values("capsule_N"), people))


def _pair(
    less: tuple[Array, NDArray[np.str_]], more: tuple[Array, NDArray[np.str_]]
) -> FeltPair | None:
    """Return the statistics of a smaller and a larger force that the same people feel.

    Each argument contains the forces [N] in all trials, and the label of the person in each trial.

    The result is None if the scatter of one of the forces is unknown, because nobody has two
    trials.
    """
    names = np.unique(less[1])
    first, second = (
        Felt.over(forces, np.searchsorted(names, people), len(names))
        for forces, people in (less, more)
    )
    return FeltPair(first, second) if first.free.sum() > 0.0 and second.free.sum() > 0.0 else None


def discrimination_section(folder: StudyFolder, table: TrialTable | None, seed: int) -> Section:
    """Report how well people discriminate each pair of forces, by group and method.

    The section contains d', right answers, and their changes relative to plain scaling. `table`
    holds the trials of all tasks except case studies; it is None without such trials.
    """
    taken: list[tuple[str, Callable[[TrialTable], FeltPair | None], TrialTable | None]] = [
        ("capsule or parenchyma", sides, case_table(folder, "needle")),
        ("carious or sound", specimens, case_table(folder, "drilling")),
    ]
    if table is not None:
        parts = {task: table.where(task=task) for task in tasks_of(table)}
        compared = [(f"{task}: softer or usual", specimens, part) for task, part in parts.items()]
        taken = [*compared, *taken]
    rows = []
    changes: dict[tuple[str, str, str], Array] = {}
    for what, pair_of, part in taken:
        if part is None:
            continue
        shared = part.shared()
        pairs = {method: pair_of(shared.where(method=method)) for method in methods_of(shared)}
        found = {method: pair for method, pair in pairs.items() if pair is not None}
        for group, method in product(GROUPS, found):
            people = people_of(group, seed)
            d, right = (each.mean() for each in found[method].felt_by(people))
            levels = [found[method].less.stimulus, found[method].more.stimulus]
            softer, stiffer = (f"{each.level_N:.3f} (SD {each.scatter_N:.3f})" for each in levels)
            row = {
                "what": what,
                "group": group,
                "method": method,
                "softer N": softer,
                "stiffer N": stiffer,
                "d′": f"{d:.2f}",
                "right %": f"{100.0 * right:.1f}",
            }
            if method != PLAIN and PLAIN in found:
                change = changes_of(people, found[PLAIN], found[method])
                if found[PLAIN].felt_by(people)[0].mean() < LEAST_D:
                    # row 1 is the change in percent
                    change[1] = np.nan
                changes[what, group, method] = change
                row |= {
                    name: f"{value:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"
                    if np.isfinite(value)
                    else ""
                    for (name, digits), (value, low, high) in zip(CHANGES, change, strict=True)
                }
            rows.append(row)
    if not rows:
        reason = "People have too few trials on two specimens each. Use --trials 60 or more."
        return Section("discrimination", "Discrimination", (reason,))
    sentences, headline = _sentences(changes)
    picture = _right_answers(rows)
    return Section("discrimination", "Discrimination", sentences, rows, picture, headline)


def people_of(group: str, seed: int) -> SimulatedObservers:
    """Return random simulated people of an expertise group, who compare forces."""
    return draw_observers(group, PEOPLE, np.random.default_rng([seed, GROUPS.index(group)]))


def case_table(folder: StudyFolder, task: str) -> TrialTable | None:
    """Return those trials of a case study that did not fail; None if there are no such trials."""
    try:
        table = folder.table(task).complete()
    except InputError:
        return None
    return table if len(table) else None


def _sentences(changes: Mapping[tuple[str, str, str], Array]) -> tuple[list[str], str]:
    """Describe the changes relative to plain scaling: sentences, and one main sentence.

    The keys of `changes` are the names of the pair of forces, the group and the method.
    """
    headline = ""
    sentences = [
        f"Right answers of {PEOPLE} simulated people of each group in two-interval trials (chance: "
        "50 %). The forces are those that reach the hand in the runs of each method, after "
        "latency, "
        "low-pass filter, range, amplifier and friction of the device. They scatter as over a "
        "person's trials, and the person's own noise is added."
    ]
    for method in dict.fromkeys(method for _, _, method in changes):
        part = np.array([each for (*_, name), each in changes.items() if name == method])
        d, percent, right = part.transpose(1, 2, 0)
        shares = ""
        if np.isfinite(percent).any():
            shares = f" ({np.nanmin(percent[0]):+.0f} to {np.nanmax(percent[0]):+.0f} %)"
        move = f"by {d[0].min():+.2f} to {d[0].max():+.2f}{shares}"
        # the main finding is the change by scaling for a person
        if method in PERSONAL:
            headline = f"{method} changes the sensitivity d′ at the skin {move} against {PLAIN}."
        sentences.append(
            f"{method} changes d′ {move} against {PLAIN} and right answers by "
            f"{right[0].min():+.1f} to {right[0].max():+.1f} percentage points. Of {len(part)} "
            "pairs "
            f"and groups, the interval of the change shows a larger d′ in {(d[1] > 0.0).sum()} "
            "and a "
            f"smaller d′ in {(d[2] < 0.0).sum()}."
        )
    weak = dict.fromkeys(key[0] for key, each in changes.items() if not np.isfinite(each[1, 0]))
    if weak:
        sentences.append(
            f"No change in percent is given for {', '.join(weak)}: under {PLAIN} d′ is below "
            f"{LEAST_D} there, so that hardly anybody discriminates the two by force."
        )
    return sentences, headline


def _right_answers(rows: Sequence[Mapping[str, str]]) -> bytes:
    """Draw the fraction of right answers, as means and ranges over the expertise groups."""
    names = list(dict.fromkeys(row["what"] for row in rows))
    shown: dict[tuple[int, str], list[float]] = {}
    for row in rows:
        place = names.index(row["what"]), row["method"]
        shown.setdefault(place, []).append(float(row["right %"]))
    points = {place: (float(np.mean(each)), min(each), max(each)) for place, each in shown.items()}
    figure, (axes,) = drawing(11.0, 4.4)
    grouped_points(axes, ["\n".join(wrap(name, WIDEST)) for name in names], points)
    axes.axhline(50.0, color="black", ls=":")
    # 50 % is chance, and a method may lie below it by the sampling of trials
    axes.set_ylim(40.0, 100.0)
    axes.set_ylabel("right answers / %; dotted: by guessing")
    legend(figure, axes)
    return image(figure)
