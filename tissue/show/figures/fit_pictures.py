"""Figures of a fit and of a band: loads, residuals, constants and sensitivities."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Array
from tissue.show.figures.figure import (
    COMPONENTS,
    legend_above,
    panelled,
    plain,
    save,
    styled,
    torque_unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "FittedConstant",
    "draw_band",
    "draw_constants",
    "draw_measured",
    "draw_presses",
    "draw_sobol",
    "draw_table",
]

MEASURED = "0.55"
SIMULATED = "#0072B2"
PRIOR = "0.75"
ROW = 0.44
FRAME = 1.0
"""Height of the row of a constant, and of the frame around the rows [in]."""


@dataclass(frozen=True)
class FittedConstant:
    """Constant before and after a fit, for a picture of the fit.

    Attributes
    ----------
    label
        Name without unit.
    unit
        Unit of the constant.
    cited, fitted
        Lower end of the 90 % interval, median, and upper end of the interval, before the fit
        (`cited`) and after it (`fitted`).
    fitted_z, cited_z
        The three values of `fitted`, and the two ends of `cited`, in standard deviations of the
        prior.
    is_identified
        True if the measurement narrows the range of the constant.
    """

    label: str
    unit: str
    cited: tuple[float, float, float]
    fitted: tuple[float, float, float]
    fitted_z: tuple[float, float, float]
    cited_z: tuple[float, float]
    is_identified: bool


@styled
def draw_measured(
    times_s: Array, measured: Array, simulated: Array, channels: Sequence[str], path: Path
) -> None:
    """Draw measured and simulated loads over time, with their residuals.

    A residual is a measured load minus the simulated load. Forces and torques have separate panels,
    each with its residuals below.

    Parameters
    ----------
    times_s
        Times [s], shape (n,).
    measured, simulated
        Loads, shape (n, channels); NaN where there is no measurement.
    channels
        Names with units, such as ``force_x_N``.
    path
        File to write.
    """
    groups: dict[str, list[int]] = {}
    for at, name in enumerate(channels):
        groups.setdefault(name.partition("_")[0], []).append(at)
    chart, panels = panelled(
        "measured and simulated loads",
        # inches: each group has its loads, and its residuals at half the height
        (8.0, 0.9 + 2.9 * len(groups)),
        2 * len(groups),
        sharex=True,
        height_ratios=(2.0, 1.0) * len(groups),
    )
    for (what, places), loads, rest in zip(groups.items(), panels[::2], panels[1::2], strict=True):
        unit = channels[places[0]].rpartition("_")[2]
        colours = COMPONENTS if len(places) > 1 else (SIMULATED,)
        for colour, at in zip(colours, places, strict=False):
            axis = channels[at].removesuffix(f"_{unit}").rpartition("_")[2]
            loads.plot(times_s, measured[:, at], color=MEASURED, linewidth=2.2, zorder=1)
            loads.plot(times_s, simulated[:, at], color=colour, linewidth=1.1, label=axis, zorder=2)
            rest.plot(times_s, measured[:, at] - simulated[:, at], color=colour, linewidth=0.8)
        loads.plot([], [], color=MEASURED, linewidth=2.2, label="measured")
        shown = unit.replace("Nm", "N m")
        loads.set_ylabel(f"{what} / {shown}")
        rest.set_ylabel(f"residual / {shown}")
    # the measured load and three axes
    legend_above(panels[0], 4)
    panels[-1].set_xlabel("time / s")
    plain(panels)
    save(chart, path)


@styled
def draw_table(
    feeds_mm: Array,
    measured: Array,
    simulated: Array,
    scatter: Array | None,
    channels: Sequence[str],
    path: Path,
) -> None:
    """Draw measured and simulated steady loads as functions of the feed per turn.

    Parameters
    ----------
    feeds_mm
        Feed per turn [mm], shape (n,).
    measured, simulated, scatter
        Measured loads, simulated loads, and standard deviations of the measured loads, each of
        shape (n, channels). `scatter` may be None.
    channels
        Names with units, such as ``force_z_N``.
    path
        File to write.
    """
    chart, panels = panelled(
        "measured and simulated loads", (8.0, 3.4), 1, len(channels), sharex=True
    )
    order = np.argsort(feeds_mm)
    for at, (name, axes) in enumerate(zip(channels, panels, strict=True)):
        bars = None if scatter is None else scatter[:, at]
        look = {"fmt": "o", "color": MEASURED, "markersize": 5.0}
        axes.errorbar(feeds_mm, measured[:, at], bars, label="measured", **look)
        fitted = {"color": SIMULATED, "marker": ".", "label": "fitted"}
        axes.plot(feeds_mm[order], simulated[order, at], **fitted)
        what = "torque / N m" if name.endswith("Nm") else "thrust / N"
        axes.set(xlabel="feed per turn / mm", ylabel=what)
    legend_above(panels[0], 2)
    plain(panels)
    for axes in panels:
        axes.set(xlim=(0.0, 1.05 * feeds_mm.max()), ylim=(0.0, None))
    save(chart, path)


@styled
def draw_presses(
    depths_mm: Array, forces_N: Array, fitted_N: Array, path: Path, *, law: str
) -> None:
    """Draw the measured and the fitted force of presses over depth.

    The measured force is drawn as the median of the presses, and as the range from 5 to 95 %.

    Parameters
    ----------
    depths_mm
        Depths [mm], shape (d,).
    forces_N
        Force of each press [N], shape (n, d).
    fitted_N
        Fitted force [N], shape (d,).
    path
        File to write.
    law
        Name of the fitted law.
    """
    chart, (axes,) = panelled("presses and fitted force", (6.4, 4.0), 1)
    low, middle, high = np.quantile(forces_N, [0.05, 0.5, 0.95], axis=0)
    axes.fill_between(depths_mm, low, high, color=MEASURED, alpha=0.25, label="5 to 95 %")
    axes.plot(depths_mm, middle, "o", color=MEASURED, markersize=5.0, label="median")
    axes.plot(depths_mm, fitted_N, color=SIMULATED, label=law)
    axes.set(xlabel="depth / mm", ylabel="force / N", xlim=(0.0, None))
    legend_above(axes, 3)
    plain([axes])
    save(chart, path)


@styled
def draw_constants(constants: Sequence[FittedConstant], path: Path, *, source: str = "log") -> None:
    """Draw medians and 90 % intervals of constants before and after a fit.

    The horizontal axis is in standard deviations of the prior. `source` names the kind of
    measurement in the text of the picture.
    """
    chart, (axes,) = panelled("constants of the fit", (8.0, FRAME + ROW * len(constants)))
    for row, one in enumerate(constants):
        least, most = one.cited_z
        # 0.3 of the row is left between two bars
        axes.barh(row, most - least, left=least, height=0.7, color=PRIOR, linewidth=0.0)
        low, middle, high = one.fitted_z
        colour = SIMULATED if one.is_identified else "0.45"
        axes.plot([low, high], [row, row], color=colour, linewidth=3.2, solid_capstyle="butt")
        axes.plot(middle, row, "o", color=colour, markersize=5.0)
        cited, found = (
            f"{value:.3g} ({least:.3g} to {most:.3g}) {one.unit}"
            for least, value, most in (one.cited, one.fitted)
        )
        lines = found if one.is_identified else f"not narrowed by this {source}", f"cited {cited}"
        # two lines of text within a row of height 1
        for shift, line, look in zip((-0.2, 0.22), lines, (colour, "0.45"), strict=True):
            across = axes.get_yaxis_transform()
            # to the right of the panel, the fitted interval above the cited one
            axes.text(1.03, row + shift, line, transform=across, va="center", size=8, color=look)
    axes.barh(0, 0, color=PRIOR, label="cited")
    axes.plot([], [], "o-", color=SIMULATED, linewidth=3.2, label="fitted")
    legend_above(axes, 2)
    axes.set_yticks(range(len(constants)), [one.label for one in constants])
    # the first constant on top, with a margin around the bars of height 0.7
    axes.set_ylim(len(constants) - 0.4, -0.6)
    # at least the cited range, 1.64 standard deviations to either side, with a margin
    reach = 1.05 * max(2.2, *(abs(z) for one in constants for z in one.fitted_z))
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("standard deviations of the cited range")
    axes.spines[["top", "right"]].set_visible(False)
    save(chart, path)


OUTER = 0.22
INNER = 0.4
"""Opacity of the 90 % band, and of the 50 % band on top of it."""
FIRST = "#0072B2"
TOTAL = "#E69F00"
SHOWN = 8
"""Largest number of constants in a bar chart.

