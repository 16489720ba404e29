"""Discrimination of two forces at the skin: levels over trials, sensitivity d', right answers,
and their changes.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from math import inf, isfinite
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
    share_right,
)
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.section import (
    CASES,
    COLOURS,
    Section,
    against,
    drawing,
    grouped_bars,
    image,
    legend,
    methods_of,
    spread,
    tasks_of,
)
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.scene.registry import GROUPS

__all__ = [
    "PEOPLE",
    "Felt",
    "FeltPair",
    "case_sections",
    "case_table",
    "changes_of",
    "discrimination_section",
    "median_interval",
    "needle_section",
    "right_percent",
    "sides",
    "specimens",
    "travel_by_people",
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


TEETH = ("carious", "sound")
"""Specimens of the drilling task. Their errors differ by more than the errors of methods."""
TORQUE_STEP_NM = CASES["torque_step_Nm"].mean
PAPERS = {"penalty": CASES["overshoot_penalty_mm"], "koopman": CASES["overshoot_koopman_mm"]}
"""Published travel by method, a mean with its standard deviation."""


def case_sections(folder: StudyFolder, seed: int) -> list[Section]:
    """Return the case studies that the folder holds."""
    makers = {"needle": needle_section, "reaming": _reaming, "drilling": _drilling}
    tables = {task: case_table(folder, task) for task in makers}
    return [makers[task](table, seed) for task, table in tables.items() if table is not None]


def _reaming(table: TrialTable, seed: int) -> Section:
    """Report tracking error in newtons at the reamer, distance from its path, and torque steps."""
    rows = []
    papers = {
        "tracking_rms_N": CASES["reaming_rms_N"],
        "position_error_mm": CASES["reaming_position_mm"],
    }
    for method in methods_of(table):
        row = [method]
        for metric, paper in papers.items():
            part = table.where(method=method).values(metric)
            row += [
                spread(part, 3),
                f"< {paper}",
                "agrees" if part.max() < paper.mean else "exceeds it",
            ]
        rows.append((*row, str(len(table.where(method=method)))))
    level, scatter = (
        float(table.values(name).mean()) for name in ("torque_Nm", "torque_scatter_Nm")
    )
    torque = constants("perception", "torque")
    # of force at the device
    scale = float(np.median(table.values("force_rms_N") / table.values("tracking_rms_N")))
    people = draw_observers("expert", PEOPLE, np.random.default_rng(seed))
    kappa = torque["kappa"].value * people.kappa / np.median(people.kappa)
    holders = replace(people, kappa=kappa, offset_N=np.full(PEOPLE, torque["offset_Nm"].value))
    shares = []
    for where, factor in (
        ("at the tool", 1.0),
        (f"scaled into the device's range by {scale:.2g}", scale),
    ):
        pair = [
            Stimulus(factor * each, factor * scatter) for each in (level, level + TORQUE_STEP_NM)
        ]
        share = share_right(holders, *pair, seed=seed, limits=ForceRange(limit_N=1e3)).mean()
        shares.append(f"{100.0 * share:.0f} % {where}")
    sentences = (
        f"RMS of the force's tracking error over {rows[0][-1]} trials, in newtons at the "
        "reamer, of forces up to "
        f"{float(table.values('peak_force_N').max()) / scale:.1f} N; the paper prints less than "
        f"{papers['tracking_rms_N']} N. The force changes slowly, so that this "
        "depends little on latency. Bone guides the reamer: its distance from the path "
        "depends little on hands.",
        f"A step of {TORQUE_STEP_NM} N m on {level:.3f} ± {scatter:.3f} N m is discriminated "
        f"in {', '.join(shares)} of "
        "the answers, 75 % being the threshold; the paper states that it is felt.",
    )
    return Section(
        "case-reaming",
        "Case: reaming of a glenoid",
        sentences,
        (
            "method",
            "tracking RMS N",
            "paper N",
            "force against paper",
            "position error mm",
            "paper mm",
            "position against paper",
            "trials",
        ),
        tuple(rows),
    )


def _drilling(table: TrialTable, seed: int) -> Section:
    """Report discrimination of carious and sound teeth, and latency at 400,000 rpm."""
    paper = CASES["drilling_latency_ms"]
    lags = {method: table.where(method=method).values("latency_ms") for method in methods_of(table)}
    rows = []
    for method, tooth in product(lags, TEETH):
        part = table.where(method=method)
        chosen = part.values("specimen") == TEETH.index(tooth)
        if chosen.any():
            lag = part.values("latency_ms")[chosen]
            error = 100.0 * part.values("force_error")[chosen]
            rows.append(
                (method, tooth, spread(lag), f"< {paper}", spread(error), str(chosen.sum()))
            )
    pair = specimens(table.where(method=methods_of(table)[0]))
    text = "there are too few trials to discriminate carious from sound"
    if pair is not None:
        shares = right_percent(pair, seed).values()
        carious = pair.less.stimulus.level_N
        sound = pair.more.stimulus.level_N
        text = (
            f"carious ({carious:.3f} N at the skin) and sound ({sound:.3f} N) are discriminated in "
            f"{min(shares):.0f} to {max(shares):.0f} % of answers; the paper prints "
            f"{CASES['caries_right_percent']} %"
        )
    late = [method for method, lag in lags.items() if round(float(lag.mean()), 2) >= paper.mean]
    sentences = (
        f"At 400,000 rpm {text}. The latency is {'not ' if late else ''}below {paper} ms"
        + (f" under {', '.join(late)}" if late else " under every method")
        + ": spin adds none, as the force is the mean over a revolution.",
    )
    header = ("method", "tooth", "latency ms", "paper ms", "force error %", "trials")
    return Section("case-drilling", "Case: drilling of caries", sentences, header, tuple(rows))


def travel_by_people(needle: TrialTable, method: str) -> Array:
    """Return the median of each person's travel after the puncture [mm], shape (people,).

    It is infinite if the person did not notice the puncture.
    """
    part = needle.where(method=method)
    travel = np.where(part.values("noticed") > 0.0, part.values("excess_mm"), inf)
    people = part.people()
    with np.errstate(invalid="ignore"):  # between two that are infinite
        medians = [_middle(np.sort(travel[people == each])) for each in np.unique(people)]
    return np.array(medians)


def median_interval(values: Array) -> tuple[float, float, float]:
    """Return the median and its interval of at least 95 %, by ranks.

    Values may be infinite. The interval reaches from the k-th smallest value to the k-th largest. k
    is the largest number for which a binomial count of n at 0.5 lies below k with a probability of
    at most 2.5 %. For fewer than six values no such interval exists, and the result is infinite.
    """
    from scipy.stats import binom

    ordered = np.sort(values)
    rank = int(binom.ppf(0.025, len(ordered), 0.5))
    if len(ordered) < 6:
        return _middle(ordered), -inf, inf
    return _middle(ordered), float(ordered[rank - 1]), float(ordered[len(ordered) - rank])


def needle_section(table: TrialTable, seed: int) -> Section:
    """Report travel by group and method, who notices the puncture, and capsule or parenchyma."""
    rows = []
    for method, group in product(
        methods_of(table), (each for each in GROUPS if each in table.group)
    ):
        part = table.where(method=method, group=group)
        noticed = part.values("noticed") > 0.0
        felt = part.values("excess_mm")[noticed]
        middle = _travel_text(_middle(np.sort(np.where(noticed, part.values("excess_mm"), inf))))
        means = (spread(felt), *against(felt, PAPERS.get(method))) if len(felt) else ("", "", "")
        rows.append((group, method, f"{noticed.sum()} of {len(noticed)}", middle, *means))
    pair = sides(table.where(method=methods_of(table)[0]))
    sentences = ["There are too few trials to discriminate capsule from parenchyma."]
    if pair is not None:
        wrong = {group: 100.0 - share for group, share in right_percent(pair, seed).items()}
        text = ", ".join(f"{group} {value:.1f} %" for group, value in wrong.items())
        sentences = [
            f"Capsule ({pair.more.stimulus.level_N:.2f} N at the skin in the tenth of a "
            "second before its puncture) "
            f"and parenchyma ({pair.less.stimulus.level_N:.2f} N after) are confused by "
            f"{text}; the paper prints less "
            "than 10 %: "
            + ("so it is here." if max(wrong.values()) < 10.0 else "here it is more."),
        ]
    shared = table.shared()
    headline = (
        "There is no trial in which the capsule broke before the hand stopped under every method."
    )
    picture = b""
    if len(shared):
        text, picture = _travels(shared)
        count = len(shared.where(method=methods_of(shared)[0]))
        headline = (
            f"Of {count} trials in which the capsule broke before the hand stopped under every "
            f"method, {text}."
        )
    sentences.append(headline)
    sentences.append(
        "A puncture that nobody notices counts as the longest travel, so that the median is "
        "of all; the mean is of "
        "those who noticed. The hand pushes with a rising force and stops a reaction after "
        "it has felt the force fall. "
        "What the springs of grip and coupling give back at the puncture is part of this "
        "travel, whatever the reaction."
    )
    header = (
        "group",
        "method",
        "noticed",
        "median",
        "mean of noticed mm",
        "paper mm",
        "against paper",
    )
    return Section(
        "case-needle", "Case: needle", tuple(sentences), header, tuple(rows), picture, headline
    )


def _travel_text(travel_mm: float) -> str:
    """Return a travel as text."""
    return f"{travel_mm:.2f} mm" if isfinite(travel_mm) else "not noticed"


def _travels(shared: TrialTable) -> tuple[str, bytes]:
    """Return median travel over people and share of noticed punctures by method.

    The result is given as text and as a picture.
    """
    found = []
    methods = methods_of(shared)
    figure, (axes,) = drawing(9.0, 0.4 * len(methods) + 1.4)
    for line, method in enumerate(methods):
        middle, low, high = median_interval(travel_by_people(shared, method))
        noticed = 100.0 * float(shared.where(method=method).values("noticed").mean())
        bounds = f" [{_travel_text(low)}, {_travel_text(high)}]" if low > -inf else ""
        found.append(
            f"{method} lets {noticed:.0f} % notice, travel {_travel_text(middle)}{bounds} in "
            "the median "
            "over people"
        )
        finite = [each for each in (low, high) if isfinite(each)]
        axes.plot(finite, [line] * len(finite), color=COLOURS[method], lw=3)
        if isfinite(middle):
            axes.plot(middle, line, "o", color=COLOURS[method], mec="black")
        if paper := PAPERS.get(method):
            axes.errorbar(paper.mean, line + 0.25, xerr=paper.spread, fmt="x", color="black")
    axes.set_yticks(range(len(methods)), methods)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.set_xlabel(
        "travel after the puncture / mm, median over people with its 95 % interval (× paper ± sd)"
    )
    return "; ".join(found), image(figure)


def _middle(ordered: Array) -> float:
    """Return the median of sorted values, some of which may be infinite."""
    low = ordered[(len(ordered) - 1) // 2]
    high = ordered[len(ordered) // 2]
    return float(low if low == high else 0.5 * (low + high))
