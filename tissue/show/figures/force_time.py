"""Figures over time: force and torque with events, and the force that a device displayed."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from numpy.typing import NDArray

from tissue.haptics.device.device import device_parameters
from tissue.models.tissue_model import TICK_S
from tissue.show.figures.figure import (
    COMPONENTS,
    MAGNITUDE,
    SMALL_NM,
    figure,
    layer_colours,
    plain,
    save,
    styled,
)
from tissue.show.figures.tool_mesh import tool_turns
from tissue.simulation.bone_surface import tool_axes
from tissue.simulation.builders.force_met import chosen_scale
from tissue.simulation.run import Run
from tissue.simulation.trace import NO_LAYER, Table

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

__all__ = [
    "EVENT_IN",
    "FLICKER_S",
    "draw_force_torque",
    "draw_played",
    "event_footnotes",
    "event_lines",
    "joined_events",
    "mark_events",
    "spells",
]

MOST_EVENTS = 6
FOOTNOTE_LETTERS = 92
"""Letters of a line of 8.5 points in 7 inches: 101 of them went over the edge."""
EVENT_IN = 0.17
"""Height of a line that names an event [inch]."""
FLICKER_S = 0.02
"""Time below which intervals and repeated events are joined with the previous one [s].

A contact that begins touches and releases a few times within a few ticks of 1 ms. Bands of that
width would appear as stripes.
"""


def spells(names: NDArray[np.generic], *, shortest: int = 1) -> list[tuple[int, int, str]]:
    """Return runs of equal entries: first index, index after the last one, entry.

    A run with fewer entries than `shortest` is joined with the previous run, and the first run with
    the next one.
    """
    if not len(names):
        return []
    starts = np.flatnonzero(np.concatenate([[True], names[1:] != names[:-1]]))
    found: list[tuple[int, int, str]] = []
    for first, behind in zip(starts.tolist(), [*starts[1:].tolist(), len(names)], strict=True):
        name = str(names[first])
        if found and (behind - first < shortest or found[-1][2] == name):
            found[-1] = (found[-1][0], behind, found[-1][2])
        elif found and len(found) == 1 and found[0][1] - found[0][0] < shortest:
            found[0] = (0, behind, name)
        else:
            found.append((first, behind, name))
    return found


def joined_events(events: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """Return the events without repetitions of the same words within `FLICKER_S`.

    Numbers in the words are ignored.
    """
    last: dict[str, float] = {}
    found = []
    for time, what in events:
        words = "".join(each for each in what if not each.isdigit())
        if time - last.get(words, -np.inf) > FLICKER_S:
            found.append((time, what))
        last[words] = time
    return found


def event_lines(events: list[tuple[float, str]]) -> list[str]:
    """Return a numbered line for each event, and one line for the events beyond the limit."""
    lines = [
        f"{i}   {time:.3f} s: {what}" for i, (time, what) in enumerate(events[:MOST_EVENTS], 1)
    ]
    left = len(events) - MOST_EVENTS
    return [*lines, f"and {left} more"] if left > 0 else lines


def event_footnotes(events: list[tuple[float, str]]) -> list[str]:
    """Return the lines of the events, broken so that they fit below a figure 8 inches wide."""
    return [
        piece
        for line in event_lines(events)
        for piece in wrap(line, FOOTNOTE_LETTERS, subsequent_indent="     ")
    ]


def mark_events(panels: "Sequence[Axes]", events: list[tuple[float, str]]) -> None:
    """Draw a line through all panels at every event, with its number on top."""
    low, high = panels[0].get_xlim()
    place = -np.inf
    lowered = 0
    for number, (time, _) in enumerate(events[:MOST_EVENTS], 1):
        for axes in panels:
            axes.axvline(time, color="0.15", linewidth=0.9, linestyle=(0, (4, 2)), zorder=3)
        lowered = (lowered + 1) % 3 if time - place < 0.02 * (high - low) else 0
        place = time
        box = {
            "boxstyle": "circle,pad=0.15",
            "facecolor": "white",
            "edgecolor": "0.15",
            "linewidth": 0.7,
        }
        panels[0].annotate(
            str(number),
            (time, 0.93 - 0.1 * lowered),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="center",
            size=8.0,
            bbox=box,
            zorder=4,
        )


COMMANDED = 0.35
"""Opacity of the commanded quantities, below the model's line."""
HEAD_IN = 0.82


