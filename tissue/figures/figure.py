"""Figures of matplotlib: their style, and PNG files that are the same for the same figure."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from meshes.base.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["DPI", "STYLE", "figure", "save"]

DPI = 200
STYLE: dict[Any, Any] = {"font.size": 9.0, "axes.linewidth": 0.7, "legend.fontsize": 8.5, "lines.linewidth": 1.2}


def figure(width_in: float, height_in: float) -> "Figure":
    """A figure that no window knows of."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        return Figure(figsize=(width_in, height_in), dpi=DPI)


def save(chart: "Figure", path: Path) -> None:
    """Write a figure as PNG, the same bytes for the same figure."""
    import matplotlib

    with matplotlib.rc_context(STYLE), whole_file(path) as temporary:
        chart.savefig(temporary, format="png", dpi=DPI, metadata={"Software": None}, pil_kwargs={"compress_level": 3})
