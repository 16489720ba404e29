"""Figures of matplotlib: their style, and PNG files that are the same for the same figure."""

from collections.abc import Callable, Iterable
from functools import wraps
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from meshes.base.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.typing import RcKeyType

__all__ = ["DPI", "DRAWING", "STYLE", "figure", "plain", "save", "styled"]

P = ParamSpec("P")
T = TypeVar("T")
DPI = 200
STYLE: "dict[RcKeyType, float]" = {
    "font.size": 9.0,
    "axes.linewidth": 0.7,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.2,
}
DRAWING = RLock()
"""Held while a picture is drawn beside others: matplotlib has one style for all threads."""


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """A function that draws in the style of the figures."""

    @wraps(draw)
    def drawn(*arguments: P.args, **options: P.kwargs) -> T:
        import matplotlib

        with DRAWING, matplotlib.rc_context(STYLE):
            return draw(*arguments, **options)

    return drawn


@styled
def figure(width_in: float, height_in: float) -> "Figure":
    """A figure that no window knows of."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), dpi=DPI)


@styled
def save(chart: "Figure", path: Path) -> None:
    """Write a figure as PNG, the same bytes for the same figure."""
    with whole_file(path) as temporary:
        chart.savefig(temporary, format="png", dpi=DPI, metadata={"Software": None}, pil_kwargs={"compress_level": 3})


def plain(panels: "Iterable[Axes]") -> None:
    """Panels without a frame above and to the right, and with a grid along y below what is drawn."""
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.margins(x=0.0)
