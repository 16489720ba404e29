"""Sections of a report on force, latency and tasks."""

import numpy as np
from matplotlib.axes import Axes

from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.paper import FORCE_ERROR, LATENCY, TASK_METRICS
from tissue.evaluation.study.section import (
    COLOURS,
    Section,
    against,
    agreement,
    drawing,
    image,
    interval_by_users,
    legend,
    methods_of,
    spread,
    tasks_of,
)
from tissue.evaluation.study.tasks import TASKS

__all__ = ["force_section", "latency_section", "task_section"]

RATIOS = {
    "ratio_error": "error of ratios / %",
    "ratio_floor": "least error of ratios / %",
    "ratio_unscaled": "by the exponent alone / %",
    "ratio_silent": "without any change / %",
}
"""Columns on ratios of intensity; folders of older studies have the first two."""
UNRESOLVED = 0.05
"""Share of rows with a least error above the error, above which the excess is named as no measure."""
Parts = dict[tuple[str, str], TrialTable]


def _parts(table: TrialTable) -> Parts:
    """Trials by task and method."""
    methods = methods_of(table)
    return {(task, method): table.where(task=task, method=method) for task in tasks_of(table) for method in methods}


def force_section(table: TrialTable) -> Section:
    """Normalised force error of every method on every task against the paper's, of trials that did not fail."""
    rows = []
    for (task, method), part in _parts(table).items():
        error = 100.0 * part.values("force_error")
        felt = [spread(100.0 * part.values(each), 1) for each in RATIOS if each in part.metrics]
        shares = (spread(100.0 * part.values(each)) for each in ("least_error", "excess_error"))
        paper = against(error, FORCE_ERROR[task].get(method))
        rows.append((task, method, spread(error), *paper, *shares, *felt, str(len(part))))
    judged = [(f"{row[0]} {row[1]} {row[4]}", row[4] == "agrees") for row in rows if row[3]]
    agreeing, apart = (", ".join(what for what, agrees in judged if agrees is wanted) for wanted in (True, False))
    sentences = (
        "Error of what is played, ||F - F_ideal|| / ||F_ideal|| over all ticks at the motor, F_ideal being the prompt "
        "force at the device's true position at that time. Beside it stand the least error, that of a perfect force "
        "through the same encoder steps, low-pass and amplifier, and what is in excess of it, sqrt(error² - least²). "
        "The force is taken before it is scaled for a person, in newtons.",
        "What scaling does is shown by ratios of intensity, in windows of a tenth of a second: the spread of the "
        "logarithm of what this person feels of the force at the skin over what the reference feels of the ideal one, "
        "beside that of a perfect force through the same encoder steps, that of the ideal force by this person's "
        "exponent alone, and that of a force that never changes. That a calibration brings a person to the "
        "reference's exponent is a recovery of the parameters by which these people were made, no finding on people.",
        *_unresolved(table),
        f"Agreeing with the paper: {agreeing or 'none'}; not agreeing: {apart or 'none'}.",
        *_ratios(table),
    )
    header = (
        "task", "method", "force error / %", "paper %", "against paper", "least error %", "excess %",
        *(name for each, name in RATIOS.items() if each in table.metrics), "trials",
    )  # fmt: skip
    return Section("force", "Force fidelity", sentences, header, tuple(rows), _force_picture(table))


def _unresolved(table: TrialTable) -> list[str]:
    """Tasks in which the least error is no bound: played and perfect force come of tools on courses of their own."""
    if "least_error" not in table.metrics:
        return []
    shares = {}
    for task in tasks_of(table):
        part = table.where(task=task)
        shares[task] = float((part.values("least_error") >= part.values("force_error")).mean())
    above = ", ".join(f"{task} {100.0 * share:.0f} %" for task, share in shares.items() if share > UNRESOLVED)
    return [
        f"The least error is no bound where a tool cuts its own course, which the perfect force's does not share: it "
        f"exceeds the error in {above} of the rows, so that there the excess, then set to 0, is no measure of methods."
    ] if above else []  # fmt: skip


def _ratios(table: TrialTable) -> list[str]:
    """The headline: what prediction leaves of the error, and perception of that of ratios."""
    remarks, parts = [], _parts(table)
    for metric, first, second, what in (
        ("force_error", "penalty", "koopman", "Prediction leaves of the force error"),
        ("ratio_error", "koopman", "koopman-perception", "Scaling for the person leaves of the error of ratios"),
    ):
        if {first, second} <= set(methods_of(table)):
            means = {key: float(part.values(metric).mean()) for key, part in parts.items()}
            ratios = {task: means[task, second] / means[task, first] for task in tasks_of(table)}
            worse = ", ".join(task for task, ratio in ratios.items() if ratio >= 1.0)
            found = ", ".join(f"{task} {ratio:.2f}" for task, ratio in ratios.items())
            remarks.append(f"{what}: {found}{f'; it does not help on {worse}' if worse else ''}.")
    return remarks


