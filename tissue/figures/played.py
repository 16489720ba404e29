"""A picture of what a device played and what the tissue did: force over time, its steepest moment, and the path."""

from pathlib import Path
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from tissue.builders.force_met import chosen_scale
from tissue.figures.events import FLICKER_S, spells
from tissue.figures.figure import figure, plain, save
from tissue.haptics.device.device import device_parameters
from tissue.models.tissue_model import TICK_S
from tissue.simulation.run import Run
from tissue.simulation.trace import Table

__all__ = ["draw_played"]


class _Look(TypedDict, total=False):
    color: str
    linewidth: float
    linestyle: str | tuple[int, tuple[int, int]]


Array = NDArray[np.float64]
MOMENT_S = 0.06
"""Length of the steepest moment [s]."""
LINES: tuple[tuple[str, str, _Look], ...] = (
    ("model", "the tissue's, at the device's scale", {"color": "0.6", "linewidth": 3.0}),
    ("raw_force", "as the renderer gives it", {"color": "#0072B2", "linewidth": 1.6}),
    (
        "predicted_force",
        "as predicted over the delay",
        {"color": "#CC79A7", "linewidth": 1.3, "linestyle": (0, (1, 1))},
    ),
    ("device_force", "as the device played it", {"color": "#D55E00", "linewidth": 2.2, "linestyle": "-"}),
    (
        "filtered_force",
        "as commanded, after low-pass and delay",
        {"color": "0.1", "linewidth": 1.0, "linestyle": (0, (4, 3))},
    ),
)
"""Columns, how a reader knows them, and colours after Okabe and Ito (2008) that differ in lightness and stroke, too."""
SATURATED = "#F0E442"


def draw_played(run: Run, path: Path) -> None:
    """Draw forces at the device [N], compressed spans, the greatest change at 1 ms, and tool and device [mm]."""
    trace, scene = run.trace, run.scene
    scale, _ = chosen_scale(scene)
    sizes = _sizes(trace, scale)
    time, limits = trace["time_s"], device_parameters(scene.held.kind, scene.constants)
    turns = bool(trace.vectors("device_torque", "Nm").any())
    chart = figure(8.0, 7.8 if turns else 6.6)
    panels = chart.subplots(3 + turns, 1, height_ratios=(2.4, 2.0, 1.5, 1.2)[: 3 + turns])
    chart.subplots_adjust(left=0.13, right=0.98, top=0.83, bottom=0.08, hspace=0.42)
    steepest = int(np.abs(np.diff(sizes["raw_force"], prepend=0.0)).argmax())
    first = max(steepest - round(0.25 * MOMENT_S * 1e3), 0)
    moment = slice(first, first + round(MOMENT_S * 1e3))
    for axes, span, width in ((panels[0], slice(None), 0.8), (panels[1], moment, 1.2)):
        for name, label, look in LINES:
            if name in sizes:
                (line,) = axes.plot(time[span], sizes[name][span], label=label, **look)
                line.set_linewidth(width * look["linewidth"])
        axes.set(ylabel="size of the force\nat the device / N")
    for index, (start, end) in enumerate(_compressed(trace["saturated"] > 0.0)):
        panels[0].axvspan(
            time[start],
            time[min(end, len(time) - 1)],
            color=SATURATED,
            alpha=0.6,
            linewidth=0.0,
            zorder=0,
            label="" if index else "compressed into the device's range",
        )
    if sizes["device_force"].max() > 0.5 * limits.force_limit_N:
        panels[0].axhline(limits.force_limit_N, color="0.2", linewidth=1.0, linestyle=(0, (6, 3)))
        panels[0].annotate(f"greatest force of the {scene.held.kind}, {limits.force_limit_N:g} N",
                           (time[0], limits.force_limit_N), (4, -11), textcoords="offset points", size=8.5)  # fmt: skip
    panels[0].axvspan(time[moment][0], time[moment][-1], color="0.85", linewidth=0.0, zorder=0)
    panels[1].set_title("the steepest moment, grey above", size=9.0, loc="left")
    axis = int(np.abs(trace.vectors("tool", "mm") - trace.vectors("device", "mm")).max(axis=0).argmax())
    for name, colour, width in (("device", "#56B4E9", 2.0), ("tool", "0.1", 1.2)):
        values = trace[f"{name}_{'xyz'[axis]}_mm"]
        panels[2].plot(time, values, label=name, color=colour, linewidth=width)
    panels[2].set(ylabel=f"{'xyz'[axis]} / mm")
    panels[2].legend(loc="best", frameon=False, ncols=2)
    if turns:
        for index, colour in enumerate(("#0072B2", "#D55E00", "#009E73")):
            panels[3].plot(time, 1e3 * trace.vectors("device_torque", "Nm")[:, index], color=colour, label="xyz"[index])
        panels[3].set(ylabel="torque played\n/ mN·m")
        panels[3].legend(loc="best", frameon=False, ncols=3)
    panels[-1].set_xlabel("time / s")
    plain(panels)
    chart.align_ylabels(panels)
    handles, labels = panels[0].get_legend_handles_labels()
    chart.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.11, 0.95), ncols=2, frameon=False)
    title = f"{scene.name}: what the {scene.held.kind} played ({scene.held.hand}, {scene.held.renderer})"
    chart.text(0.12, 0.965, f"{title}; {scale:g} N for each newton at the tool", va="center", size=10.0)
    save(chart, path)


def _compressed(saturated: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First row and the one behind the last of compressed spans; those less than `FLICKER_S` apart are one."""
    found: list[tuple[int, int]] = []
    for start, end, name in spells(saturated):
        if name == "True":
            near = bool(found) and (start - found[-1][1]) * TICK_S < FLICKER_S
            found[-1:] = [(found[-1][0], end)] if near else [*found[-1:], (start, end)]
    return found


def _sizes(trace: Table, force_scale: float) -> dict[str, Array]:
    """Sizes of the forces at the device [N], by the names of `LINES`."""
    sizes = {"model": force_scale * np.linalg.norm(trace.vectors("model_force", "N"), axis=1)}
    there = (name for name, _, _ in LINES if f"{name}_x_N" in trace.columns)
    return sizes | {name: np.linalg.norm(trace.vectors(name, "N"), axis=1) for name in there}
