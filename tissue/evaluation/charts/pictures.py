"""Pictures of charts: speed against accuracy of scenes, and errors of predictors."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.evaluation.charts.frontier import Frontier
from tissue.evaluation.charts.measure import Measured
from tissue.evaluation.training import HORIZONS
from tissue.scene.registry import PREDICTORS
from tissue.show.figures.figure import figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

    from tissue.evaluation.charts.prediction import PredictorComparison
    from tissue.scene.entries import PredictorEntry

__all__ = ["draw_frontiers", "draw_overview", "draw_scene", "draw_tasks"]

# Colours after Okabe and Ito (2008), where possible.
ORANGE = "#D55E00"
LAW = "#882255"
FAMILIES = {
    "voxels": ("#0072B2", "o", "voxels"),
    "shell": ("#56B4E9", "s", "elements of the cutter"),
    "stress": ("#CC79A7", "D", "with stress"),
    "elements": ("#009E73", "p", "elements"),
    "path": ("#E69F00", "H", "compliance"),
    "cores": ("0.45", "h", "one core"),
    "loop": (ORANGE, "o", "renderer, predictor, model rate"),
    "model": ("0.2", "o", "the model"),
}
"""Colour, mark and label of each family of settings."""
LEAST = 1e-4
"""Error that is drawn for zero [%], on logarithmic axes."""
PANEL_IN = 4.6
BESIDE_IN = 2.6
LEFT_IN = 0.72
HIGH_IN = 4.6
"""Width of a panel, of the names next to it and of its axis, and height of a picture [in]."""
BY = {"script": ("#0072B2", "o", "by script: model"), "hand": ("#B34700", "s", "by hand: loop")}
"""Looks in the overview. The second colour is dark enough for text."""
COLUMNS = 4
OVERVIEW_PANEL_IN = 2.0
OVERVIEW_BESIDE_IN = 1.95
OVERVIEW_HIGH_IN = 2.45
OVERVIEW_TOP_IN = 0.6
OVERVIEW_TICKS_US = (30.0, 1.4e3)
PAPER = {"palpation": ("T1", 8.2, 3.5), "wall": ("T2", 7.1, 3.0), "milling": ("T3", 9.5, 4.2)}
"""Task, and raw and adjusted errors [%] printed in a paper, against its own ideal force."""
LIMIT_US = 20.0
"""Median cost of a prediction that is aimed at [us]."""


def draw_frontiers(found: Sequence[Frontier], path: Path) -> None:
    """Draw a panel for each frontier: median tick with its 99th percentile against force error.

    Pareto-optimal settings have numbers, which are named next to the panel. The uncertainty of the
    reference is shaded. Lines across are errors that no setting reduces: of the linear law, dashed,
    and of float32, dotted.
    """
    step = LEFT_IN + PANEL_IN + BESIDE_IN
    wide = step * len(found)
    chart = figure(wide, HIGH_IN)
    for index, each in enumerate(found):
        axes = chart.add_axes(((index * step + LEFT_IN) / wide, 0.13, PANEL_IN / wide, 0.79))
        _draw_frontier(axes, each)
    save(chart, path)


def draw_overview(found: Sequence[Sequence[Frontier]], path: Path) -> None:
    """Draw a small panel for each scene with its Pareto-optimal settings by script and by hand."""
    columns = min(COLUMNS, len(found))
    rows = -(-len(found) // columns)
    width = (OVERVIEW_PANEL_IN + OVERVIEW_BESIDE_IN) * columns + 0.55
    height = OVERVIEW_HIGH_IN * rows + OVERVIEW_TOP_IN
    chart = figure(width, height)
    panels = chart.subplots(rows, columns, squeeze=False).ravel()
    chart.subplots_adjust(
        left=0.72 / width,
        right=1.0 - (OVERVIEW_BESIDE_IN - 0.17) / width,
        top=1.0 - OVERVIEW_TOP_IN / height,
        bottom=0.48 / height,
        wspace=OVERVIEW_BESIDE_IN / OVERVIEW_PANEL_IN,
        hspace=0.28,
    )
    for axes in panels[len(found) :]:
        axes.set_axis_off()
    for place, (axes, both) in enumerate(zip(panels, found, strict=False)):
        _draw_both(axes, both)
        axes.set_ylabel("force error / %" if place % columns == 0 else "")
        axes.set_xlabel("tick / µs" if place + columns >= len(found) else "")
    lines = {str(line.get_label()): line for axes in panels for line in axes.lines}
    named = {label: line for label, line in lines.items() if not label.startswith("_")}
    chart.legend(
        named.values(),
        named.keys(),
        loc="upper center",
        ncols=min(columns + 1, len(named)),
        frameon=False,
    )
    save(chart, path)


def _draw_frontier(axes: "Axes", found: Frontier) -> None:
    """Draw all settings of a scene."""
    labelled: set[str] = set()
    for point in found.points:
        colour, mark, label = FAMILIES[point.family]
        error = _percent(point.force_error)
        axes.plot(
            [point.median_us, point.p99_us], [error, error], color=colour, linewidth=0.8, alpha=0.5
        )
        axes.plot(
            point.median_us, error, mark, color=colour, label=None if label in labelled else label
        )
        labelled.add(label)
        if point.error_50_ms > 0.0:
            over = _percent(point.error_50_ms)
            axes.plot([point.median_us] * 2, [error, over], color=colour, linewidth=0.8, alpha=0.5)
            axes.plot(
                point.median_us, over, mark, color=colour, markersize=4.0, markerfacecolor="white"
            )
    axes.plot(
        [], [], "o", color="0.4", markersize=4.0, markerfacecolor="white", label="error over 50 ms"
    )
    best = found.best
    errors = [_percent(point.force_error) for point in best]
    axes.step(
        [p.median_us for p in best],
        errors,
        where="post",
        color="0.15",
        linewidth=1.4,
        label="frontier",
    )
    for number, (point, error) in enumerate(zip(best, errors, strict=True), 1):
        colour, mark, _ = FAMILIES[point.family]
        _numbered(axes, (point.median_us, error), number, colour, mark)
    for row in found.bounds:
        _draw_bound(axes, row)
    axes.axvline(1e3, color=ORANGE, linestyle="--", linewidth=1.3, label="1 ms")
    low, high = _limits(found)
    if found.gap > 0.0:
        axes.axhspan(
            low, 100.0 * found.gap, color="0.9", zorder=0, label="uncertainty of the reference"
        )
    axes.set_ylim(low, high)  # before the scale: the limits of a single error have no width
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="tick in contact / µs: median, line to its 99th percentile",
        ylabel="force error over ticks / %, to the reference",
        title=f"{found.scene.name}, {_how(found)}",
    )
    _plain_numbers(axes.yaxis)
    _plain_numbers(axes.xaxis)
    axes.grid(alpha=0.3, which="both")
    left = 1.0 + 0.12 / PANEL_IN
    axes.text(left, 1.0, "frontier", transform=axes.transAxes, weight="bold", va="top")
    names = [(point.setting, FAMILIES[point.family][0]) for point in best]
    _write_names(axes, names, left, row=0.165 / (0.79 * HIGH_IN), first=1)
    axes.legend(
        loc="lower left", bbox_to_anchor=(left, 0.0), borderaxespad=0.0, fontsize=8, frameon=False
    )


def _limits(found: Frontier) -> tuple[float, float]:
    """Return limits of the error axis [%]. The error of float32 may lie below them."""
    errors = [_percent(point.force_error) for point in found.points]
    laws = [_percent(row.force_error) for row in found.bounds if row.family == "law"]
    known = [100.0 * found.gap, *(100.0 * point.error_50_ms for point in found.points)]
    low = 0.5 * min([*errors, *laws, *(each for each in known if each > 0.0)])
    return low, 2.2 * max([*errors, *laws, 0.1])


def _draw_bound(axes: "Axes", row: Measured) -> None:
    """Draw an error that no setting reduces."""
    error = _percent(row.force_error)
    if row.family == "rounding":
        axes.axhline(
            error,
            color="0.35",
            linestyle=":",
            linewidth=1.6,
            label=f"float32 rounding, {error:.1g} %",
        )
    else:
        label = f"linear law: {error:.2g} % off neo-Hookean\non this motion"
        axes.axhline(error, color=LAW, linestyle="--", linewidth=1.3, label=label)


def _draw_both(axes: "Axes", both: Sequence[Frontier]) -> None:
    """Draw the frontiers of one scene by script and by hand."""
    points = []
    for found in both:
        colour, mark, label = BY["script" if found.scene.device is None else "hand"]
        errors = [100.0 * max(point.force_error, 1e-4) for point in found.best]
        ticks = [point.median_us for point in found.best]
        names = [point.setting.replace(" mm, shell ", ", ") for point in found.best]
        points += [(*each, colour, mark) for each in zip(errors, ticks, names, strict=True)]
        axes.step([*ticks, 1e3], [*errors, errors[-1]], where="post", color=colour, linewidth=1.5)
        axes.plot([], [], mark, color=colour, markersize=7.0, label=label)
    axes.axvline(1e3, color="0.2", linestyle="--", linewidth=1.2, label="1 ms, the haptic tick")
    points.sort(reverse=True)
    for number, (error, tick, _, colour, mark) in enumerate(points, 1):
        _numbered(axes, (tick, error), number, colour, mark)
    names_and_colours = [(name, colour) for _, _, name, colour, _ in points]
    _write_names(axes, names_and_colours, 1.05, row=0.185 / (0.76 * OVERVIEW_HIGH_IN), first=0)
    heights = np.log([error for error, *_ in points])
    low = heights.min() - 0.5
    high = max(heights.max(), heights.min() + 1.0) + 0.4
    axes.set(
        xscale="log",
        yscale="log",
        xlim=OVERVIEW_TICKS_US,
        ylim=np.exp([low, high]),
        title=both[0].scene.name,
    )
    axes.set_xticks([100.0, 1e3], ["100", "1000"])
    axes.xaxis.set_minor_formatter("")
    _plain_numbers(axes.yaxis)
    axes.grid(alpha=0.25)


def _percent(error: float) -> float:
    """Return an error in per cent, large enough for a logarithmic axis."""
    return max(100.0 * error, LEAST)


def _how(found: Frontier) -> str:
    """Return how the tool of a frontier is moved."""
    return "by script" if found.scene.device is None else f"by hand on {found.scene.held.kind}"


def _numbered(
    axes: "Axes", place: tuple[float, float], number: int, colour: str, mark: str
) -> None:
    """Mark a Pareto-optimal setting with its number."""
    axes.plot(
        *place,
        mark,
        color=colour,
        markersize=11.5,
        markeredgecolor="white",
        markeredgewidth=0.7,
        zorder=4,
    )
    axes.annotate(
        f"{number}",
        place,
        xytext=(0.0, -0.3),
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=7.5,
        weight="bold",
        color="white",
        zorder=5,
    )


def _write_names(
    axes: "Axes", names: Sequence[tuple[str, str]], left: float, *, row: float, first: int
) -> None:
    """Write numbered names in their colours to the right of a panel.

    ``row`` and ``left`` are shares of the panel.
    """
    for number, (name, colour) in enumerate(names, 1):
        height = 1.0 - (number - 1 + first) * row
        label = f"{number}  {name}"
        axes.text(
            left, height, label, transform=axes.transAxes, fontsize=8.5, color=colour, va="top"
        )


def _plain_numbers(axis: "Axis") -> None:
    """Write numbers instead of powers of ten on a logarithmic axis.

    Few numbers are written over many decades.
    """
    from matplotlib.ticker import LogLocator

    low, high = axis.get_view_interval()
    wide = high > 2e3 * low > 0.0
    axis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def draw_scene(found: "PredictorComparison", path: Path) -> None:
    """Draw the results of all predictors on a scene.

    The panels show error over horizon and over cost, the spectrum, training sizes, a model at 100
    Hz, and all runs.
    """
    chart = figure(11.0, 7.8)
    panels = chart.subplots(2, 3)
    chart.subplots_adjust(
        left=0.065, right=0.985, top=0.845, bottom=0.075, wspace=0.27, hspace=0.34
    )
    runs = len(found.errors["hold"])
    title = (
        f"{found.scene}: {runs} runs with other seeds, in tissue 30 % softer and stiffer; bars "
        "and bands are 95 %"
    )
    chart.text(0.065, 0.965, title, size=11)
    _over_horizon(panels[0, 0], found)
    _over_cost(panels[0, 1], found)
    _spectrum(panels[0, 2], found)
    _sizes(panels[1, 0], found)
    _slow(panels[1, 1], found)
    _spread(panels[1, 2], found)
    for axes in panels.flat:
        axes.grid(alpha=0.3, which="both")
    handles = panels[0, 0].get_legend_handles_labels()
    chart.legend(*handles, loc="upper left", bbox_to_anchor=(0.06, 0.955), ncols=4, frameon=False)
    save(chart, path)


def draw_tasks(found: "Sequence[PredictorComparison]", path: Path) -> None:
    """Draw the error of every predictor at 4 ms on every scene, next to the paper's errors."""
    chart = figure(max(1.9 * len(found) + 1.6, 6.0), 4.4)
    axes = chart.subplots()
    chart.subplots_adjust(left=0.11, right=0.98, top=0.86, bottom=0.1)
    width = 0.8 / (len(PREDICTORS) + 2)
    names = []
    for place, each in enumerate(found):
        left = place - 0.4 + 0.5 * width
        for index, (kind, looks) in enumerate(_predictors()):
            at = each.at(kind, 4)
            x = left + index * width
            axes.bar(x, 100 * at.mean, width, color=looks.colour, label=None if place else kind)
            axes.plot([x, x], [100 * at.low, 100 * at.high], color="0.1", linewidth=1.0)
        task, *printed = PAPER.get(each.scene, ("",))
        for index, value in enumerate(printed, len(PREDICTORS)):
            fill = "none" if index == len(PREDICTORS) else "0.1"
            axes.plot(
                left + index * width, value, "*", color="0.1", markerfacecolor=fill, markersize=9
            )
        names.append(f"{task} {each.scene}".strip())
    for fill, label in (("none", "paper, raw"), ("0.1", "paper, adjusted")):
        axes.plot([], [], "*", color="0.1", markerfacecolor=fill, markersize=9, label=label)
    label = "force error 4 ms ahead / % of the force"
    axes.set(xticks=range(len(found)), xticklabels=names, ylabel=label, yscale="log")
    _plain_numbers(axes.yaxis)
    axes.grid(axis="y", which="both", alpha=0.3)
    axes.set_axisbelow(True)
    columns = 7 if len(found) > 3 else 5
    chart.legend(
        loc="upper center",
        ncols=columns,
        frameon=False,
        fontsize=8.5,
        columnspacing=1.0,
        handletextpad=0.4,
    )
    save(chart, path)


