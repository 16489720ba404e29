"""Section of a report: who discriminates what from the force at the skin, under each method."""

from collections.abc import Callable
from itertools import product
from textwrap import wrap

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.calibration.force_discrimination import Stimulus, chance_right, sensitivity
from tissue.evaluation.calibration.simulated_observer import SimulatedObservers, draw_observers
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.section import COLOURS, Section, drawing, image, legend, methods_of, tasks_of
from tissue.scene.registry import GROUPS

__all__ = ["PEOPLE", "PLAIN", "case_table", "discrimination_section", "right_percent", "sides", "specimens"]

PEOPLE = 200
"""Simulated people of each group who compare; none of them is one whom a method was tuned to."""
PLAIN = "koopman"
"""Method of plain scaling, which the others are held against."""
RESAMPLES = 400
"""Draws of trials and people anew for an interval."""
WIDEST = 12
"""Letters of a line below a group of bars."""
Picked = NDArray[np.int64]
Levels = tuple[Array, Array]
"""Forces at the skin of the first and the second of a pair over trials [N], shape (n,) and (m,)."""


def discrimination_section(folder: StudyFolder, table: TrialTable, seed: int) -> Section:
    """Sensitivity d' and right answers for every pair, group and method, and their change against plain scaling."""
    taken: list[tuple[str, Callable[[TrialTable], Levels | None], TrialTable]] = [
        (f"{task}: softer or usual", specimens, table.where(task=task)) for task in tasks_of(table)
    ]
    if (needle := case_table(folder, "needle")) is not None:
        taken.append(("capsule or parenchyma", sides, needle))
    if (drilling := case_table(folder, "drilling")) is not None:
        taken.append(("carious or sound", specimens, drilling))
    rows, shown, changes = [], {}, {}
    for what, levels, part in taken:
        part = part.shared()
        methods = methods_of(part)
        pairs = {method: levels(part.where(method=method)) for method in methods}
        found = {method: pair for method, pair in pairs.items() if pair is not None}
        for group in GROUPS if found else ():
            rng = np.random.default_rng([seed, GROUPS.index(group)])
            people = draw_observers(group, PEOPLE, rng)
            for method, pair in found.items():
                less, more = sorted(map(_level, pair), key=lambda each: each.level_N)
                d, right = sensitivity(people, less, more).mean(), 100.0 * chance_right(people, less, more)
                shown[what, group, method] = right.mean(), 1.96 * right.std(ddof=1) / PEOPLE**0.5
                row = [what, group, method, *(f"{each.level_N:.3f} ± {each.scatter_N:.3f}" for each in (less, more))]
                row += [f"{d:.2f}", f"{right.mean():.1f}"]
                if method != PLAIN and PLAIN in found:
                    change = changes_of(people, found[PLAIN], pair, np.random.default_rng(seed))
                    changes[what, group, method] = change
                    row += [f"{value:+.1f} [{low:+.1f}, {high:+.1f}]" for value, low, high in change]
                rows.append((*row, *[""] * (9 - len(row))))
    if not rows:
        return Section("discrimination", "Discrimination", ("People have too few trials on two specimens each.",))
    header = ("what", "group", "method", "less N", "more N", "d′", "right %", "change of d′ %", "change of right %")
    return Section(
        "discrimination", "Discrimination", _sentences(changes), header, tuple(rows), _bars(shown)
    )  # fmt: skip


def changes_of(people: SimulatedObservers, plain: Levels, other: Levels, rng: np.random.Generator) -> Array:
    """Change of mean d' and of mean right answers against plain scaling in percent: value, low, high; shape (2, 3).

    Intervals of 95 % are by drawing people and trials again, the same trials under both methods.
    """

    def means(pair: Levels, picked: list[Picked], who: Picked) -> Array:
        less, more = sorted(
            (_level(each[index]) for each, index in zip(pair, picked, strict=True)), key=lambda each: each.level_N
        )
        return np.array([sensitivity(people, less, more)[who].mean(), chance_right(people, less, more)[who].mean()])

    def change(picked: list[Picked], who: Picked) -> Array:
        before = np.maximum(means(plain, picked, who), 1e-9)
        return np.asarray(100.0 * (means(other, picked, who) / before - 1.0))

    count = [min(len(one), len(two)) for one, two in zip(plain, other, strict=True)]
    value = change([np.arange(each) for each in count], np.arange(len(people)))
    drawn = [
        change([rng.integers(each, size=each) for each in count], rng.integers(len(people), size=len(people)))
        for _ in range(RESAMPLES)
    ]
    return np.column_stack([value, *np.quantile(drawn, [0.025, 0.975], axis=0)])


