"""Report sections on errors, latency, task metrics, sensitivity, reference error and speed.

The errors are force errors.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from meshes.base.arrays import Array
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import MIDDLE, REFERENCE, SENSITIVITY_TRIALS, TASKS, VARIANTS
from tissue.evaluation.study.section import (
    FORCE_ERROR,
    LATENCY,
    TASK_METRICS,
    Section,
    against,
    agreement,
    drawing,
    grouped_bars,
    image,
    interval_by_users,
    legend,
    methods_of,
    parts_of,
    spread,
    tasks_of,
)
from tissue.evaluation.study.trial import Trial

__all__ = [
    "force_section",
    "latency_section",
    "reference_section",
    "sensitivity_section",
    "speed_section",
    "task_section",
]

RATIOS = {
    "ratio_error": "error of ratios / %",
    "ratio_floor": "least error of ratios / %",
    "ratio_unscaled": "by the exponent alone / %",
    "ratio_silent": "without any change / %",
}
"""Columns on ratios of intensity."""
UNRESOLVED = 0.05
"""Share of rows with a smallest possible error above the error that makes the excess invalid.

Above this share, the report marks the excess as not meaningful.
"""
APART = 0.24
"""Distance of two tasks' marks on a line, in lines."""


def force_section(table: TrialTable) -> Section:
    """Compare the normalised force error of every method on every task with the published one.

    Parameters
    ----------
    table
        Trials that did not fail.
    """
    rows = []
    for (task, method), part in parts_of(table).items():
        error = 100.0 * part.values("force_error")
        felt = [spread(100.0 * part.values(each), 1) for each in RATIOS if each in part.metrics]
        shares = (spread(100.0 * part.values(each)) for each in ("least_error", "excess_error"))
        paper = against(error, FORCE_ERROR[task].get(method))
        rows.append((task, method, spread(error), *paper, *shares, *felt, str(len(part))))
    left = _left_over(table)
    sentences = (
        "Error of the played force, ||F - F_ideal|| / ||F_ideal|| over all ticks at the "
        "motor. F_ideal is the prompt "
        "force at the device's true position at that time. The least error is that of a "
        "perfect force through the same "
        "encoder steps, low-pass and amplifier; the excess is sqrt(error² - least²). The "
        "force is taken before it is "
        "scaled for a person, in newtons.",
        "Ratios of intensity show the effect of scaling: the spread, over windows of 0.1 s, "
        "of the logarithm of this "
        "person's intensity of the force at the skin over the reference's intensity of the "
        "ideal force. Beside it "
        "stand the same of a perfect force through the encoder, of the ideal force by this "
        "person's exponent, and of a "
        "force that never changes. That a calibration brings a person to the reference's "
        "exponent is a recovery of "
        "the parameters by which these people were made, no finding on people.",
        *_unresolved(table),
        *left,
    )
    header = (
        "task",
        "method",
        "force error / %",
        "paper %",
        "against paper",
        "least error %",
        "excess %",
        *(name for each, name in RATIOS.items() if each in table.metrics),
        "trials",
    )
    means = ", ".join(f"{task} {method} {text.split()[0]}" for task, method, text, *_ in rows)
    headline = " ".join([f"Force error at the motor in %: {means}.", *left])
    return Section(
        "force", "Force fidelity", sentences, header, tuple(rows), _force_picture(table), headline
    )


def _unresolved(table: TrialTable) -> list[str]:
    """Name the tasks in which the smallest possible error is not a bound.

    This happens where a tool takes a different course.
    """
    shares = {}
    for task in tasks_of(table):
        part = table.where(task=task)
        shares[task] = float((part.values("least_error") >= part.values("force_error")).mean())
    above = ", ".join(
        f"{task} {100.0 * share:.0f} %" for task, share in shares.items() if share > UNRESOLVED
    )
    if not above:
        return []
    return [
        "The least error is no bound where a tool cuts its own course, which the perfect "
        "force's does not share: it "
        f"exceeds the error in {above} of the rows, so that there the excess, then set to 0, "
        "is no measure of methods."
    ]


def _left_over(table: TrialTable) -> list[str]:
    """Report the remaining force error with prediction, and ratio error with perception."""
    remarks = []
    parts = parts_of(table)
    for metric, first, second, what in (
        ("force_error", "penalty", "koopman", "Prediction leaves of the force error"),
        (
            "ratio_error",
            "koopman",
            "koopman-perception",
            "Scaling for the person leaves of the error of ratios",
        ),
    ):
        if {first, second} <= set(methods_of(table)) and metric in table.metrics:
            means = {key: float(part.values(metric).mean()) for key, part in parts.items()}
            ratios = {task: means[task, second] / means[task, first] for task in tasks_of(table)}
            worse = ", ".join(task for task, ratio in ratios.items() if ratio >= 1.0)
            found = ", ".join(f"{task} {ratio:.2f}" for task, ratio in ratios.items())
            remarks.append(f"{what}: {found}{f'; it does not help on {worse}' if worse else ''}.")
    return remarks


