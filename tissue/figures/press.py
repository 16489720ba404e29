"""A still picture of a soft organ under load: how far it has moved, and the stress where it is cut open at the tool."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissue.fem.fields import FieldSeries, Frame
from tissue.figures.figure import DPI, figure, save
from tissue.figures.rendering import Camera, Coloured, render
from tissue.simulation.saved_fields import IN_MM, field_label, field_limits, field_values
from tissue.simulation.series import frame_mesh
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pyvista

__all__ = ["camera_of", "draw_press"]

PANEL_PX = 780
EYE = (0.25, -0.75, 0.62)
"""Direction towards the eye, that of `tissue view` but lower."""
TOOL = (0.72, 0.72, 0.75)
SHARP_DEG = 40.0
"""Edges of a greater angle are drawn sharp."""


def draw_press(
    series: FieldSeries, trace: Table, path: Path, *, title: str, tool: "pyvista.PolyData | None" = None
) -> str | None:
    """Draw the deformed organ when it had moved most, whole and cut open at the tool.

    Parameters
    ----------
    series
        Its fields; the frames have a displacement at the nodes and von Mises stress in the cells.
    trace
        The trace, for where the tool was and its force.
    path
        PNG file.
    title
        What is written above.
    tool
        Surface of the tool in its own frame [mm], as `tissue.figures.tool_mesh.tool_surface` gives it.

    Returns
    -------
    None, or why it could not be drawn.
    """
    frame, names = _loaded(series)
    if frame is None:
        return "nothing has moved"
    row = int(np.clip(np.searchsorted(trace["time_s"], frame.time_s - 1e-9), 0, len(trace.rows) - 1))
    shown: list[tuple[str, tuple[float, float]]] = []
    cameras: list[Camera] = []

    def make() -> tuple[list[Coloured], Camera]:
        """The deformed organ, whole and cut open, and where it is seen from."""
        mesh: Any = frame_mesh(series, frame)
        unit = IN_MM[names[0].rpartition("_")[2]]
        mesh.points = np.asarray(mesh.points) + np.float32(unit) * mesh.point_data[names[0]]
        probe = None if tool is None else tool.transform(_pose(trace, row), inplace=False)
        cut = float(trace["tool_y_mm"][row])
        plane: dict[str, Any] = {"normal": (0.0, -1.0, 0.0), "origin": (0.0, cut + 1e-4, 0.0)}
        open_probe = None if probe is None else probe.clip(**plane)
        shown[:] = [(name, field_limits(name, [v])) for name in names if (v := field_values(mesh, name)) is not None]
        bodies = [mesh, mesh.clip(**plane)][: len(shown)]
        surfaces = [_painted(body, *one) for body, one in zip(bodies, shown, strict=True)]
        for index, one in enumerate((probe, open_probe)[: len(surfaces)]):
            if one is not None and one.n_cells:
                surfaces[index] = _joined(surfaces[index], _surface(one))
        cameras[:] = [camera_of(surfaces[0].points_mm)]
        return surfaces, cameras[0]

    pictures = render(make)
    if isinstance(pictures, str):
        return pictures
    force = float(np.linalg.norm(trace.vectors("model_force", "N")[row]))
    _compose(pictures, shown, f"{title}: {force:.3g} N at {frame.time_s:.3f} s", path)
    return None


def _loaded(series: FieldSeries) -> tuple[Frame | None, list[str]]:
    """The frame of greatest displacement, and the names of its displacement and of its von Mises stress."""
    for frame in sorted(series.frames, key=_greatest, reverse=True)[:1]:
        stress = [name for name in frame.cells if name.startswith("von_mises_")]
        if _greatest(frame) > 0.0:
            return frame, [_displacement(frame), *stress[:1]]
    return None, []


def _displacement(frame: Frame) -> str:
    return next((n for n in frame.points if n.startswith("displacement_") and n.rpartition("_")[2] in IN_MM), "")


def _greatest(frame: Frame) -> float:
    name = _displacement(frame)
    return float(np.linalg.norm(frame.points[name], axis=1).max(initial=0.0)) if name else 0.0


def _pose(trace: Table, row: int) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([trace[f"tool_q{c}"][row] for c in "xyzw"]).as_matrix()
    pose[:3, 3] = trace.vectors("tool", "mm")[row]
    return pose


def _surface(body: Any) -> Any:
    """Triangles of a body's surface, with normals that keep its edges."""
    triangles = body.extract_surface(algorithm="dataset_surface").triangulate()
    return triangles.compute_normals(
        cell_normals=False, split_vertices=True, feature_angle=SHARP_DEG, consistent_normals=False
    )


