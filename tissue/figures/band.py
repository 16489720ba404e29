"""Pictures of a band: loads over time with 50 and 90 % bands, and which constant matters."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissue.figures.figure import figure, plain, save, styled
from tissue.figures.style import COMPONENTS, SMALL_NM

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_band", "draw_sobol"]

Array = NDArray[np.float64]

OUTER, INNER = 0.22, 0.4
"""Opacity of the 90 % band, and of the 50 % band upon it."""
FIRST, TOTAL = "#0072B2", "#E69F00"
SHOWN = 8
"""Constants in a bar chart; those that matter least are left out and counted."""
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
        Loads at the constants' nominal values: x, y, z and size of force [N] and of torque [N m], shape (n, 8).
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
    panels = chart.subplots(2 * len(groups), 1, sharex=True, height_ratios=(1.0, 1.15) * len(groups))
    chart.subplots_adjust(left=0.11, right=0.98, top=1.0 - 0.6 / height, bottom=0.5 / height, hspace=0.16)
    for (name, unit, first, scale), size, components in zip(groups, panels[::2], panels[1::2], strict=True):
        _draw(size, times_s, scale * nominal[:, first + 3], scale * quantiles[..., first + 3], "0.25")
        size.set_ylabel(f"size of {name}\n/ {unit}")
        size.set_ylim(bottom=0.0)
        for axis in range(3):
            at = first + axis
            _draw(components, times_s, scale * nominal[:, at], scale * quantiles[..., at], COMPONENTS[axis])
        components.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
        components.set_ylabel(f"{name} / {unit}")
    chart.text(
        0.11, 1.0 - 0.16 / height, f"{title}: loads on the tool over the ranges of constants", va="center", size=10.5
    )
    _legend(panels[0])
    panels[-1].set_xlabel("time / s")
    plain(panels)
    chart.align_ylabels(panels)
    save(chart, path)


def _draw(axes: "Axes", times_s: Array, nominal: Array, quantiles: Array, colour: str) -> None:
    """One channel: bands, the median dashed, the run's nominal value as a line."""
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
        *(Line2D([], [], color=COMPONENTS[axis], linewidth=3.0, label="xyz"[axis]) for axis in range(3)),
    ]
    axes.legend(
        handles=handles, ncols=7, frameon=False, loc="lower left", bbox_to_anchor=(-0.02, 0.98), columnspacing=1.2
    )


@styled
def draw_sobol(indices: Mapping[str, Mapping[str, Mapping[str, Any]]], path: Path, *, title: str) -> None:
    """Draw first-order and total Sobol indices with their 90 % intervals, a panel a figure.

    Parameters
    ----------
    indices
        By figure and constant ``first``, ``first_90``, ``total`` and ``total_90``, as ``summary.json`` has them.
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
    chart.subplots_adjust(left=0.27, right=0.98, top=1.0 - 0.85 / height, bottom=0.5 / height, hspace=0.25, wspace=0.08)
    for axes, (figure_name, of) in zip(panels.ravel(), indices.items(), strict=False):
        _bars(axes, [of[group] for group in shown])
        axes.set_title(WORDS.get(figure_name) or UNIT.sub("", figure_name).replace("_", " "), size=9.5, loc="left")
        axes.set_yticks(range(len(shown)), [_label(group) for group in shown])
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="x", color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
    for axes in panels.ravel()[len(indices) :]:
        axes.set_visible(False)
    panels[0, 0].set_ylim(len(shown) - 0.5, -0.5)
    panels[0, 0].set_xlim(0.0, 1.05)
    for axes in panels.ravel()[max(len(indices) - 2, 0) : len(indices)]:  # the lowest of each column
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("share of the variance")
    left = len(groups) - len(shown)
    more = f"; {left} that matter less are left out" if left else ""
    chart.text(0.02, 1.0 - 0.17 / height, f"{title}: which constant matters{more}", va="center", size=10.5)
    chart.legend(
        *panels[0, 0].get_legend_handles_labels(), ncols=2, frameon=False, loc="upper left",
        bbox_to_anchor=(0.02, 1.0 - 0.27 / height),
    )  # fmt: skip
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
            np.arange(len(rows)) + shift, value, 0.36, color=colour, label=label,
            xerr=spread, error_kw={"ecolor": "0.25", "elinewidth": 0.9},
        )  # fmt: skip


def _label(group: str) -> str:
    """Names of constants without table and unit, one line each."""
    lines = []
    for name in group.split(" + "):
        _, _, rest = name.partition(".")
        material, _, constant = rest.rpartition(".")
        words = UNIT.sub("", constant or material)
        lines.append(f"{material} {words}".replace("_", " ").strip())
    return "\n".join(lines)
