"""What colours mean in the report's 3D view: a scale of numbers with its unit, or names."""

from base64 import b64encode
from collections.abc import Mapping, Sequence

import numpy as np

from tissue.figures.style import BONE, DEPTH_COLOURS, layer_colours
from tissue.reporting.packing import Record
from tissue.simulation.saved_fields import field_label

__all__ = ["depth_scale", "field_scale", "hexadecimal", "layer_scale"]

UNCUT = 0.02
"""Share of the deepest cut below which bone has its own colour."""
SIGNED, STRESS, OTHER = "coolwarm", "inferno", "viridis"
"""As in the window of `tissue view`, for colour-blind readers too (Moreland 2009; van der Walt and Smith 2015)."""


def depth_scale(deepest_mm: float) -> Record:
    """Removed depth; bone that was not cut has its own colour."""
    colours = _colours(DEPTH_COLOURS)
    colours[: round(UNCUT * len(colours))] = np.array(BONE)
    return {
        "label": "removed depth",
        "unit": "mm",
        "array": "depth",
        "low": 0.0,
        "high": deepest_mm,
        "logarithmic": False,
        **_table(colours),
    }


def layer_scale(names: Sequence[str], shown: Sequence[int]) -> Record:
    """Layers by their colours; the legend names those that are shown."""
    colours = layer_colours(tuple(names))
    table = np.zeros((256, 3))
    table[: len(names)] = np.array([colours[name] for name in names])
    legend = [[names[index], hexadecimal(colours[names[index]])] for index in shown]
    return {"label": "layer", "unit": "", "array": "layer", "names": legend, **_table(table)}


def field_scale(name: str, limits: tuple[float, float]) -> Record:
    """A field over the range of the whole run, logarithmic where it begins above 0."""
    words, unit = field_label(name)
    low, high = limits
    return {
        "label": words,
        "unit": unit,
        "array": name,
        "low": low,
        "high": high,
        "logarithmic": low > 0.0,
        **_table(_colours(SIGNED if low < 0.0 else STRESS if low > 0.0 else OTHER)),
    }


def hexadecimal(colour: Sequence[float]) -> str:
    """A colour as ``#rrggbb``."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in colour[:3])


def _colours(name: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    import matplotlib

    return np.asarray(matplotlib.colormaps[name](np.linspace(0.0, 1.0, 256)))[:, :3].copy()


def _table(colours: "np.ndarray[tuple[int, int], np.dtype[np.float64]]") -> Mapping[str, str]:
    return {"colours": b64encode(np.rint(255 * colours).astype(np.uint8).tobytes()).decode("ascii")}
