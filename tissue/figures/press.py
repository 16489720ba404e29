"""A still picture of a soft organ under load: how far it has moved, and the stress where it is cut open at the tool."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.fem.fields import FieldSeries, Frame
from tissue.figures.figure import DRAWING, save
from tissue.figures.rendering import Camera, paint, render, side_by_side
from tissue.figures.tool_mesh import pose
from tissue.simulation.saved_fields import IN_MM, field_label, field_limits, field_values
from tissue.simulation.series import frame_mesh
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pyvista
    from matplotlib.cm import ScalarMappable

__all__ = ["draw_press"]

EYE = (0.25, -0.75, 0.62)
"""Direction towards the eye, that of `tissue view` but lower."""
TOOL = (0.72, 0.72, 0.75)
SHARP_DEG = 40.0
"""Edges of a greater angle are drawn sharp."""
HEAD_PX, FOOT_PX = 90, 150


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
    import pyvista

    frame = max(series.frames, key=_greatest, default=None)
    if frame is None or _greatest(frame) == 0.0:
        return "nothing has moved"
    row = int(np.clip(np.searchsorted(trace["time_s"], frame.time_s - 1e-9), 0, len(trace.rows) - 1))
    moved = _displacement(frame)
    mesh = frame_mesh(series, frame)
    mesh.points = np.asarray(mesh.points) + np.float32(IN_MM[moved.rpartition("_")[2]]) * mesh.point_data[moved]
    stress = [name for name in frame.cells if name.startswith("von_mises_")][:1]
    values = {name: field_values(mesh, name) for name in (moved, *stress)}
    limits = {name: field_limits(name, [array]) for name, array in values.items() if array is not None}

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        """The deformed organ, whole and cut open, and what sees it."""
        place = pose(trace.vectors("tool", "mm")[row], [trace[f"tool_q{c}"][row] for c in "xyzw"])
        probe = pyvista.PolyData() if tool is None else tool.transform(place, inplace=False)
        cut = (0.0, float(trace["tool_y_mm"][row]) + 1e-4, 0.0)
        surfaces: list[pyvista.PolyData] = []
        for name, (low, high) in limits.items():
            body, side = _surface(mesh), _surface(probe)
            if surfaces:  # the first is whole, the second cut open
                body, side = (_surface(one.clip(normal=(0.0, -1.0, 0.0), origin=cut)) for one in (mesh, probe))
            shown = np.maximum(np.asarray(field_values(body, name)), low)
            paint(body, np.asarray(_mapped(low, high).to_rgba(shown))[:, :3])
            count = side.n_points if "colours" in body.point_data else side.n_cells
            paint(side, np.tile(TOOL, (count, 1)))
            surfaces.append(body.append_polydata(side) if side.n_cells else body)
        camera = Camera.seeing(surfaces[0].points, EYE, (0.0, 0.0, 1.0))
        return [(surface, camera) for surface in surfaces]

    pictures = render(make)
    if isinstance(pictures, str):
        return pictures
    force = float(np.linalg.norm(trace.vectors("model_force", "N")[row]))
    with DRAWING:
        chart, panels, (_, tall) = side_by_side(pictures, head_px=HEAD_PX, foot_px=FOOT_PX)
        title = f"{title}: {force:.3g} N at {frame.time_s:.3f} s"
        chart.text(0.5, 1.0 - 0.45 * HEAD_PX / tall, title, ha="center", va="center", size=11)
        for index, (axes, (name, ends)) in enumerate(zip(panels, limits.items(), strict=True)):
            left, foot, wide, _ = axes.get_position().bounds
            place = chart.add_axes((left + 0.2 * wide, 0.66 * foot, 0.6 * wide, 0.16 * foot))
            bar = chart.colorbar(_mapped(*ends), cax=place, orientation="horizontal")
            words = " / ".join(part for part in field_label(name) if part)
            bar.set_label(words + (", cut open at the tool" if index else ""))
            if ends[0] > 0.0:
                ticks = np.geomspace(*ends, 4).tolist()
                bar.set_ticks(ticks, labels=[f"{tick:.2g}" for tick in ticks])
                bar.minorticks_off()
        save(chart, path)
    return None


def _displacement(frame: Frame) -> str:
    return next((n for n in frame.points if n.startswith("displacement_") and n.rpartition("_")[2] in IN_MM), "")


def _greatest(frame: Frame) -> float:
    name = _displacement(frame)
    return float(np.linalg.norm(frame.points[name], axis=1).max(initial=0.0)) if name else 0.0


def _surface(body: "pyvista.DataSet") -> "pyvista.PolyData":
    """Triangles of a body's surface, with normals that keep its edges."""
    triangles = body.extract_surface(algorithm="dataset_surface").triangulate()
    return triangles.compute_normals(
        cell_normals=False, split_vertices=True, feature_angle=SHARP_DEG, consistent_normals=False
    )


def _mapped(low: float, high: float) -> "ScalarMappable":
    """Colours of a field by the ends of its scale, which is logarithmic where it begins above 0."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    return ScalarMappable(LogNorm(low, high), "inferno") if low > 0.0 else ScalarMappable(Normalize(low, high))
