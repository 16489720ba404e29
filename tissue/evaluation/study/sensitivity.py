"""Sections of a report on how the headline moves with five parameters, on the reference's own error, and on speed."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import MIDDLE, REFERENCE, SENSITIVITY_TRIALS, TrialKey
from tissue.evaluation.study.section import Section, drawing, image, legend, spread
from tissue.evaluation.study.tasks import TASKS, VARIANTS

__all__ = ["reference_section", "sensitivity_section", "speed_section"]


def sensitivity_section(folder: StudyFolder) -> Section | None:
    """Ratio of force errors, Koopman over penalty, with one parameter at another value."""
    tasks = [task for task in folder.plan().tasks if not TASKS[task].case]
    usual = {task: _ratio([held for key, held in folder.trials() if _is_base(key, task)]) for task in tasks}
    rows, moves = [], {}
    for name, variant in VARIANTS.items():
        ratios = {}
        for task in tasks:
            ratios[task] = _ratio([held for key, held in folder.trials(variant=name) if key.task == task])
        if all(value is None for value in ratios.values()):
            continue
        pairs = [(ratios[task], usual[task]) for task in tasks if ratios[task] and usual[task]]
        moves[name] = float(np.mean([one / other for one, other in pairs if one and other])) if pairs else 1.0
        texts = [f"{value:.2f}" if value is not None else "" for value in ratios.values()]
        rows.append((variant.parameter, variant.value, *texts, f"{100.0 * (moves[name] - 1.0):+.0f} %"))
    if not rows:
        return None
    base = ("as in the study", MIDDLE, *(f"{value:.2f}" if value is not None else "" for value in usual.values()), "")
    most = max(moves, key=lambda name: abs(np.log(moves[name])))
    above = [f"{row[0]}, {row[1]} ({task})" for row in rows for task, value in zip(tasks, row[2:], strict=False)
             if value and float(value) >= 1.0]  # fmt: skip
    count = min(SENSITIVITY_TRIALS, folder.plan().trials)
    sentences = (
        f"Force error under Koopman over that under penalty, {count} trials each with the seeds of the study. It moves "
        f"most with {VARIANTS[most].parameter} ({VARIANTS[most].value}: {100.0 * (moves[most] - 1.0):+.0f} % on the "
        "average over tasks).",
        f"Prediction does harm at: {'; '.join(above)}." if above else "Prediction does no harm at any of these values.",
    )
    header = ("parameter", "value", *tasks, "change")
    return Section("sensitivity", "Sensitivity", sentences, header, (base, *rows), _picture(rows, tasks, usual))


def reference_section(folder: StudyFolder) -> Section | None:
    """What the reference itself leaves open: its error against the finest model on the same motion."""
    rows, by_task = [], []
    for task in (task for task in folder.plan().tasks if not TASKS[task].case):
        held = [held for key, held in folder.trials(variant=REFERENCE) if key.task == task]
        errors = np.array(
            [100.0 * row["reference_error"] for each in held for row in each["rows"] if "failure" not in row]
        )
        if len(errors):
            rows.append((task, spread(errors), str(len(errors))))
            by_task.append(f"{task} {errors.mean():.1f} %")
    if not rows:
        return None
    sentences = (
        f"F_ideal is the prompt force on the study's own model; against the finest model on the same motion it is off "
        f"by {', '.join(by_task)}. That error is the model's, common to all methods, and not in their errors above: "
        "a method whose error lies below it is better than the model that it renders. Where it is zero there is "
        "no finer model.",
    )
    return Section("reference", "The reference's own error", sentences, ("task", "error %", "trials"), tuple(rows))


def speed_section(folder: StudyFolder) -> Section:
    """Seconds a trial by task, as they were measured while the study ran."""
    rows = []
    per_method = len(folder.plan().methods)
    total = 0.0
    for task in folder.plan().tasks:
        took = np.array([held["took_s"] for key, held in folder.trials() if key.task == task])
        if len(took):
            total += float(np.median(took)) if not TASKS[task].case else 0.0
            rows.append((task, f"{np.median(took):.2f}", f"{took.max():.2f}", str(per_method), str(len(took))))
    minutes = 300.0 * total / 2.0 / 60.0
    sentences = (
        f"Seconds on one worker for a trial under all its methods, with whatever else the machine did. 900 trials of "
        f"T1 to T3 on two workers take {minutes:.0f} min at these medians.",
    )
    return Section("speed", "Speed", sentences, ("task", "median s", "longest s", "methods", "trials"), tuple(rows))


def _is_base(key: TrialKey, task: str) -> bool:
    """Whether a trial of the study is one that the variants repeat."""
    return key.task == task and key.group == MIDDLE and key.trial < SENSITIVITY_TRIALS


def _ratio(trials: list[Mapping[str, Any]]) -> float | None:
    """Ratio of mean force errors over trials in which neither method failed."""
    sums = np.zeros(2)
    for held in trials:
        errors = {row["method"]: row.get("force_error") for row in held["rows"]}
        pair = (errors.get("koopman"), errors.get("penalty"))
        if pair[0] is not None and pair[1] is not None:
            sums += np.array(pair)
    return float(sums[0] / sums[1]) if sums[1] > 0.0 else None


def _picture(rows: list[tuple[str, ...]], tasks: list[str], usual: Mapping[str, float | None]) -> bytes:
    """Ratios by variant, one colour a task, the study's own as lines."""
    figure, (axes,) = drawing(9.0, 0.32 * len(rows) + 1.2)
    for task, colour, mark in zip(tasks, ("#0072B2", "#D55E00", "#009E73"), "os^", strict=False):
        at = tasks.index(task)
        values = [float(row[2 + at]) if row[2 + at] else np.nan for row in rows]
        axes.plot(values, range(len(rows)), mark, color=colour, label=task)
        if (reference := usual[task]) is not None:
            axes.axvline(reference, color=colour, lw=1.0, ls=":")
    axes.axvline(1.0, color="black", lw=0.8)
    axes.set_yticks(range(len(rows)), [f"{row[0]}: {row[1]}" for row in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("force error, Koopman over penalty (dotted: as in the study)")
    legend(figure, axes)
    return image(figure)
