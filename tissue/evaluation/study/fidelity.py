"""Report sections on force errors, latency, task metrics, sensitivity and reference error.

The sensitivity is the effect of changed parameters on the force errors.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from meshes.base.arrays import Array
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import (
    LATENCY_MS,
    MIDDLE,
    REFERENCE,
    SENSITIVITY_TRIALS,
    TASKS,
    VARIANTS,
)
from tissue.evaluation.study.section import (
    FORCE_ERROR,
    POSITION_ERROR_MM,
    Figure,
    Section,
    against,
    drawing,
    grouped_points,
    image,
    interval_by_users,
    legend,
    methods_of,
    parts_of,
    published,
    spread,
    tasks_of,
)
from tissue.evaluation.study.trial import Trial
from tissue.show.figures.figure import plain_numbers

__all__ = [
    "force_section",
    "latency_section",
    "reference_section",
    "sensitivity_section",
    "task_section",
]

RATIOS = {
    "ratio_error": "error of ratios / %",
    "ratio_floor": "least error of ratios / %",
    "ratio_unscaled": "by the exponent alone / %",
    "ratio_silent": "without any change / %",
}
"""Column name of each metric on ratios of perceived intensity."""
UNRESOLVED = 0.05
"""Fraction of unresolved rows above which the report calls the excess error not meaningful.

