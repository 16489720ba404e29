"""Force on a needle over the path of its tip, in and out, and what it is made of."""

from pathlib import Path

import numpy as np

from tissue.figures.figure import figure, plain, save
from tissue.simulation.run import Run

__all__ = ["draw_insertion"]

SHARES = (("elastic_N", "organ and membranes", "#56B4E9"), ("cutting_N", "cutting", "#E69F00"),
          ("friction_N", "friction along the shaft", "#009E73"))  # fmt: skip
BESIDE = 0.15
"""Share of the depths within which a puncture's name is written above that of the one before."""


def draw_insertion(run: Run, path: Path) -> None:
    """Draw the axial force over the tip's depth and its shares over time, punctures marked."""
    trace = run.trace
    time, depth = trace["time_s"], -trace["tool_z_mm"]
    force = trace["model_force_z_N"]
    chart = figure(8.0, 6.4)
    over_depth, over_time = chart.subplots(2, 1)
    chart.subplots_adjust(left=0.12, right=0.98, top=0.9, bottom=0.1, hspace=0.38)
    inward = np.gradient(depth) > 0.0
    for chosen, colour, label in ((inward, "#0072B2", "pushed in"), (~inward, "#D55E00", "drawn out")):
        over_depth.plot(depth, np.where(chosen, force, np.nan), color=colour, linewidth=1.8, label=label)
    for name, label, colour in SHARES:
        over_time.plot(time, trace[name], color=colour, linewidth=1.8, label=label)
    over_time.plot(time, force, color="0.1", linewidth=1.0, label="all together")
    last_mm, height = -np.inf, 10
    for when, what in run.events:
        row = int(np.searchsorted(time, when))
        if "punctured" in what and row < len(time):
            height = height + 14 if depth[row] - last_mm < BESIDE * np.ptp(depth) else 10
            last_mm = depth[row]
            over_depth.annotate(
                what.partition(" is punctured")[0].removeprefix("the "),
                (depth[row], force[max(row - 1, 0)]),
                xytext=(0, height),
                textcoords="offset points",
                ha="center",
                arrowprops={"arrowstyle": "-", "color": "0.4"},
            )
            first = not over_time.lines[len(SHARES) + 1 :]
            over_time.axvline(
                when, color="0.4", linestyle=":", linewidth=1.2, label="puncture" if first else "", zorder=0
            )
    over_depth.set(
        xlabel="depth of the tip below the resting surface / mm", ylabel="axial force / N,\npositive drives it out"
    )
    over_time.set(xlabel="time / s", ylabel="parts of the\naxial force / N")
    plain((over_depth, over_time))
    for axes in (over_depth, over_time):
        axes.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
        axes.margins(y=0.12)
        axes.legend(frameon=False, loc="best")
    chart.text(0.12, 0.96, f"{run.scene.name}: axial force on the needle", va="center", size=10.5)
    save(chart, path)
