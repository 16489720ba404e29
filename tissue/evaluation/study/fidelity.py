"""Sections of a report on force, latency and tasks."""

from typing import Any

import numpy as np

from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.paper import FORCE_ERROR, LATENCY, TASK_METRICS
from tissue.evaluation.study.section import (
    COLOURS,
    Section,
    agreement,
    drawing,
    image,
    interval_by_users,
    legend,
    spread,
)
from tissue.evaluation.study.tasks import TASKS

__all__ = ["force_section", "latency_section", "task_section"]


def force_section(table: TrialTable) -> Section:
    """Normalised force error of every method on every task, against the paper's."""
    tasks, methods = _labels(table)
    rows: list[tuple[str, ...]] = []
    apart: list[str] = []
    agreeing: list[str] = []
    for task in tasks:
        for method in methods:
            part = table.where(task=task, method=method).complete()
            error = 100.0 * part.values("force_error")
            paper = FORCE_ERROR[task].get(method)
            rows.append(
                (
                    task,
                    method,
                    f"{spread(error)}",
                    str(paper) if paper else "",
                    agreement(error, paper) if paper else "",
                    spread(100.0 * part.values("perceived_error"), 1),
                    str(len(part)),
                )
            )
            if paper:
                (agreeing if rows[-1][4] == "agrees" else apart).append(f"{task} {method} {rows[-1][4]}")
    sentences = [
        "Error of what is played, ||F - F_ideal|| / ||F_ideal|| over all ticks, F_ideal being the prompt force on the "
        "same motion. The force is taken before it is scaled for a person, in newtons; what that scaling does is in "
        "the last column but one, the error of the intensity that this person feels against the reference observer's.",
        f"Agreeing with the paper: {', '.join(agreeing) or 'none'}; not agreeing: {', '.join(apart) or 'none'}.",
        *_ratios(table, tasks, methods),
    ]
    header = ("task", "method", "force error %", "paper %", "against paper", "felt error %", "trials")
    return Section("force", "Force fidelity", tuple(sentences), header, tuple(rows), _force_picture(table))


def _ratios(table: TrialTable, tasks: list[str], methods: list[str]) -> list[str]:
    """The headline: what prediction leaves of the error, and what perception leaves of the felt one."""
    remarks = []
    for metric, first, second, what in (
        ("force_error", "penalty", "koopman", "prediction leaves of the force error"),
        ("perceived_error", "koopman", "koopman-perception", "scaling for the person leaves of the felt error"),
    ):
        if not {first, second} <= set(methods):
            continue
        parts = []
        for task in tasks:
            means = [
                float(table.where(task=task, method=each).complete().values(metric).mean()) for each in (first, second)
            ]
            parts.append((task, means[1] / means[0]))
        worse = [task for task, ratio in parts if ratio >= 1.0]
        sentence = f"{what[0].upper()}{what[1:]}: " + ", ".join(f"{task} {ratio:.2f}" for task, ratio in parts)
        remarks.append(f"{sentence}; it does not help on {', '.join(worse)}." if worse else f"{sentence}.")
    return remarks


def _force_picture(table: TrialTable) -> bytes:
    """Bars with 95 % intervals over users, the paper's figures as diamonds."""
    tasks, methods = _labels(table)
    figure, (left, right) = drawing(11.0, 4.2, 2)
    for axes, metric, what in ((left, "force_error", "force error %"), (right, "perceived_error", "felt error %")):
        _bars(axes, table, metric, 100.0, tasks, methods)
        axes.set_ylabel(what)
    for index, task in enumerate(tasks):
        for shift, method in enumerate(methods):
            if paper := FORCE_ERROR[task].get(method):
                at = index + 0.2 * (shift - 0.5 * (len(methods) - 1))
                left.errorbar(at, paper.mean, paper.spread, fmt="D", color="black", ms=4, capsize=2, lw=0.8)
    left.plot([], [], "kD", ms=4, label="paper ± sd")
    legend(figure, left)
    return image(figure)


