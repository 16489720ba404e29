"""Plot of the loads on the tools of several runs, over depth or time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from tissue.objects.plots import COLOURS, new_panels
from tissue.show.figures.figure import plain, styled, torque_unit
from tissue.show.figures.force_depth import deepening_rows, needle_travel_mm
from tissue.simulation.bone_surface import facing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from tissue.fitting.bands.band import Band
    from tissue.simulation.trace import Table

Over = Literal["time", "depth"]
MOST_NAMED = 12
"""Largest number of names in a legend. With this number, the legend has four lines."""
LONG = 28
"""Length of the longest name [letters] above which a line of the legend holds only two names."""
SMALL = 0.05
"""Smallest ratio of a drawn force component to the largest force component."""
INSERTION = "insertion_mm"
"""Column that only the trace of a needle has."""
MAINLY = 0.5
"""Ratio of depth to path length in contact, above which depth is the default abscissa."""
WIDTHS = 2.2, 1.0
"""Line widths of the first and last curve [points]; wide curves stay visible below thin ones."""
THRUST, ACROSS_X, ACROSS_Y, TORQUE = range(4)
FORCES = ("thrust / N", "force across\nthe tool, x / N", "force across\nthe tool, y / N")
LOWER_QUANTILE = 0
UPPER_QUANTILE = -1
"""Index of the 95 % quantile in an uncertainty band.

`LOWER_QUANTILE` is the index of the 5 % quantile.
"""


@dataclass(frozen=True, eq=False)
class Curve:
    """One run in a plot.

    Attributes
    ----------
    label
        Name in the legend.
    trace
        Trace of the run.
    band
        Uncertainty band of the run; None to draw no band.
    is_path_given
        Whether the tool follows a given path. All samples of the uncertainty band then have the
        same depth at a given time, so the band can be drawn over depth.
    """

    label: str
    trace: "Table"
    band: "Band | None" = None
    is_path_given: bool = True


@dataclass(frozen=True, eq=False)
class Loads:
    """Loads on the tool in the tool's frame, over time or depth.

    Attributes
    ----------
    place
        Time [s] or depth [mm], shape (rows,).
    values
        Columns: thrust [N], two force components perpendicular to the tool's axis [N], and torque
        [N m]; shape (rows, 4).
    low, high
        Ends of the 90 % uncertainty band of `values`, shape (n, 4). The band covers the first n
        rows. None without a band.
    force
        Force on the tool in the world frame [N], shape (rows, 3).
    """

    place: Array
    values: Array
    low: Array | None
    high: Array | None
    force: Array


def chosen_over(curves: Sequence[Curve]) -> Over:
    """Return ``depth`` if all tools mainly move into the tissue, else ``time``.

    If a run has an uncertainty band and its tool does not follow a given path, return ``time``.
    """
    if any(each.band is not None and not each.is_path_given for each in curves):
        return "time"
    return "depth" if all(_mainly_descends(each.trace) for each in curves) else "time"


def _mainly_descends(trace: "Table") -> bool:
    """Return True if the depth is more than half of the length of the tip's path in contact."""
    contact, height = _heights(trace)
    steps = np.linalg.norm(np.diff(trace.vectors("tool", "mm"), axis=0), axis=1)
    descent = height[deepening_rows(height, contact)]
    return len(descent) > 1 and bool(np.ptp(descent) > MAINLY * steps[contact[1:]].sum())


def _heights(trace: "Table") -> tuple[Flags, Array]:
    """Return a mask of rows in contact, and the tip's coordinate along the outward axis [mm].

    For a needle, the coordinate is the negative travel of the tip along the needle.
    """
    contact = trace["contact_mm2"] > 0.0
    if INSERTION in trace.columns:
        return contact, -needle_travel_mm(trace)
    axis, outward = facing(trace)
    return contact, outward * trace.vectors("tool", "mm")[:, axis]


