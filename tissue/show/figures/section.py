"""Section through the tool, with layers, removed tissue, stress and structures to keep clear of.

The plane goes through the deepest point of the tool. For a scene with structures to keep clear of,
the plane contains the tool's axis and the nearest point of a structure.
"""

from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Array, Bytes
from meshes.voxels.volume import FULL
from tissue.fem.fields import FieldSeries, Frame
from tissue.show.figures.figure import (
    EDGE,
    axis_names,
    halo,
    layer_colours,
    panelled,
    save,
    styled,
)
from tissue.show.figures.nearest_points import Closest, closest, distances_to_structures
from tissue.show.figures.tool_mesh import row_at
from tissue.simulation.bone_surface import HALF, facing, tool_axes
from tissue.simulation.run import Run

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

STRESS = "von_mises_MPa"
REMOVED_TINT = 0.28
"""Fraction of a layer's colour in the pale colour for removed tissue of this layer."""
PATH = "#CC79A7"
"""Colour of the path of the tip."""
TOOL: dict[str, Any] = {"color": "0.1", "linewidth": 1.0, "linestyle": (0, (3, 1.5))}
NEAREST: dict[str, Any] = {"color": "black", "marker": "o", "markersize": 3.0}
"""Look of the line between the nearest points of tool and structure."""
LAYERS_APART_MM = 1e4
"""Artificial distance [mm] between layers, so that a search finds cells of the same layer only."""
DECADES = 3.0
"""Largest span of a logarithmic colour scale [decades].

With more decades, the colours of neighbouring values could not be distinguished.
"""


@dataclass(frozen=True)
class Section:
    """Voxels in a plane.

    Attributes
    ----------
    axes
        Three unit vectors (rows), shape (3, 3): the direction u of the first array index, the
        direction v of the second array index, and the normal of the plane.
    origin_mm
        Point of the plane [mm] at u = v = 0, shape (3,).
    row
        Row of the trace at the shown time.
    extent_mm
        Lowest and highest coordinate along u and v, (u0, u1, v0, v1) [mm].
    start, left
        Filled fraction of each voxel, 0 to 1, shape (nu, nv): `start` before the first cut, `left`
        at the shown time. nu and nv are the numbers of voxels along u and v.
    layer
        Layer of each voxel, shape (nu, nv).
    """

    axes: Array
    origin_mm: Array
    row: int
    extent_mm: tuple[float, float, float, float]
    start: Array
    left: Array
    layer: Bytes

    def points_mm(self, u_mm: Array, v_mm: Array) -> Array:
        """Return the 3D points [mm] at the plane coordinates u and v, shape (len(u), len(v), 3)."""
        return _points_mm(self.axes, self.origin_mm, u_mm, v_mm)

    def project(self, points_mm: Array) -> Array:
        """Project points onto the plane; return their plane coordinates [mm], shape (n, 2)."""
        return (points_mm - self.origin_mm) @ self.axes[:2].T


def _points_mm(axes: Array, origin_mm: Array, u_mm: Array, v_mm: Array) -> Array:
    return origin_mm + u_mm[:, None, None] * axes[0] + v_mm[:, None] * axes[1]


def plane_of(run: Run, row: int) -> tuple[tuple[int, int, int], float]:
    """Return the section plane through the deepest tool position up to a row of the trace.

    The plane is parallel to two world axes: the axis closest to the tool's axis, and the other axis
    along which the tool moves farther.

    Returns
    -------
    Indices of three world axes: the axis along which the tool moves farther, the axis closest to
    the tool's axis, and the axis perpendicular to the plane. The second value is the coordinate
    [mm] of the plane along the perpendicular axis.
    """
    axis, outward = facing(run.trace)
    tips = run.trace.vectors("tool", "mm")
    cutting = np.flatnonzero(run.trace["contact_mm2"] > 0.0)
    rows = cutting if cutting.size else np.arange(len(tips))
    # a moment before the first contact shows the plane of the deepest point of the whole run
    so_far = rows[rows <= row] if (rows <= row).any() else rows
    deepest = int(so_far[np.argmin(outward * tips[so_far, axis])])
    sides = [a for a in range(3) if a != axis]
    across = sides[int(np.ptp(tips[rows][:, sides], axis=0).argmax())]
    normal = next(a for a in sides if a != across)
    return (across, axis, normal), float(tips[deepest, normal])


