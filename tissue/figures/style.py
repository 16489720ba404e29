"""Pictures of a run in the plane: removed depth, forces and torques."""

from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from numpy.typing import NDArray

from tissue.figures.events import EVENT_IN, event_lines, mark_events
from tissue.figures.figure import figure, plain, save, styled
from tissue.simulation.depth_map import DepthMap, tool_axes
from tissue.simulation.run import Run
from tissue.simulation.trace import NO_LAYER

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.typing import LineStyleType

__all__ = [
    "BONE",
    "DEPTH_COLOURS",
    "EDGE",
    "axis_names",
    "depth_limit",
    "draw_force_torque",
    "draw_outline",
    "draw_removed_depth",
    "field_colours",
    "layer_colours",
    "spells",
]


class _Edge(TypedDict):
    edgecolor: str
    linewidth: float


EDGE: _Edge = {"edgecolor": "0.3", "linewidth": 0.5}
"""Edge of a patch in a legend."""
BONE = (0.93, 0.89, 0.81)
"""Colour of bone that was not cut."""
LAYERS = {
    "subchondral": "#E69F00",
    "cortical": "#56B4E9",
    "trabecular": "#009E73",
    "enamel": "#56B4E9",
    "dentin": "#E69F00",
    "pulp": "#D55E00",
    "caries": "#404040",
    "ligament": "#CC79A7",
    "bone": "#009E73",
    "capsule": "#56B4E9",
    "parenchyma": "#E69F00",
    "vessel wall": "#D55E00",
}
DEPTH_COLOURS = "viridis"
SIGNED, STRESS, OTHER = "coolwarm", "magma_r", "YlGnBu"
"""Colours of fields; little is light, so that a body does not turn black where nothing happens. Colour-blind readers
can follow them (Moreland 2009; van der Walt and Smith 2015; Harrower and Brewer 2003)."""
OTHER_LAYERS = ("#CC79A7", "#F0E442", "#0072B2", "#D55E00")
COMPONENTS = ("#0072B2", "#D55E00", "#009E73")
"""Colours of layers and components after Okabe and Ito (2008), distinct for colour-blind readers."""
MAGNITUDE = "0.88"
COMMANDED = 0.35
"""Opacity of what is commanded, below the model's line."""
EXPOSED: "tuple[LineStyleType, ...]" = ("--", ":", "-.")
"""Lines around the layers that a run laid bare."""
SMALL_NM = 0.02
"""Torque below which a picture shows thousandths [N m]."""
ANATOMICAL = {"glenoid": ("anterior", "superior", "lateral")}
"""What the world's axes mean, by kind of anatomy."""


def axis_names(run: Run) -> tuple[str, ...]:
    """The world's axes with their anatomical direction where the kind of anatomy has one."""
    meanings = ANATOMICAL.get(run.scene.anatomy.kind)
    if meanings is None:
        return tuple("xyz")
    named = tuple(f"{c} ({meaning})" for c, meaning in zip("xyz", meanings, strict=True))
    bone = run.scene.bone
    if bone.centre_mm is not None or bone.along is not None:
        return tuple("xyz")  # what was pointed at on a bone need not be its glenoid
    # On bone from a file x points forward or backward with the side of the body, which the file does not state.
    return ("x", *named[1:]) if bone.file else named


def layer_colours(names: tuple[str, ...]) -> dict[str, tuple[float, float, float]]:
    """Red, green and blue of every layer; those of bone and of teeth have the same colour in every scene."""
    from matplotlib.colors import to_rgb

    others = [name for name in names if name not in LAYERS]
    colours = LAYERS | {name: OTHER_LAYERS[i % len(OTHER_LAYERS)] for i, name in enumerate(others)}
    return {name: to_rgb(colours[name]) for name in names}


def field_colours(low: float, high: float) -> str:
    """Name of the colours of a field whose scale has these ends; one that begins above 0 is a stress."""
    return SIGNED if low < 0.0 else STRESS if low > 0.0 else OTHER


def depth_limit(depth: DepthMap) -> float:
    """Upper end of the depth scale [mm]: the deepest column, peg holes and drilled channels left to saturate."""
    cut = depth.depth_mm[depth.depth_mm > 0.0]
    return float(max(cut.max(), 1e-3)) if cut.size else 1.0


