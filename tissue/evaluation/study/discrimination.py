"""Section of a report: who discriminates what from the force at the skin, under each method."""

from collections.abc import Callable
from itertools import product
from textwrap import wrap

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.calibration.simulated_observer import draw_observers
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.felt_pairs import PEOPLE, FeltPair, changes_of, sides, specimens
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.section import COLOURS, Section, drawing, image, legend, methods_of, tasks_of
from tissue.scene.registry import GROUPS

__all__ = ["LEAST_D", "PLAIN", "case_table", "discrimination_section"]

PLAIN = "koopman"
"""Method of plain scaling, which the others are held against."""
WIDEST = 12
"""Letters of a line below a group of bars."""
LEAST_D = 0.5
"""Sensitivity under plain scaling below which a change in percent would be a division by almost nothing."""


def discrimination_section(folder: StudyFolder, table: TrialTable, seed: int) -> Section:
    """Sensitivity d' and right answers for every pair, group and method, and their change against plain scaling."""
    taken: list[tuple[str, Callable[[TrialTable], FeltPair | None], TrialTable]] = [
        (f"{task}: softer or usual", specimens, table.where(task=task)) for task in tasks_of(table)
    ]
    if (needle := case_table(folder, "needle")) is not None:
        taken.append(("capsule or parenchyma", sides, needle))
    if (drilling := case_table(folder, "drilling")) is not None:
        taken.append(("carious or sound", specimens, drilling))
    rows, shown, changes = [], {}, {}
    for what, pair_of, part in taken:
        part = part.shared()
        pairs = {method: pair_of(part.where(method=method)) for method in methods_of(part)}
        found = {method: pair for method, pair in pairs.items() if pair is not None}
        for group in GROUPS if found else ():
            people = draw_observers(group, PEOPLE, np.random.default_rng([seed, GROUPS.index(group)]))
            plain = found[PLAIN].felt_by(people)[0].mean() if PLAIN in found else 0.0
            for method, pair in found.items():
                d, right = (float(each.mean()) for each in pair.felt_by(people))
                error = 196.0 * pair.felt_by(people)[1].std(ddof=1) / PEOPLE**0.5
                shown[what, group, method] = 100.0 * right, error
                row = [
                    what,
                    group,
                    method,
                    *(
                        f"{each.level_N:.3f} ± {each.scatter_N:.3f}"
                        for each in (pair.less.stimulus, pair.more.stimulus)
                    ),
                ]
                row += [f"{d:.2f}", f"{100.0 * right:.1f}"]
                if method != PLAIN and PLAIN in found:
                    change = changes_of(people, found[PLAIN], pair)
                    if plain < LEAST_D:
                        change[1] = np.nan
                    changes[what, group, method] = change
                    row += [
                        f"{value:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]" if np.isfinite(value) else ""
                        for digits, (value, low, high) in zip((2, 1, 1), change, strict=True)
                    ]
                rows.append((*row, *[""] * (10 - len(row))))
    if not rows:
        return Section("discrimination", "Discrimination", ("People have too few trials on two specimens each.",))
    header = ("what", "group", "method", "softer N", "stiffer N", "d′", "right %", "change of d′", "in %",
              "change of right, points")  # fmt: skip
    return Section("discrimination", "Discrimination", _sentences(changes), header, tuple(rows), _bars(shown))


def case_table(folder: StudyFolder, task: str) -> TrialTable | None:
    """Trials of a case study that did not fail, or None."""
    try:
        table = folder.table(task).complete()
    except InputError:
        return None
    return table if len(table) else None


def _sentences(changes: dict[tuple[str, str, str], Array]) -> tuple[str, ...]:
    """What was found, computed from the table."""
    sentences = [
        f"Right answers of {PEOPLE} simulated people of each group in two intervals, 50 % being chance. Forces are "
        "those that reach the hand in the runs of each method: after latency, low-pass, range, amplifier and friction "
        "of the device. Their scatter is that over a person's trials, and the person's own noise comes after it."
    ]
    for method in dict.fromkeys(key[2] for key in changes):
        part = {key: each for key, each in changes.items() if key[2] == method}
        d, percent, right = (np.array([each[row] for each in part.values()]) for row in range(3))
        more, fewer = int((d[:, 1] > 0.0).sum()), int((d[:, 2] < 0.0).sum())
        known = percent[np.isfinite(percent[:, 0]), 0]
        shares = f" ({known.min():+.0f} to {known.max():+.0f} %)" if len(known) else ""
        sentences.append(
            f"{method} changes d′ by {d[:, 0].min():+.2f} to {d[:, 0].max():+.2f}{shares} against {PLAIN} and right "
            f"answers by {right[:, 0].min():+.1f} to {right[:, 0].max():+.1f} points; by its interval d′ is greater in "
            f"{more} and smaller in {fewer} of {len(part)} pairs and groups; the paper prints +18 to +22 %."
        )
    if weak := list(dict.fromkeys(key[0] for key, each in changes.items() if not np.isfinite(each[1, 0]))):
        sentences.append(
            f"No change in percent is given for {', '.join(weak)}: under {PLAIN} d′ is below {LEAST_D} there, so that "
            "hardly anybody discriminates the two by force."
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
