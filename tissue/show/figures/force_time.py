"""Figures over time: force and torque with events, and the force of a haptic device."""

from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissue.models.tissue_model import TICK_S
from tissue.show.figures.figure import (
    COMPONENTS,
    MAGNITUDE,
    layer_colours,
    legend_above,
    panelled,
    plain,
    save,
    styled,
    torque_unit,
)
from tissue.simulation.bone_surface import tool_axes
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.run import Run
from tissue.simulation.trace import NO_LAYER

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_EVENTS = 6
"""Largest number of events that are numbered and listed below a picture.

A list of more events would be higher than a panel.
"""
FOOTNOTE_LETTERS = 92
"""Largest number of letters in a footnote line, which is 7 inches wide with 8.5 point letters."""
EVENT_IN = 0.17
"""Height of a text line for an event below a picture [in]."""
FLICKER_S = 0.02
"""Duration [s] below which intervals, or gaps between equal events, are ignored.

At the start of a contact, the tool bounces within a few ticks of 1 ms. Shaded bands of this width
would look like stripes.
"""


def constant_intervals(
    names: NDArray[np.generic], *, shortest: int = 1
) -> list[tuple[int, int, str]]:
    """Return intervals of equal consecutive entries as (first index, index after the last, entry).

    An interval with fewer entries than `shortest` is joined with the previous interval. If the
    first interval is too short, it is joined with the next interval.
    """
    if not len(names):
        return []
    starts = np.flatnonzero(np.concatenate([[True], names[1:] != names[:-1]]))
    found: list[tuple[int, int, str]] = []
    for first, behind in zip(starts.tolist(), [*starts[1:].tolist(), len(names)], strict=True):
        name = str(names[first])
        # too short, or the same as before a run that was too short
        if found and (behind - first < shortest or found[-1][2] == name):
            found[-1] = (found[-1][0], behind, found[-1][2])
        # the first run is too short itself
        elif found and len(found) == 1 and found[0][1] - found[0][0] < shortest:
            found[0] = (0, behind, name)
        else:
            found.append((first, behind, name))
    return found


