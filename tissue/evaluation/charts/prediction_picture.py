"""What predictors were measured to do, as pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.evaluation.charts.picture import plain_numbers
from tissue.evaluation.training.train import HORIZONS
from tissue.figures.figure import figure, save
from tissue.scene.registry import PREDICTORS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from tissue.evaluation.charts.prediction import PredictorComparison

__all__ = ["draw_scene", "draw_tasks"]

PAPER = {"palpation": ("T1", 8.2, 3.5), "wall": ("T2", 7.1, 3.0), "milling": ("T3", 9.5, 4.2)}
"""Raw and adjusted errors [%] that a paper prints for its tasks, against its own ideal force."""
STRONG = 1.8
COLUMNS = 4
"""Columns of the legend."""
LIMIT_US = 20.0
"""Median cost of a prediction that is aimed at [us]."""


def draw_scene(found: "PredictorComparison", path: Path) -> None:
    """Draw error over horizon, error over cost, the spectrum, training size, and a model at 100 Hz; one legend."""
    chart = figure(11.0, 7.8)
    axes = chart.subplots(2, 3)
    chart.subplots_adjust(left=0.065, right=0.985, top=0.845, bottom=0.075, wspace=0.27, hspace=0.34)
    runs = len(found.errors["hold"])
    title = f"{found.scene}: {runs} runs with other seeds, in tissue 30 % softer and stiffer; bars and bands are 95 %"
    chart.text(0.065, 0.965, title, size=11)
    for panel, draw in zip(axes.flat, (_over_horizon, _over_cost, _spectrum, _sizes, _slow, _spread), strict=True):
        draw(panel, found)
    chart.legend(
        *axes.flat[0].get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.06, 0.955), ncols=COLUMNS,
        frameon=False,
    )  # fmt: skip
    save(chart, path)


def draw_tasks(found: "Sequence[PredictorComparison]", path: Path) -> None:
    """Draw the error of every predictor at 4 ms on every scene, beside what the paper prints."""
    chart = figure(max(1.9 * len(found) + 1.6, 6.0), 4.4)
    axes = chart.subplots()
    chart.subplots_adjust(left=0.11, right=0.98, top=0.86, bottom=0.1)
    width = 0.8 / (len(PREDICTORS) + 2)
    for place, each in enumerate(found):
        for index, kind in enumerate(PREDICTORS):
            at, x = each.at(kind, 4), place - 0.4 + (index + 0.5) * width
            label_text = kind if place == 0 else None
            axes.bar(x, 100 * at.mean, width, color=PREDICTORS[kind].colour, label=label_text)
            axes.plot([x, x], [100 * at.low, 100 * at.high], color="0.1", linewidth=1.0)
        if each.scene in PAPER:
            _, raw, adjusted = PAPER[each.scene]
            for index, (value, fill, name) in enumerate(
                ((raw, "none", "paper, raw"), (adjusted, "0.1", "paper, adjusted"))
            ):
                x = place - 0.4 + (len(PREDICTORS) + index + 0.5) * width
                first = not any(other.scene in PAPER for other in found[:place])
                axes.plot(x, value, "*", color="0.1", markerfacecolor=fill, markersize=9, label=name if first else None)
    names = [f"{PAPER[each.scene][0]} {each.scene}" if each.scene in PAPER else each.scene for each in found]
    axes.set(
        xticks=range(len(found)), xticklabels=names, ylabel="force error 4 ms ahead / % of the force", yscale="log"
    )
    plain_numbers(axes.yaxis)
    axes.grid(axis="y", which="both", alpha=0.3)
    axes.set_axisbelow(True)
    columns = 7 if len(found) > 3 else 4
    chart.legend(loc="upper center", ncols=columns, frameon=False, fontsize=8.5, columnspacing=1.0, handletextpad=0.4)
    save(chart, path)


def _over_horizon(axes: "Axes", found: "PredictorComparison") -> None:
    for kind in PREDICTORS:
        looks = PREDICTORS[kind]
        percent = [(100 * at.mean, 100 * at.low, 100 * at.high) for at in (found.at(kind, each) for each in HORIZONS)]
        mean, low, high = zip(*percent, strict=True)
        strong = STRONG if kind == "koopman-look-ahead" else 1.1
        axes.plot(HORIZONS, mean, "-" + looks.marker, color=looks.colour, label=kind, markersize=4, linewidth=strong)
        axes.fill_between(HORIZONS, low, high, color=looks.colour, alpha=0.15)
    axes.set(xlabel="horizon / ms", ylabel="force error / %", yscale="log")
    plain_numbers(axes.yaxis)
    axes.grid(alpha=0.3, which="both")


def _over_cost(axes: "Axes", found: "PredictorComparison") -> None:
    for kind in PREDICTORS:
        looks = PREDICTORS[kind]
        at, (median, p99) = found.at(kind, 4), found.cost_us[kind]
        axes.plot([median, p99], [100 * at.mean] * 2, color=looks.colour, alpha=0.5)
        axes.plot(median, 100 * at.mean, looks.marker, color=looks.colour, label=kind, markersize=6)
    axes.axvline(LIMIT_US, color="#D55E00", linestyle="--", linewidth=1.0)
    axes.set(
        xlabel="cost a tick / µs, median to 99 %", ylabel="force error 4 ms ahead / %", xscale="log", ylim=(0, None)
    )
    plain_numbers(axes.xaxis)
    axes.grid(alpha=0.3, which="both")


def _spectrum(axes: "Axes", found: "PredictorComparison") -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    axes.plot(np.cos(turn), np.sin(turn), color="0.6", linewidth=0.8)
    values = found.eigenvalues
    axes.plot(values.real, values.imag, "o", color=PREDICTORS["koopman"].colour, markersize=3, alpha=0.7)
    largest = float(np.abs(values).max())
    axes.set(xlabel="real", ylabel="imaginary", aspect="equal")
    axes.set_title(f"{len(values)} eigenvalues, largest {largest:.5f}", fontsize=9)
    axes.grid(alpha=0.3)


def _sizes(axes: "Axes", found: "PredictorComparison") -> None:
    sizes, at = list(found.sizes), list(found.sizes.values())
    bars = [[100 * (a.mean - a.low) for a in at], [100 * (a.high - a.mean) for a in at]]
    axes.errorbar(
        sizes, [100 * a.mean for a in at], bars, fmt="-o", color=PREDICTORS["koopman"].colour, capsize=3, ms=4
    )
    axes.set(xlabel="runs trained on", ylabel="error 4 ms ahead / %", ylim=(0, None))
    axes.grid(alpha=0.3)


def _slow(axes: "Axes", found: "PredictorComparison") -> None:
    for kind in PREDICTORS:
        looks = PREDICTORS[kind]
        at, cost_us = found.slow[kind]
        bars = [[100 * (at.mean - at.low)], [100 * (at.high - at.mean)]]
        axes.errorbar(cost_us, 100 * at.mean, bars, fmt=looks.marker, color=looks.colour, ms=6)
    axes.plot(found.slow["1 kHz"][1], 0.0, "*", color="0.1", markersize=11, clip_on=False)
    axes.set(xlabel="model and prediction / µs a tick", ylabel="force error now / %", xscale="log", ylim=(0, None))
    axes.set_title("model at 100 Hz; star: at 1 kHz", fontsize=9)
    plain_numbers(axes.xaxis)
    axes.grid(alpha=0.3, which="both")


def _spread(axes: "Axes", found: "PredictorComparison") -> None:
    column = HORIZONS.index(4)
    for place, kind in enumerate(PREDICTORS):
        values = 100 * found.errors[kind][:, column]
        aside = np.linspace(-0.25, 0.25, len(values))
        axes.plot(place + aside, np.sort(values), ".", color=PREDICTORS[kind].colour, markersize=4)
        axes.plot([place - 0.3, place + 0.3], [np.median(values)] * 2, color="0.1", linewidth=1.2)
    axes.set(xticks=[], xlabel="predictors in the legend's order", ylabel="error 4 ms ahead of each run / %")
    axes.set_ylim(0, None)
    axes.grid(axis="y", alpha=0.3)
