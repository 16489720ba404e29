"""Report sections of a study: force errors, latency and task metrics."""

from collections.abc import Iterable, Mapping, Sequence

from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.plan import (
    LATENCY_MS,
    TASKS,
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
from tissue.show.figures.figure import plain_numbers

RATIOS = {
    "ratio_error": "error of ratios / %",
    "ratio_floor": "least error of ratios / %",
    "ratio_unscaled": "by the exponent alone / %",
    "ratio_silent": "without any change / %",
}
"""Names of the table columns for metrics on ratios of perceived intensity."""
TIMES = {
    "time s": "time_s",
    "position error mm": "position_error_mm",
    "acceleration change m/s2": "acceleration_change_m_s2",
    "spectral arc length": "spectral_arc_length",
}
"""Metric in each column of the table with time, position error and smoothness."""


def force_section(table: TrialTable) -> Section:
    """Report force errors by task and method, together with the published errors.

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
    left = _error_ratios(table)
    means = ", ".join(
        f"{row['task']} {row['method']} {row['force error / %'].split()[0]}" for row in rows
    )
    sentences = (
        f"Mean force error at the motor in %: {means}.",
        "Error of the played force, ||F - F_ideal|| / ||F_ideal|| over all ticks at the motor. "
        "F_ideal is the force without delay at the device's true position at that time. The least "
        "error is the error of a perfect force with the same encoder steps, low-pass filter and "
        "amplifier. The excess is sqrt(error² - least²). If a tool cuts its own path, the least "
        "error is not a bound, and an excess of 0 does not compare methods. The force is in "
        "newtons, "
        "before it is scaled for a person.",
        "The error of ratios shows the effect of scaling. The ratio is the intensity that this "
        "person feels from the force at the skin, divided by the intensity that the reference "
        "observer feels from the ideal force. The error is the spread of its logarithm over "
        "windows "
        "of 0.1 s. The other columns hold this error for a perfect force with encoder steps, for "
        "the ideal force felt with this person's exponent, and for a force that never changes. A "
        "calibration that finds the reference's exponent only recovers a parameter of these "
        "simulated people. It is not a finding on real people.",
        *left,
    )
    metrics = {"force_error": ("force error / %, 95 % interval\n(◆ paper: mean, SD)", 100.0)}
    if "ratio_error" in table.metrics:
        metrics["ratio_error"] = ("error of intensity ratios / %, 95 % interval", 100.0)
    return Section(
        "force",
        "Force fidelity",
        sentences,
        rows,
        # inches; two panels at most
        _points(table, metrics, (11.0, 4.2)),
        left[0] if left else f"Mean force error at the motor in %: {means}.",
    )


def _error_ratios(table: TrialTable) -> list[str]:
    """Return sentences on how much prediction and personal scaling reduce the errors.

    The sentences state two ratios: force error with prediction over force error without, and error
    of perceived ratios with personal scaling over the error without.
    """
    remarks = []
    for metric, first, second, what in (
        (
            "force_error",
            "penalty",
            "koopman",
            "Force error with prediction, divided by the force error of the penalty law",
        ),
        (
            "ratio_error",
            "koopman",
            "koopman-perception",
            "Error of ratios with scaling for the person, divided by the error without scaling",
        ),
    ):
        if {first, second} <= set(methods_of(table)) and metric in table.metrics:
            ratios = {}
            for task in tasks_of(table):
                parts = (table.where(task=task, method=each) for each in (second, first))
                left, usual = (part.values(metric).mean() for part in parts)
                ratios[task] = left / usual
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

    `metrics` maps the name of a metric to its axis label and a scale factor.

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
    """Return the published force errors, keyed by index of the task and name of the method."""
    figures = {
        (tasks.index(task), method): published(task, FORCE_ERROR[task].get(method))
        for task, method in parts
    }
    return {place: figure for place, figure in figures.items() if figure is not None}


def latency_section(table: TrialTable) -> Section:
    """Report by how much the applied force lags behind a perfectly predicted force.

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
        "Time shift at which the force at the motor correlates best with the force of a perfect "
        f"prediction with the same encoder steps, over all tasks: {shifts}. A negative value is a "
        "force that comes early" + (f" ({early})." if early else "; none does."),
        "The paper's latency is the delay of the whole loop. Here this delay is an input, "
        f"{LATENCY_MS} ms plus the delay up to the motor, so it is not compared.",
    )
    headline = f"The mean lag at the motor is {shifts}."
    return Section("latency", "Latency", sentences, rows, headline=headline)


def task_section(table: TrialTable) -> Section:
    """Report time, smoothness and position error of the tasks, with published errors.

    Failed trials are left out.
    """
    rows = [
        {"task": task, "method": method}
        | {label: spread(part.values(metric)) for label, metric in TIMES.items()}
        | {"completed %": f"{100.0 * part.values('completed').mean():.0f}"}
        for (task, method), part in parts_of(table).items()
    ]
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