def _bars(
    table: TrialTable,
    metrics: dict[str, tuple[str, float]],
    size: tuple[float, float],
    *,
    papers: bool = False,
) -> bytes:
    """Draw metrics with 95 % intervals over users, a panel each: name of the metric, its label
    and factor.
    """
    tasks = tasks_of(table)
    figure, panels = drawing(*size, len(metrics))
    labels = [f"{task}\n{TASKS[task].scene}" for task in tasks]
    for axes, (metric, (label, scale)) in zip(panels, metrics.items(), strict=True):
        grouped_bars(
            axes,
            labels,
            methods_of(table),
            lambda index, method, metric=metric, scale=scale: tuple(  # type: ignore[misc]
                scale * each
                for each in interval_by_users(table.where(task=tasks[index]), metric, method)
            ),
            lambda index, method, metric=metric: (  # type: ignore[misc]
                FORCE_ERROR[tasks[index]].get(method)
                if papers and metric == "force_error"
                else None
            ),
        )
        axes.set_ylabel(label)
    legend(figure, panels[0])
    return image(figure)


def _force_picture(table: TrialTable) -> bytes:
    """Draw errors of force and of ratios, with the published force errors as diamonds."""
    metrics = {
        "force_error": ("force error % (◆ paper ± sd)", 100.0),
        "ratio_error": ("error of intensity ratios / %", 100.0),
    }
    return _bars(
        table,
        {each: metrics[each] for each in metrics if each in table.metrics},
        (11.0, 4.2),
        papers=True,
    )


def latency_section(table: TrialTable) -> Section:
    """Compare the lag of the played force behind a perfect prediction.

    Failed trials are left out.
    """
    lags = {key: part.values("latency_ms") for key, part in parts_of(table).items()}
    rows = tuple((*key, spread(lag), *against(lag, LATENCY)) for key, lag in lags.items())
    means = {
        each: table.where(method=each).values("latency_ms").mean() for each in methods_of(table)
    }
    shifts = ", ".join(f"{name} {value:.1f} ms" for name, value in means.items())
    early = ", ".join(" ".join(key) for key, lag in lags.items() if lag.mean() < 0.0)
    sentences = (
        "Shift at which the force at the motor correlates best with that of a perfect "
        "prediction through the same "
        f"encoder steps, over all tasks: {shifts}. The loop is late by 4 ms and its path to "
        "the motor in every trial "
        f"by construction, the paper's mean being {LATENCY} ms. A value below zero is a "
        "force that comes early" + (f" ({early})." if early else "; none does."),
    )
    header = ("task", "method", "latency ms", "paper ms", "against paper")
    headline = f"Residual latency at the motor: {shifts}; the paper prints {LATENCY} ms."
    return Section("latency", "Latency", sentences, header, rows, headline=headline)


def task_section(table: TrialTable) -> Section:
    """Compare time, position error and smoothness with the published values.

    Failed trials are left out.
    """
    rows = tuple(
        (
            task,
            method,
            spread(part.values("time_s")),
            str(TASK_METRICS[task]["time_s"]),
            spread(part.values("position_error_mm")),
            str(TASK_METRICS[task]["position_error_mm"]),
            spread(part.values("acceleration_change_m_s2")),
            spread(part.values("spectral_arc_length")),
            str(TASK_METRICS[task]["smoothness"]),
            f"{100.0 * part.values('completed').mean():.0f}",
        )
        for (task, method), part in parts_of(table).items()
    )
    remarks = []
    for task in tasks_of(table):
        time, position = (
            agreement(table.where(task=task).values(name), TASK_METRICS[task][name])
            for name in ("time_s", "position_error_mm")
        )
        remarks.append(f"{task}: time {time}, position error {position}")
    sentences = (
        f"Against the paper, {'; '.join(remarks)}. Our tasks are a few seconds long, so that "
        "their time is not the "
        "paper's; the position error is the mean distance of the tool from its wanted path.",
        "The paper's index of smoothness cannot be compared: its formula, a mean change of "
        "acceleration [m/s2], is "
        "lower for smoother motion, its table reads as if higher were better. Both that "
        "formula and the spectral arc "
        "length (nearer to zero is smoother) are given.",
    )
    header = (
        "task",
        "method",
        "time s",
        "paper s",
        "position error mm",
        "paper mm",
        "acceleration change m/s2",
        "spectral arc length",
        "paper's index",
        "completed %",
    )
    metrics = {
        "time_s": ("time / s", 1.0),
        "position_error_mm": ("position error / mm", 1.0),
        "spectral_arc_length": ("spectral arc length", 1.0),
    }
    return Section(
        "tasks", "Task metrics", sentences, header, rows, _bars(table, metrics, (12.0, 3.6))
    )