def specimens(part: TrialTable) -> Levels | None:
    """Forces at the skin on the first two specimens of a task; None where trials do not separate them from people.

    A person compares for themselves: what people differ by, in pace and in how forces are scaled for them, is taken out
    by least squares of the force on person and specimen.
    """
    chosen = np.isin(part.values("specimen"), (0.0, 1.0))
    levels, second = part.values("skin_N")[chosen], part.values("specimen")[chosen] == 1.0
    people = np.array([f"{group} {user}" for group, user in zip(part.group, part.user, strict=True)])[chosen]
    if min(second.sum(), (~second).sum()) < 2:
        return None
    names = sorted(set(people))
    design = np.column_stack([*((people == name) for name in names), second]).astype(float)
    if len(levels) <= len(names) + 1 or np.linalg.matrix_rank(design) <= len(names):
        return None
    effects, *_ = np.linalg.lstsq(design, levels, rcond=None)
    shares = np.sqrt(len(levels) / (len(levels) - len(names) - 1))  # residuals of a fit are smaller than the scatter
    mean = effects[:-1].mean()
    fitted = mean + effects[-1] * second + shares * (levels - design @ effects)
    return fitted[~second], fitted[second]


def sides(needle: TrialTable) -> Levels | None:
    """Forces at the skin before and after the capsule's puncture, people's own means taken out; None of few trials."""
    before, after = needle.values("capsule_N"), needle.values("parenchyma_N")
    if len(before) < 2:
        return None
    people, middle = np.array([*zip(needle.group, needle.user, strict=True)]), 0.5 * (before + after)
    means = np.array([middle[(people == each).all(axis=1)].mean() for each in people])
    return before - means + middle.mean(), after - means + middle.mean()


def right_percent(levels: Levels, seed: int) -> dict[str, float]:
    """Right answers of simulated people by group [%]."""
    less, more = sorted(map(_level, levels), key=lambda each: each.level_N)
    rngs = {group: np.random.default_rng([seed, index]) for index, group in enumerate(GROUPS)}
    people = {group: draw_observers(group, PEOPLE, rng) for group, rng in rngs.items()}
    return {group: 100.0 * float(chance_right(each, less, more).mean()) for group, each in people.items()}


def case_table(folder: StudyFolder, task: str) -> TrialTable | None:
    """Trials of a case study that did not fail, or None."""
    try:
        table = folder.table(task).complete()
    except InputError:
        return None
    return table if len(table) else None


def _level(values: Array) -> Stimulus:
    """Mean and scatter over trials."""
    return Stimulus(float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0)


def _sentences(changes: dict[tuple[str, str, str], Array]) -> tuple[str, ...]:
    """What was found, computed from the table."""
    sentences = [
        f"Right answers of {PEOPLE} simulated people of each group in two intervals, 50 % being chance. Forces are "
        "those that reach the hand in the runs of each method: after latency, low-pass, range, amplifier and friction "
        "of the device. Their scatter is that over a person's trials, and the person's own noise comes after it."
    ]
    for method in dict.fromkeys(key[2] for key in changes):
        part = [each for key, each in changes.items() if key[2] == method]
        d, right = (np.array([each[row] for each in part]) for row in (0, 1))
        more, fewer = int((right[:, 1] > 0.0).sum()), int((right[:, 2] < 0.0).sum())
        sentences.append(
            f"{method} changes d′ by {d[:, 0].min():+.0f} to {d[:, 0].max():+.0f} % against {PLAIN} and right answers "
            f"by {right[:, 0].min():+.1f} to {right[:, 0].max():+.1f} %, more in {more} and fewer in {fewer} of "
            f"{len(part)} pairs and groups by their intervals; the paper prints +18 to +22 %."
        )
    sentences.append(
        "A map that rises with the force adds no information to the scatter of tissue, hand and device, which goes "
        "through it. It changes how far a difference lies above the person's own noise."
    )
    return tuple(sentences)


def _bars(shown: dict[tuple[str, str, str], tuple[float, float]]) -> bytes:
    """Right answers by method, mean over groups; lines span the groups."""
    names, methods = (list(dict.fromkeys(key[at] for key in shown)) for at in (0, 2))
    figure, (axes,) = drawing(11.0, 4.4)
    width = 0.84 / len(methods)
    for shift, method in enumerate(methods):
        for at, what in enumerate(names):
            values = np.array([shown[key][0] for key in product([what], GROUPS, [method]) if key in shown])
            if len(values):
                place, mean = at + width * (shift - 0.5 * (len(methods) - 1)), values.mean()
                axes.bar(place, mean, 0.92 * width, color=COLOURS[method], label=method if at == 0 else None)
                axes.plot([place, place], [values.min(), values.max()], color="#333333", lw=1.2)
    axes.axhline(50.0, color="black", lw=0.8, ls=":")
    axes.set_xticks(range(len(names)), ["\n".join(wrap(name, WIDEST)) for name in names], fontsize=9)
    axes.set_ylim(40.0, 100.0)
    axes.set_ylabel("right answers / %; dotted: by guessing")
    legend(figure, axes)
    return image(figure)