def joined_events(events: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """Return events (time [s], text) without repetitions of a text within `FLICKER_S`.

    Texts that differ only in numbers count as equal.
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
    """Return a numbered line of text for each of the first `MOST_EVENTS` events.

    If there are more events, an additional last line gives the number of remaining events.
    """
    lines = [
        f"{i}   {time:.3f} s: {what}" for i, (time, what) in enumerate(events[:MOST_EVENTS], 1)
    ]
    left = len(events) - MOST_EVENTS
    return [*lines, f"and {left} more"] if left > 0 else lines


def event_footnotes(events: list[tuple[float, str]]) -> list[str]:
    """Return the text of `event_lines`, wrapped to fit below a figure of 8 inches width."""
    return [
        piece
        for line in event_lines(events)
        for piece in wrap(line, FOOTNOTE_LETTERS, subsequent_indent="     ")
    ]


def mark_events(
    panels: NDArray[np.object_], events: list[tuple[float, str]], *, listed: bool = True
) -> None:
    """Draw a numbered vertical line through all panels at each of the first `MOST_EVENTS` events.

    If `listed` is True, the events are listed below the panels.
    """
    low, high = panels[0].get_xlim()
    place = -np.inf
    lowered = 0
    for number, (time, _) in enumerate(events[:MOST_EVENTS], 1):
        for axes in panels:
            # dashes, since layers and steps have full lines
            axes.axvline(time, color="0.15", linewidth=0.9, linestyle=(0, (4, 2)), zorder=3)
        # numbers closer than 2 % of the axis would overlap; they are placed at three heights
        lowered = (lowered + 1) % 3 if time - place < 0.02 * (high - low) else 0
        place = time
        panels[0].annotate(
            str(number),
            (time, 0.93 - 0.1 * lowered),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="center",
            size=8.0,
            bbox={"boxstyle": "circle,pad=0.15", "facecolor": "white", "linewidth": 0.7},
            zorder=4,
        )
    if listed and events:
        lines = "\n".join(event_footnotes(events))
        panels[0].figure.supxlabel(lines, x=0.02, ha="left", size=8.5, parse_math=False)


COMMANDED = 0.35
"""Opacity of commanded force and torque, drawn behind force and torque of the model."""


@styled
def draw_force_torque(run: Run, path: Path) -> None:
    """Draw force, torque, removal rate and tip position over time.

    Torque is left out if it is zero. If nothing is removed, the contact area is drawn instead of
    the removal rate.
    """
    trace = run.trace
    time = trace["time_s"]
    events = joined_events(run.events)
    turns = bool(trace.vectors("torque", "Nm").any() or trace.vectors("model_torque", "Nm").any())
    # inches of the panels; force is the largest, removal rate and path need less
    heights = (2.2, *([1.6] if turns else []), 0.9, 1.0)
    # 1.4 in for title, legends and the label of the axis
    full = sum(heights) + 1.4 + EVENT_IN * len(event_footnotes(events))
    chart, panels = panelled(
        f"{run.scene.name}: force on the tool{'' if turns else ' (no torque)'}",
        (8.0, full),
        len(heights),
        sharex=True,
        height_ratios=heights,
    )
    _draw_components(panels[0], run, "force", "N", 1.0, "force / N")
    if turns:
        unit, scale = torque_unit(np.abs(trace.vectors("torque", "Nm")).max(initial=0.0))
        _draw_components(panels[1], run, "torque", "Nm", scale, f"torque / {unit}")
    legend_above(panels[0], 3)
    cuts = bool((trace["removed_mm3"] > 0.0).any())
    panels[-2].plot(time, trace["removal_rate_mm3_s" if cuts else "contact_mm2"], color="0.1")
    panels[-2].set_ylabel("removal rate\n/ mm³ s⁻¹" if cuts else "contact area\n/ mm²")
    panels[-2].set_ylim(bottom=0.0)
    _draw_path(panels[-1], run)
    plain(panels)
    chart.align_ylabels(panels)
    mark_events(panels, events)
    save(chart, path)


def _draw_components(
    axes: "Axes", run: Run, name: str, unit: str, scale: float, label: str
) -> None:
    """Draw a vector's components: values of the model in front of commanded values.

    With simulated vibration by the cutter's teeth, the commanded components look like wide bands.
    """
    time = run.trace["time_s"]
    commanded, model = (scale * run.trace.vectors(f"{of}{name}", unit) for of in ("", "model_"))
    # all commanded components first, so that none of them hides a component of the model
    for c, colour in enumerate(COMPONENTS):
        axes.plot(time, commanded[:, c], color=colour, linewidth=2.4, alpha=COMMANDED)
    for c, colour in enumerate(COMPONENTS):
        axes.plot(time, model[:, c], color=colour, linewidth=1.1, label=f"along {'xyz'[c]}")
    size = np.linalg.norm(commanded, axis=1)
    axes.fill_between(
        time, size, color=MAGNITUDE, linewidth=0.0, zorder=0, label="magnitude, as commanded"
    )
    axes.plot([], [], color="0.2", linewidth=1.1, label="thin: force of the model")
    wide = "wide: as commanded, after low-pass and vibration"
    axes.plot([], [], color="0.2", linewidth=2.4, alpha=COMMANDED, label=wide)
    axes.set_ylabel(label)
    axes.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)


def _draw_path(axes: "Axes", run: Run) -> None:
    """Draw the tip position along the tool's axis, shaded by the layer of largest contact."""
    trace = run.trace
    time = trace["time_s"]
    turned = tool_axes(trace.quaternions())
    axes.plot(time, (trace.vectors("tool", "mm") * turned).sum(axis=1), color="0.1")
    axes.set(ylabel="tip along\nits axis / mm", xlabel="time / s")
    colours = layer_colours(trace.layer_names)
    named: set[str] = set()
    for first, last, name in constant_intervals(trace["layer"], shortest=round(FLICKER_S / TICK_S)):
        if name == NO_LAYER:
            continue
        # one legend entry for each layer
        label = "" if name in named else f"largest contact: {name}".replace("$", r"\$")
        end = time[min(last, len(time) - 1)]
        axes.axvspan(time[first], end, color=colours[name], alpha=0.45, linewidth=0.0, label=label)
        named.add(name)
    if named:
        longest = max(len(name) for name in named)
        legend_above(axes, max(LEGEND_LETTERS // (longest + BESIDE_NAME_LETTERS), 1))


LEGEND_LETTERS = 125
BESIDE_NAME_LETTERS = 25
"""Width of a legend entry without the layer's name [letters]: colour patch, other words and gaps.

`LEGEND_LETTERS` is the largest width of a legend row. A wider legend would narrow the panels.
"""
MOMENT_S = 0.06
"""Duration [s] of an enlarged interval, in which latencies of milliseconds are visible."""
LINES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("model_force", "tissue force times the force scale", {"color": "0.6", "linewidth": 3.0}),
    ("raw_force", "force of the renderer", {"color": "#0072B2", "linewidth": 1.6}),
    (
        "predicted_force",
        "predicted force",
        {"color": "#CC79A7", "linewidth": 1.3, "linestyle": (0, (1, 1))},
    ),
    ("device_force", "played by the device", {"color": "#D55E00", "linewidth": 2.2}),
    (
        "filtered_force",
        "commanded, after low-pass and delay",
        {"color": "0.1", "linewidth": 1.0, "linestyle": (0, (4, 3))},
    ),
)
"""Trace columns that `draw_played` draws, with labels and line properties.

The colours are from Okabe and Ito (2008). The lines also differ in lightness and style.
"""
SATURATED = "#F0E442"


@styled
def draw_played(run: Run, path: Path) -> None:
    """Draw the forces at the device [N] and the positions of tool and device [mm] over time.

    Shading marks the times at which the force is compressed to fit into the force range of the
    device.

    A separate panel enlarges the interval with the largest change of force in one millisecond
    during contact.
    """
    trace = run.trace
    held = run.scene.held
    time = trace["time_s"]
    scale = chosen_scale(run.scene).factor
    turns = bool(trace.vectors("device_torque", "Nm").any())
    # inches: the whole run, its steepest moment, the positions, and the torque if there is any
    heights = (2.4, 2.0, 1.5, 1.2)[: 3 + turns]
    # 1 in for title, legends and the label of the axis
    chart, panels = panelled(
        f"{run.scene.name}: force at the {held.kind} (hand: {held.hand}, renderer: "
        f"{held.renderer}, force scale: {scale:g})",
        (8.0, 1.0 + sum(heights)),
        len(heights),
        height_ratios=heights,
    )
    sizes = {
        name: np.linalg.norm(trace.vectors(name, "N"), axis=1)
        for name, _, _ in LINES
        if f"{name}_x_N" in trace.columns
    }
    sizes["model_force"] *= scale
    change = np.abs(np.diff(sizes["raw_force"], prepend=0.0))
    # the motion of the hand before the contact changes the force, too
    steepest = int(np.where(trace["contact_mm2"] > 0.0, change, 0.0).argmax())
    # a quarter of the moment is shown before the steepest change
    first = max(steepest - round(0.25 * MOMENT_S / TICK_S), 0)
    moment = slice(first, first + round(MOMENT_S / TICK_S))
    for axes, span in ((panels[0], slice(None)), (panels[1], moment)):
        for name, label, look in LINES:
            if name in sizes:
                axes.plot(time[span], sizes[name][span], label=label, **look)
        axes.set_ylabel("size of the force\nat the device / N")
    saturated = trace["saturated"] > 0.0
    if saturated.any():
        panels[0].fill_between(
            time,
            0.0,
            1.0,
            where=saturated,
            transform=panels[0].get_xaxis_transform(),
            color=SATURATED,
            alpha=0.6,
            zorder=0,
            label="compressed into the device's range",
        )
    # the edges stay visible where the interval is narrower than a pixel
    edges: dict[str, Any] = {"facecolor": "0.85", "edgecolor": "0.4", "linewidth": 1.0}
    panels[0].axvspan(time[moment][0], time[moment][-1], zorder=0, **edges)
    panels[1].set_title("steepest change of force in contact, grey above", loc="left")
    apart = np.abs(trace.vectors("tool", "mm") - trace.vectors("device", "mm")).max(axis=0)
    axis = "xyz"[int(apart.argmax())]
    # the tool's line is thinner and drawn last, so that both are visible where they coincide
    for name, colour, width in (("device", "#56B4E9", 2.0), ("tool", "0.1", 1.2)):
        panels[2].plot(time, trace[f"{name}_{axis}_mm"], label=name, color=colour, linewidth=width)
    panels[2].set_ylabel(f"{axis} / mm")
    panels[2].legend(loc="best", ncols=2)
    if turns:
        torque = 1e3 * trace.vectors("device_torque", "Nm")
        for c, colour in enumerate(COMPONENTS):
            panels[3].plot(time, torque[:, c], color=colour, label="xyz"[c])
        panels[3].set_ylabel("torque played\n/ mN·m")
        panels[3].legend(loc="best", ncols=3)
    panels[-1].set_xlabel("time / s")
    plain(panels)
    chart.align_ylabels(panels)
    legend_above(panels[0], 2)
    save(chart, path)
