"""Figures of matplotlib: their style, and files that are the same for the same figure."""

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

__all__ = ["DPI", "DRAWING", "STYLE", "VECTOR_DPI", "figure", "is_vector", "plain", "save", "styled"]

P = ParamSpec("P")
T = TypeVar("T")
DPI = 200
VECTOR_DPI = 2 * DPI
"""Pixels an inch of what is no line or text in SVG and PDF: a rendering's own, see `tissue.figures.rendering`."""
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
    """Write a figure in the format of its file's ending, png, svg or pdf; the same bytes for the same figure.

    SVG and PDF hold lines and text as such, and what was drawn in 3D or as an image with `VECTOR_DPI` pixels an inch.
    """
    import matplotlib

    kind = path.suffix.removeprefix(".")
    metadata: dict[str, dict[str, str | None]] = {
        "png": {"Software": None},
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
    }
    look: dict[RcKeyType, object] = {"svg.fonttype": "none", "svg.hashsalt": "tissue"}
    with whole_file(path) as temporary, matplotlib.rc_context(look):
        if is_vector(path):
            chart.savefig(temporary, format=kind, dpi=VECTOR_DPI, metadata=metadata[kind])
        else:
            packed = {"compress_level": 3}
            chart.savefig(temporary, format=kind, dpi=DPI, metadata=metadata[kind], pil_kwargs=packed)


def is_vector(path: Path) -> bool:
    """Whether a file holds lines and text as such."""
    return path.suffix in (".svg", ".pdf")


def plain(panels: "Iterable[Axes]") -> None:
    """Panels without a frame above and to the right, and with a grid along y below what is drawn."""
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.margins(x=0.0)
