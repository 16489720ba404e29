"""Force, torque, removal and the tool's path over time."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.figures.events import EVENT_IN, FLICKER_S, event_lines, joined_events, mark_events, spells
from tissue.figures.figure import figure, plain, save, styled
from tissue.figures.style import COMPONENTS, MAGNITUDE, SMALL_NM, layer_colours
from tissue.models.tissue_model import TICK_S
from tissue.simulation.depth_map import tool_axes
from tissue.simulation.run import Run
from tissue.simulation.trace import NO_LAYER

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

__all__ = ["draw_force_torque"]

COMMANDED = 0.35
"""Opacity of what is commanded, below the model's line."""
HEAD_IN = 0.82


@styled
def draw_force_torque(run: Run, path: Path) -> None:
    """Draw force, torque where there is any, removal rate (or contact area, where nothing goes) and the tool's path."""
    trace = run.trace
    time = trace["time_s"]
    events = joined_events(run.events)
    lines = event_lines(events)
    turns = bool(trace.vectors("torque", "Nm").any() or trace.vectors("model_torque", "Nm").any())
    heights = (3.0, *([2.2] if turns else []), 1.3, 1.45)
    foot = 0.55 + EVENT_IN * len(lines)
    full = 0.72 * sum(heights) + HEAD_IN + foot
    chart = figure(8.0, full)
    panels = chart.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    chart.subplots_adjust(left=0.11, right=0.98, top=1.0 - HEAD_IN / full, bottom=foot / full, hspace=0.18)
    _draw_components(panels[0], run, "force", "N", 1.0, "force / N")
    if turns:
        # A bur's torque is a thousandth of a reamer's.
        small = bool(np.abs(trace.vectors("torque", "Nm")).max(initial=0.0) < SMALL_NM)
        _draw_components(panels[1], run, "torque", "Nm", *((1e3, "torque / mN·m") if small else (1.0, "torque / N·m")))
    about = " and torque about its tip" if turns else " (no torque)"
    chart.text(0.11, 1.0 - 0.18 / full, f"{run.scene.name}: force on the tool{about}", va="center", size=10.5)
    for row, handles in enumerate(_handles()):
        chart.legend(
            handles=handles,
            loc="upper left",
            bbox_to_anchor=(0.1, 1.0 - (0.28 + 0.2 * row) / full),
            ncols=4,
            frameon=False,
            handlelength=1.6,
            columnspacing=1.4,
        )
    cuts = bool((trace["removed_mm3"] > 0.0).any())
    panels[-2].plot(time, trace["removal_rate_mm3_s" if cuts else "contact_mm2"], color="0.1")
    panels[-2].set_ylabel("removal rate\n/ mm³ s⁻¹" if cuts else "contact area\n/ mm²")
    panels[-2].set_ylim(bottom=0.0)
    _draw_path(panels[-1], run)
    plain(panels)
    chart.align_ylabels(panels)
    mark_events(panels, events)
    for line, sentence in enumerate(lines):
        chart.text(0.11, (foot - 0.6 - EVENT_IN * line) / full, sentence, va="center", size=8.5, parse_math=False)
    save(chart, path)


def _draw_components(axes: "Axes", run: Run, name: str, unit: str, scale: float, label: str) -> None:
    """The model's components upon those commanded: teeth that vibrate make a band of the wide lines."""
    time = run.trace["time_s"]
    commanded, model = (scale * run.trace.vectors(f"{of}{name}", unit) for of in ("", "model_"))
    axes.fill_between(time, np.linalg.norm(commanded, axis=1), color=MAGNITUDE, linewidth=0.0)
    for c in range(3):
        axes.plot(time, commanded[:, c], color=COMPONENTS[c], linewidth=2.4, alpha=COMMANDED)
    for c in range(3):
        axes.plot(time, model[:, c], color=COMPONENTS[c], linewidth=1.1)
    axes.set_ylabel(label)
    axes.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)


def _handles() -> "list[list[Artist]]":
    """Entries of the legend in two rows, in words."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    along = [Line2D([], [], color=COMPONENTS[c], label=f"along {'xyz'[c]}") for c in range(3)]
    given = Line2D([], [], color="0.2", linewidth=1.1, label="thin: as the model gives it")
    played = Line2D(
        [], [], color="0.2", linewidth=2.4, alpha=COMMANDED, label="wide: as commanded, after low-pass and vibration"
    )
    size = Patch(facecolor=MAGNITUDE, label="magnitude, as commanded")
    return [[*along, size], [given, played]]


def _draw_path(axes: "Axes", run: Run) -> None:
    """The tip along the tool's axis, behind it the layer that it is in."""
    from matplotlib.patches import Patch

    trace = run.trace
    time = trace["time_s"]
    turned = tool_axes(np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"]))
    axes.plot(time, (trace.vectors("tool", "mm") * turned).sum(axis=1), color="0.1")
    axes.set(ylabel="tip along\nits axis / mm", xlabel="time / s")
    colours = layer_colours(trace.layer_names)
    drawn = [each for each in spells(trace["layer"], shortest=round(FLICKER_S / TICK_S)) if each[2] != NO_LAYER]
    for first, last, name in drawn:
        end = time[min(last, len(time) - 1)]
        axes.axvspan(time[first], end, color=colours[name], alpha=0.45, linewidth=0.0)
    met = [name for name in trace.layer_names if name in {each[2] for each in drawn}]
    if met:
        axes.legend(
            handles=[
                Patch(facecolor=colours[name], alpha=0.45, label=f"tip in {name}".replace("$", r"\$")) for name in met
            ],
            loc="lower right",
            bbox_to_anchor=(1.0, 0.96),
            ncols=4,
            frameon=False,
            handlelength=1.2,
            borderpad=0.0,
        )