@styled
def draw_force_torque(run: Run, path: Path) -> None:
    """Draw force, torque, removal rate and the tool's path.

    Torque is left out if it is zero. Contact area replaces the removal rate if nothing is removed.
    """
    trace = run.trace
    time = trace["time_s"]
    events = joined_events(run.events)
    lines = event_footnotes(events)
    turns = bool(trace.vectors("torque", "Nm").any() or trace.vectors("model_torque", "Nm").any())
    heights = (3.0, *([2.2] if turns else []), 1.3, 1.45)
    foot = 0.55 + EVENT_IN * len(lines)
    full = 0.72 * sum(heights) + HEAD_IN + foot
    chart = figure(8.0, full)
    panels = chart.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    chart.subplots_adjust(
        left=0.11, right=0.98, top=1.0 - HEAD_IN / full, bottom=foot / full, hspace=0.18
    )
    _draw_components(panels[0], run, "force", "N", 1.0, "force / N")
    if turns:
        # A bur's torque is a thousandth of a reamer's.
        small = bool(np.abs(trace.vectors("torque", "Nm")).max(initial=0.0) < SMALL_NM)
        _draw_components(
            panels[1],
            run,
            "torque",
            "Nm",
            *((1e3, "torque / mN·m") if small else (1.0, "torque / N·m")),
        )
    about = " and torque about its tip" if turns else " (no torque)"
    chart.text(
        0.11,
        1.0 - 0.18 / full,
        f"{run.scene.name}: force on the tool{about}",
        va="center",
        size=10.5,
    )
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
        chart.text(
            0.11,
            (foot - 0.6 - EVENT_IN * line) / full,
            sentence,
            va="center",
            size=8.5,
            parse_math=False,
        )
    save(chart, path)


def _draw_components(
    axes: "Axes", run: Run, name: str, unit: str, scale: float, label: str
) -> None:
    """Draw the model's components over the commanded ones.

    The commanded components form a wide band where teeth vibrate.
    """
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
    """Return the entries of the legend in two rows."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    along = [Line2D([], [], color=COMPONENTS[c], label=f"along {'xyz'[c]}") for c in range(3)]
    given = Line2D([], [], color="0.2", linewidth=1.1, label="thin: as the model gives it")
    played = Line2D(
        [],
        [],
        color="0.2",
        linewidth=2.4,
        alpha=COMMANDED,
        label="wide: as commanded, after low-pass and vibration",
    )
    size = Patch(facecolor=MAGNITUDE, label="magnitude, as commanded")
    return [[*along, size], [given, played]]


def _draw_path(axes: "Axes", run: Run) -> None:
    """Draw the tip position along the tool's axis, with the layer at the tip shaded."""
    from matplotlib.patches import Patch

    trace = run.trace
    time = trace["time_s"]
    turned = tool_axes(tool_turns(trace))
    axes.plot(time, (trace.vectors("tool", "mm") * turned).sum(axis=1), color="0.1")
    axes.set(ylabel="tip along\nits axis / mm", xlabel="time / s")
    colours = layer_colours(trace.layer_names)
    drawn = [
        each
        for each in spells(trace["layer"], shortest=round(FLICKER_S / TICK_S))
        if each[2] != NO_LAYER
    ]
    for first, last, name in drawn:
        end = time[min(last, len(time) - 1)]
        axes.axvspan(time[first], end, color=colours[name], alpha=0.45, linewidth=0.0)
    met = [name for name in trace.layer_names if name in {each[2] for each in drawn}]
    if met:
        axes.legend(
            handles=[
                Patch(
                    facecolor=colours[name], alpha=0.45, label=f"tip in {name}".replace("$", r"\$")
                )
                for name in met
            ],
            loc="lower right",
            bbox_to_anchor=(1.0, 0.96),
            ncols=4,
            frameon=False,
            handlelength=1.2,
            borderpad=0.0,
        )


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
    (
        "device_force",
        "as the device played it",
        {"color": "#D55E00", "linewidth": 2.2, "linestyle": "-"},
    ),
    (
        "filtered_force",
        "as commanded, after low-pass and delay",
        {"color": "0.1", "linewidth": 1.0, "linestyle": (0, (4, 3))},
    ),
)
"""Columns, their labels, and colours after Okabe and Ito (2008).

The colours also differ in lightness and stroke.
"""
SATURATED = "#F0E442"