@styled
def overlay(
    curves: Sequence[Curve], *, over: Over | None = None, about_axis: bool = True
) -> NDArray[np.object_]:
    """Draw thrust, lateral force and torque of all runs in one figure.

    A force component perpendicular to the tool's axis is not drawn if it is small in all runs. For
    two runs, the last panel shows the magnitude of the vector difference of the two forces at equal
    time or depth.

    Parameters
    ----------
    curves
        Runs in the order of the legend.
    over
        ``time``; or ``depth`` below the point of first contact, for a needle along its axis. Over
        depth, only ticks in which the tip is deeper than ever before are drawn. See `chosen_over`
        for the default.
    about_axis
        Whether to draw the torque about the tool's axis. Otherwise the magnitude of the torque
        vector is drawn.

    Returns
    -------
    Matplotlib axes, one for each panel, shape (panels,).
    """
    over = over or chosen_over(curves)
    if over not in ("time", "depth"):
        raise InputError("over", "be time or depth", over, "use one of these")
    loads = [_loads(each, over, about_axis=about_axis) for each in curves]
    largest = np.max([np.abs(each.values).max(axis=0, initial=0.0) for each in loads], axis=0)
    forces = [at for at in range(TORQUE) if largest[at] >= SMALL * largest[:TORQUE].max()]
    panels = new_panels(len(forces) + bool(largest[TORQUE]) + (len(loads) == 2))
    for axes, at in zip(panels, forces, strict=False):
        axes.set_ylabel(FORCES[at])
        _draw(axes, curves, loads, at)
    if largest[TORQUE] > 0.0:
        unit, scale = torque_unit(largest[TORQUE])
        axes = panels[len(forces)]
        axes.set_ylabel(f"torque{' about' * about_axis}\n{'the axis ' * about_axis}/ {unit}")
        first = loads[0].values[:, TORQUE].sum()
        _draw(axes, curves, loads, TORQUE, scale=-scale if first < 0.0 else scale)
    if len(loads) == 2:
        panels[-1].set_ylabel("magnitude of the\nforce difference / N")
        panels[-1].plot(*_difference(*loads), color="0.3", linewidth=1.1)
    depth = "depth of the tool's tip from its first contact / mm"
    if all(INSERTION in each.trace.columns for each in curves):
        depth = "travel of the tip along the needle, from its first contact / mm"
    panels[-1].set_xlabel("time / s" if over == "time" else depth)
    _legend(panels, curves)
    plain(panels)
    panels[0].figure.align_ylabels(panels)
    return panels


def _draw(
    axes: "Axes", curves: Sequence[Curve], loads: Sequence[Loads], at: int, *, scale: float = 1.0
) -> None:
    """Draw column `at` of the loads of all runs, with uncertainty bands."""
    widths = np.linspace(*WIDTHS, len(curves))
    for number, (curve, load) in enumerate(zip(curves, loads, strict=True)):
        colour = _colour(number, len(curves))
        label = curve.label
        if load.low is not None and load.high is not None:
            ends = scale * load.low[:, at], scale * load.high[:, at]
            rows = load.place[: len(load.low)]
            axes.fill_between(rows, *ends, color=colour, alpha=0.12, linewidth=0.0)
            # Thin edges distinguish bands that cover each other.
            axes.plot(rows, np.column_stack(ends), color=colour, alpha=0.7, linewidth=0.6)
        elif curve.band is not None:
            label += " (band not drawn)"
        look = {"color": colour, "linewidth": widths[number], "label": label}
        axes.plot(load.place, scale * load.values[:, at], **look)
    axes.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)


