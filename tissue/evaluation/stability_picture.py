"""The stability map of a scene's loop as a picture: stiffness against damping and against delay."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from tissue.figures.figure import figure, save
from tissue.haptics.loop.stability_map import StabilityChart, StabilityMap

__all__ = ["draw_stability"]

DOTS = "#0072B2"
LABELS = {
    "wall_damping_N_s_m": ("virtual damping / N s/m", 1.0),
    "delay_s": ("delay added to the hold / ms", 1e3),
}
LINES = {
    "passive": ("#009E73", "--"),
    "first order in delay": ("#E69F00", "-."),
    "Pade": ("#CC79A7", ":"),
}


def draw_stability(found: StabilityMap, path: Path, *, title: str) -> None:
    """Draw both charts: growth by eigenvalues as shading, the measured boundary, lines of theory, the chosen point."""
    chart = figure(9.0, 4.9)
    axes = chart.subplots(1, 2)
    chart.subplots_adjust(left=0.09, right=0.98, top=0.84, bottom=0.25, wspace=0.24)
    for panel, data in zip(axes, (found.over_damping, found.over_delay), strict=True):
        _draw(panel, data, found)
    chart.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=3, frameon=False, fontsize=9)
    chart.text(0.09, 0.95, title, va="center", size=11)
    chosen = f"chosen: {found.verdict.sentence(found.chosen.stiffness_N_m)}"
    chart.text(0.09, 0.895, chosen, va="center", size=9, color="0.25")
    save(chart, path)


def _draw(panel: Axes, data: StabilityChart, found: StabilityMap) -> None:
    """One chart."""
    label, scale = LABELS[data.along]
    across, low, high = scale * data.values, data.stiffnesses_N_m[0], data.stiffnesses_N_m[-1]
    grows = np.where(data.growth >= 1.0, 1.0, np.nan)
    panel.pcolormesh(across, data.stiffnesses_N_m, grows, cmap="Greys", vmin=0.0, vmax=4.0, shading="nearest")
    panel.plot(across, data.exact_N_m, color="0.1", linewidth=2.0, label="eigenvalues, exact delay")
    panel.plot(
        across[::2], data.measured_N_m[::2], "o", color="#0072B2", markersize=4.5, label="measured by running it"
    )
    for name, values in data.lines_N_m.items():
        colour, line = LINES[name]
        shown = np.where((values > low) & (values < high), values, np.nan)
        panel.plot(across, shown, color=colour, linestyle=line, linewidth=1.6, label=name)
    x = scale * float(getattr(found.chosen, data.along))
    panel.plot([x], [found.chosen.stiffness_N_m], "*", color="#D55E00", markersize=14, label="chosen", zorder=5)
    panel.set(xlabel=label, ylabel="stiffness / N/m", yscale="log", ylim=(low, high))
    panel.grid(alpha=0.3, which="both")