def draw_played(run: Run, path: Path) -> None:
    """Draw device forces [N], compressed spans, force changes, and tool and device [mm].

    The force changes are the largest changes at 1 ms.
    """
    trace = run.trace
    scene = run.scene
    scale, _ = chosen_scale(scene)
    sizes = _sizes(trace, scale)
    time = trace["time_s"]
    limits = device_parameters(scene.held.kind, scene.constants)
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
        panels[0].annotate(
            f"greatest force of the {scene.held.kind}, {limits.force_limit_N:g} N",
            (time[0], limits.force_limit_N),
            (4, -11),
            textcoords="offset points",
            size=8.5,
        )
    panels[0].axvspan(time[moment][0], time[moment][-1], color="0.85", linewidth=0.0, zorder=0)
    panels[1].set_title("the steepest moment, grey above", size=9.0, loc="left")
    axis = int(
        np.abs(trace.vectors("tool", "mm") - trace.vectors("device", "mm")).max(axis=0).argmax()
    )
    for name, colour, width in (("device", "#56B4E9", 2.0), ("tool", "0.1", 1.2)):
        values = trace[f"{name}_{'xyz'[axis]}_mm"]
        panels[2].plot(time, values, label=name, color=colour, linewidth=width)
    panels[2].set(ylabel=f"{'xyz'[axis]} / mm")
    panels[2].legend(loc="best", frameon=False, ncols=2)
    if turns:
        for index, colour in enumerate(("#0072B2", "#D55E00", "#009E73")):
            panels[3].plot(
                time,
                1e3 * trace.vectors("device_torque", "Nm")[:, index],
                color=colour,
                label="xyz"[index],
            )
        panels[3].set(ylabel="torque played\n/ mN·m")
        panels[3].legend(loc="best", frameon=False, ncols=3)
    panels[-1].set_xlabel("time / s")
    plain(panels)
    chart.align_ylabels(panels)
    handles, labels = panels[0].get_legend_handles_labels()
    chart.legend(
        handles, labels, loc="upper left", bbox_to_anchor=(0.11, 0.95), ncols=2, frameon=False
    )
    title = (
        f"{scene.name}: what the {scene.held.kind} played ({scene.held.hand}, "
        f"{scene.held.renderer})"
    )
    chart.text(
        0.12, 0.965, f"{title}; {scale:g} N for each newton at the tool", va="center", size=10.0
    )
    save(chart, path)


def _compressed(saturated: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and end row of the compressed spans. Spans less than `FLICKER_S` apart are
    joined.
    """
    found: list[tuple[int, int]] = []
    for start, end, name in spells(saturated):
        if name == "True":
            near = bool(found) and (start - found[-1][1]) * TICK_S < FLICKER_S
            found[-1:] = [(found[-1][0], end)] if near else [*found[-1:], (start, end)]
    return found


def _sizes(trace: Table, force_scale: float) -> dict[str, Array]:
    """Return the magnitudes of the forces at the device [N], by the names of `LINES`."""
    sizes = {"model": force_scale * np.linalg.norm(trace.vectors("model_force", "N"), axis=1)}
    there = (name for name, _, _ in LINES if f"{name}_x_N" in trace.columns)
    return sizes | {name: np.linalg.norm(trace.vectors(name, "N"), axis=1) for name in there}
