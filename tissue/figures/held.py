"""A still picture of a soft organ at rest, from above and from below: what holds it, and what the tool may touch."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissue.fem.fields import FieldSeries
from tissue.figures.figure import DPI, figure, save
from tissue.figures.press import camera_of
from tissue.figures.rendering import Camera, Coloured, render

if TYPE_CHECKING:
    pass

__all__ = ["draw_held"]

FREE, HELD, TOUCHABLE = (0.86, 0.84, 0.80), (0.835, 0.369, 0.0), (0.0, 0.447, 0.698)
EYES = ((0.25, -0.75, 0.62), (0.25, -0.75, -0.62))
TITLES = ("from above", "from below")


def draw_held(series: FieldSeries, path: Path, *, title: str) -> str | None:
    """Draw the organ's surface, triangles of held nodes and of touchable nodes in colours of their own.

    Returns
    -------
    None, or why it could not be drawn.
    """
    surfaces = [_surface(series)] * len(EYES)
    cameras = [camera_of(surfaces[0].points_mm, eye) for eye in EYES]
    pictures: list[NDArray[np.uint8]] = []
    for surface, camera in zip(surfaces, cameras, strict=True):
        drawn = render(_made(surface, camera))
        if isinstance(drawn, str):
            return drawn
        pictures += drawn
    _compose(pictures, title, path)
    return None


def _made(surface: Coloured, camera: Camera) -> Any:
    return lambda: ([surface], camera)


def _surface(series: FieldSeries) -> Coloured:
    """Flat triangles of the boundary, coloured."""
    import pyvista

    corners = series.cells.shape[1]
    cells = np.insert(series.cells, 0, corners, axis=1)
    kind = {4: pyvista.CellType.TETRA, 8: pyvista.CellType.HEXAHEDRON}[corners]
    grid = pyvista.UnstructuredGrid(cells.ravel(), np.full(len(cells), kind), 1e3 * series.nodes_m)
    surface: Any = grid.extract_surface(algorithm="dataset_surface").triangulate()
    triangles = surface.regular_faces
    nodes = np.asarray(surface.point_data["vtkOriginalPointIds"])[triangles]
    colours = np.tile(FREE, (len(triangles), 1))
    for name, colour in (("touchable", TOUCHABLE), ("held", HELD)):
        chosen = np.zeros(len(series.nodes_m), dtype=bool)
        chosen[series.node_sets.get(name, np.zeros(0, dtype=np.int64))] = True
        colours[chosen[nodes].all(axis=1)] = colour
    points = np.asarray(surface.points, dtype=np.float32)[triangles].reshape(-1, 3)
    sides = points.reshape(-1, 3, 3)
    normals = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Coloured(
        points_mm=points,
        normals=np.repeat(normals, 3, axis=0).astype(np.float32),
        triangles=np.arange(len(points)).reshape(-1, 3),
        colours=np.repeat(np.rint(255.0 * colours), 3, axis=0).astype(np.uint8),
    )


def _compose(pictures: list[NDArray[np.uint8]], title: str, path: Path) -> None:
    """The views side by side above a legend."""
    from matplotlib.patches import Patch

    tall, wide = max(p.shape[0] for p in pictures), pictures[0].shape[1]
    gap, head, foot = 40, 110, 80
    size = len(pictures) * (wide + gap) - gap, tall + head + foot
    chart = figure(size[0] / DPI, size[1] / DPI)
    chart.text(0.5, 1.0 - 35 / size[1], f"{title}: what holds the organ", ha="center", va="center", size=11)
    for index, (picture, name) in enumerate(zip(pictures, TITLES, strict=True)):
        high = picture.shape[0]
        place = (index * (wide + gap) / size[0], (foot + tall - high) / size[1], wide / size[0], high / size[1])
        axes = chart.add_axes(place)
        axes.imshow(picture, interpolation="nearest")
        axes.set_axis_off()
        axes.set_title(name, size=10)
    named = (("held", HELD), ("may be touched", TOUCHABLE), ("free", FREE))
    chart.legend(
        handles=[Patch(facecolor=colour, edgecolor="0.4", label=name) for name, colour in named],
        loc="lower center",
        ncols=3,
        frameon=False,
    )
    save(chart, path)