def _bars(axes: Any, table: TrialTable, metric: str, scale: float, tasks: list[str], methods: list[str]) -> None:
    """Grouped bars: tasks along the axis, methods beside each other."""
    for shift, method in enumerate(methods):
        means, lows, highs = (
            scale * np.array([interval_by_users(table.where(task=task), metric, method) for task in tasks]).T
        )
        at = np.arange(len(tasks)) + 0.2 * (shift - 0.5 * (len(methods) - 1))
        axes.bar(at, means, 0.18, color=COLOURS[method], label=method)
        axes.errorbar(at, means, [means - lows, highs - means], fmt="none", ecolor="#333333", capsize=3, lw=1.0)
    axes.set_xticks(range(len(tasks)), [f"{task}\n{TASKS[task].scene}" for task in tasks])


def latency_section(table: TrialTable) -> Section:
    """How far the played force lags the ideal one."""
    tasks, methods = _labels(table)
    rows = []
    for task in tasks:
        for method in methods:
            lag = table.where(task=task, method=method).complete().values("latency_ms")
            rows.append((task, method, spread(lag), str(LATENCY), agreement(lag, LATENCY)))
    means = {each: table.where(method=each).complete().values("latency_ms").mean() for each in methods}
    shifts = ", ".join(f"{name} {value:.1f} ms" for name, value in means.items())
    early = [
        f"{task} {method}"
        for task in tasks
        for method in methods
        if table.where(task=task, method=method).complete().values("latency_ms").mean() < 0.0
    ]
    sentences = (
        f"Shift at which played and ideal force correlate best, over all tasks: {shifts}. The loop is late by 4 ms in "
        f"every trial by construction, as the paper's mean is {LATENCY} ms; what prediction takes off is the result, "
        "and a value below zero is a force that comes early" + (f" ({', '.join(early)})." if early else "; none does."),
    )
    header = ("task", "method", "latency ms", "paper ms", "against paper")
    return Section("latency", "Latency", sentences, header, tuple(rows))


def task_section(table: TrialTable) -> Section:
    """Time, position error and smoothness, against the paper's."""
    tasks, methods = _labels(table)
    rows, remarks = [], []
    for task in tasks:
        paper = TASK_METRICS[task]
        for method in methods:
            part = table.where(task=task, method=method).complete()
            rows.append(
                (
                    task,
                    method,
                    spread(part.values("time_s")),
                    str(paper["time_s"]),
                    spread(part.values("position_error_mm")),
                    str(paper["position_error_mm"]),
                    spread(part.values("acceleration_change_m_s2")),
                    spread(part.values("spectral_arc_length")),
                    str(paper["smoothness"]),
                    f"{100.0 * part.values('completed').mean():.0f}",
                )
            )
        of = table.where(task=task).complete()
        remarks.append(
            f"{task}: time {agreement(of.values('time_s'), paper['time_s'])}, position error "
            f"{agreement(of.values('position_error_mm'), paper['position_error_mm'])}"
        )
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
    return Section("tasks", "Task metrics", sentences, header, tuple(rows), _task_picture(table))


def _task_picture(table: TrialTable) -> bytes:
    """Bars of time, position error and arc length."""
    tasks, methods = _labels(table)
    figure, axes = drawing(12.0, 3.6, 3)
    names = {"time_s": "time s", "position_error_mm": "position error mm", "spectral_arc_length": "spectral arc length"}
    for each, (metric, what) in zip(axes, names.items(), strict=True):
        _bars(each, table, metric, 1.0, tasks, methods)
        each.set_ylabel(what)
    legend(figure, axes[0])
    return image(figure)


def _labels(table: TrialTable) -> tuple[list[str], list[str]]:
    """Tasks and methods that have trials, in their order."""
    return [task for task in TASKS if task in table.task], [each for each in COLOURS if each in table.method]
