"""Three slices of a CT through a site, with what was found in it, the site and a path drawn in."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from meshes.images.frame import Image
from tissue.figures.figure import figure, save, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["SOFT_HU", "draw_ct_slices"]

Line = Literal["solid", "dashed", "dotted"]
BONE_HU, SOFT_HU = (-200.0, 1300.0), (-160.0, 240.0)
"""Grey values from black to white: fat to cortical bone, and those of soft tissue (the usual abdominal window)."""
VIEWS = ((0, 1, 2, "axial"), (0, 2, 1, "coronal"), (1, 2, 0, "sagittal"))
"""Axes of a slice to the right and upward, the axis through it, and its name."""
AXES = ("left", "back", "head")
BODY, SITE, PATH = "#E69F00", "#D55E00", "#CC79A7"
OTHERS = ("#56B4E9", "#009E73", "#F0E442", "#0072B2")
"""Colours of outlines after Okabe and Ito (2008)."""
LINES: tuple[Line, ...] = ("solid", "dashed", "dotted")
"""Of the outlines: the next one where all colours are taken."""
NORMAL_MM = 12.0
WIDTH_IN, HEIGHT_IN = 9.0, 3.7


@styled
def draw_ct_slices(
    image: Image,
    path: Path,
    *,
    body: tuple[str, Image],
    others: Mapping[str, Image],
    centre_mm: NDArray[np.float64],
    normal: NDArray[np.float64] | None,
    points_mm: NDArray[np.float64] | None,
    title: str,
    window_HU: tuple[float, float] = BONE_HU,
) -> None:
    """Draw the slices to a file.

    Parameters
    ----------
    image
        Grey values around the bone.
    body
        What it is called, and what is above 0 where it is, on the same voxels as far as it goes.
    others
        The same of other structures, by what they are called.
    centre_mm
        Where the slices cross [mm, LPS]: the site, or the middle of the bone.
    normal
        Outward direction at the site; None where there is none yet.
    points_mm
        Corners of a path [mm, LPS], shape (n, 3); None where there is none.
    window_HU
        Hounsfield units from black to white; images of other units take their own range.
    """
    origin, spacing, shape = np.array(image.origin_mm), np.array(image.spacing_mm), image.values.shape
    at = np.rint((centre_mm - origin) / spacing).astype(int).clip(0, np.array(shape) - 1)
    hounsfield = float(image.values.min()) < -100.0
    low, high = window_HU if hounsfield else np.percentile(image.values, (1, 99.8))
    chart = figure(WIDTH_IN, HEIGHT_IN)
    panels = chart.subplots(1, 3, gridspec_kw={"wspace": 0.3, "left": 0.07, "right": 0.98, "bottom": 0.22, "top": 0.85})
    for axes, (u, v, through, name) in zip(panels, VIEWS, strict=True):
        ends = [(origin[a] - 0.5 * spacing[a], origin[a] + spacing[a] * (shape[a] - 0.5)) for a in (u, v)]
        grey = np.take(image.values, int(at[through]), axis=through).T
        extent = (*ends[0], *ends[1])
        axes.imshow(grey, cmap="gray", vmin=low, vmax=high, origin="lower", extent=extent, interpolation="nearest")
        place = float(origin[through] + spacing[through] * at[through])
        _outline(axes, body[1], (u, v, through), place, BODY)
        for number, field in enumerate(others.values()):
            _outline(axes, field, (u, v, through), place, *_look(number))
        if points_mm is not None:
            axes.plot(points_mm[:, u], points_mm[:, v], color=PATH, linewidth=1.2)
        if normal is not None:
            axes.annotate(
                "",
                (centre_mm[u] + NORMAL_MM * normal[u], centre_mm[v] + NORMAL_MM * normal[v]),
                (centre_mm[u], centre_mm[v]),
                arrowprops={"arrowstyle": "-|>", "color": SITE, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0},
            )
            axes.plot(centre_mm[u], centre_mm[v], "o", color=SITE, markersize=4)
        axes.set(xlabel=f"{AXES[u]} [mm]", ylabel=f"{AXES[v]} [mm]", xlim=ends[0], ylim=ends[1], aspect="equal")
        if v == 1:  # the patient's front is up, as radiologists have it
            axes.invert_yaxis()
        axes.set_title(f"{name}, {AXES[through]} {place:.1f} mm", size=9)
    chart.suptitle(title, size=10, y=0.98)
    _legend(chart, (body[0], *others), normal is not None, points_mm is not None)
    save(chart, path)


def _look(number: int) -> tuple[str, Line]:
    """Colour and line of one of the other structures."""
    return OTHERS[number % len(OTHERS)], LINES[number // len(OTHERS) % len(LINES)]


def _outline(
    axes: "Axes", field: Image, order: tuple[int, int, int], place_mm: float, colour: str, line: Line = "solid"
) -> None:
    """The line where a field is 0 in the slice at a place along its axis."""
    u, v, through = order
    at = round((place_mm - field.origin_mm[through]) / field.spacing_mm[through])
    if not 0 <= at < field.values.shape[through]:
        return
    values = np.take(field.values, at, axis=through).T
    x, y = (field.origin_mm[a] + field.spacing_mm[a] * np.arange(field.values.shape[a]) for a in (u, v))
    if values.min() < 0.0 < values.max():
        axes.contour(x, y, values, levels=[0.0], colors=[colour], linestyles=[line], linewidths=[1.1])


def _legend(chart: "Figure", names: Sequence[str], sited: bool, pathed: bool) -> None:
    """What the colours mean, below the slices."""
    from matplotlib.lines import Line2D

    looks: list[tuple[str, Line]] = [(BODY, "solid"), *map(_look, range(len(names) - 1))]
    lines = [
        Line2D([], [], color=colour, linestyle=line, label=name)
        for name, (colour, line) in zip(names, looks, strict=True)
    ]
    if sited:
        lines.append(Line2D([], [], color=SITE, marker="o", markersize=4, label="site and normal"))
    if pathed:
        lines.append(Line2D([], [], color=PATH, label="path of the tip"))
    chart.legend(handles=lines, loc="lower center", ncols=min(len(lines), 5), frameon=False)