The chart states the number of constants that are left out. These constants have the smallest Sobol
indices.
"""
UNIT = re.compile(r"(_(N|Nm|[mu]?m[23]?|m?s|kg|kgK|[kMG]Pa|Hz|J|W|mK|rad))+$")
"""Pattern of the unit at the end of the name of a constant."""
WORDS = {
    "force_N.peak": "peak force",
    "force_N.mean_in_contact": "mean force in contact",
    "torque_Nm.peak": "peak torque",
    "torque_Nm.mean_in_contact": "mean torque in contact",
}


@styled
def draw_band(times_s: Array, nominal: Array, quantiles: Array, path: Path, *, title: str) -> None:
    """Draw force and torque over time with their uncertainty bands.

    Magnitude and components are drawn in separate panels. Torque is left out if it is zero.

    Parameters
    ----------
    times_s
        Times [s], shape (n,).
    nominal
        Loads at the nominal values of the constants, shape (n, 8). The columns are x, y, z and
        magnitude of the force [N], then x, y, z and magnitude of the torque [N m].
    quantiles
        5, 25, 50, 75 and 95 % quantiles of these loads, shape (5, n, 8).
    path
        File to write.
    title
        Name of the scene.
    """
    # columns 0 to 3 are the force, 4 to 7 the torque
    torque = np.abs(quantiles[..., 4:]).max(initial=0.0)
    groups = [("force", "N", 0, 1.0)]
    if torque > 0.0:
        unit, scale = torque_unit(torque)
        groups.append(("torque", unit, 4, scale))
    chart, panels = panelled(
        f"{title}: loads on the tool over the ranges of constants",
        # inches: each group has a panel of sizes and one of components
        (8.0, 1.3 + 3.9 * len(groups)),
        2 * len(groups),
        sharex=True,
        height_ratios=(1.0, 1.15) * len(groups),
    )
    for (name, unit, first, scale), size, components in zip(
        groups, panels[::2], panels[1::2], strict=True
    ):
        # columns of a group: three components, then the size
        for axes, at, colour in (
            (size, first + 3, "0.25"),
            *((components, first + c, COMPONENTS[c]) for c in range(3)),
        ):
            low, low_half, median, high_half, high = scale * quantiles[..., at]
            look = {"color": colour, "linewidth": 0.0}
            axes.fill_between(times_s, low, high, alpha=OUTER, label="90 %", **look)
            axes.fill_between(times_s, low_half, high_half, alpha=INNER, label="50 %", **look)
            dashes = (0, (3, 2))
            axes.plot(times_s, median, color=colour, linestyle=dashes, label="median")
            axes.plot(times_s, scale * nominal[:, at], color=colour, label="run itself")
        size.set_ylabel(f"size of {name}\n/ {unit}")
        size.set_ylim(bottom=0.0)
        components.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
        components.set_ylabel(f"{name} / {unit}")
    for c, colour in enumerate(COMPONENTS):
        panels[0].plot([], [], color=colour, linewidth=3.0, label="xyz"[c])
    # three axes, the median, the run itself and two bands in one line
    legend_above(panels[0], 7)
    panels[-1].set_xlabel("time / s")
    plain(panels)
    chart.align_ylabels(panels)
    save(chart, path)


@styled
def draw_sobol(
    indices: Mapping[str, Mapping[str, Mapping[str, Any]]], path: Path, *, title: str
) -> None:
    """Draw first-order and total Sobol indices with 90 % intervals.

    The picture has one panel for each number of the run's summary that has indices, such as the
    peak force.

    Parameters
    ----------
    indices
        Values ``first``, ``first_90``, ``total`` and ``total_90`` of each number of the summary and
        each constant, as in ``summary.json``. An example is ``indices[number][constant]["first"]``.
    path
        File to write.
    title
        Name of the scene.
    """
    if not indices:
        return
    groups = list(next(iter(indices.values())))
    most = {group: max(each[group]["total"] for each in indices.values()) for group in groups}
    shown = sorted(groups, key=lambda group: -most[group])[:SHOWN]
    # two panels a row
    rows = -(-len(indices) // 2)
    left = len(groups) - len(shown)
    more = f"; {left} that matter less are left out" if left else ""
    chart, panels = panelled(
        f"{title}: which constant matters{more}",
        # inches: title and legend, then in each row a title and 0.36 for each constant
        (8.0, 0.75 + rows * (0.75 + 0.36 * len(shown))),
        rows,
        2,
        sharey=True,
        sharex=True,
    )
    for axes, (name, of) in zip(panels, indices.items(), strict=False):
        _bars(axes, [of[group] for group in shown])
        words = WORDS.get(name) or UNIT.sub("", name).replace("_", " ")
        axes.set_title(words, loc="left")
        axes.set_yticks(range(len(shown)), [_label(group) for group in shown])
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="x", color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
    # an odd number of figures leaves a panel empty
    for axes in panels[len(indices) :]:
        axes.set_visible(False)
    # a total index may exceed 1 by its sampling error
    panels[0].set(xlim=(0.0, 1.05), ylim=(len(shown) - 0.5, -0.5))
    # the lowest of each column
    for axes in panels[max(len(indices) - 2, 0) : len(indices)]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("share of the variance")
    entries = panels[0].get_legend_handles_labels()
    chart.legend(*entries, ncols=2, loc="outside lower center")
    save(chart, path)


def _bars(axes: "Axes", rows: list[Mapping[str, Any]]) -> None:
    for shift, name, colour, label in (
        # two bars of height 0.36 in a row of 1
        (-0.19, "first", FIRST, "first-order: alone"),
        (0.19, "total", TOTAL, "total: with what it does together with others"),
    ):
        value = np.array([row[name] for row in rows])
        ends = np.array([row[f"{name}_90"] for row in rows]).T
        spread = np.maximum([value - ends[0], ends[1] - value], 0.0)
        axes.barh(
            np.arange(len(rows)) + shift,
            value,
            0.36,  # height of a bar
            color=colour,
            label=label,
            xerr=spread,
            error_kw={"ecolor": "0.25", "elinewidth": 0.9},
        )


def _label(group: str) -> str:
    """Return the names of constants without table and unit, one per line."""
    lines = []
    for name in group.split(" + "):
        table, *material, constant = name.split(".")
        # A factor of the density of an image is density.bone: its table is the quantity.
        words = [*material, constant] if material else [constant, table]
        lines.append(" ".join([*words[:-1], UNIT.sub("", words[-1])]).replace("_", " "))
    return "\n".join(lines)