def section_of(run: Run, row: int, through_mm: Array | None = None) -> Section:
    """Return the section through the voxels at a row of the trace.

    Parameters
    ----------
    run
        A run with voxels.
    row
        Row of the trace at the shown time.
    through_mm
        Point in the plane [mm], shape (3,). The plane also contains the axis of the tool. If None,
        the section lies in the plane that `plane_of` returns.
    """
    volume = run.volume
    spacing = 1e3 * volume.spacing_m
    low, high = 1e3 * np.array(volume.bounds_m)
    if through_mm is None:
        order, place = plane_of(run, row)
        axes = np.eye(3)[list(order)]
        # a tool that has left the voxels still shows their last plane
        normal = order[2]
        inside = np.clip(place, low[normal] + 0.5 * spacing, high[normal] - 0.5 * spacing)
        origin = axes[2] * inside
    else:
        origin = run.trace.vectors("tool", "mm")[row]
        axes = _axes_through(run, row, through_mm)
    box = np.stack([low, high])
    corners = np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)
    spread = (corners - origin) @ axes[:2].T
    first = spread.min(axis=0)
    counts = np.rint(np.ptp(spread, axis=0) / spacing).astype(int)
    u, v = (first[k] + spacing * (np.arange(counts[k]) + 0.5) for k in (0, 1))
    # 1e-6 voxels: rounding of a plane between two layers of voxels
    places = (_points_mm(axes, origin, u, v) - low) / spacing + 1e-6
    is_inside = ((places >= 0.0) & (places < volume.shape)).all(axis=-1)
    index = tuple(np.moveaxis(np.clip(places.astype(int), 0, np.array(volume.shape) - 1), -1, 0))
    left = run.remaining if run.poses is None else run.replay().at(row)
    end = first + spacing * counts
    return Section(
        axes=axes,
        origin_mm=origin,
        row=row,
        extent_mm=(float(first[0]), float(end[0]), float(first[1]), float(end[1])),
        start=np.where(is_inside, volume.fraction[index], 0) / FULL,
        left=np.where(is_inside, left[index], 0) / FULL,
        layer=volume.layer[index],
    )


def _axes_through(run: Run, row: int, point_mm: Array) -> Array:
    """Return the axes of the plane through the tool's axis and a point, as in `Section.axes`."""
    along = tool_axes(run.trace.quaternions())[row]
    sideways = point_mm - run.trace.vectors("tool", "mm")[row]
    # a point on the axis does not determine the plane, so the main direction of motion is used
    for direction in (sideways, *np.eye(3)[list(plane_of(run, row)[0])]):
        across = direction - (direction @ along) * along
        length = float(np.linalg.norm(across))
        if length > 0.01:
            break
    across = across / length
    return np.stack([across, along, np.cross(across, along)])


def loaded_frame(series: FieldSeries) -> Frame | None:
    """Return the last frame whose largest stress is at least a tenth of the peak stress of the run.

    The result is None if the run has no stress.
    """
    peaks = [
        float(np.nanmax(frame.cells.get(STRESS, np.zeros(1)), initial=0.0))
        for frame in series.frames
    ]
    # 1e-12 MPa: without any stress, no frame counts as loaded
    loaded = np.flatnonzero(np.array(peaks) >= max(0.1 * max(peaks, default=0.0), 1e-12))
    return series.frames[loaded[-1]] if len(loaded) else None


def nearest_frame(series: FieldSeries, time_s: float) -> Frame | None:
    """Return the frame nearest to a time among the frames with stress; None without such frames."""
    stressed = [frame for frame in series.frames if STRESS in frame.cells]
    return min(stressed, key=lambda frame: abs(frame.time_s - time_s), default=None)


