"""Figures of a fit and of a band: loads, residuals, constants and sensitivities."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissue.show.figures.figure import COMPONENTS, SMALL_NM, figure, plain, save, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "FittedConstant",
    "draw_band",
    "draw_constants",
    "draw_measured",
    "draw_residuals",
    "draw_sobol",
]

Array = NDArray[np.float64]

MEASURED, SIMULATED, PRIOR = "0.55", "#0072B2", "0.75"
ROW, FRAME = 0.44, 1.0
"""Height of a constant's row, and of the frame around the rows [in]."""


@dataclass(frozen=True)
class FittedConstant:
    """Constant before and after a fit, for a picture.

    Attributes
    ----------
    label
        Name without unit.
    unit
        Unit of the constant.
    cited, fitted
        Median and the ends of the 90 % interval, (low, value, high), before and after.
    fitted_z, cited_z
        The three fitted values, and the ends of the cited range, in standard deviations of the
        prior.
    is_identified
        True if the log narrows the constant.
    """

    label: str
    unit: str
    cited: tuple[float, float, float]
    fitted: tuple[float, float, float]
    fitted_z: tuple[float, float, float]
    cited_z: tuple[float, float]
    is_identified: bool


def draw_measured(
    times_s: Array, measured: Array, simulated: Array, channels: Sequence[str], path: Path
) -> None:
    """Draw measured and simulated loads over time with their residuals.

    Forces and torques are drawn separately, each with the residuals below.

    Parameters
    ----------
    times_s
        Times [s], shape (n,).
    measured, simulated
        Loads, shape (n, channels); NaN where nothing was measured.
    channels
        Names with units, such as ``force_x_N``.
    path
        File to write.
    """
    whats = list(dict.fromkeys(name.partition("_")[0] for name in channels))
    groups = [
        (what, [at for at, name in enumerate(channels) if name.startswith(f"{what}_")])
        for what in whats
    ]
    chart = figure(8.0, 0.9 + 2.9 * len(groups))
    rows = 2 * len(groups)
    panels = chart.subplots(
        rows, 1, sharex=True, height_ratios=(2.0, 1.0) * len(groups), squeeze=False
    )[:, 0]
    chart.subplots_adjust(
        left=0.11, right=0.98, top=0.93, bottom=0.5 / (0.9 + 2.9 * len(groups)), hspace=0.22
    )
    for (what, places), loads, rest in zip(groups, panels[::2], panels[1::2], strict=True):
        unit = channels[places[0]].rpartition("_")[2]
        shown = "N m" if unit == "Nm" else unit
        for colour, at in zip(_colours(len(places)), places, strict=True):
            axis = channels[at].removesuffix(f"_{unit}").rpartition("_")[2]
            loads.plot(times_s, measured[:, at], color=MEASURED, linewidth=2.2, zorder=1)
            loads.plot(times_s, simulated[:, at], color=colour, linewidth=1.1, label=axis, zorder=2)
            rest.plot(times_s, measured[:, at] - simulated[:, at], color=colour, linewidth=0.8)
        loads.plot([], [], color=MEASURED, linewidth=2.2, label="measured")
        loads.set_ylabel(f"{what} / {shown}")
        rest.set_ylabel(f"residual / {shown}")
    panels[0].legend(frameon=False, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 0.98))
    panels[-1].set_xlabel("time / s")
    plain(panels)
    save(chart, path)


def draw_residuals(innovations: Array, correlations: Array, freedom: float, path: Path) -> None:
    """Draw the distribution of innovations over the assumed density, and the autocorrelations.

    Parameters
    ----------
    innovations
        Standardised innovations, shape (n, channels). NaN where nothing was measured.
    correlations
        Autocorrelation of residuals and of innovations over lags, each the mean over channels,
        shape (2, lags + 1).
    freedom
        Degrees of freedom of the assumed Student's t.
    path
        File to write.
    """
    from scipy.stats import t

    chart = figure(8.0, 3.2)
    spread, over = chart.subplots(1, 2)
    chart.subplots_adjust(left=0.09, right=0.98, top=0.9, bottom=0.18, wspace=0.28)
    known = innovations[np.isfinite(innovations)]
    at = np.linspace(-6.0, 6.0, 121)
    spread.hist(np.clip(known, -6.0, 6.0), bins=60, range=(-6.0, 6.0), density=True, color="0.8")
    spread.plot(
        at,
        t.pdf(at, freedom),
        color=SIMULATED,
        label=f"Student's t, {freedom:.3g} degrees of freedom",
    )
    spread.set(
        xlabel="noise added in a sample / its scale",
        ylabel="density",
        yscale="log",
        ylim=(1e-4, 1.0),
    )
    spread.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.0, 1.14))
    lags = np.arange(correlations.shape[1])
    over.axhspan(
        *np.array([-1.96, 1.96]) / np.sqrt(max(len(innovations), 1)),
        color="0.9",
        label="95 % of white noise",
    )
    over.plot(lags, correlations[0], color=MEASURED, label="residual")
    over.plot(lags, correlations[1], color=SIMULATED, label="after the noise model")
    over.set(xlabel="lag / samples", ylabel="autocorrelation")
    over.legend(frameon=False)
    plain((spread, over))
    save(chart, path)