def sensitivity_section(folder: StudyFolder) -> Section | None:
    """Report the ratio of force errors, Koopman over penalty, with one parameter changed."""
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
    moves = {name: _mean_over(ratios / usual) for name, ratios in found.items()}
    percent = {name: f"{100.0 * (move - 1.0):+.0f} %" for name, move in moves.items()}
    rows = [
        (VARIANTS[name].parameter, VARIANTS[name].value, *map(_as_text, ratios), percent[name])
        for name, ratios in found.items()
    ]
    most = max(moves, key=lambda name: abs(np.log(moves[name])))
    above = [
        f"{row[0]}, {row[1]} ({task})"
        for row in rows
        for task, value in zip(tasks, row[2:], strict=False)
        if value and float(value) >= 1.0
    ]
    count = min(SENSITIVITY_TRIALS, folder.plan().trials)
    sentences = (
        f"Force error under Koopman over that under penalty, {count} trials each with the "
        "seeds of the study. It moves "
        f"most with {VARIANTS[most].parameter} ({VARIANTS[most].value}: {percent[most]} on the "
        "average over tasks).",
        f"Prediction does harm at: {'; '.join(above)}."
        if above
        else "Prediction does no harm at any of these values.",
    )
    header = ("parameter", "value", *tasks, "change")
    whole = (("as in the study", MIDDLE, *map(_as_text, usual), ""), *rows)
    return Section(
        "sensitivity", "Sensitivity", sentences, header, whole, _picture(rows, tasks, usual)
    )


def reference_section(folder: StudyFolder) -> Section | None:
    """Report the error of the reference against the finest model on the same motion."""
    errors: dict[str, list[float]] = {}
    for trial in folder.trials(variant=REFERENCE):
        errors.setdefault(trial.key.task, []).extend(
            100.0 * each for each in trial.values("reference_error").values()
        )
    found = {task: np.array(errors[task]) for task in folder.plan().compared if errors.get(task)}
    if not found:
        return None
    sentences = (
        "F_ideal is the prompt force on the study's own model; against the finest model on "
        "the same motion it is off "
        f"by {', '.join(f'{task} {each.mean():.1f} %' for task, each in found.items())}. "
        "That error is the model's, "
        "common to all methods, and not in their errors above: a method whose error lies "
        "below it is better than the "
        "model that it renders. Where it is zero there is no finer model.",
    )
    rows = tuple((task, spread(each), str(len(each))) for task, each in found.items())
    return Section(
        "reference", "The reference's own error", sentences, ("task", "error %", "trials"), rows
    )


def speed_section(folder: StudyFolder) -> Section:
    """Report the seconds a trial by task, as they were measured while the study ran."""
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
        "Seconds on one worker for a trial under all its methods, with whatever else the "
        "machine did. 900 trials of "
        f"T1 to T3 on two workers take {300.0 * total / 2.0 / 60.0:.0f} min at these medians.",
    )
    return Section(
        "speed", "Speed", sentences, ("task", "median s", "longest s", "methods", "trials"), rows
    )


def _ratios(trials: Iterable[Trial], tasks: Sequence[str]) -> Array:
    """Return the ratio of mean force errors by task, over trials in which no method failed.

    The ratio is NaN if there is no such trial.
    """
    sums = np.zeros((len(tasks), 2))
    for trial in trials:
        errors = trial.values("force_error")
        if trial.key.task in tasks and {"koopman", "penalty"} <= errors.keys():
            sums[tasks.index(trial.key.task)] += errors["koopman"], errors["penalty"]
    return np.array(
        [koopman / penalty if penalty > 0.0 else np.nan for koopman, penalty in sums.tolist()]
    )


def _mean_over(quotients: Array) -> float:
    """Return the mean of the quotients that there are, one without any."""
    known = quotients[np.isfinite(quotients)]
    return float(known.mean()) if len(known) else 1.0


def _as_text(ratio: float) -> str:
    return f"{ratio:.2f}" if np.isfinite(ratio) else ""


def _picture(rows: Sequence[tuple[str, ...]], tasks: Sequence[str], usual: Array) -> bytes:
    """Draw the ratios by variant, one colour a task, the study's own as lines."""
    figure, (axes,) = drawing(9.0, 0.32 * len(rows) + 1.2)
    for at, (task, colour, mark) in enumerate(
        zip(tasks, ("#0072B2", "#D55E00", "#009E73"), "os^", strict=False)
    ):
        places = np.arange(len(rows)) + APART * (at - 0.5 * (len(tasks) - 1))
        axes.plot(
            [float(row[2 + at] or "nan") for row in rows], places, mark, color=colour, label=task
        )
        if np.isfinite(usual[at]):
            axes.axvline(usual[at], color=colour, lw=1.0, ls=":")
    axes.axvline(1.0, color="black", lw=0.8)
    axes.set_yticks(range(len(rows)), [f"{row[0]}: {row[1]}" for row in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("force error, Koopman over penalty (dotted: as in the study)")
    legend(figure, axes)
    return image(figure)
