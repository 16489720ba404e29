"""Figures of force over depth: for a first descent, for a needle, and for a ball on a wall."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Flags
from tissue.models.tissue_model import TICK_S
from tissue.scene.coupling import WallAnatomy
from tissue.scene.tool import Probe
from tissue.show.figures.figure import (
    COMPONENTS,
    draw_arrow,
    field_words,
    layer_colours,
    legend_above,
    panelled,
    plain,
    save,
    styled,
)
from tissue.show.figures.force_time import FLICKER_S, spells
from tissue.simulation.bone_surface import HALF, facing, tool_axes
from tissue.simulation.builders.force_met import chosen_scale
from tissue.simulation.run import Run
from tissue.simulation.saved_fields import field_label
from tissue.simulation.trace import NO_LAYER

RISE_MM = 0.2
"""Rise of the tool that ends a descent [mm].

The value is twice the tremor of a novice's hand (0.1 mm, tissue/materials/hands.toml).
"""


def first_descent(coordinate_mm: Array, contact: Flags) -> slice:
    """Return the rows of the trace in which the tool first moves down into the tissue.

    The rows start where the tip is `RISE_MM` above its position at the first contact. They end at
    the deepest point that the tip reaches before it rises again by more than `RISE_MM`.

    Parameters
    ----------
    coordinate_mm
        Coordinate of the tool's tip, which increases out of the tissue [mm], shape (rows,).
    contact
        True where the tool touches tissue, shape (rows,).
    """
    if not contact.any():
        return slice(0, 0)
    first = int(contact.argmax())
    down = coordinate_mm[first:]
    risen = down > np.minimum.accumulate(down) + RISE_MM
    stop = int(risen.argmax()) if risen.any() else len(down)
    # the first row at the deepest point, up to rounding: a tool that rests there would add a
    # vertical line
    last = first + int(np.argmax(down[:stop] <= down[:stop].min() + 1e-6))
    before = int(np.searchsorted(-coordinate_mm[:first], -(coordinate_mm[first] + RISE_MM)))
    return slice(before, last + 1)


def layers_passed(run: Run, tips_mm: Array) -> NDArray[np.str_]:
    """Return the name of the layer at each position of the tip before any cut, shape (n,).

    `tips_mm` contains the positions [mm], shape (n, 3).
    """
    volume = run.volume
    place = np.floor((tips_mm * 1e-3 - volume.origin_m) / volume.spacing_m).astype(int)
    # tips outside of the voxels are clipped to have an index, and get no layer
    inside = ((place >= 0) & (place < volume.shape)).all(axis=1)
    x, y, z = np.clip(place, 0, np.array(volume.shape) - 1).T
    inside &= volume.fraction[x, y, z] >= HALF
    return np.where(inside, np.array(volume.layer_names)[volume.layer[x, y, z]], NO_LAYER)


@styled
def draw_force_depth(run: Run, path: Path) -> str | None:
    """Draw force and other values of the tissue over depth while the tool first moves down.

    Parameters
    ----------
    run
        A run with voxels.
    path
        File to write.

    Returns
    -------
    None, or the reason why the picture could not be drawn.
    """
    trace = run.trace
    axis, outward = facing(trace)
    tips = trace.vectors("tool", "mm")
    rows = first_descent(outward * tips[:, axis], trace["contact_mm2"] > 0.0)
    # a single point is no curve
    if len(tips[rows]) < 2:
        return "the tool did not go down into the tissue"
    coordinate_mm = outward * tips[rows, axis]
    passed = layers_passed(run, tips[rows])
    depth = coordinate_mm[int((passed != NO_LAYER).argmax())] - coordinate_mm
    measures: dict[str, list[str]] = {}
    for name in run.parts.tissue.measure_names:
        measures.setdefault(field_label(name)[1], []).append(name)
    # inches per panel at about 1.3: the force has the tallest panel, as it holds the names of
    # layers
    heights = [2.2, *([1.0] * len(measures))]
    # 3.55 in: the panel of the force, title, and label of the axis
    chart, panels = panelled(
        f"{run.scene.name}: force on the tool over depth, first descent",
        (8.0, 3.55 + 1.3 * len(measures)),
        len(heights),
        sharex=True,
        height_ratios=heights,
    )
    turns = tool_axes(trace.quaternions()[rows])
    model = trace.vectors("model_force", "N")[rows]
    size = np.linalg.norm(model, axis=1)
    along = np.einsum("ij,ij->i", model, turns)
    panels[0].plot(depth, size, color="0.1", label="magnitude")
    label = "along the tool's axis, outward"
    panels[0].plot(depth, along, color=COMPONENTS[0], linestyle=(0, (4, 2)), label=label)
    panels[0].set_ylabel("force / N")
    for axes, names in zip(panels[1:], measures.values(), strict=True):
        for name, colour in zip(names, ("0.1", *COMPONENTS, "#CC79A7"), strict=False):
            axes.plot(depth, trace[name][rows], color=colour, label=field_label(name)[0])
        axes.set_ylabel(field_words(*names).replace(" / ", "\n/ "))
        if len(names) > 1:
            axes.legend(ncols=len(names), loc="best")
    _shade(run, panels, depth, passed, size)
    plain(panels)
    panels[-1].set_xlim(depth[0], depth[-1])
    panels[-1].set_xlabel("depth of the tool's tip below the surface / mm")
    chart.align_ylabels(panels)
    legend_above(panels[0], 2)
    save(chart, path)
    return None


def _shade(
    run: Run, panels: NDArray[np.object_], depth: Array, passed: NDArray[np.str_], force: Array
) -> None:
    """Shade a band for each layer, with the name of the layer and the mean force in it."""
    colours = layer_colours(run.volume.layer_names)
    for first, last, name in spells(passed, shortest=round(FLICKER_S / TICK_S)):
        if name == NO_LAYER:
            continue
        ends = depth[first], depth[min(last, len(depth) - 1)]
        for axes in panels:
            axes.axvspan(*ends, color=colours[name], alpha=0.28, linewidth=0.0, zorder=0)
            axes.axvline(ends[0], color="0.35", linewidth=0.7, zorder=1)
        share = (ends[1] - ends[0]) / (depth[-1] - depth[0])
        mean = f"mean {force[first:last].mean():.2g} N"
        # a narrower band has no space even for upright text; up to 0.12 it is written upright
        if share > 0.02:
            panels[0].text(
                0.5 * sum(ends),
                0.97,
                f"{name}\n{mean}" if share > 0.12 else f"{name}, {mean}",
                transform=panels[0].get_xaxis_transform(),
                rotation=0.0 if share > 0.12 else 90.0,
                ha="center",
                va="top",
                size=8.5,
            )
    low, high = panels[0].get_ylim()
    # the names of the layers need a fifth of the panel above the curves
    panels[0].set_ylim(min(low, 0.0), high + 0.2 * (high - low))


SHARES = (
    ("elastic_N", "organ and membranes", "#56B4E9"),
    ("cutting_N", "cutting", "#E69F00"),
    ("friction_N", "friction along the shaft", "#009E73"),
)
SIDE_BY_SIDE = 0.15
"""Distance between two punctures, relative to the depth range, below which names are stacked."""


@styled
def draw_insertion(run: Run, path: Path) -> None:
    """Draw the axial force on a needle over tip depth and over time, with the punctures.

    Over time, the elastic, cutting and friction parts of the force are drawn too.
    """
    trace = run.trace
    time = trace["time_s"]
    depth = -trace["tool_z_mm"]
    force = trace["model_force_z_N"]
    # inches: two panels of equal height
    chart, panels = panelled(f"{run.scene.name}: axial force on the needle", (8.0, 6.4), 2)
    over_depth, over_time = panels
    inward = np.gradient(depth) > 0.0
    for chosen, colour, label in (
        (inward, "#0072B2", "pushed in"),
        (~inward, "#D55E00", "drawn out"),
    ):
        shown = np.where(chosen, force, np.nan)
        over_depth.plot(depth, shown, color=colour, linewidth=1.8, label=label)
    for name, label, colour in SHARES:
        over_time.plot(time, trace[name], color=colour, linewidth=1.8, label=label)
    over_time.plot(time, force, color="0.1", linewidth=1.0, label="all together")
    last_mm = -np.inf
    # points above the curve
    height = 10
    above = 4.0
    label = "puncture"
    for when, what in run.events:
        row = int(np.searchsorted(time, when))
        if "punctured" in what and row < len(time):
            # points above the curve; a line of text is 14 points high
            height = height + 14 if depth[row] - last_mm < SIDE_BY_SIDE * np.ptp(depth) else 10
            last_mm = depth[row]
            # leaders run behind the names of earlier punctures
            above -= 0.01
            over_depth.annotate(
                what.partition(" is punctured")[0].removeprefix("the "),
                # the force before the puncture, at its peak
                (depth[row], force[max(row - 1, 0)]),
                xytext=(0, height),
                textcoords="offset points",
                ha="center",
                arrowprops={"arrowstyle": "-", "color": "0.4"},
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
                zorder=above,
            )
            over_time.axvline(when, color="0.4", linestyle=":", label=label, zorder=0)
            label = ""
    over_depth.set_xlabel("depth of the tip below the resting surface / mm")
    over_depth.set_ylabel("axial force / N,\npositive drives it out")
    over_time.set(xlabel="time / s", ylabel="parts of the\naxial force / N")
    plain(panels)
    for axes in panels:
        # the zero line lies under the curves; a margin of 12 % holds the names of the punctures
        axes.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
        axes.margins(y=0.12)
        axes.legend(loc="best")
    save(chart, path)


WALL = "#CC79A7"
BALL = "0.1"
DEVICE = "#D55E00"
FORCE = "#0072B2"
LONGEST = 0.28
"""Length of the arrow of the largest force, relative to the height of the picture."""


@styled
def draw_wall(run: Run, path: Path) -> None:
    """Draw the paths of ball and device at a wall, and the force over the depth of the device.

    The upper panel shows the paths in a section perpendicular to the wall. The lower panel shows
    the force.

    The ball is drawn at the time of the largest force. In a run without a device, the force is
    drawn over the depth of the ball.
    """
    from matplotlib.patches import Circle

    trace = run.trace
    tool = run.scene.tool
    wall = run.scene.anatomy
    assert isinstance(tool, Probe) and isinstance(wall, WallAnatomy), wall.kind
    radius = 0.5 * tool.size_mm
    tips = trace.vectors("tool", "mm")
    aimed = tips
    force = trace["model_force_z_N"]
    across = int(np.ptp(tips[:, :2], axis=0).argmax())
    title = f"{run.scene.name}: {tool.size_mm:g} mm ball on a wall of {wall.stiffness_kN_m:g} kN/m"
    # inches; the panel of the paths is the taller one, since its axes have one scale
    chart, (side, felt) = panelled(title, (8.0, 6.6), 2, height_ratios=(1.5, 1.0))
    # the wall has no bottom: 1 m is beyond every view
    side.axhspan(-1e3, 0.0, color=WALL, alpha=0.35, linewidth=0.0, label="wall")
    felt.set_xlabel("depth of the ball below the wall's face / mm")
    if "device_x_mm" in trace:
        aimed = tips[0] + run.scene.motion_scale * (trace.vectors("device", "mm") - tips[0])
        look = {"color": DEVICE, "linewidth": 1.0, "linestyle": (0, (4, 2))}
        side.plot(aimed[:, across], aimed[:, 2], label="device", **look)
        scale = chosen_scale(run.scene).factor
        played = trace["device_force_z_N"] / scale
        label = "played by the device" + (f", over {scale:g}" if scale != 1.0 else "")
        felt.plot(-aimed[:, 2], played, label=label, **look)
        felt.set_xlabel("depth of the device below the wall's face / mm")
    side.plot(tips[:, across], tips[:, 2], color=BALL, linewidth=1.6, label="ball's tip")
    row = int(force.argmax())
    at, deep = tips[row, [across, 2]]
    side.add_patch(Circle((at, deep + radius), radius, fill=False, edgecolor=BALL))
    # 1.3 of the depth, at least 1 mm, shows the wall below the path; 2.2 radii show the whole ball
    low = min(1.3 * tips[:, 2].min(), 1.3 * aimed[:, 2].min(), -1.0)
    high = max(tips[:, 2].max(), 2.2 * radius)
    if force[row] > 0.0:
        end = deep + LONGEST * (high - low)
        draw_arrow(side, (at, deep), (at, end), FORCE, width=2.0)
        side.text(at, end, f"{force[row]:.3g} N", color=FORCE, ha="center", va="bottom")
    side.set(xlabel=f"{'xy'[across]} / mm", ylabel="z / mm", ylim=(low, high))
    side.set_aspect("equal", adjustable="datalim")
    felt.plot(-aimed[:, 2], force, color=FORCE, linewidth=1.4, label="of the wall on the ball")
    felt.set_ylabel("force along z / N")
    # a fifth of the depth is shown before the contact
    felt.set_xlim(left=0.2 * min(float(aimed[:, 2].min()), -1.0))
    plain((side, felt))
    side.legend(loc="upper right")
    felt.legend(loc="upper left")
    save(chart, path)
