"""Picture of measured against predicted figures, with bands."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from predictions import Compared, compared, ratios
from published import data_sets

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw"]

SIZE_INCH = (11.0, 4.9)
LIMITS = {"thrust": (0.7, 400.0), "torque": (3.0, 400.0), "ratio": (0.4, 5.0)}


def draw(path: Path) -> None:
    """Write the picture: thrust, torque and ratios, one colour per data set."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    sets = {key: data for key, data in data_sets().items() if data.law.startswith("drill")}
    colours = dict(zip(sets, colormaps["tab20"](np.linspace(0.0, 1.0, 20)), strict=False))
    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    axes = dict(zip(LIMITS, figure.subplots(1, 3), strict=True))
    for key, data in sets.items():
        for quantity in ("thrust", "torque"):
            chosen = [each for each in compared(key) if each.kind == quantity]
            _with_bands(axes[quantity], chosen, colours[key], data.name, quantity)
        found = [each for each in ratios(key) if each.kind in ("speed", "feed", "both")]
        axes["ratio"].plot(
            [each.measured for each in found],
            [each.predicted for each in found],
            "o",
            color=colours[key],
            markersize=5,
        )
    titles = {
        "thrust": "thrust / N",
        "torque": "torque / N mm",
        "ratio": "ratio over feed or speed",
    }
    for name, ax in axes.items():
        low, high = LIMITS[name]
        ax.plot([low, high], [low, high], color="0.4", linewidth=1)
        ax.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high))
        ax.set(title=titles[name], xlabel="measured", ylabel="predicted at cited constants")
        ax.set_aspect("equal")
        ax.grid(which="major", color="0.9")
    low, high = LIMITS["ratio"]
    ends = np.array([low, high])
    axes["ratio"].fill_between(ends, ends / 1.15, ends * 1.15, color="0.5", alpha=0.25, lw=0)
    ticks = [0.5, 1.0, 2.0, 4.0]
    axes["ratio"].set_xticks(ticks, [f"{each:g}" for each in ticks])
    axes["ratio"].set_yticks(ticks, [f"{each:g}" for each in ticks])
    axes["ratio"].minorticks_off()
    handles, labels = axes["thrust"].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


def _with_bands(
    ax: "Axes", chosen: list[Compared], colour: np.ndarray, label: str, quantity: str
) -> None:
    """Plot predictions with their bands; scatter of the measurement is a horizontal line."""
    lowest = LIMITS[quantity][0]
    for each in chosen:
        bottom = max(each.band[0], lowest)
        ax.plot([each.measured] * 2, [bottom, each.band[1]], color=colour, linewidth=1)
        if each.low is not None:
            ax.plot([each.low, each.high], [each.predicted] * 2, color=colour, linewidth=1)
    measured = [each.measured for each in chosen]
    predicted = [each.predicted for each in chosen]
    if chosen or quantity == "thrust":
        ax.plot(measured, predicted, "o", color=colour, markersize=5, label=label)