def moment_of(run: Run) -> tuple[int, Frame | None]:
    """Return the row of the trace and the frame of fields that the section shows.

    If there are stress fields, the result is the frame of `loaded_frame` and the trace row at the
    time of this frame. Otherwise, the frame is None, and the row is the last row with contact or,
    without contact, the last row.
    """
    series = run.parts.fields
    frame = None if series is None else loaded_frame(series)
    if frame is not None:
        return row_at(run.trace, frame.time_s), frame
    cutting = np.flatnonzero(run.trace["contact_mm2"] > 0.0)
    return int(cutting[-1]) if cutting.size else len(run.trace.rows) - 1, None


@styled
def draw_section(run: Run, path: Path) -> None:
    """Draw layers, removed tissue and stress in a section through the tool.

    Stress is drawn only if the run has stress fields.
    """
    series = run.parts.fields
    near = closest(run)
    if near is None:
        row, frame = moment_of(run)
        section = section_of(run, row)
    else:
        row = near.row
        frame = None if series is None else nearest_frame(series, run.trace["time_s"][row])
        section = section_of(run, row, near.points_mm[1])
    window = shown_mm(run, section, near)
    u0, u1, v0, v1 = window
    shape = (v1 - v0) / (u1 - u0)
    # inches: two panels and a colour bar, or one panel of at most 5.2 in both directions
    wide = 3.05 if frame is not None else min(5.2, 5.2 / shape)
    through, x, y = _described(run, section, near)
    # 1.75 in for title, titles of the panels, label of the axis and legend
    chart, panels = panelled(
        f"{run.scene.name}: section at {run.trace['time_s'][row]:.3f} s{through}",
        (8.0, wide * shape + 1.75),
        1,
        1 if frame is None else 2,
        layout="compressed",
        sharey=True,
    )
    _draw_layers(panels[0], run, section)
    structures = draw_kept_clear(panels[0], run, window, section, near)
    if near is not None:
        panels[0].plot(*section.project(near.points_mm).T, **NEAREST)
    panels[0].set_ylabel(f"{y} / mm")
    panels[0].set_title("layers, and tissue removed up to this time")
    handles = _handles(run, section)
    chart.legend(handles=[*handles, *structures], loc="outside lower center", ncols=4)
    if series is not None and frame is not None:
        drawn = _draw_stress(panels[1], series, frame, section)
        panels[1].set_title("stress" if near is None else f"stress at {frame.time_s:.3f} s")
        chart.colorbar(drawn, ax=panels[1], extend="both", label="von Mises stress / MPa")
    for panel in panels:
        _draw_tool(panel, run, section)
        panel.set(xlabel=f"{x} / mm", xlim=window[:2], ylim=window[2:], aspect="equal")
    save(chart, path)


def _described(run: Run, section: Section, near: Closest | None) -> tuple[str, str, str]:
    """Return texts for a section: its time or place, and the names of its two axes."""
    if near is not None:
        through = (
            ", the time of the smallest distance,\n"
            f"through the tool's axis and the nearest point of {near.name}"
        )
        return through, f"from the tool's axis towards {near.name}", "along the tool's axis"
    x, y, normal = (axis_names(run)[each] for each in section.axes.argmax(axis=1))
    touched = bool((run.trace["contact_mm2"] > 0.0).any())
    # `plane_of` looks only at the ticks in contact if there are any
    deepest = "deepest contact so far" if touched else "deepest point of the path so far"
    place = f"{normal} = {section.origin_mm @ section.axes[2]:.2f} mm"
    return f",\nin the plane of the {deepest}, {place}", x, y


def _draw_layers(axes: "Axes", run: Run, section: Section) -> None:
    """Draw each voxel in the colour of its layer; removed voxels are pale."""
    colours = np.array(list(layer_colours(run.volume.layer_names).values()))[section.layer]
    # white where there was no tissue
    pale = _removed_colour(colours)
    left = section.left[..., None]
    start = section.start[..., None]
    paint = left * colours + (start - left) * pale + (1.0 - start)
    axes.imshow(
        np.clip(paint, 0.0, 1.0).swapaxes(0, 1),
        origin="lower",
        extent=section.extent_mm,
        interpolation="nearest",
    )
    gone = _removed(section)
    # contour() would warn without a contour
    if gone.max() > 0.5 > gone.min():
        look: dict[str, Any] = {"colors": "black", "linewidths": 1.1, "origin": "lower"}
        axes.contour(gone.T, [0.5], extent=section.extent_mm, **look)


