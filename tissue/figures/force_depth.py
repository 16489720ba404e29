"""Force over depth as the tool goes down through the layers for the first time."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue.figures.events import FLICKER_S, spells
from tissue.figures.figure import figure, plain, save, styled
from tissue.figures.style import COMPONENTS, layer_colours
from tissue.models.tissue_model import TICK_S
from tissue.simulation.depth_map import HALF, tool_axes
from tissue.simulation.run import Run
from tissue.simulation.saved_fields import field_label
from tissue.simulation.trace import NO_LAYER

__all__ = ["draw_force_depth", "first_descent", "layers_passed"]

MEANT = {"µm": "displacement"}
"""Quantity of a unit."""
RISE_MM = 0.2
"""A tool that rises by this much has ended its descent."""


def first_descent(coordinate_mm: NDArray[np.float64], contact: NDArray[np.bool_]) -> slice:
    """Rows from a little before the first contact down to the deepest point before the tool rises.

    Parameters
    ----------
    coordinate_mm
        Place of the tool's tip, growing out of the tissue [mm], shape (rows,).
    contact
        Whether the tool meets tissue, shape (rows,).
    """
    if not contact.any():
        return slice(0, 0)
    first = int(contact.argmax())
    down = coordinate_mm[first:]
    risen = down > np.minimum.accumulate(down) + RISE_MM
    stop = int(risen.argmax()) if risen.any() else len(down)
    last = first + int(np.argmax(down[:stop] <= down[:stop].min() + 1e-6))
    before = int(np.searchsorted(-coordinate_mm[:first], -(coordinate_mm[first] + RISE_MM))) if first else 0
    return slice(before, last + 1)


def layers_passed(run: Run, tips_mm: NDArray[np.float64]) -> NDArray[np.str_]:
    """Layer that lay at the tip before the run, by name, shape (tips,)."""
    volume = run.volume
    place = np.floor((tips_mm * 1e-3 - volume.origin_m) / volume.spacing_m).astype(int)
    inside = ((place >= 0) & (place < volume.shape)).all(axis=1)
    x, y, z = np.clip(place, 0, np.array(volume.shape) - 1).T
    inside &= volume.fraction[x, y, z] >= HALF
    return np.where(inside, np.array(volume.layer_names)[volume.layer[x, y, z]], NO_LAYER)


@styled
def draw_force_depth(run: Run, path: Path, *, axis: int, outward: int) -> str | None:
    """Draw force, and what else the tissue reports, over the depth of the first descent.

    Parameters
    ----------
    run
        A run with voxels.
    path
        File.
    axis, outward
        World axis closest to the tool's, and the side that the tool comes from.

    Returns
    -------
    None, or why it could not be drawn.
    """
    trace = run.trace
    tips = trace.vectors("tool", "mm")
    rows = first_descent(outward * tips[:, axis], trace["contact_mm2"] > 0.0)
    if len(tips[rows]) < 2:
        return "the tool did not go down into the tissue"
    coordinate_mm, passed = outward * tips[rows, axis], layers_passed(run, tips[rows])
    entered = int((passed != NO_LAYER).argmax()) if (passed != NO_LAYER).any() else 0
    depth = coordinate_mm[entered] - coordinate_mm
    measures: dict[str, list[str]] = {}
    for name in run.parts.tissue.measure_names:
        measures.setdefault(field_label(name)[1], []).append(name)
    full = 3.55 + 1.3 * len(measures)
    chart = figure(8.0, full)
    heights = [2.2, *([1.0] * len(measures))]
    panels = chart.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    chart.subplots_adjust(left=0.115, right=0.98, top=1.0 - 0.8 / full, bottom=0.5 / full, hspace=0.12)
    force, model = trace.vectors("force", "N")[rows], trace.vectors("model_force", "N")[rows]
    turns = tool_axes(np.column_stack([trace[f"tool_q{c}"][rows] for c in "xyzw"]))
    for values, colour, style, label in (
        (lambda f: np.linalg.norm(f, axis=1), "0.1", "-", "magnitude"),
        (
            lambda f: np.einsum("ij,ij->i", f, turns),
            COMPONENTS[0],
            (0, (4, 2)),
            "along the tool's axis, outward",
        ),
    ):
        panels[0].plot(depth, values(force), color=colour, linewidth=0.8, alpha=0.35)
        panels[0].plot(depth, values(model), color=colour, linewidth=1.4, linestyle=style, label=label)
    panels[0].plot([], [], color="0.4", linewidth=1.4, label="dark: as the model gives it")
    panels[0].plot(
        [], [], color="0.4", linewidth=3.2, alpha=0.35, label="pale: as commanded, after low-pass and vibration"
    )
    panels[0].set_ylabel("force / N")
    for axes, (unit, names) in zip(panels[1:], measures.items(), strict=True):
        for name, colour in zip(names, ("0.1", *COMPONENTS, "#CC79A7"), strict=False):
            axes.plot(depth, trace[name][rows], color=colour, label=field_label(name)[0])
        words = [field_label(name)[0].split() for name in names]
        shared = " ".join(first for first, *others in zip(*words, strict=False) if set(others) <= {first})
        axes.set_ylabel(f"{shared}\n{MEANT.get(unit, '')} / {unit}".strip("\n/ "))
        if len(names) > 1:
            axes.legend(frameon=False, ncols=len(names), loc="best", handlelength=1.4)
    _shade(run, panels, depth, passed, np.linalg.norm(model, axis=1))
    plain(panels)
    panels[-1].set_xlim(depth[0], depth[-1])
    panels[-1].set_xlabel("depth of the tool's tip below the surface / mm")
    chart.align_ylabels(panels)
    chart.text(
        0.115,
        1.0 - 0.22 / full,
        f"{run.scene.name}: force on the tool over depth, first descent",
        va="center",
        size=10.5,
    )
    panels[0].legend(
        loc="lower left",
        bbox_to_anchor=(-0.01, 0.99),
        ncols=2,
        frameon=False,
        labelspacing=0.25,
        handlelength=1.8,
        columnspacing=1.2,
    )
    save(chart, path)
    return None


def _shade(
    run: Run,
    panels: "NDArray[np.object_]",
    depth: NDArray[np.float64],
    passed: NDArray[np.str_],
    force: NDArray[np.float64],
) -> None:
    """A band for each layer, with its name and the mean force in it."""
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
    panels[0].set_ylim(min(low, 0.0), high + 0.2 * (high - low))