@styled
def draw_removed_depth(run: Run, depth: DepthMap, path: Path) -> None:
    """Draw the map of removed depth on the face that the tool meets."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    u0, u1, v0, v1 = depth.extent_mm
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
    x, y = (f"{axis_names(run)[axis]} / mm" for axis in depth.across)
    axes.set(xlabel=x, ylabel=y, aspect="equal")
    bar = chart.add_axes(((left + wide + 0.15) / 8.0, 0.6 / full, 0.16 / 8.0, tall / full))
    chart.colorbar(image, cax=bar, label="removed depth / mm")
    cut = depth.depth_mm[depth.depth_mm >= least]
    summary = "nothing removed"
    if cut.size:
        summary = f"peak {cut.max():.2f} mm, median {np.median(cut):.2f} mm over {cut.size * spacing**2:.0f} mm²"
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


def draw_outline(
    axes: "Axes",
    values: NDArray[np.float64] | NDArray[np.bool_],
    extent: tuple[float, float, float, float],
    *,
    color: str,
    linewidth: float,
    linestyle: "LineStyleType" = "-",
) -> None:
    """Draw the line at a half of columns between 0 and 1, closed where it meets the edge of the map."""
    if values.max(initial=0) < 0.5:
        return
    ends = zip(extent[::2], extent[1::2], values.shape, strict=True)
    u, v = (low + (high - low) / count * (np.arange(-1, count + 1) + 0.5) for low, high, count in ends)
    padded = np.pad(values, 1).T.astype(float)
    axes.contour(u, v, padded, levels=[0.5], colors=[color], linewidths=[linewidth], linestyles=[linestyle])


def _hillshade(height_mm: NDArray[np.float64], spacing_mm: float) -> NDArray[np.float64]:
    """Brightness of a face lit from the upper left, darker where it lies deep."""
    from scipy.ndimage import gaussian_filter

    there = np.isfinite(height_mm)
    weight = np.maximum(gaussian_filter(there.astype(np.float64), 2.0), 1e-6)
    filled = gaussian_filter(np.where(there, height_mm, 0.0), 2.0) / weight
    slope_u, slope_v = np.gradient(filled, spacing_mm)
    lit = (0.35 * slope_u - 0.35 * slope_v + 0.87) / np.sqrt(1.0 + slope_u**2 + slope_v**2)
    return np.asarray(np.clip(0.62 + 0.45 * lit, 0.35, 1.05))


@styled
def draw_force_torque(run: Run, path: Path) -> None:
    """Draw force, torque, removal rate (or contact area, where nothing goes) and the tool's path through layers."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    trace = run.trace
    time = trace["time_s"]
    event_texts = event_lines(run.events)
    foot = 0.55 + EVENT_IN * len(event_texts)
    full = 6.25 + foot
    chart = figure(8.0, full)
    panels = chart.subplots(4, 1, sharex=True, height_ratios=(3.0, 2.2, 1.3, 1.3))
    chart.subplots_adjust(left=0.11, right=0.98, top=1.0 - 0.6 / full, bottom=foot / full, hspace=0.14)
    # A bur's torque is a thousandth of a reamer's.
    small = bool(np.abs(trace.vectors("torque", "Nm")).max(initial=0.0) < SMALL_NM)
    for axes, name, unit, scale, label in (
        (panels[0], "force", "N", 1.0, "force / N"),
        (panels[1], "torque", "Nm", *((1e3, "torque / mN·m") if small else (1.0, "torque / N·m"))),
    ):
        commanded, model = scale * trace.vectors(name, unit), scale * trace.vectors(f"model_{name}", unit)
        axes.fill_between(time, np.linalg.norm(commanded, axis=1), color=MAGNITUDE, linewidth=0.0)
        for c in range(3):
            axes.plot(time, commanded[:, c], color=COMPONENTS[c], linewidth=2.4, alpha=COMMANDED)
        for c in range(3):  # upon all of them: teeth that vibrate make a band of the line below
            axes.plot(time, model[:, c], color=COMPONENTS[c], linewidth=1.1)
        axes.set_ylabel(label)
        axes.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
        if not model.any() and not commanded.any():
            axes.set_ylim(-1.0, 1.0)
    panels[0].legend(
        handles=[Line2D([], [], color=COMPONENTS[c], label="xyz"[c]) for c in range(3)]
        + [
            Patch(facecolor=MAGNITUDE, label="magnitude"),
            Line2D([], [], color="0.2", linewidth=1.1, label="model's, before the low-pass"),
            Line2D([], [], color="0.2", linewidth=2.4, alpha=COMMANDED, label="commanded"),
        ],
        loc="lower left",
        bbox_to_anchor=(-0.01, 0.99),
        ncols=6,
        frameon=False,
        handlelength=1.6,
        columnspacing=1.2,
    )
    chart.text(
        0.11, 1.0 - 0.24 / full, f"{run.scene.name}: force on the tool and torque about its tip", va="center", size=10.5
    )
    cuts = bool((trace["removed_mm3"] > 0.0).any())
    panels[2].plot(time, trace["removal_rate_mm3_s" if cuts else "contact_mm2"], color="0.1")
    panels[2].set_ylabel("removal rate\n/ mm³ s⁻¹" if cuts else "contact area\n/ mm²")
    panels[2].set_ylim(bottom=0.0)
    axis = tool_axes(np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"]))
    panels[3].plot(time, (trace.vectors("tool", "mm") * axis).sum(axis=1), color="0.1")
    panels[3].set_ylabel("tip along\nits axis / mm")
    panels[3].set_xlabel("time / s")
    layers = trace["layer"]
    colours = layer_colours(trace.layer_names)
    met = [name for name in trace.layer_names if (layers == name).any()]
    for first, last, name in spells(layers):
        if name != NO_LAYER:
            end = time[min(last, len(time) - 1)]
            panels[3].axvspan(time[first], end, color=colours[name], alpha=0.45, linewidth=0.0)
    if met:
        panels[3].legend(
            handles=[
                Patch(facecolor=colours[name], alpha=0.45, label=f"in {name}".replace("$", r"\$")) for name in met
            ],
            loc="lower left",
            ncols=3,
            frameon=False,
            handlelength=1.2,
            borderpad=0.2,
        )
    plain(panels)
    chart.align_ylabels(panels)
    mark_events(panels, run.events)
    for line, sentence in enumerate(event_texts):
        chart.text(0.11, (foot - 0.6 - EVENT_IN * line) / full, sentence, va="center", size=8.5, parse_math=False)
    save(chart, path)


def spells(names: NDArray[np.generic]) -> list[tuple[int, int, str]]:
    """Runs of equal entries: first index, index behind the last, entry."""
    if not len(names):
        return []
    starts = np.flatnonzero(np.concatenate([[True], names[1:] != names[:-1]]))
    return [(int(a), int(b), str(names[a])) for a, b in zip(starts, [*starts[1:], len(names)], strict=True)]
