"""Common style of all figures: matplotlib settings, panels, colours and files."""

from collections.abc import Callable, Iterable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.whole_file import whole_file
from tissue.simulation.saved_fields import field_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.patheffects import AbstractPathEffect
    from matplotlib.typing import RcKeyType

    from tissue.simulation.bone_surface import DepthMap
    from tissue.simulation.run import Run

P = ParamSpec("P")
T = TypeVar("T")
DPI = 200
"""Pixels per inch of a PNG picture, for sharp pictures on screens and in documents."""
VECTOR_DPI = 2 * DPI
"""Pixels per inch of images and renderings in SVG and PDF files.

Lines and text are vectors. The value is the resolution of the renderings in
`tissue.show.figures.rendering`.
"""
STYLE: "dict[RcKeyType, float]" = {
    "font.size": 9.0,
    "axes.linewidth": 0.7,
    "axes.titlesize": 9.5,
    "legend.columnspacing": 1.4,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.2,
}


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Decorate a drawing function so that it uses the common matplotlib settings."""

    @wraps(draw)
    def drawn(*arguments: P.args, **options: P.kwargs) -> T:
        import matplotlib

        with matplotlib.rc_context(STYLE):
            return draw(*arguments, **options)

    return drawn


@styled
def figure(width_in: float, height_in: float) -> "Figure":
    """Return an empty matplotlib figure that is not shown in a window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), dpi=DPI)


@styled
def panelled(
    title: str,
    size_in: tuple[float, float],
    rows: int = 1,
    columns: int = 1,
    *,
    layout: Literal["constrained", "compressed"] = "constrained",
    **options: Any,
) -> "tuple[Figure, NDArray[np.object_]]":
    """Return a figure with a title, and its panels as an array of axes.

    Parameters
    ----------
    title
        Text above all panels.
    size_in
        Width and height [in].
    rows, columns, options
        As for `matplotlib.figure.Figure.subplots`.
    layout
        Layout engine of matplotlib. Use ``compressed`` for panels with a fixed aspect ratio.
    """
    chart = figure(*size_in)
    chart.set_layout_engine(layout)
    chart.suptitle(title, size=10.5, parse_math=False)
    return chart, chart.subplots(rows, columns, squeeze=False, **options).ravel()


def legend_above(axes: "Axes", columns: int) -> None:
    """Put the legend of a panel above the panel."""
    # shares of the panel: on its upper edge, flush with its left one
    axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=columns)


@styled
def save(chart: "Figure", path: Path) -> None:
    """Write a figure as png, svg or pdf, according to the suffix of the file.

    Writing the same figure twice gives identical files. In SVG and PDF files, lines and text are
    vectors. 3D drawings and images in these files have `VECTOR_DPI` pixels per inch.
    """
    import matplotlib

    kind = path.suffix.removeprefix(".")
    changing = {"png": "Software", "svg": "Date", "pdf": "CreationDate"}[kind]
    look: dict[RcKeyType, object] = {"svg.fonttype": "none", "svg.hashsalt": "tissue"}
    # compression 3: 20 % larger files than with 9, written in a seventh of the time
    packed: dict[str, Any] = {} if is_vector(path) else {"pil_kwargs": {"compress_level": 3}}
    with whole_file(path) as temporary, matplotlib.rc_context(look):
        chart.savefig(
            temporary,
            format=kind,
            dpi=VECTOR_DPI if is_vector(path) else DPI,
            metadata={changing: None},
            **packed,
        )


def is_vector(path: Path) -> bool:
    """Return True if the file format stores lines and text as vectors."""
    return path.suffix in (".svg", ".pdf")


def plain(panels: "Iterable[Axes]") -> None:
    """Remove the upper and right frame lines of panels, and add horizontal grid lines."""
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.margins(x=0.0)


def plain_numbers(axis: "Axis") -> None:
    """Label a logarithmic axis with plain numbers, such as 100 instead of 10^2.

    An axis longer than about three decades is labelled only at 1, 10, 100 and so on. A shorter axis
    is also labelled at 2, 5, 20, 50 and so on. An axis of about one decade or less has additional
    labels at 1.5, 3, 4 and 7.
    """
    from matplotlib.ticker import LogLocator

    low, high = axis.get_view_interval()
    labels: tuple[float, ...] = (1.0, 2.0, 5.0)
    if high > 2e3 * low:
        # over more than three decades, 2 and 5 of each decade would overlap
        labels = (1.0,)
    elif high < 15.0 * low:
        labels = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    axis.set_major_locator(LogLocator(subs=labels))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


