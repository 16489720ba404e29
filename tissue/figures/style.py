"""Colours, names of axes and outlines that the pictures of a run share."""

from typing import TYPE_CHECKING, TypedDict

import numpy as np
from numpy.typing import NDArray

from tissue.simulation.depth_map import DepthMap
from tissue.simulation.run import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.typing import LineStyleType

__all__ = [
    "BONE",
    "DEPTH_COLOURS",
    "EDGE",
    "axis_names",
    "depth_limit",
    "draw_outline",
    "field_colours",
    "layer_colours",
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
    if getattr(bone, "centre_mm", None) is not None or getattr(bone, "along", None) is not None:
        return tuple("xyz")  # what was pointed at on a bone need not be its glenoid
    # On bone from a file x points forward or backward with the side of the body, which the file does not state.
    return ("x", *named[1:]) if bone.from_file else named


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