def _predictors() -> "list[tuple[str, PredictorEntry]]":
    """Return all predictors with their colours and marks."""
    return [(kind, PREDICTORS[kind]) for kind in PREDICTORS]


def _over_horizon(axes: "Axes", found: "PredictorComparison") -> None:
    """Draw mean errors over the horizon."""
    for kind, looks in _predictors():
        mean, low, high = 100 * np.array([found.at(kind, each) for each in HORIZONS]).T
        axes.plot(HORIZONS, mean, "-" + looks.marker, color=looks.colour, label=kind, markersize=4)
        axes.fill_between(HORIZONS, low, high, color=looks.colour, alpha=0.15)
    axes.set(xlabel="horizon / ms", ylabel="force error / %", yscale="log")
    _plain_numbers(axes.yaxis)


def _over_cost(axes: "Axes", found: "PredictorComparison") -> None:
    """Draw errors at 4 ms over the cost of a prediction."""
    for kind, looks in _predictors():
        error = 100 * found.at(kind, 4).mean
        median, p99 = found.cost_us[kind]
        axes.plot([median, p99], [error, error], color=looks.colour, alpha=0.5)
        axes.plot(median, error, looks.marker, color=looks.colour, markersize=6)
    axes.axvline(LIMIT_US, color=ORANGE, linestyle="--", linewidth=1.0)
    label = "cost a tick / µs, median to 99 %"
    axes.set(xlabel=label, ylabel="force error 4 ms ahead / %", xscale="log", ylim=(0, None))
    _plain_numbers(axes.xaxis)


