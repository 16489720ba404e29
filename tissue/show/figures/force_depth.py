"""Figures of force over depth: for a rotating tool, for a needle, and for a ball on a wall."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Flags, Ints
from tissue.models.needle.parameters import LEAST_COSINE
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
from tissue.show.figures.force_time import FLICKER_S, constant_intervals
from tissue.simulation.bone_surface import facing, tool_axes
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.run import Run
from tissue.simulation.saved_fields import field_label
from tissue.simulation.trace import NO_LAYER, Table

APPROACH_MM = 0.2
"""Height above the first contact at which a plot over depth begins [mm]; chosen for the plot."""


def needle_travel_mm(trace: Table) -> Array:
    """Return the travel of a needle's tip beyond the undeformed surface [mm], shape (rows,).

    The travel is measured along the needle, as in the events of a puncture. It is negative outside
    the organ.
    """
    cosines = tool_axes(trace.quaternions())[:, 2]
    # The model measures the height of a flatter needle outside the organ vertically.
    cosines = np.where(cosines >= LEAST_COSINE, cosines, 1.0)
    return -trace["tool_z_mm"] / cosines


def deepening_rows(coordinate_mm: Array, contact: Flags) -> Ints:
    """Return those rows of the trace in which the tip is deeper than in all previous rows.

    The first row is the one in which the tip comes within `APPROACH_MM` of its position at the
    first contact. Rows of sideways or upward motion are left out, so that each depth occurs only
    once.

    Parameters
    ----------
    coordinate_mm
        Coordinate of the tool's tip [mm], shape (rows,), along an axis that points out of the
        tissue.
    contact
        True where the tool touches tissue, shape (rows,).
    """
    if not contact.any():
        return np.zeros(0, dtype=np.int64)
    first = int(contact.argmax())
    height = coordinate_mm.copy()
    # a tool that approaches from the side may be lower before its first contact
    height[:first] = np.maximum(height[:first], height[first])
    lowest = np.minimum.accumulate(height)
    # 1e-9 mm: rounding of the position of a tool at rest
    is_deeper = np.append(True, lowest[1:] < lowest[:-1] - 1e-9)
    return np.flatnonzero(is_deeper & (height <= height[first] + APPROACH_MM))


@styled
def draw_force_depth(run: Run, path: Path) -> str | None:
    """Draw force and other columns of the tissue model over the depth of the tip.

    Only the rows of `deepening_rows` are drawn, so that each depth occurs once. Shading shows the
    layer with the largest contact area. For each layer, the legend gives the mean force over all
    ticks in which this layer has the largest contact area.

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
    contact = trace["contact_mm2"] > 0.0
    coordinate_mm = outward * tips[:, axis]
    rows = deepening_rows(coordinate_mm, contact)
    # a single point is no curve
    if contact[rows].sum() < 2:
        return "the tool did not go down into the tissue"
    depth = coordinate_mm[contact.argmax()] - coordinate_mm[rows]
    measures: dict[str, list[str]] = {}
    for name in run.parts.tissue.measure_names:
        measures.setdefault(field_label(name)[1], []).append(name)
    # units of 1.3 in; the force has the tallest panel
    heights = [2.2, *(1.0 if len(names) == 1 else 1.8 for names in measures.values())]
    # 0.69 in: title and label of the axis
    chart, panels = panelled(
        f"{run.scene.name}: force on the tool where its tip is first at each depth",
        (8.0, 0.69 + 1.3 * sum(heights)),
        len(heights),
        sharex=True,
        height_ratios=heights,
    )
    turns = tool_axes(trace.quaternions()[rows])
    model = trace.vectors("model_force", "N")
    size = np.linalg.norm(model, axis=1)
    along = np.einsum("ij,ij->i", model[rows], turns)
    panels[0].plot(depth, size[rows], color="0.1", label="magnitude")
    label = "along the tool's axis, outward"
    panels[0].plot(depth, along, color=COMPONENTS[0], linestyle=(0, (4, 2)), label=label)
    panels[0].set_ylabel("force / N")
    colours = ("0.1", *COMPONENTS, "#CC79A7", "#56B4E9")
    for axes, names in zip(panels[1:], measures.values(), strict=True):
        for name, colour in zip(names, colours, strict=False):
            axes.plot(depth, trace[name][rows], color=colour, label=field_label(name)[0])
        axes.set_ylabel(field_words(*names).replace(" / ", "\n/ "))
        if len(names) > 1:
            axes.legend(ncols=2, loc="best", fontsize=8)
        elif unseen := _unseen_extremes(run, names[0], rows):
            axes.set_title(unseen, loc="right", fontsize=8)
    _shade(run, panels, depth, rows, size)
    plain(panels)
    panels[-1].set_xlim(depth[0], depth[-1])
    last_s = trace["time_s"][rows[-1]]
    panels[-1].set_xlabel(
        "depth of the tool's tip from its first contact / mm; "
        f"the last new depth is reached at {last_s:.3f} s"
    )
    chart.align_ylabels(panels)
    legend_above(panels[0], 2)
    save(chart, path)
    return None


