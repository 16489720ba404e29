"""Figures of the uncertainty of a run's loads: bands over time, and Sobol indices."""

import re
from collections.abc import Mapping
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

OUTER = 0.22
INNER = 0.4
"""Opacity of the 50 % band; the 90 % band below it has the opacity `OUTER`."""
FIRST = "#0072B2"
TOTAL = "#E69F00"
SHOWN = 8
"""Largest number of constants in a bar chart of Sobol indices.

The constants with the smallest indices are left out, and the chart states their number.
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
    """Draw force and torque on the tool over time, with uncertainty bands.

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

    The picture has one panel for each key of `indices`, such as the peak force.

    Parameters
    ----------
    indices
        Sobol indices as in ``summary.json``. ``indices[result][constant]`` has the entries
        ``first``, ``first_90``, ``total`` and ``total_90``.
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
    chart, panels = panelled(
        f"{title}: constants with the largest influence ({len(shown)} of {len(groups)})",
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
    """Return the names of a group of constants, one per line, without the table and the unit."""
    lines = []
    for name in group.split(" + "):
        table, *material, constant = name.split(".")
        # A factor of the density of an image is density.bone: its table is the quantity.
        words = [*material, constant] if material else [constant, table]
        lines.append(" ".join([*words[:-1], UNIT.sub("", words[-1])]).replace("_", " "))
    return "\n".join(lines)