def _removed(section: Section) -> Array:
    """Return the removed fraction of each voxel of a section, 0 to 1, shape (nu, nv)."""
    return np.where(section.start >= HALF / FULL, section.start - section.left, 0.0)


def _removed_colour(colours: Array) -> Array:
    """Return the pale colours of removed tissue, from the colours of its layers."""
    return 1.0 - REMOVED_TINT * (1.0 - colours)


def _draw_tool(axes: "Axes", run: Run, section: Section) -> None:
    """Draw the outline of the tool at the shown time, and the path of its tip so far."""
    tips = section.project(run.trace.vectors("tool", "mm")[: section.row + 1])
    along = section.axes[:2] @ tool_axes(run.trace.quaternions())[section.row]
    # a tool at right angles to the section has no direction in it
    along = along / max(float(np.hypot(*along)), 1e-9)
    side = np.array([along[1], -along[0]])
    outline = 1e3 * run.cutter.profile.outline
    for sign in (-1.0, 1.0):
        points = tips[-1] + outline @ np.stack([sign * side, along])
        # the halo shows the line on dark colours
        axes.plot(*points.T, path_effects=halo(2.2), **TOOL)
    axes.plot(*tips.T, color=PATH, linewidth=1.0)


def _draw_stress(axes: "Axes", series: FieldSeries, frame: Frame, section: Section) -> "AxesImage":
    """Draw the von Mises stress of the remaining tissue on a logarithmic scale."""
    from matplotlib.colors import LogNorm

    stress = _section_stress(series, frame, section)
    there = section.left >= HALF / FULL
    shown = stress[there & np.isfinite(stress)]
    # single cells at sharp edges would stretch the scale; the span is one to three decades
    low, peak = np.percentile(shown, (2.0, 99.8)) if shown.size else (1.0, 1.0)
    # a logarithmic scale needs a range above zero, even without stress
    peak = max(float(peak), 1e-9)
    scale = LogNorm(float(np.clip(low, peak * 10.0**-DECADES, 0.1 * peak)), peak)
    # a logarithm needs positive values; the scale begins far above 1e-12 MPa
    picture = np.ma.masked_where(~there, np.maximum(stress, 1e-12))
    return axes.imshow(
        picture.T,
        origin="lower",
        extent=section.extent_mm,
        cmap="inferno",
        norm=scale,
        interpolation="nearest",
    )


def _section_stress(series: FieldSeries, frame: Frame, section: Section) -> Array:
    """Return the stress at the voxels of a section [MPa], shape (nu, nv).

    A voxel gets the stress of the nearest finite-element cell in the same layer.
    """
    from scipy.spatial import cKDTree

    values = frame.cells[STRESS]
    there = np.flatnonzero(np.isfinite(values))
    if not len(there):
        return np.full(section.layer.shape, np.nan)
    u0, u1, v0, v1 = section.extent_mm
    (columns, rows) = section.layer.shape
    u = u0 + (u1 - u0) * (np.arange(columns) + 0.5) / columns
    v = v0 + (v1 - v0) * (np.arange(rows) + 0.5) / rows
    # the layer is a fourth coordinate, so far apart that cells of the own layer are nearest
    places = np.empty((columns, rows, 4))
    places[..., :3] = section.points_mm(u, v)
    places[..., 3] = LAYERS_APART_MM * section.layer
    centres_mm = 1e3 * series.nodes_m[series.cells[there]].mean(axis=1)
    known = np.column_stack([centres_mm, LAYERS_APART_MM * series.layer[there]])
    return np.asarray(values[there[cKDTree(known).query(places)[1]]])


