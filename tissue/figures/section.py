"""A section through the deepest point that the tool reached, at one moment: layers, what was removed, and stress."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.voxels.volume import FULL
from tissue.fem.fields import FieldSeries, Frame
from tissue.figures.figure import figure, save, styled
from tissue.figures.kept_clear import draw_kept_clear, kept_window, nearest_places
from tissue.figures.layer_interpolation import interpolate_in_layers
from tissue.figures.style import EDGE, axis_names, draw_outline, layer_colours
from tissue.simulation.depth_map import HALF, tool_axes
from tissue.simulation.run import Run

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

__all__ = ["Section", "draw_section", "loaded_frame", "moment_of", "plane_of", "section_of"]

STRESS = "von_mises_MPa"
REMOVED_TINT = 0.28
"""How much of its layer's colour removed tissue keeps."""
PATH = "#CC79A7"
"""Colour of the tip's path."""
DECADES = 3.0
"""Widest span of a logarithmic scale."""


@dataclass(frozen=True)
class Section:
    """Voxels in a plane that holds the tool's axis.

    Attributes
    ----------
    across, axis
        World axes of the arrays' first and second index, 0 to 2.
    normal
        World axis at right angles to the plane.
    place_mm
        Coordinate of the plane along the normal [mm].
    row
        Row of the trace at the moment.
    extent_mm
        Lowest and highest coordinate along the two axes, (u0, u1, v0, v1) [mm].
    start, left
        Tissue before the first cut and at the moment, 0 to 1, shape (nu, nv).
    layer
        Layer of each voxel, shape (nu, nv).
    """

    across: int
    axis: int
    normal: int
    place_mm: float
    row: int
    extent_mm: tuple[float, float, float, float]
    start: NDArray[np.float64]
    left: NDArray[np.float64]
    layer: NDArray[np.uint8]


def plane_of(run: Run, *, axis: int, outward: int, row: int) -> tuple[int, int, float]:
    """The plane through the deepest point so far, along the tool's axis and its main direction.

    Returns
    -------
    World axes of the tool's main direction and at right angles to the plane, and the plane's coordinate there [mm].
    """
    tips = run.trace.vectors("tool", "mm")
    cutting = np.flatnonzero(run.trace["contact_mm2"] > 0.0)
    rows = cutting if cutting.size else np.arange(len(tips))
    so_far = rows[rows <= row] if (rows <= row).any() else rows
    deepest = int(so_far[np.argmin(outward * tips[so_far, axis])])
    sides = [a for a in range(3) if a != axis]
    across = sides[int(np.ptp(tips[rows][:, sides], axis=0).argmax())]
    normal = next(a for a in sides if a != across)
    return across, normal, float(tips[deepest, normal])


def section_of(run: Run, *, axis: int, outward: int, row: int) -> Section:
    """The section through the deepest point so far, along the tool's axis and the tool's main direction.

    Parameters
    ----------
    run
        A run with voxels.
    axis, outward
        World axis closest to the tool's, and the side that the tool comes from.
    row
        Row of the trace at the moment that is shown.
    """
    volume = run.volume
    across, normal, place = plane_of(run, axis=axis, outward=outward, row=row)
    spacing, origin = 1e3 * volume.spacing_m, 1e3 * volume.origin_m
    index = int(np.clip(np.floor((place - origin[normal]) / spacing), 0, volume.shape[normal] - 1))
    left = run.remaining if run.poses is None else run.replay().at(row)
    planes = (np.take(array, index, axis=normal) for array in (volume.fraction, left, volume.layer))
    start, left, layer = (plane if across < axis else plane.T for plane in planes)
    ends = [(float(origin[a]), float(origin[a] + spacing * volume.shape[a])) for a in (across, axis)]
    return Section(
        across=across,
        axis=axis,
        normal=normal,
        place_mm=place,
        row=row,
        extent_mm=(*ends[0], *ends[1]),
        start=start / FULL,
        left=left / FULL,
        layer=layer,
    )