def _painted(body: Any, name: str, limits: tuple[float, float]) -> Coloured:
    surface = _surface(body)
    mapped = _mapped(name, limits)
    values: Any = field_values(surface, name)
    return _coloured(surface, mapped.to_rgba(np.maximum(values, limits[0]))[:, :3])


def _joined(one: Coloured, probe: Any) -> Coloured:
    at_points = len(one.colours) == len(one.points_mm)
    other = _coloured(probe, np.tile(TOOL, (probe.n_points if at_points else probe.n_cells, 1)))
    return Coloured(
        points_mm=np.vstack([one.points_mm, other.points_mm]),
        normals=np.vstack([one.normals, other.normals]),
        triangles=np.vstack([one.triangles, other.triangles + len(one.points_mm)]),
        colours=np.vstack([one.colours, other.colours]),
    )


def _coloured(surface: Any, colours: NDArray[np.float64]) -> Coloured:
    return Coloured(
        points_mm=np.asarray(surface.points, dtype=np.float32),
        normals=np.asarray(surface.point_data["Normals"], dtype=np.float32),
        triangles=np.asarray(surface.regular_faces),
        colours=np.rint(255.0 * colours).astype(np.uint8),
    )


def _mapped(name: str, limits: tuple[float, float]) -> Any:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    low, high = limits
    return ScalarMappable(
        LogNorm(low, high) if low > 0.0 else Normalize(low, high), "inferno" if low > 0.0 else "viridis"
    )


def camera_of(points_mm: NDArray[np.float32], eye: tuple[float, float, float] = EYE) -> Camera:
    """A camera that sees all points."""
    towards = np.array(eye) / np.linalg.norm(eye)
    up = np.array((0.0, 0.0, 1.0)) - towards[2] * towards
    up /= np.linalg.norm(up)
    right = np.cross(up, towards)
    seen = points_mm @ np.column_stack([right, up, towards])
    first, last = seen.min(axis=0), seen.max(axis=0)
    width, height = 1.06 * (last - first)[:2]
    tall = int(np.clip(PANEL_PX * height / width, 0.45 * PANEL_PX, 1.15 * PANEL_PX)) // 2 * 2
    height = max(height, width * tall / PANEL_PX)
    centre = 0.5 * (first + last) @ np.stack([right, up, towards])
    return Camera(tuple(towards), tuple(up), tuple(centre), height_mm=float(height), size=(PANEL_PX, tall))


def _compose(
    pictures: list[NDArray[np.uint8]], shown: list[tuple[str, tuple[float, float]]], title: str, path: Path
) -> None:
    """Put the pictures side by side, each above the bar of its field."""
    tall, wide = pictures[0].shape[:2]
    gap, head, foot = 40, 90, 150
    size = len(pictures) * (wide + gap) - gap, tall + head + foot
    chart = figure(size[0] / DPI, size[1] / DPI)
    chart.text(0.5, 1.0 - 0.45 * head / size[1], title, ha="center", va="center", size=11)
    for index, (picture, (name, limits)) in enumerate(zip(pictures, shown, strict=True)):
        left = index * (wide + gap) / size[0]
        axes = chart.add_axes((left, foot / size[1], wide / size[0], tall / size[1]))
        axes.imshow(picture, interpolation="nearest")
        axes.set_axis_off()
        place = (left + 0.2 * wide / size[0], 0.66 * foot / size[1], 0.6 * wide / size[0], 0.16 * foot / size[1])
        words = " / ".join(part for part in field_label(name) if part)
        bar = chart.colorbar(_mapped(name, limits), cax=chart.add_axes(place), orientation="horizontal")
        bar.set_label(words + (", cut open at the tool" if index else ""))
        if limits[0] > 0.0:
            bar.set_ticks(ticks := np.geomspace(*limits, 4).tolist(), labels=[f"{tick:.2g}" for tick in ticks])
            bar.minorticks_off()
    save(chart, path)