def _handles(run: Run, section: Section) -> "list[Artist]":
    """Return legend entries for the layers and the marks of the section."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    names = run.volume.layer_names
    seen = np.unique(section.layer[section.start >= HALF / FULL])
    removed = np.unique(section.layer[_removed(section) >= HALF / FULL])
    colours = layer_colours(names)
    tips_mm = run.trace.vectors("tool", "mm")[: section.row + 1]
    path = Line2D([], [], color=PATH, linewidth=1.0, label="path of its tip (projected)")
    return [
        *(Patch(facecolor=colours[names[i]], label=names[i], **EDGE) for i in seen),
        *(
            Patch(
                facecolor=tuple(_removed_colour(np.array(colours[names[i]]))),
                edgecolor="black",
                linewidth=1.1,
                label=f"removed {names[i]}",
            )
            for i in removed
        ),
        Line2D([], [], label="tool", **TOOL),
        *([path] if np.ptp(tips_mm, axis=0).max() > 0.0 else []),
    ]


STRUCTURES = ("#D55E00", "#0072B2", "#009E73", "#000000")
"""Colours of protected structures, after Okabe and Ito (2008)."""
AROUND_MM = 3.0
"""Margin [mm] around the tissue and the nearest points in pictures with protected structures.

The margin around the tissue is wider by the tool's distance from the farthest structure.
"""
ACROSS = 200
"""Number of points along each side of a section at which distances are computed."""


def shown_mm(run: Run, section: Section, near: Closest | None) -> tuple[float, float, float, float]:
    """Return the drawn extent of a section, (u0, u1, v0, v1) [mm].

    Without protected structures, the whole section is drawn. Otherwise, the extent contains the
    tissue, a margin that shows structures near the tool, and the points of smallest distance
    (`near`).
    """
    tissue = np.argwhere(section.start > 0.0)
    distances_mm = distances_to_structures(run).values()
    if not distances_mm or not len(tissue):
        return section.extent_mm
    u0, u1, v0, v1 = section.extent_mm
    size = np.array([u1 - u0, v1 - v0])
    edge = size / section.start.shape
    around = AROUND_MM + np.clip(max(distances_mm), 0.0, size.max())
    low = (u0, v0) + edge * tissue.min(axis=0) - around
    high = (u0, v0) + edge * (tissue.max(axis=0) + 1) + around
    if near is not None:
        ends = section.project(near.points_mm)
        low = np.minimum(low, ends.min(axis=0) - AROUND_MM)
        high = np.maximum(high, ends.max(axis=0) + AROUND_MM)
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def draw_kept_clear(
    axes: "Axes",
    run: Run,
    window: tuple[float, float, float, float],
    section: Section,
    near: Closest | None,
) -> "list[Artist]":
    """Draw protected structures in a section.

    Return legend entries that give each distance at the shown time, and the smallest distance of
    the run.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    clear = run.parts.keep_clear
    if clear is None or near is None:
        return []
    u, v = (np.linspace(window[k], window[k + 1], ACROSS) for k in (0, 2))
    points_m = 1e-3 * section.points_mm(u, v).reshape(-1, 3)
    end = run.parts.region_end
    until = "" if end is None or end.left_s is None else f",\nup to {end.left_s:.3f} s"
    distances_mm = distances_to_structures(run)
    least_mm = distances_mm[near.name]
    line = f"smallest distance of the tool,\n{least_mm:.3f} mm away from {near.name}{until}"
    if least_mm < 0.0:
        # the line of a depth need not lie in a plane with the axis
        line = (
            f"largest depth of the tool (projected),\n{-least_mm:.3f} mm inside {near.name}{until}"
        )
    handles: list[Artist] = [Line2D([], [], label=line, **NEAREST)]
    for name, colour in zip(distances_mm, cycle(STRUCTURES), strict=False):
        depth = np.asarray(clear.distances[name](points_m)).reshape(ACROSS, ACROSS).T
        # the section does not meet the structure otherwise, and contour() would warn
        if depth.min() < 0.0 < depth.max():
            axes.contourf(u, v, depth, [float(depth.min()), 0.0], colors=[colour], alpha=0.15)
            axes.contour(u, v, depth, [0.0], colors=[colour], linewidths=[1.6])
        label = f"surface of {name}"
        if name != near.name:
            now_mm = float(run.trace[f"distance_{name}_mm"][section.row])
            where = f"{now_mm:.3f} mm away from the tool"
            if now_mm < 0.0:
                where = f"tool {-now_mm:.3f} mm inside"
            # a single line would be wider than the picture
            label = f"surface of {name}, at this time\n{where}"
        handles.append(Patch(facecolor=colour, alpha=0.4, label=label))
    return handles