def draw_constants(constants: Sequence[FittedConstant], path: Path) -> None:
    """Draw the 90 % intervals of constants before and after the fit, with their values.

    The scale is that of the cited range.
    """
    height = FRAME + ROW * len(constants)
    chart = figure(8.0, height)
    axes = chart.subplots()
    chart.subplots_adjust(left=0.34, right=0.7, top=1.0 - 0.4 / height, bottom=0.55 / height)
    for row, one in enumerate(constants):
        least, most = one.cited_z
        axes.barh(row, most - least, left=least, height=0.7, color=PRIOR, linewidth=0.0)
        low, middle, high = one.fitted_z
        colour = SIMULATED if one.is_identified else "0.45"
        axes.plot([low, high], [row, row], color=colour, linewidth=3.2, solid_capstyle="butt")
        axes.plot(middle, row, "o", color=colour, markersize=5.0)
        cited, found = (
            f"{value:.3g} ({least:.3g} to {most:.3g})"
            for least, value, most in (one.cited, one.fitted)
        )
        across = axes.get_yaxis_transform()
        result = f"{found} {one.unit}" if one.is_identified else "not narrowed by this log"
        axes.text(
            1.03, row - 0.2, result, transform=across, va="center", fontsize=8.0, color=colour
        )
        axes.text(
            1.03,
            row + 0.22,
            f"cited {cited} {one.unit}",
            transform=across,
            va="center",
            fontsize=7.5,
            color="0.45",
        )
    axes.barh(0, 0, color=PRIOR, label="cited")
    axes.plot([], [], "o-", color=SIMULATED, linewidth=3.2, label="fitted")
    axes.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes.set_yticks(range(len(constants)), [one.label for one in constants])
    axes.set_ylim(len(constants) - 0.4, -0.6)
    axes.set_xlim(*_ends(constants))
    axes.set_xlabel("standard deviations of the cited range")
    axes.spines[["top", "right"]].set_visible(False)
    save(chart, path)


def _ends(constants: Sequence[FittedConstant]) -> tuple[float, float]:
    reach = [2.2, *(abs(z) for one in constants for z in one.fitted_z)]
    return -1.05 * max(reach), 1.05 * max(reach)


def _colours(count: int) -> tuple[str, ...]:
    return COMPONENTS[:count] if count > 1 else (SIMULATED,)


OUTER, INNER = 0.22, 0.4
"""Opacity of the 90 % band, and of the 50 % band upon it."""
FIRST, TOTAL = "#0072B2", "#E69F00"
SHOWN = 8
"""Constants in a bar chart. The least important ones are left out and counted."""
UNIT = re.compile(r"(_(N|Nm|[mu]?m[23]?|m?s|kg|kgK|[kMG]Pa|Hz|J|W|mK|rad))+$")
"""Unit at the end of a constant's name."""
WORDS = {
    "force_N.peak": "peak force",
    "force_N.mean_in_contact": "mean force in contact",
    "torque_Nm.peak": "peak torque",
    "torque_Nm.mean_in_contact": "mean torque in contact",
}


@styled
def draw_band(times_s: Array, nominal: Array, quantiles: Array, path: Path, *, title: str) -> None:
    """Draw size and components of force, and of torque where there is any, with their bands.

    Parameters
    ----------
    times_s
        Times [s], shape (n,).
    nominal
        Loads at the constants' nominal values: x, y, z and size of force [N] and of torque [N m],
        shape (n, 8).
    quantiles
        5, 25, 50, 75 and 95 % quantiles of the same, shape (5, n, 8).
    path
        File to write.
    title
        Name of the scene.
    """
    turns = bool(np.abs(quantiles[..., 4:]).max(initial=0.0) > 0.0)
    small = bool(np.abs(quantiles[..., 4:]).max(initial=0.0) < SMALL_NM)
    groups = [("force", "N", 0, 1.0)]
    if turns:
        groups.append(("torque", *(("mN·m", 4, 1e3) if small else ("N·m", 4, 1.0))))
    height = 1.3 + 3.9 * len(groups)
    chart = figure(8.0, height)
    panels = chart.subplots(
        2 * len(groups), 1, sharex=True, height_ratios=(1.0, 1.15) * len(groups)
    )
    chart.subplots_adjust(
        left=0.11, right=0.98, top=1.0 - 0.6 / height, bottom=0.5 / height, hspace=0.16
    )
    for (name, unit, first, scale), size, components in zip(
        groups, panels[::2], panels[1::2], strict=True
    ):
        _draw(
            size, times_s, scale * nominal[:, first + 3], scale * quantiles[..., first + 3], "0.25"
        )
        size.set_ylabel(f"size of {name}\n/ {unit}")
        size.set_ylim(bottom=0.0)
        for axis in range(3):
            at = first + axis
            _draw(
                components,
                times_s,
                scale * nominal[:, at],
                scale * quantiles[..., at],
                COMPONENTS[axis],
            )
        components.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
        components.set_ylabel(f"{name} / {unit}")
    chart.text(
        0.11,
        1.0 - 0.16 / height,
        f"{title}: loads on the tool over the ranges of constants",
        va="center",
        size=10.5,
    )
    _legend(panels[0])
    panels[-1].set_xlabel("time / s")
    plain(panels)
    chart.align_ylabels(panels)
    save(chart, path)


