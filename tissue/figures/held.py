"""A still picture of a soft organ at rest, from above and from below: what holds it, and what the tool may touch."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.fem.fields import FieldSeries
from tissue.figures.figure import DRAWING, is_vector, save
from tissue.figures.marks import draw_scale
from tissue.figures.organ_surface import SHOWN, drawn_surface
from tissue.figures.rendering import Camera, paint, render, side_by_side
from tissue.simulation.series import CELL_TYPES

if TYPE_CHECKING:
    import pyvista

__all__ = ["draw_held"]

FREE, HELD, TOUCHABLE = (0.93, 0.91, 0.87), (0.902, 0.624, 0.0), (0.0, 0.447, 0.698)
EYES = {"from above": (0.25, -0.75, 0.62), "from below": (0.25, -0.75, -0.62)}
HEAD_PX, FOOT_PX = 110, 80


def draw_held(series: FieldSeries, path: Path, *, title: str) -> str | None:
    """Draw the organ's surface, triangles of held nodes and of touchable nodes in colours of their own.

    Returns
    -------
    None, or why it could not be drawn.
    """
    from matplotlib.patches import Patch

    surface = _surface(series)
    up = (0.0, 0.0, 1.0)
    cameras = [Camera.seeing(surface.points, eye, up) for eye in EYES.values()]
    pictures = render(lambda: [(surface, camera) for camera in cameras], fine=is_vector(path))
    if isinstance(pictures, str):
        return pictures
    with DRAWING:
        chart, panels, (_, tall) = side_by_side(pictures, head_px=HEAD_PX, foot_px=FOOT_PX, fine=is_vector(path))
        chart.text(0.5, 1.0 - 35 / tall, f"{title}: what holds the organ", ha="center", va="center", size=11)
        for axes, name, camera in zip(panels, EYES, cameras, strict=True):
            axes.set_title(name, size=10)
            draw_scale(axes, camera)
        named = (("held", HELD), ("may be touched", TOUCHABLE), ("free", FREE))
        chart.legend(
            handles=[Patch(facecolor=colour, edgecolor="0.4", label=name) for name, colour in named],
            loc="lower center",
            ncols=3,
            frameon=False,
        )
        save(chart, path)
    return None


def _surface(series: FieldSeries) -> "pyvista.PolyData":
    """The boundary, coloured where all nodes of a triangle are held or may be touched."""
    import pyvista

    grid = pyvista.UnstructuredGrid({CELL_TYPES[series.cells.shape[1]]: series.cells}, 1e3 * series.nodes_m)
    marks = {"touchable": TOUCHABLE, "held": HELD}
    nodes = np.arange(len(series.nodes_m))
    member = np.column_stack([np.isin(nodes, series.node_sets.get(name, ())) for name in marks])
    surface = drawn_surface(grid, member.astype(np.float32))
    colours = np.tile(FREE, (surface.n_cells, 1))
    whole = np.asarray(surface.point_data[SHOWN])[surface.regular_faces].min(axis=1) == 1.0
    for index, colour in enumerate(marks.values()):
        colours[whole[:, index]] = colour
    return paint(surface, colours)