EDGE: dict[str, Any] = {"edgecolor": "0.3", "linewidth": 0.5}
"""Matplotlib properties for the edge of a colour patch in a legend."""
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
SIGNED = "coolwarm"
STRESS = "magma_r"
OTHER = "YlGnBu"
"""Colour map of fields, such as displacement, whose values begin at 0.

`STRESS` is the map for stresses, and `SIGNED` the map for values of both signs. Small values are
light, so that unloaded parts of a body are not black. Colour-blind readers can distinguish the
colours (Moreland 2009; van der Walt and Smith 2015; Harrower and Brewer 2003).
"""
OTHER_LAYERS = ("#CC79A7", "#F0E442", "#0072B2", "#D55E00")
COMPONENTS = ("#0072B2", "#D55E00", "#009E73")
"""Colours of the x, y and z components of a vector, after Okabe and Ito (2008)."""
MAGNITUDE = "0.88"
SMALL_NM = 0.02
"""Torque [N m] below which a picture uses the unit mN m.

A reamer has a torque of 0.2 to 2 N m. A bur has a thousandth of this torque.
"""
ANATOMICAL = {"glenoid": ("anterior", "superior", "lateral")}
"""Anatomical directions of the world axes, keyed by kind of anatomy."""


def axis_names(run: "Run") -> tuple[str, ...]:
    """Return the names of the world axes, each with its anatomical direction if known.

    For example, in a glenoid scene x is anterior, see `ANATOMICAL`.
    """
    meanings = ANATOMICAL.get(run.scene.anatomy.kind)
    if meanings is None:
        return tuple("xyz")
    named = tuple(f"{c} ({meaning})" for c, meaning in zip("xyz", meanings, strict=True))
    bone = run.scene.bone
    if getattr(bone, "centre_mm", None) is not None or getattr(bone, "along", None) is not None:
        return tuple("xyz")  # the site on a bone need not be its glenoid
    # For bone from a file, the direction of x (forward or backward) depends on the side of the
    # body, which the file does not contain.
    return ("x", *named[1:]) if bone.from_file else named


def torque_unit(torque_Nm: float) -> tuple[str, float]:
    """Return the unit for plots of torques up to `torque_Nm`, and the factor that converts N m."""
    return ("mN·m", 1e3) if torque_Nm < SMALL_NM else ("N·m", 1.0)


def layer_colours(names: tuple[str, ...]) -> dict[str, tuple[float, float, float]]:
    """Return the colour of each layer as red, green and blue from 0 to 1, keyed by name.

    The layers in `LAYERS`, such as ``dentin``, have the same colour in every scene.
    """
    from matplotlib.colors import to_rgb

    others = [name for name in names if name not in LAYERS]
    colours = LAYERS | {name: OTHER_LAYERS[i % len(OTHER_LAYERS)] for i, name in enumerate(others)}
    return {name: to_rgb(colours[name]) for name in names}


def field_colours(low: float, high: float) -> str:
    """Return the name of the colour map for a field with a given range.

    The map is `SIGNED` if the range begins below 0, `STRESS` if it begins above 0, and `OTHER` if
    it begins at 0.
    """
    if low < 0.0:
        return SIGNED
    return STRESS if low > 0.0 else OTHER


def field_words(*names: str) -> str:
    """Return the words that several field or column labels have in common, followed by the unit.

    An example is ``von Mises / kPa``.
    """
    words = [field_label(name)[0].split() for name in names]
    shared = [first for first, *others in zip(*words, strict=False) if set(others) <= {first}]
    return " / ".join(filter(None, (" ".join(shared), field_label(names[0])[1])))


def depth_limit(depth: "DepthMap") -> float:
    """Return the upper end [mm] of the colour scale for the removed depth.

    The upper end is the largest depth in the map, or 1 mm if nothing was removed.
    """
    cut = depth.depth_mm[depth.depth_mm > 0.0]
    # a colour scale needs a range: 1 um for rounding, and 1 mm without a cut
    return float(max(cut.max(), 1e-3)) if cut.size else 1.0


def draw_arrow(
    axes: "Axes", start: ArrayLike, end: ArrayLike, colour: str, *, width: float = 1.6
) -> None:
    """Draw an arrow between two points of a panel."""
    from matplotlib.patches import FancyArrowPatch

    (x, y), (to_x, to_y) = np.array([start, end], dtype=np.float64).tolist()
    axes.add_patch(
        FancyArrowPatch(
            (x, y),
            (to_x, to_y),
            arrowstyle="-|>",
            color=colour,
            linewidth=width,
            mutation_scale=6.0 + 5.0 * width,  # a thicker line needs a larger head
            shrinkA=0,
            shrinkB=0,
        )
    )


def halo(width: float = 4.0) -> "list[AbstractPathEffect]":
    """Return path effects that keep a line or text legible on any background."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=width, foreground="white")]