def _unseen_extremes(run: Run, name: str, rows: Ints) -> str:
    """Return a text with the extremes of a column that the drawn rows do not contain.

    Rows of the trace before the first drawn row are ignored.
    """
    values = run.trace[name][rows[0] :]
    shown = run.trace[name][rows]
    unit = field_label(name)[1]
    # 1 % of the range cannot be seen in the picture
    slack = 0.01 * np.ptp(values)
    found = []
    for word, row, is_outside in (
        ("largest", int(values.argmax()), values.max() > shown.max() + slack),
        ("smallest", int(values.argmin()), values.min() < shown.min() - slack),
    ):
        if is_outside:
            time_s = run.trace["time_s"][rows[0] + row]
            found.append(f"{word} in the run: {values[row]:.3g} {unit} at {time_s:.3g} s")
    return ", ".join(found)


def _shade(run: Run, panels: NDArray[np.object_], depth: Array, rows: Ints, force: Array) -> None:
    """Shade the layers with the largest contact area, and add their mean forces to the legend.

    `depth` has one value per entry of `rows`; `force` has one value per row of the trace.
    """
    layers = run.trace["layer"]
    colours = layer_colours(run.volume.layer_names)
    look: dict[str, Any] = {"alpha": 0.28, "linewidth": 0.0}
    for first, last, name in constant_intervals(layers[rows], shortest=round(FLICKER_S / TICK_S)):
        if name == NO_LAYER:
            continue
        for axes in panels:
            end = depth[min(last, len(depth) - 1)]
            axes.axvspan(depth[first], end, color=colours[name], zorder=0, **look)
    for name, colour in colours.items():
        in_layer = layers == name
        if in_layer.any():
            label = f"{name}: mean {force[in_layer].mean():.2g} N over the whole run"
            panels[0].plot([], [], color=colour, alpha=look["alpha"], linewidth=8.0, label=label)


SHARES = (
    ("elastic_N", "organ and membranes", "#56B4E9"),
    ("cutting_N", "cutting", "#E69F00"),
    ("friction_N", "friction along the shaft", "#009E73"),
)
SIDE_BY_SIDE = 0.15
"""Distance of two punctures, relative to the depth range, below which labels are stacked."""


SPRING_BACK_MM = 1.0
"""Longest outward motion of a needle that counts as part of an insertion [mm].

A needle on a device springs back by some tenths of a millimetre after a slip. With a smaller value,
this motion would be drawn as a withdrawal.
"""


def _inward(depth_mm: Array) -> Flags:
    """Return True for each tick of an insertion, and False for each tick of a withdrawal.

    A reversal counts only if the reversed motion is longer than `SPRING_BACK_MM`.
    """
    found = np.ones(len(depth_mm), dtype=bool)
    is_inward = True
    turn = 0  # row of the deepest point of an insertion, or the shallowest of a withdrawal
    for row, depth in enumerate(depth_mm):
        beyond = depth - depth_mm[turn] if is_inward else depth_mm[turn] - depth
        if beyond >= 0.0:
            turn = row
        elif beyond < -SPRING_BACK_MM:
            is_inward = not is_inward
            found[turn + 1 :] = is_inward
            turn = row
    return found


@styled
def draw_insertion(run: Run, path: Path) -> None:
    """Draw the axial force on a needle over tip travel and over time, and mark the punctures.

    The panel over time also shows the elastic, cutting and friction parts of the force.
    """
    trace = run.trace
    time = trace["time_s"]
    depth = needle_travel_mm(trace)
    axes_of_tool = tool_axes(trace.quaternions())
    force = np.einsum("ij,ij->i", trace.vectors("model_force", "N"), axes_of_tool)
    # inches: two panels of equal height
    chart, panels = panelled(f"{run.scene.name}: axial force on the needle", (8.0, 6.4), 2)
    over_depth, over_time = panels
    inward = _inward(depth)
    for chosen, colour, label in (
        (inward, "#0072B2", "insertion"),
        (~inward, "#D55E00", "withdrawal"),
    ):
        if not chosen.any():
            continue
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
    over_depth.set_xlabel("travel of the tip along the needle, from the undeformed surface / mm")
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
"""Length of the arrow that shows the largest force, relative to the picture's height."""


@styled
def draw_wall(run: Run, path: Path) -> None:
    """Draw the paths of the ball and the haptic device at a virtual wall, and force over depth.

    The upper panel shows the paths in a section perpendicular to the wall. The lower panel shows
    the force.

    The depth is the device's depth in the wall or, in a run without a device, the ball's depth. The
    ball is drawn at the time of the largest force.
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
    side.set(xlabel=f"{'xy'[across]} / mm", ylabel="z / mm")
    # a path wider than the panel extends these limits, and fixed limits would print a warning
    side.set_ylim(low, high, auto=True)
    side.set_aspect("equal", adjustable="datalim")
    felt.plot(-aimed[:, 2], force, color=FORCE, linewidth=1.4, label="of the wall on the ball")
    felt.set_ylabel("force along z / N")
    # a fifth of the depth is shown before the contact
    felt.set_xlim(left=0.2 * min(float(aimed[:, 2].min()), -1.0))
    plain((side, felt))
    legend_above(side, 3)
    felt.legend(loc="upper left")
    save(chart, path)