def loaded_frame(series: FieldSeries) -> Frame | None:
    """The last frame under load: stress of at least a tenth of the run's peak; None where there is no stress at all."""
    peaks = [float(np.nanmax(frame.cells.get(STRESS, np.zeros(1)), initial=0.0)) for frame in series.frames]
    if not any(peaks):
        return None
    return next(f for f, peak in zip(reversed(series.frames), reversed(peaks), strict=True) if peak >= 0.1 * max(peaks))


def moment_of(run: Run) -> tuple[int, Frame | None]:
    """Row of the trace at the moment that a section shows, and the fields then: under load, else at the last cut."""
    series, cutting = run.parts.fields, np.flatnonzero(run.trace["contact_mm2"] > 0.0)
    frame = None if series is None else loaded_frame(series)
    if frame is None:
        return int(cutting[-1]) if cutting.size else len(run.trace.rows) - 1, None
    times = run.trace["time_s"]
    return int(np.clip(np.searchsorted(times, frame.time_s - 1e-9), 0, len(times) - 1)), frame


@styled
def draw_section(run: Run, path: Path, *, axis: int, outward: int) -> None:
    """Draw layers with what was removed and, where fields were computed, the stress in the same section and moment."""
    series = run.parts.fields
    row, frame = moment_of(run)
    section = section_of(run, axis=axis, outward=outward, row=row)
    kept = nearest_places(run)
    window = kept_window(kept, section.extent_mm, section.start > 0.0, section.across, section.axis)
    u0, u1, v0, v1 = window
    wide = 3.05 if frame is not None else min(5.2, 5.2 * (u1 - u0) / (v1 - v0))
    tall = wide * (v1 - v0) / (u1 - u0)
    full = tall + 1.75
    chart = figure(8.0, full)
    left = 0.62 if frame is not None else 0.5 * (8.0 - wide)
    names = axis_names(run)
    panel = chart.add_axes((left / 8.0, 1.15 / full, wide / 8.0, tall / full))
    _draw_layers(panel, run, section)
    _draw_tool(panel, run, section)
    structures = draw_kept_clear(panel, kept, window, section.across, section.axis, section.place_mm)
    panel.set(xlabel=f"{names[section.across]} / mm", ylabel=f"{names[section.axis]} / mm")
    panel.set_title("layers and what was removed", size=9.5)
    chart.legend(
        handles=[*_handles(run, section, borders=frame is not None), *structures],
        loc="center",
        bbox_to_anchor=(0.5, 0.3 / full),
        ncols=4,
        frameon=False,
        handlelength=1.4,
        columnspacing=1.2,
    )
    if series is not None and frame is not None:
        panel = chart.add_axes(((left + wide + 0.28) / 8.0, 1.15 / full, wide / 8.0, tall / full))
        drawn = _draw_stress(panel, series, frame, section)
        # Edges of the layers that are left, as thin lines.
        there = section.left >= HALF / FULL
        for index in np.unique(section.layer[there]):
            draw_outline(panel, there & (section.layer == index), section.extent_mm, color="0.55", linewidth=0.7)
        _draw_tool(panel, run, section)
        panel.set(xlabel=f"{names[section.across]} / mm", yticklabels=[], xlim=window[:2], ylim=window[2:])
        panel.set_title("stress", size=9.5)
        bar = chart.add_axes(((left + 2.0 * wide + 0.4) / 8.0, 1.15 / full, 0.14 / 8.0, tall / full))
        chart.colorbar(drawn, cax=bar, extend="both", label="von Mises stress / MPa")
    title = (
        f"{run.scene.name} at {run.trace['time_s'][section.row]:.3f} s: section at {names[section.normal]} = "
        f"{section.place_mm:.2f} mm, through the deepest point"
    )
    chart.text(0.5, 1.0 - 0.22 / full, title, ha="center", va="center", size=10.5)
    save(chart, path)


def _draw_layers(axes: "Axes", run: Run, section: Section) -> None:
    """Every voxel in its layer's colour, pale as far as it was removed."""
    colours = np.array(list(layer_colours(run.volume.layer_names).values()))[section.layer]
    pale = 1.0 - REMOVED_TINT * (1.0 - colours)
    left, start = section.left[..., None], section.start[..., None]
    paint = left * colours + (start - left) * pale + (1.0 - start)
    axes.imshow(
        np.clip(paint, 0.0, 1.0).swapaxes(0, 1), origin="lower", extent=section.extent_mm, interpolation="nearest"
    )
    gone = np.where(section.start >= HALF / FULL, section.start - section.left, 0.0)
    draw_outline(axes, gone, section.extent_mm, color="black", linewidth=1.1)