def _force_picture(table: TrialTable) -> bytes:
    """Bars with 95 % intervals over users, the paper's figures as diamonds."""
    figure, (left, right) = drawing(11.0, 4.2, 2)
    _bars(left, table, "force_error", "force error %", 100.0)
    _bars(right, table, "ratio_error", "error of intensity ratios / %", 100.0)
    methods = methods_of(table)
    for index, task in enumerate(tasks_of(table)):
        for shift, method in enumerate(methods):
            if paper := FORCE_ERROR[task].get(method):
                at = index + 0.84 / len(methods) * (shift - 0.5 * (len(methods) - 1))
                left.errorbar(at, paper.mean, paper.spread, fmt="D", color="black", ms=4, capsize=2, lw=0.8)
    left.plot([], [], "kD", ms=4, label="paper ± sd")
    legend(figure, left)
    return image(figure)


def _bars(axes: Axes, table: TrialTable, metric: str, label: str, scale: float = 1.0) -> None:
    """Grouped bars: tasks along the axis, methods beside each other."""
    tasks, methods = tasks_of(table), methods_of(table)
    for shift, method in enumerate(methods):
        means, lows, highs = (
            scale * np.array([interval_by_users(table.where(task=task), metric, method) for task in tasks]).T
        )
        at = np.arange(len(tasks)) + 0.84 / len(methods) * (shift - 0.5 * (len(methods) - 1))
        axes.bar(at, means, 0.76 / len(methods), color=COLOURS[method], label=method)
        axes.errorbar(at, means, [means - lows, highs - means], fmt="none", ecolor="#333333", capsize=3, lw=1.0)
    axes.set_xticks(range(len(tasks)), [f"{task}\n{TASKS[task].scene}" for task in tasks])
    axes.set_ylabel(label)


def latency_section(table: TrialTable) -> Section:
    """How far the played force lags that of a perfect prediction, in trials that did not fail."""
    lags = {key: part.values("latency_ms") for key, part in _parts(table).items()}
    rows = tuple((*key, spread(lag), *against(lag, LATENCY)) for key, lag in lags.items())
    means = {each: table.where(method=each).values("latency_ms").mean() for each in methods_of(table)}
    shifts = ", ".join(f"{name} {value:.1f} ms" for name, value in means.items())
    early = ", ".join(" ".join(key) for key, lag in lags.items() if lag.mean() < 0.0)
    sentences = (
        "Shift at which the force at the motor correlates best with that of a perfect prediction through the same "
        f"encoder steps, over all tasks: {shifts}. The loop is late by 4 ms and its path to the motor in every trial "
        f"by construction, the paper's mean being {LATENCY} ms; what prediction takes off is the result, and a value "
        "below zero is a force that comes early" + (f" ({early})." if early else "; none does."),
    )
    header = ("task", "method", "latency ms", "paper ms", "against paper")
    return Section("latency", "Latency", sentences, header, rows)


def task_section(table: TrialTable) -> Section:
    """Time, position error and smoothness of trials that did not fail, against the paper's."""
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
        for (task, method), part in _parts(table).items()
    )
    remarks = []
    for task in tasks_of(table):
        time, position = (
            agreement(table.where(task=task).values(name), TASK_METRICS[task][name])
            for name in ("time_s", "position_error_mm")
        )
        remarks.append(f"{task}: time {time}, position error {position}")
    sentences = (
        f"Against the paper, {'; '.join(remarks)}. Our tasks are a few seconds long, so that their time is not the "
        "paper's; the position error is the mean distance of the tool from its wanted path.",
        "The paper's index of smoothness cannot be compared: its formula, a mean change of acceleration [m/s2], is "
        "lower for smoother motion, its table reads as if higher were better. Both that formula and the spectral arc "
        "length (nearer to zero is smoother) are given.",
    )
    header = (
        "task", "method", "time s", "paper s", "position error mm", "paper mm", "acceleration change m/s2",
        "spectral arc length", "paper's index", "completed %",
    )  # fmt: skip
    return Section("tasks", "Task metrics", sentences, header, rows, _task_picture(table))


def _task_picture(table: TrialTable) -> bytes:
    """Bars of time, position error and arc length."""
    figure, axes = drawing(12.0, 3.6, 3)
    names = {
        "time_s": "time / s",
        "position_error_mm": "position error / mm",
        "spectral_arc_length": "spectral arc length",
    }
    for each, (metric, what) in zip(axes, names.items(), strict=True):
        _bars(each, table, metric, what)
    legend(figure, axes[0])
    return image(figure)
