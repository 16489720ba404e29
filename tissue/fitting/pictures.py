"""Figures of a fit: loads with residuals, and constants before and after the fit."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.problem import MeasuredLoads
from tissue.fitting.result import ConstantFit, words_of
from tissue.show.figures.figure import COMPONENTS, legend_above, panelled, plain, save, styled

MEASURED = "0.55"
SIMULATED = "#0072B2"
PRIOR = "0.75"
ROW = 0.44
FRAME = 1.0
"""Height of the frame around the rows [in]; `ROW` is the height of the row of a constant."""


@styled
def draw_log(log: MeasuredLoads, simulated: Array, path: Path) -> None:
    """Draw the measured loads, the simulated loads and their residuals over time.

    A residual is a measured load minus the simulated load. Forces and torques have separate panels,
    each with its residuals below.

    Parameters
    ----------
    log
        Measured log.
    simulated
        Simulated loads, shape (m, channels).
    path
        File to write.
    """
    groups: dict[str, list[int]] = {}
    for at, name in enumerate(log.channels):
        groups.setdefault(name.partition("_")[0], []).append(at)
    chart, panels = panelled(
        "measured and simulated loads",
        # inches: each group has its loads, and its residuals at half the height
        (8.0, 0.9 + 2.9 * len(groups)),
        2 * len(groups),
        sharex=True,
        height_ratios=(2.0, 1.0) * len(groups),
    )
    times_s = log.times_s
    for (what, places), loads, rest in zip(groups.items(), panels[::2], panels[1::2], strict=True):
        colours = COMPONENTS if len(places) > 1 else (SIMULATED,)
        for colour, at in zip(colours, places, strict=False):
            _, axis, unit = log.channels[at].split("_")
            measured = log.values[:, at]
            loads.plot(times_s, measured, color=MEASURED, linewidth=2.2, zorder=1)
            loads.plot(times_s, simulated[:, at], color=colour, linewidth=1.1, label=axis, zorder=2)
            rest.plot(times_s, measured - simulated[:, at], color=colour, linewidth=0.8)
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
def draw_rows(
    label: str, x: Array, loads: Mapping[str, tuple[Array, Array | None, Array]], path: Path
) -> None:
    """Draw measured and fitted loads of a table in one panel for each load.

    Parameters
    ----------
    label, x
        Label of the horizontal axis, and its values, shape (n,).
    loads
        Three arrays for each panel, keyed by the label of the vertical axis. The first array is the
        measured load, shape (n,). The second array holds the half lengths of the error bars, shape
        (n,) or (2, n), or is None. The third array is the fitted load, shape (n,).
    path
        File to write.
    """
    chart, panels = panelled("measured and fitted loads", (8.0, 3.4), 1, len(loads), sharex=True)
    order = np.argsort(x)
    for (what, (measured, bars, fitted)), axes in zip(loads.items(), panels, strict=True):
        axes.errorbar(x, measured, bars, label="measured", fmt="o", color=MEASURED, markersize=5.0)
        axes.plot(x[order], fitted[order], color=SIMULATED, marker=".", label="fitted")
        axes.set(xlabel=label, ylabel=what)
    legend_above(panels[0], 2)
    plain(panels)
    for axes in panels:
        axes.set(xlim=(0.0, 1.05 * x.max()))
    save(chart, path)


@styled
def draw_constants(constants: Sequence[ConstantFit], path: Path, *, source: str) -> None:
    """Draw medians and 90 % intervals of constants before and after a fit.

    The horizontal axis is in standard deviations of the prior. `source` names the kind of
    measurement in the labels of the picture.
    """
    chart, (axes,) = panelled("constants of the fit", (8.0, FRAME + ROW * len(constants)))
    labels = []
    for row, one in enumerate(constants):
        low, middle, high, lowest, highest = one.z
        label, unit = words_of(one.name)
        labels.append(f"{label} (doubtful)" if one.state == "doubtful" else label)
        # 0.3 of the row is left between two bars
        axes.barh(row, highest - lowest, left=lowest, height=0.7, color=PRIOR, linewidth=0.0)
        found = f"{one.value:.3g} ({one.low:.3g} to {one.high:.3g}) {unit}"
        colour = SIMULATED
        if one.state == "at its prior":
            found = f"not narrowed by this {source}"
            colour = "0.45"
        axes.plot([low, high], [row, row], color=colour, linewidth=3.2, solid_capstyle="butt")
        axes.plot(middle, row, "o", color=colour, markersize=5.0)
        cited = f"cited {one.prior.value:.3g} ({one.prior.low:.3g} to {one.prior.high:.3g}) {unit}"
        # two lines of text within a row of height 1, to the right of the panel
        for shift, line, look in ((-0.2, found, colour), (0.22, cited, "0.45")):
            across = axes.get_yaxis_transform()
            axes.text(1.03, row + shift, line, transform=across, va="center", size=8, color=look)
    axes.barh(0, 0, color=PRIOR, label="cited")
    axes.plot([], [], "o-", color=SIMULATED, linewidth=3.2, label="fitted")
    legend_above(axes, 2)
    axes.set_yticks(range(len(constants)), labels)
    # the first constant on top, with a margin around the bars of height 0.7
    axes.set_ylim(len(constants) - 0.4, -0.6)
    # at least the cited range, 1.64 standard deviations to either side, with a margin
    reach = 1.05 * max(2.2, *(abs(z) for one in constants for z in one.z[:3]))
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("standard deviations of the cited range")
    axes.spines[["top", "right"]].set_visible(False)
    save(chart, path)
