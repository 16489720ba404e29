"""A still picture of a soft organ at rest, from above and from below: what holds it, and what the tool may touch."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.fem.fields import FieldSeries
from tissue.figures.figure import DRAWING, save
from tissue.figures.rendering import Camera, paint, render, side_by_side
from tissue.simulation.series import CELL_TYPES

if TYPE_CHECKING:
    import pyvista

__all__ = ["draw_held"]

FREE, HELD, TOUCHABLE = (0.86, 0.84, 0.80), (0.835, 0.369, 0.0), (0.0, 0.447, 0.698)
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
    pictures = render(lambda: [(surface, Camera.seeing(surface.points, eye, up)) for eye in EYES.values()])
    if isinstance(pictures, str):
        return pictures
    with DRAWING:
        chart, panels, (_, tall) = side_by_side(pictures, head_px=HEAD_PX, foot_px=FOOT_PX)
        chart.text(0.5, 1.0 - 35 / tall, f"{title}: what holds the organ", ha="center", va="center", size=11)
        for axes, name in zip(panels, EYES, strict=True):
            axes.set_title(name, size=10)
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
    """Flat triangles of the boundary, coloured."""
    import pyvista

    kind = CELL_TYPES[series.cells.shape[1]]
    grid = pyvista.UnstructuredGrid({kind: series.cells}, 1e3 * series.nodes_m)
    surface = grid.extract_surface(algorithm="dataset_surface").triangulate()
    nodes = np.asarray(surface.point_data["vtkOriginalPointIds"])[surface.regular_faces]
    colours = np.tile(FREE, (len(nodes), 1))
    for name, colour in (("touchable", TOUCHABLE), ("held", HELD)):
        colours[np.isin(nodes, series.node_sets.get(name, ())).all(axis=1)] = colour
    flat = surface.compute_normals(cell_normals=False, split_vertices=True, feature_angle=0.0, consistent_normals=False)
    return paint(flat, colours)