def _legend(panels: NDArray[np.object_], curves: Sequence[Curve]) -> None:
    """Write the names of the runs above all panels.

    If there are more than `MOST_NAMED` runs, only the names of an evenly spaced selection are
    written.
    """
    handles, labels = panels[0].get_legend_handles_labels()
    every = -(-len(curves) // MOST_NAMED)
    title = []
    if every > 1:
        title.append(f"1 run in {every} is named")
    if any(each.band is not None for each in curves):
        title.append("bands: 90 %")
    columns = 3 if max(map(len, labels)) < LONG else 2
    legend = panels[0].figure.legend(
        handles[::every],
        labels[::every],
        loc="outside upper left",
        ncols=columns,
        title="; ".join(title),
        alignment="left",
    )
    for text in legend.get_texts():
        text.set_parse_math(False)


def _loads(curve: Curve, over: Over, *, about_axis: bool) -> Loads:
    """Return the loads of a run on its tool, in the tool's frame."""
    from scipy.spatial.transform import Rotation

    trace = curve.trace
    rows, place = _place(trace, over, curve.label)
    force = trace.vectors("model_force", "N")[rows]
    torque = trace.vectors("model_torque", "Nm")[rows]
    turns = Rotation.from_quat(trace.quaternions()[rows])
    into_tool = turns.inv()
    across_x, across_y, thrust = into_tool.apply(force).T
    about = into_tool.apply(torque)[:, 2] if about_axis else np.linalg.norm(torque, axis=1)
    values = np.column_stack([thrust, across_x, across_y, about])
    band = curve.band if over == "time" or curve.is_path_given else None
    low, high = _band_ends(band, turns.as_matrix(), rows, about_axis=about_axis)
    return Loads(place, values, low, high, force)


def _band_ends(
    band: "Band | None", turns: Array, rows: Ints, *, about_axis: bool
) -> tuple[Array | None, Array | None]:
    """Return lower and upper end of an uncertainty band in the tool's frame, each of shape (n, 4).

    The band contains quantiles of force components in the world frame. Quantiles of the components
    in the tool's frame follow from them only if the axes of both frames are always parallel.
    Otherwise the result is None.
    """
    aligned = np.rint(turns[:1])
    # 1e-6: rounding of quaternions in a file
    if band is None or np.abs(turns - aligned).max(initial=0.0) > 1e-6:
        return None, None
    # World axis of each axis of the tool, and 1 or -1 for its direction.
    at = np.abs(aligned[0]).argmax(axis=0)
    sign = aligned[0].sum(axis=0)
    # A band has force x, y, z and size, then torque x, y, z and size.
    places = [at[2], at[0], at[1], 4 + at[2] if about_axis else 7]
    signs = np.array([sign[2], sign[0], sign[1], sign[2] if about_axis else 1.0])
    # a band may end before its run
    rows = rows[rows < len(band.quantiles[LOWER_QUANTILE])]
    ends = [
        signs * band.quantiles[end][rows][:, places] for end in (LOWER_QUANTILE, UPPER_QUANTILE)
    ]
    return np.minimum(*ends), np.maximum(*ends)


def _difference(first: Loads, second: Loads) -> tuple[Array, Array]:
    """Return the times or depths that both runs have, and the force difference there [N]."""
    place = first.place
    common = place[(place >= second.place[0]) & (place <= second.place[-1])]
    apart = _at(common, second.place, second.force) - _at(common, place, first.force)
    return common, np.linalg.norm(apart, axis=1)


def _place(trace: "Table", over: Over, name: str) -> tuple[Ints, Array]:
    """Return the rows to draw, and their time [s] or depth [mm]."""
    if over == "time":
        return np.arange(len(trace["time_s"])), trace["time_s"]
    contact, height = _heights(trace)
    if not contact.any():
        raise InputError(
            "runs",
            "have contact with the tissue to be drawn over depth",
            f"{name}, which has no contact",
            "draw the runs over time",
        )
    rows = deepening_rows(height, contact)
    return rows, np.maximum.accumulate(height[contact.argmax()] - height[rows])


def _at(places: Array, known: Array, vectors: Array) -> Array:
    """Interpolate vectors at given positions; the result has shape (places, 3)."""
    return np.column_stack([np.interp(places, known, vectors[:, c]) for c in range(3)])


def _colour(number: int, count: int) -> object:
    """Return the colour of a curve: from a list for few curves, else from a colour map."""
    if count <= len(COLOURS):
        return COLOURS[number]
    from matplotlib import colormaps

    return colormaps["viridis"](number / (count - 1))