def _draw(axes: "Axes", times_s: Array, nominal: Array, quantiles: Array, colour: str) -> None:
    """Draw one channel: bands, the median dashed, and the run's nominal value as a line."""
    axes.fill_between(times_s, quantiles[0], quantiles[4], color=colour, alpha=OUTER, linewidth=0.0)
    axes.fill_between(times_s, quantiles[1], quantiles[3], color=colour, alpha=INNER, linewidth=0.0)
    axes.plot(times_s, quantiles[2], color=colour, linewidth=0.9, linestyle=(0, (3, 2)))
    axes.plot(times_s, nominal, color=colour, linewidth=1.2)


def _legend(axes: "Axes") -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], color="0.25", label="run itself"),
        Line2D([], [], color="0.25", linewidth=0.9, linestyle=(0, (3, 2)), label="median"),
        Patch(color="0.25", alpha=OUTER + INNER, linewidth=0.0, label="50 %"),
        Patch(color="0.25", alpha=OUTER, linewidth=0.0, label="90 %"),
        *(
            Line2D([], [], color=COMPONENTS[axis], linewidth=3.0, label="xyz"[axis])
            for axis in range(3)
        ),
    ]
    axes.legend(
        handles=handles,
        ncols=7,
        frameon=False,
        loc="lower left",
        bbox_to_anchor=(-0.02, 0.98),
        columnspacing=1.2,
    )


@styled
def draw_sobol(
    indices: Mapping[str, Mapping[str, Mapping[str, Any]]], path: Path, *, title: str
) -> None:
    """Draw first-order and total Sobol indices with 90 % intervals, one panel per figure.

    Parameters
    ----------
    indices
        ``first``, ``first_90``, ``total`` and ``total_90`` by figure and constant, as in
        ``summary.json``.
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
    rows = -(-len(indices) // 2)
    each_in = 0.75 + 0.36 * len(shown)
    height = 0.75 + rows * each_in
    chart = figure(8.0, height)
    panels = chart.subplots(rows, 2, sharey=True, sharex=True, squeeze=False)
    chart.subplots_adjust(
        left=0.27,
        right=0.98,
        top=1.0 - 0.85 / height,
        bottom=0.5 / height,
        hspace=0.25,
        wspace=0.08,
    )
    for axes, (figure_name, of) in zip(panels.ravel(), indices.items(), strict=False):
        _bars(axes, [of[group] for group in shown])
        axes.set_title(
            WORDS.get(figure_name) or UNIT.sub("", figure_name).replace("_", " "),
            size=9.5,
            loc="left",
        )
        axes.set_yticks(range(len(shown)), [_label(group) for group in shown])
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="x", color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
    for axes in panels.ravel()[len(indices) :]:
        axes.set_visible(False)
    panels[0, 0].set_ylim(len(shown) - 0.5, -0.5)
    panels[0, 0].set_xlim(0.0, 1.05)
    # the lowest of each column
    for axes in panels.ravel()[max(len(indices) - 2, 0) : len(indices)]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("share of the variance")
    left = len(groups) - len(shown)
    more = f"; {left} that matter less are left out" if left else ""
    chart.text(
        0.02, 1.0 - 0.17 / height, f"{title}: which constant matters{more}", va="center", size=10.5
    )
    chart.legend(
        *panels[0, 0].get_legend_handles_labels(),
        ncols=2,
        frameon=False,
        loc="upper left",
        bbox_to_anchor=(0.02, 1.0 - 0.27 / height),
    )
    save(chart, path)


def _bars(axes: "Axes", rows: list[Mapping[str, Any]]) -> None:
    for shift, name, colour, label in (
        (-0.19, "first", FIRST, "first-order: alone"),
        (0.19, "total", TOTAL, "total: with what it does together with others"),
    ):
        value = np.array([row[name] for row in rows])
        ends = np.array([row[f"{name}_90"] for row in rows]).T
        spread = np.maximum([value - ends[0], ends[1] - value], 0.0)
        axes.barh(
            np.arange(len(rows)) + shift,
            value,
            0.36,
            color=colour,
            label=label,
            xerr=spread,
            error_kw={"ecolor": "0.25", "elinewidth": 0.9},
        )


def _label(group: str) -> str:
    """Return names of constants without table and unit, one line each."""
    lines = []
    for name in group.split(" + "):
        _, _, rest = name.partition(".")
        material, _, constant = rest.rpartition(".")
        words = UNIT.sub("", constant or material)
        lines.append(f"{material} {words}".replace("_", " ").strip())
    return "\n".join(lines)
