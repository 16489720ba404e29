"""The map of removed depth on the face that the tool meets."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.figures.figure import figure, save, styled
from tissue.figures.style import BONE, DEPTH_COLOURS, EDGE, axis_names, depth_limit, draw_outline
from tissue.simulation.depth_map import DepthMap
from tissue.simulation.run import Run

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.typing import LineStyleType

__all__ = ["draw_removed_depth", "shown_mm"]

EXPOSED: "tuple[LineStyleType, ...]" = ("--", ":", "-.")
"""Lines around the layers that a run laid bare."""
SMALL, AROUND = 0.5, 0.4
"""A cut that takes up less than this share of the region along both axes is drawn larger, with this share of its longer
side around it."""


def shown_mm(depth: DepthMap) -> tuple[float, float, float, float]:
    """Ends of what the map shows along its two axes [mm]: the region, or a small cut and what is around it."""
    u0, u1, v0, v1 = depth.extent_mm
    cut = np.argwhere(depth.depth_mm > 0.0)
    if not len(cut):
        return u0, u1, v0, v1
    size = np.array([u1 - u0, v1 - v0])
    edge = size / depth.depth_mm.shape
    low, high = cut.min(axis=0) * edge, (cut.max(axis=0) + 1) * edge
    if ((high - low) > SMALL * size).any():
        return u0, u1, v0, v1
    around = AROUND * float((high - low).max())
    (a, b), (c, d) = (np.clip([low[i] - around, high[i] + around], 0.0, size[i]) for i in range(2))
    return float(u0 + a), float(u0 + b), float(v0 + c), float(v0 + d)


@styled
def draw_removed_depth(run: Run, depth: DepthMap, path: Path) -> None:
    """Draw the map of removed depth on the face that the tool meets."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    u0, u1, v0, v1 = shown_mm(depth)
    per_mm = min(6.0 / (u1 - u0), 6.4 / (v1 - v0))
    wide, tall = per_mm * (u1 - u0), per_mm * (v1 - v0)
    full = tall + 1.35
    left = 0.5 * (8.0 - wide - 0.4)
    chart = figure(8.0, full)
    axes = chart.add_axes((left / 8.0, 0.6 / full, wide / 8.0, tall / full))
    spacing = run.volume.spacing_m * 1e3
    least = 0.01 * spacing
    shade = _hillshade(depth.height_mm * depth.outward, spacing)
    ground = np.clip(np.array(BONE) * shade[..., None], 0.0, 1.0)
    ground[~(depth.bone & np.isfinite(depth.height_mm))] = 1.0
    axes.imshow(ground.swapaxes(0, 1), origin="lower", extent=depth.extent_mm, interpolation="nearest")
    image = axes.imshow(
        np.ma.masked_less(depth.depth_mm, least).T,
        origin="lower",
        extent=depth.extent_mm,
        cmap=DEPTH_COLOURS,
        vmin=0.0,
        vmax=depth_limit(depth),
        interpolation="nearest",
    )
    handles: list[Artist] = [Patch(facecolor=BONE, label="not cut", **EDGE)]
    draw_outline(axes, depth.bone, depth.extent_mm, color="0.15", linewidth=1.0)
    handles.append(Line2D([], [], color="0.15", linewidth=1.0, label="bone in the simulated region"))
    for name, mask in depth.exposed.items():
        dashes = EXPOSED[len(handles) % len(EXPOSED)]
        draw_outline(axes, mask, depth.extent_mm, color="white", linewidth=2.6)
        draw_outline(axes, mask, depth.extent_mm, color="black", linewidth=1.3, linestyle=dashes)
        handles.append(Line2D([], [], color="black", linewidth=1.3, linestyle=dashes, label=f"{name} laid bare"))
    axes.set(xlim=(u0, u1), ylim=(v0, v1))
    x, y = (f"{axis_names(run)[axis]} / mm" for axis in depth.across)
    axes.set(xlabel=x, ylabel=y, aspect="equal")
    bar = chart.add_axes(((left + wide + 0.15) / 8.0, 0.6 / full, 0.16 / 8.0, tall / full))
    chart.colorbar(image, cax=bar, label="removed depth / mm")
    cut = depth.depth_mm[depth.depth_mm >= least]
    summary = "nothing removed"
    if cut.size:
        summary = (
            f"removed depth, peak {cut.max():.2f} mm, median {np.median(cut):.2f} mm over "
            f"{cut.size * spacing**2:.3g} mm²"
        )
    title = f"{run.scene.name}: {summary}"
    chart.text((left + 0.5 * wide) / 8.0, 1.0 - 0.2 / full, title, ha="center", va="center", size=10.5)
    chart.legend(
        handles=handles,
        loc="center",
        bbox_to_anchor=((left + 0.5 * wide) / 8.0, 1.0 - 0.5 / full),
        ncols=4,
        frameon=False,
    )
    save(chart, path)


def _hillshade(height_mm: NDArray[np.float64], spacing_mm: float) -> NDArray[np.float64]:
    """Brightness of a face lit from the upper left, darker where it lies deep."""
    from scipy.ndimage import gaussian_filter

    there = np.isfinite(height_mm)
    weight = np.maximum(gaussian_filter(there.astype(np.float64), 2.0), 1e-6)
    filled = gaussian_filter(np.where(there, height_mm, 0.0), 2.0) / weight
    slope_u, slope_v = np.gradient(filled, spacing_mm)
    lit = (0.35 * slope_u - 0.35 * slope_v + 0.87) / np.sqrt(1.0 + slope_u**2 + slope_v**2)
    return np.asarray(np.clip(0.62 + 0.45 * lit, 0.35, 1.05))
