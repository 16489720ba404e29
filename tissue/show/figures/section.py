"""Figure of the section of a tissue through the deepest point of a tool.

The section shows layers, removed tissue, stress and protected structures.
"""

from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Array, Bytes
from meshes.voxels.volume import FULL
from tissue.fem.fields import FieldSeries, Frame
from tissue.scene.anatomy import Tooth
from tissue.show.figures.figure import (
    EDGE,
    axis_names,
    halo,
    layer_colours,
    panelled,
    save,
    styled,
)
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
LAYERS_APART_MM = 1e4
"""Artificial distance [mm] between layers, so that the nearest cell is in the same layer."""
DECADES = 3.0
"""Largest span of a logarithmic colour scale [decades].

With more decades, the colours of neighbouring values could not be distinguished.
"""


@dataclass(frozen=True)
class Section:
    """Voxels in a plane that contains the tool's axis.

    Attributes
    ----------
    axes
        Indices (0 to 2) of three world axes: two axes in the plane (u and v), and the axis
        perpendicular to the plane.
    place_mm
        Coordinate of the plane along its normal [mm].
    row
        Row of the trace at the shown time.
    extent_mm
        Lowest and highest coordinate along u and v, (u0, u1, v0, v1) [mm].
    start, left
        Filled fraction of each voxel before the first cut (`start`) and at the shown time (`left`),
        0 to 1, shape (nu, nv). nu and nv are the numbers of voxels along u and v.
    layer
        Layer of each voxel, shape (nu, nv).
    """

    axes: tuple[int, int, int]
    place_mm: float
    row: int
    extent_mm: tuple[float, float, float, float]
    start: Array
    left: Array
    layer: Bytes


def plane_of(run: Run, row: int) -> tuple[tuple[int, int, int], float]:
    """Return the section plane through the deepest point of the tool up to a row of the trace.

    The plane is parallel to two world axes: the axis closest to the tool's axis, and, of the other
    two axes, the one along which the tool moves farther.

    Returns
    -------
    Indices of three world axes: the main direction of motion, the axis closest to the tool's axis,
    and the axis perpendicular to the plane. In addition, the coordinate of the plane along the last
    of these axes [mm].
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


def section_of(run: Run, row: int) -> Section:
    """Return the section through the deepest point of the tool up to a row of the trace.

    The section lies in the plane of `plane_of`.

    Parameters
    ----------
    run
        A run with voxels.
    row
        Row of the trace at the shown time.
    """
    volume = run.volume
    axes, place = plane_of(run, row)
    across, axis, normal = axes
    spacing = 1e3 * volume.spacing_m
    origin = 1e3 * volume.origin_m
    index = int(np.clip(np.floor((place - origin[normal]) / spacing), 0, volume.shape[normal] - 1))
    left = run.remaining if run.poses is None else run.replay().at(row)
    planes = (np.take(array, index, axis=normal) for array in (volume.fraction, left, volume.layer))
    # `take` keeps the order of the world's axes, but the first index of a section runs across
    start, left, layer = (plane if across < axis else plane.T for plane in planes)
    ends = [
        (float(origin[a]), float(origin[a] + spacing * volume.shape[a])) for a in (across, axis)
    ]
    return Section(
        axes=axes,
        place_mm=place,
        row=row,
        extent_mm=(*ends[0], *ends[1]),
        start=start / FULL,
        left=left / FULL,
        layer=layer,
    )


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


def moment_of(run: Run) -> tuple[int, Frame | None]:
    """Return the row of the trace and the frame of fields that the section shows.

    The frame is that of `loaded_frame`, and the row has the same time. Without stress, the frame is
    None, and the row is the last row with contact or, without contact, the last row.
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
    row, frame = moment_of(run)
    section = section_of(run, row)
    window = shown_mm(run, section)
    u0, u1, v0, v1 = window
    shape = (v1 - v0) / (u1 - u0)
    # inches: two panels and a colour bar, or one panel of at most 5.2 in both directions
    wide = 3.05 if frame is not None else min(5.2, 5.2 / shape)
    x, y, normal = (f"{axis_names(run)[each]}" for each in section.axes)
    tissue = "tooth" if isinstance(run.scene.anatomy, Tooth) else "bone"
    touched = bool((run.trace["contact_mm2"] > 0.0).any())
    # `plane_of` looks only at the ticks in contact if there are any
    deepest = "the deepest point in contact" if touched else "the deepest point of the path"
    # 1.75 in for title, titles of the panels, label of the axis and legend
    chart, panels = panelled(
        f"{run.scene.name}: tool and {tissue} at {run.trace['time_s'][row]:.3f} s. Section at "
        f"{normal} = {section.place_mm:.2f} mm, through {deepest}",
        (8.0, wide * shape + 1.75),
        1,
        1 if frame is None else 2,
        layout="compressed",
        sharey=True,
    )
    _draw_layers(panels[0], run, section)
    structures = draw_kept_clear(panels[0], run, window, section)
    panels[0].set_ylabel(f"{y} / mm")
    panels[0].set_title("layers and removed tissue")
    handles = _handles(run, section)
    chart.legend(handles=[*handles, *structures], loc="outside lower center", ncols=4)
    if series is not None and frame is not None:
        drawn = _draw_stress(panels[1], series, frame, section)
        panels[1].set_title("stress")
        chart.colorbar(drawn, ax=panels[1], extend="both", label="von Mises stress / MPa")
    for panel in panels:
        _draw_tool(panel, run, section)
        panel.set(xlabel=f"{x} / mm", xlim=window[:2], ylim=window[2:], aspect="equal")
    save(chart, path)


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
    plane = list(section.axes[:2])
    tips = run.trace.vectors("tool", "mm")[: section.row + 1, plane]
    along = tool_axes(run.trace.quaternions())[section.row, plane]
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
    across, axis, normal = section.axes
    # the layer is a fourth coordinate, so far apart that cells of the own layer are nearest
    places = np.empty((columns, rows, 4))
    places[..., across] = (u0 + (u1 - u0) * (np.arange(columns) + 0.5) / columns)[:, None]
    places[..., axis] = v0 + (v1 - v0) * (np.arange(rows) + 0.5) / rows
    places[..., normal] = section.place_mm
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
        Line2D([], [], color=PATH, linewidth=1.0, label="path of its tip (projected)"),
    ]