In an unresolved row, the force error does not exceed the lower bound of the error.
"""
APART = 0.24
"""Vertical distance between the marks of two tasks for a variant, divided by the line spacing."""


def force_section(table: TrialTable) -> Section:
    """Report force errors by task and method, next to the published errors.

    Parameters
    ----------
    table
        Trials that did not fail.
    """
    ratios = {each: name for each, name in RATIOS.items() if each in table.metrics}
    rows = []
    for (task, method), part in parts_of(table).items():
        percent = {name: 100.0 * values for name, values in part.metrics.items()}
        rows.append(
            {"task": task, "method": method, "force error / %": spread(percent["force_error"])}
            | against(percent["force_error"], published(task, FORCE_ERROR[task].get(method)), "%")
            | {
                "least error %": spread(percent["least_error"]),
                "excess %": spread(percent["excess_error"]),
            }
            | {name: spread(percent[each], 1) for each, name in ratios.items()}
            | {"trials": str(len(part))}
        )
    left = _left_over(table)
    means = ", ".join(
        f"{row['task']} {row['method']} {row['force error / %'].split()[0]}" for row in rows
    )
    sentences = (
        f"Mean force error at the motor in %: {means}.",
        "Error of the played force, ||F - F_ideal|| / ||F_ideal|| over all ticks at the motor. "
        "F_ideal is the prompt force at the device's true position at that time. The least error "
        "is that of a perfect force through the same encoder steps, low-pass and amplifier; the "
        "excess is sqrt(error² - least²). The force is taken before it is scaled for a person, in "
        "newtons.",
        "Ratios of intensity show the effect of scaling: the spread, over windows of 0.1 s, of the "
        "logarithm of this person's intensity of the force at the skin over the reference's "
        "intensity of the ideal force. The other columns hold this ratio of a perfect force "
        "through the encoder, of the ideal force by this person's exponent, and of a force that "
        "never changes. That a calibration brings a person to the reference's exponent is a "
        "recovery of the parameters by which these people were made, no finding on people.",
        *_unresolved(table),
        *left,
    )
    metrics = {"force_error": ("force error % (◆ paper, mean and SD)", 100.0)}
    if "ratio_error" in table.metrics:
        metrics["ratio_error"] = ("error of intensity ratios / %", 100.0)
    return Section(
        "force",
        "Force fidelity",
        sentences,
        rows,
        # inches; two panels at most
        _points(table, metrics, (11.0, 4.2)),
        left[0] if left else f"Mean force error at the motor in %: {means}.",
    )


def _unresolved(table: TrialTable) -> list[str]:
    """Return a sentence on the tasks in which the smallest possible error is not a lower bound.

    The smallest possible error is the error of a perfect force through the same device. It is not a
    lower bound if the tool takes a different path than with the perfect force.
    """
    above = []
    for task in tasks_of(table):
        part = table.where(task=task)
        share = (part.values("least_error") >= part.values("force_error")).mean()
        if share > UNRESOLVED:
            above.append(f"{task} {100.0 * share:.0f} %")
    if not above:
        return []
    return [
        "The least error is no bound where a tool cuts its own course, which the perfect force's "
        f"does not share: it exceeds the error in {', '.join(above)} of the rows, so that there "
        "the excess, then set to 0, is no measure of methods."
    ]


def _left_over(table: TrialTable) -> list[str]:
    """Return sentences on the force error with prediction, and on the ratio error with perception.

    The errors are divided by the errors without prediction, or without perception.
    """
    remarks = []
    parts = parts_of(table)
    for metric, first, second, what in (
        (
            "force_error",
            "penalty",
            "koopman",
            "Force error with prediction over that of the penalty law",
        ),
        (
            "ratio_error",
            "koopman",
            "koopman-perception",
            "Error of ratios with scaling for the person over that without it",
        ),
    ):
        if {first, second} <= set(methods_of(table)) and metric in table.metrics:
            means = {key: part.values(metric).mean() for key, part in parts.items()}
            ratios = {task: means[task, second] / means[task, first] for task in tasks_of(table)}
            worse = ", ".join(task for task, ratio in ratios.items() if ratio >= 1.0)
            found = ", ".join(f"{task} {ratio:.2f}" for task, ratio in ratios.items())
            remarks.append(f"{what}: {found}{f'; no improvement on {worse}' if worse else ''}.")
    return remarks


def _points(
    table: TrialTable,
    metrics: Mapping[str, tuple[str, float]],
    size: tuple[float, float],
) -> bytes:
    """Draw metrics with 95 % intervals over users, one panel for each metric.

    `metrics` has the axis label and the scale factor of each metric, by the name of the metric.

    Published force errors are drawn as diamonds.
    """
    tasks = tasks_of(table)
    figure, panels = drawing(*size, len(metrics))
    parts = parts_of(table)
    for axes, (metric, (label, scale)) in zip(panels, metrics.items(), strict=True):
        points = {
            (tasks.index(task), method): [scale * each for each in interval_by_users(part, metric)]
            for (task, method), part in parts.items()
        }
        shown = _published_errors(tasks, parts) if metric == "force_error" else {}
        grouped_points(axes, [f"{task}\n{TASKS[task].scene}" for task in tasks], points, shown)
        # errors and times of tasks differ by factors
        if min(low for _, low, _ in points.values()) > 0.0:
            axes.set_yscale("log")
            plain_numbers(axes.yaxis)
        axes.set_ylabel(label)
    legend(figure, panels[0])
    return image(figure)


def _published_errors(
    tasks: Sequence[str], parts: Iterable[tuple[str, str]]
) -> dict[tuple[int, str], Figure]:
    """Return the published force errors, keyed by the index of the task and the method."""
    figures = {
        (tasks.index(task), method): published(task, FORCE_ERROR[task].get(method))
        for task, method in parts
    }
    return {place: figure for place, figure in figures.items() if figure is not None}


def latency_section(table: TrialTable) -> Section:
    """Report the lag of the played force behind a perfectly predicted force.

    Failed trials are left out.
    """
    lags = {key: part.values("latency_ms") for key, part in parts_of(table).items()}
    rows = [
        {"task": task, "method": method, "latency ms": spread(lag)}
        for (task, method), lag in lags.items()
    ]
    means = {
        each: table.where(method=each).values("latency_ms").mean() for each in methods_of(table)
    }
    shifts = ", ".join(f"{value:.1f} ms ({name})" for name, value in means.items())
    early = ", ".join(" ".join(key) for key, lag in lags.items() if lag.mean() < 0.0)
    sentences = (
        "Shift at which the force at the motor correlates best with that of a perfect prediction "
        f"through the same encoder steps, over all tasks: {shifts}. A value below zero is a force "
        "that comes early" + (f" ({early})." if early else "; none does."),
        "The paper's latency is the delay of the whole loop. Here that delay is set, to "
        f"{LATENCY_MS} ms and the path to the motor, so it is no result to compare.",
    )
    headline = f"The mean lag at the motor is {shifts}."
    return Section("latency", "Latency", sentences, rows, headline=headline)


def task_section(table: TrialTable) -> Section:
    """Report time, smoothness and position error of the tasks, and the published position error.

    Failed trials are left out.
    """
    rows = []
    for (task, method), part in parts_of(table).items():
        rows.append(
            {
                "task": task,
                "method": method,
                "time s": spread(part.values("time_s")),
                "position error mm": spread(part.values("position_error_mm")),
                "acceleration change m/s2": spread(part.values("acceleration_change_m_s2")),
                "spectral arc length": spread(part.values("spectral_arc_length")),
                "completed %": f"{100.0 * part.values('completed').mean():.0f}",
            }
        )
    # the paper gives one position error for each task, not one for each method
    for task in tasks_of(table):
        position = table.where(task=task).values("position_error_mm")
        rows.append(
            {"task": task, "method": "all", "position error mm": spread(position)}
            | against(position, published(task, POSITION_ERROR_MM[task]), "mm")
        )
    sentences = (
        "The position error is the mean distance of the tool from its wanted path. Times are not "
        "compared with the paper's, because tasks here take a few seconds.",
        "Smoothness is not compared either: the paper's formula, a mean change of acceleration "
        "[m/s2], is lower for smoother motion, and its table reads as if higher were better. Both "
        "that formula and the spectral arc length (nearer to zero is smoother) are given.",
    )
    metrics = {
        "position_error_mm": ("position error / mm", 1.0),
        "time_s": ("time / s", 1.0),
        "spectral_arc_length": ("spectral arc length", 1.0),
    }
    # 12 x 3.6 inches for three panels
    picture = _points(table, metrics, (12.0, 3.6))
    return Section("tasks", "Task metrics", sentences, rows, picture)


def sensitivity_section(folder: StudyFolder) -> Section | None:
    """Report the force error of koopman divided by that of penalty, for each changed parameter."""
    tasks = folder.plan().compared
    base = [
        each
        for each in folder.trials()
        if each.key.group == MIDDLE and each.key.trial < SENSITIVITY_TRIALS
    ]
    usual = _ratios(base, tasks)
    found = {name: _ratios(folder.trials(variant=name), tasks) for name in VARIANTS}
    found = {name: ratios for name, ratios in found.items() if np.isfinite(ratios).any()}
    if not found:
        return None
    rows = [{"parameter": "as in the study", "value": MIDDLE} | _as_texts(tasks, usual)]
    moves = {}
    harm = []
    for name, ratios in found.items():
        variant = VARIANTS[name]
        known = (ratios / usual)[np.isfinite(ratios / usual)]
        # no trial yet: no change
        moves[name] = known.mean() if len(known) else 1.0
        rows.append(
            {"parameter": variant.parameter, "value": variant.value}
            | _as_texts(tasks, ratios)
            | {"change": _percent(moves[name])}
        )
        for task, ratio in zip(tasks, ratios, strict=True):
            if ratio >= 1.0:
                harm.append(f"{variant.parameter}, {variant.value} ({task})")
    most = max(moves, key=lambda name: abs(np.log(moves[name])))
    count = min(SENSITIVITY_TRIALS, folder.plan().trials)
    sentences = (
        f"Force error under Koopman over that under penalty, {count} trials each with the seeds of "
        f"the study. It moves most with {VARIANTS[most].parameter} ({VARIANTS[most].value}: "
        f"{_percent(moves[most])} on the average over tasks).",
        f"Prediction does harm at: {'; '.join(harm)}."
        if harm
        else "Prediction does no harm at any of these values.",
    )
    picture = _picture(found, tasks, usual)
    return Section("sensitivity", "Sensitivity", sentences, rows, picture)


def _percent(ratio: float) -> str:
    return f"{100.0 * (ratio - 1.0):+.0f} %"


def reference_section(folder: StudyFolder) -> Section | None:
    """Report the error of the reference force against the force of the finest model."""
    errors: dict[str, list[float]] = {}
    for trial in folder.trials(variant=REFERENCE):
        errors.setdefault(trial.key.task, []).extend(
            100.0 * each for each in trial.values("reference_error").values()
        )
    found = {task: np.array(errors[task]) for task in folder.plan().compared if errors.get(task)}
    if not found:
        return None
    means = ", ".join(f"{task} {each.mean():.1f} %" for task, each in found.items())
    sentences = (
        "F_ideal is the prompt force on the study's own model; against the finest model on the "
        f"same motion it is off by {means}. That error is the model's, common to all methods, and "
        "not in their errors above: a method whose error lies below it is better than the model "
        "that it renders. Where it is zero there is no finer model.",
    )
    rows = [
        {"task": task, "error %": spread(each), "trials": str(len(each))}
        for task, each in found.items()
    ]
    return Section("reference", "The reference's own error", sentences, rows)


def _ratios(trials: Iterable[Trial], tasks: Sequence[str]) -> Array:
    """Return the mean force error of koopman divided by that of penalty, by task.

    Only trials in which neither of the two methods failed are used.

    The ratio is NaN if there is no such trial.
    """
    sums = np.zeros((len(tasks), 2))
    for trial in trials:
        errors = trial.values("force_error")
        if trial.key.task in tasks and {"koopman", "penalty"} <= errors.keys():
            sums[tasks.index(trial.key.task)] += errors["koopman"], errors["penalty"]
    koopman, penalty = sums.T
    return np.divide(koopman, penalty, out=np.full(len(tasks), np.nan), where=penalty > 0.0)


def _as_texts(tasks: Sequence[str], ratios: Array) -> dict[str, str]:
    return {
        task: f"{ratio:.2f}" if np.isfinite(ratio) else ""
        for task, ratio in zip(tasks, ratios, strict=True)
    }


def _picture(found: Mapping[str, Array], tasks: Sequence[str], usual: Array) -> bytes:
    """Draw the ratios of force errors by variant, with one colour for each task.

    Dotted lines show the ratios of the study itself, without a changed parameter.
    """
    # 0.32 inches a line, 1.2 for axis and label
    figure, (axes,) = drawing(9.0, 0.32 * len(found) + 1.2)
    looks = zip(("#0072B2", "#D55E00", "#009E73"), "os^", strict=True)
    for at, (task, (colour, mark)) in enumerate(zip(tasks, looks, strict=False)):
        places = np.arange(len(found)) + APART * (at - 0.5 * (len(tasks) - 1))
        ratios = [each[at] for each in found.values()]
        axes.plot(ratios, places, mark, color=colour, label=task)
        axes.axvline(usual[at], color=colour, ls=":")
    axes.axvline(1.0, color="black")
    labels = [f"{VARIANTS[name].parameter}: {VARIANTS[name].value}" for name in found]
    axes.set_yticks(range(len(found)), labels)
    axes.invert_yaxis()
    axes.set_xlabel("force error, Koopman over penalty (dotted: as in the study)")
    legend(figure, axes)
    return image(figure)