def _draw_tool(axes: "Axes", run: Run, section: Section) -> None:
    """Outline of the tool at one moment, and the path of its tip so far."""
    from matplotlib.patheffects import withStroke

    trace, row = run.trace, section.row
    tips = trace.vectors("tool", "mm")
    turn = tool_axes(np.column_stack([trace[f"tool_q{c}"][row : row + 1] for c in "xyzw"]))[0]
    along = turn[[section.across, section.axis]]
    along = along / max(float(np.hypot(*along)), 1e-9)
    side = np.array([along[1], -along[0]])
    outline = 1e3 * run.cutter.profile.outline
    for sign in (-1.0, 1.0):
        points = tips[row, [section.across, section.axis]] + outline @ np.stack([sign * side, along])
        halo = [withStroke(linewidth=2.2, foreground="white")]  # for what lies on dark colours
        axes.plot(*points.T, color="0.1", linewidth=1.0, linestyle=(0, (3, 1.5)), path_effects=halo)
    axes.plot(*tips[: row + 1, [section.across, section.axis]].T, color=PATH, linewidth=1.0)
    axes.set(xlim=section.extent_mm[:2], ylim=section.extent_mm[2:], aspect="equal")


def _draw_stress(axes: "Axes", series: FieldSeries, frame: Frame, section: Section) -> "AxesImage":
    """Von Mises stress of the tissue that is left, between the cells of each layer, on a logarithmic scale."""
    from matplotlib.colors import LogNorm

    stress = _section_stress(series, frame, section)
    there = section.left >= HALF / FULL
    shown = stress[there & np.isfinite(stress)]
    low, peak = np.percentile(shown, (2.0, 99.8)) if shown.size else (1.0, 1.0)
    peak = max(float(peak), 1e-9)
    scale = LogNorm(float(np.clip(low, peak * 10.0**-DECADES, 0.1 * peak)), peak)
    picture = np.ma.masked_where(~there, np.maximum(stress, 1e-12))
    return axes.imshow(
        picture.T, origin="lower", extent=section.extent_mm, cmap="inferno", norm=scale, interpolation="nearest"
    )


def _section_stress(series: FieldSeries, frame: Frame, section: Section) -> NDArray[np.float64]:
    """Stress at the centres of the section's voxels [MPa], each in its layer."""
    u0, u1, v0, v1 = section.extent_mm
    (columns, rows), places = section.layer.shape, np.empty((*section.layer.shape, 3))
    places[..., section.across] = (u0 + (u1 - u0) * (np.arange(columns) + 0.5) / columns)[:, None]
    places[..., section.axis] = v0 + (v1 - v0) * (np.arange(rows) + 0.5) / rows
    places[..., section.normal] = section.place_mm
    values = interpolate_in_layers(series, frame.cells[STRESS], 1e-3 * places.reshape(-1, 3), section.layer.ravel())
    return values.reshape(section.layer.shape)


def _handles(run: Run, section: Section, *, borders: bool) -> "list[Artist]":
    """Entries of a legend: the layers that the section shows, and the marks in it."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    names = run.volume.layer_names
    seen = np.unique(section.layer[section.start >= HALF / FULL])
    colours = layer_colours(names)
    return [
        *(Patch(facecolor=colours[names[i]], label=names[i], **EDGE) for i in seen),
        Patch(facecolor="0.9", edgecolor="black", linewidth=1.1, label="removed"),
        Line2D([], [], color="0.1", linewidth=1.0, linestyle=(0, (3, 1.5)), label="tool"),
        Line2D([], [], color=PATH, linewidth=1.0, label="path of its tip"),
        *([Line2D([], [], color="0.55", linewidth=0.7, label="edges of the layers that are left")] if borders else []),
    ]