STRUCTURES = ("#D55E00", "#0072B2", "#009E73", "#000000")
"""Colours of protected structures, after Okabe and Ito (2008)."""
AROUND_MM = 3.0
"""Margin [mm] around the tissue in pictures with protected structures.

The largest distance between tool and structure is added to this margin.
"""
ACROSS = 200
"""Number of points along each side of a section at which distances are computed."""


def distances_to_structures(run: Run) -> dict[str, float]:
    """Return the smallest distance [mm] between the tool and each protected structure.

    A distance is negative if the tool was inside the structure. Ticks after the tool left the
    simulated region are ignored.
    """
    clear = run.parts.keep_clear
    found = {} if clear is None else clear.summary()
    distances = {name: each["least_distance_mm"] for name, each in found.items()}
    return {name: each for name, each in distances.items() if each is not None}


def shown_mm(run: Run, section: Section) -> tuple[float, float, float, float]:
    """Return the drawn extent of a section, (u0, u1, v0, v1) [mm].

    Without protected structures, the whole section is drawn. Otherwise, the extent is that of the
    tissue plus a margin in which structures near the tool are visible.
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
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def draw_kept_clear(
    axes: "Axes", run: Run, window: tuple[float, float, float, float], section: Section
) -> "list[Artist]":
    """Draw protected structures in a section; return legend entries with smallest distances."""
    from matplotlib.patches import Patch

    clear = run.parts.keep_clear
    if clear is None:
        return []
    across, axis, _ = section.axes
    u, v = (np.linspace(window[k], window[k + 1], ACROSS) for k in (0, 2))
    points_mm = np.full((ACROSS, ACROSS, 3), section.place_mm)
    points_mm[..., across] = u[None, :]
    points_mm[..., axis] = v[:, None]
    end = run.parts.region_end
    until = "" if end is None or end.left_s is None else f",\nup to {end.left_s:.3f} s"
    handles: list[Artist] = []
    for (name, least_mm), colour in zip(
        distances_to_structures(run).items(), cycle(STRUCTURES), strict=False
    ):
        depth = np.asarray(clear.distances[name](1e-3 * points_mm.reshape(-1, 3)))
        depth = depth.reshape(ACROSS, ACROSS)
        # the section does not meet the structure otherwise, and contour() would warn
        if depth.min() < 0.0 < depth.max():
            axes.contourf(u, v, depth, [float(depth.min()), 0.0], colors=[colour], alpha=0.15)
            axes.contour(u, v, depth, [0.0], colors=[colour], linewidths=[1.6])
        side = "away" if least_mm >= 0.0 else "inside"
        # a single line would be wider than the picture
        label = f"{name}: smallest distance\nof the tool, {abs(least_mm):.2f} mm {side}{until}"
        handles.append(Patch(facecolor=colour, alpha=0.4, label=label))
    return handles
