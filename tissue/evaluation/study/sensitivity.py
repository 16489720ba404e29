"""Sections of a report on how the headline moves with five parameters, on the reference's own error, and on speed."""

from collections.abc import Iterable, Sequence

import numpy as np

from meshes.base.arrays import Array
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import MIDDLE, REFERENCE, SENSITIVITY_TRIALS
from tissue.evaluation.study.section import Section, drawing, image, legend, spread
from tissue.evaluation.study.tasks import VARIANTS
from tissue.evaluation.study.trial import Trial

__all__ = ["reference_section", "sensitivity_section", "speed_section"]

APART = 0.24
"""Distance of two tasks' marks on a line, in lines."""


def sensitivity_section(folder: StudyFolder) -> Section | None:
    """Ratio of force errors, Koopman over penalty, with one parameter at another value."""
    tasks = folder.plan().compared
    base = [each for each in folder.trials() if each.key.group == MIDDLE and each.key.trial < SENSITIVITY_TRIALS]
    usual = _ratios(base, tasks)
    found = {name: _ratios(folder.trials(variant=name), tasks) for name in VARIANTS}
    found = {name: ratios for name, ratios in found.items() if np.isfinite(ratios).any()}
    if not found:
        return None
    moves = {name: _mean_over(ratios / usual) for name, ratios in found.items()}
    percent = {name: f"{100.0 * (move - 1.0):+.0f} %" for name, move in moves.items()}
    rows = [
        (VARIANTS[name].parameter, VARIANTS[name].value, *map(_as_text, ratios), percent[name])
        for name, ratios in found.items()
    ]
    most = max(moves, key=lambda name: abs(np.log(moves[name])))
    above = [f"{row[0]}, {row[1]} ({task})" for row in rows for task, value in zip(tasks, row[2:], strict=False)
             if value and float(value) >= 1.0]  # fmt: skip
    count = min(SENSITIVITY_TRIALS, folder.plan().trials)
    sentences = (
        f"Force error under Koopman over that under penalty, {count} trials each with the seeds of the study. It moves "
        f"most with {VARIANTS[most].parameter} ({VARIANTS[most].value}: {percent[most]} on the "
        "average over tasks).",
        f"Prediction does harm at: {'; '.join(above)}." if above else "Prediction does no harm at any of these values.",
    )
    header = ("parameter", "value", *tasks, "change")
    whole = (("as in the study", MIDDLE, *map(_as_text, usual), ""), *rows)
    return Section("sensitivity", "Sensitivity", sentences, header, whole, _picture(rows, tasks, usual))


def reference_section(folder: StudyFolder) -> Section | None:
    """What the reference itself leaves open: its error against the finest model on the same motion."""
    errors: dict[str, list[float]] = {}
    for trial in folder.trials(variant=REFERENCE):
        errors.setdefault(trial.key.task, []).extend(100.0 * each for each in trial.values("reference_error").values())
    found = {task: np.array(errors[task]) for task in folder.plan().compared if errors.get(task)}
    if not found:
        return None
    sentences = (
        f"F_ideal is the prompt force on the study's own model; against the finest model on the same motion it is off "
        f"by {', '.join(f'{task} {each.mean():.1f} %' for task, each in found.items())}. That error is the model's, "
        "common to all methods, and not in their errors above: a method whose error lies below it is better than the "
        "model that it renders. Where it is zero there is no finer model.",
    )
    rows = tuple((task, spread(each), str(len(each))) for task, each in found.items())
    return Section("reference", "The reference's own error", sentences, ("task", "error %", "trials"), rows)


def speed_section(folder: StudyFolder) -> Section:
    """Seconds a trial by task, as they were measured while the study ran."""
    plan = folder.plan()
    times: dict[str, list[float]] = {}
    for trial in folder.trials():
        times.setdefault(trial.key.task, []).append(trial.took_s)
    rows = tuple(
        (task, f"{np.median(took):.2f}", f"{max(took):.2f}", str(len(plan.methods)), str(len(took)))
        for task in plan.tasks
        if (took := times.get(task))
    )
    total = sum(float(np.median(times[task])) for task in plan.compared if task in times)
    sentences = (
        f"Seconds on one worker for a trial under all its methods, with whatever else the machine did. 900 trials of "
        f"T1 to T3 on two workers take {300.0 * total / 2.0 / 60.0:.0f} min at these medians.",
    )
    return Section("speed", "Speed", sentences, ("task", "median s", "longest s", "methods", "trials"), rows)


def _ratios(trials: Iterable[Trial], tasks: Sequence[str]) -> Array:
    """Ratio of mean force errors by task, over trials in which neither method failed; NaN where there is none."""
    sums = np.zeros((len(tasks), 2))
    for trial in trials:
        errors = trial.values("force_error")
        if trial.key.task in tasks and {"koopman", "penalty"} <= errors.keys():
            sums[tasks.index(trial.key.task)] += errors["koopman"], errors["penalty"]
    return np.array([koopman / penalty if penalty > 0.0 else np.nan for koopman, penalty in sums.tolist()])


def _mean_over(quotients: Array) -> float:
    """Mean of the quotients that there are, one without any."""
    known = quotients[np.isfinite(quotients)]
    return float(known.mean()) if len(known) else 1.0


def _as_text(ratio: float) -> str:
    return f"{ratio:.2f}" if np.isfinite(ratio) else ""


def _picture(rows: Sequence[tuple[str, ...]], tasks: Sequence[str], usual: Array) -> bytes:
    """Ratios by variant, one colour a task, the study's own as lines."""
    figure, (axes,) = drawing(9.0, 0.32 * len(rows) + 1.2)
    for at, (task, colour, mark) in enumerate(zip(tasks, ("#0072B2", "#D55E00", "#009E73"), "os^", strict=False)):
        places = np.arange(len(rows)) + APART * (at - 0.5 * (len(tasks) - 1))
        axes.plot([float(row[2 + at] or "nan") for row in rows], places, mark, color=colour, label=task)
        if np.isfinite(usual[at]):
            axes.axvline(usual[at], color=colour, lw=1.0, ls=":")
    axes.axvline(1.0, color="black", lw=0.8)
    axes.set_yticks(range(len(rows)), [f"{row[0]}: {row[1]}" for row in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("force error, Koopman over penalty (dotted: as in the study)")
    legend(figure, axes)
    return image(figure)