def _spectrum(axes: "Axes", found: "PredictorComparison") -> None:
    """Draw the eigenvalues of the lifted operator with the unit circle."""
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    values = found.eigenvalues
    axes.plot(np.cos(turn), np.sin(turn), color="0.6", linewidth=0.8)
    axes.plot(
        values.real, values.imag, "o", color=PREDICTORS["koopman"].colour, markersize=3, alpha=0.7
    )
    axes.set(xlabel="real", ylabel="imaginary", aspect="equal")
    axes.set_title(f"{len(values)} eigenvalues, largest {np.abs(values).max():.5f}", fontsize=9)


def _sizes(axes: "Axes", found: "PredictorComparison") -> None:
    """Draw the error at 4 ms over the number of training runs."""
    mean, low, high = 100 * np.array(list(found.sizes.values())).T
    colour = PREDICTORS["koopman"].colour
    axes.errorbar(
        list(found.sizes), mean, (mean - low, high - mean), fmt="-o", color=colour, capsize=3, ms=4
    )
    axes.set(xlabel="training runs", ylabel="error 4 ms ahead / %", ylim=(0, None))


def _slow(axes: "Axes", found: "PredictorComparison") -> None:
    """Draw errors with a model at 100 Hz over the cost of model and prediction."""
    for kind, looks in _predictors():
        at, cost_us = found.slow[kind]
        mean, low, high = 100 * np.array(at)
        axes.errorbar(
            cost_us, mean, [[mean - low], [high - mean]], fmt=looks.marker, color=looks.colour, ms=6
        )
    axes.plot(found.slow["1 kHz"][1], 0.0, "*", color="0.1", markersize=11, clip_on=False)
    axes.set(
        xlabel="model and prediction / µs a tick",
        ylabel="force error now / %",
        xscale="log",
        ylim=(0, None),
    )
    axes.set_title("model at 100 Hz; star: at 1 kHz", fontsize=9)
    _plain_numbers(axes.xaxis)


def _spread(axes: "Axes", found: "PredictorComparison") -> None:
    """Draw the error at 4 ms of every run, sorted, with the median."""
    for place, (kind, looks) in enumerate(_predictors()):
        values = np.sort(100 * found.errors[kind][:, HORIZONS.index(4)])
        axes.plot(
            place + np.linspace(-0.25, 0.25, len(values)),
            values,
            ".",
            color=looks.colour,
            markersize=4,
        )
        axes.plot([place - 0.3, place + 0.3], [np.median(values)] * 2, color="0.1", linewidth=1.2)
    axes.set(
        xticks=[],
        xlabel="predictors in the order of the legend",
        ylabel="error of each run / %",
        ylim=(0, None),
    )
