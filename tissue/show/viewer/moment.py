"""One moment of a run in a view: tool, force arrow, and cursor in the force chart."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.show.figures.figure import COMPONENTS
from tissue.show.figures.tool_mesh import pose, tool_turns
from tissue.show.viewer.plotter import Plotter, add_text
from tissue.show.viewer.saved_surfaces import tool_force
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pyvista

__all__ = ["CHART_SHARE", "MomentShown", "ToolShown"]

CHART_SHARE = 0.27
"""Height of the chart in the window."""
MOST_POINTS = 4000
"""Rows of the trace that a path or a curve shows."""
LONGEST = 0.3
"""Ratio of the longest arrow's length to the size of the touched object."""


class MomentShown:
    """Tool, force and chart cursor of one moment of a trace.

    Parameters
    ----------
    plotter
        Plotter of the moment.
    trace
        Trace with at least one row.
    tool
        Surface of the tool in its own frame [mm], or None.
    size_mm
        Size of the object that the tool touches [mm]. The arrow is in proportion to it.
    chart
        If true, the force is written and drawn over time along the lower edge.
    """

    def __init__(
        self,
        plotter: Plotter,
        trace: Table,
        tool: "pyvista.PolyData | None",
        *,
        size_mm: float,
        chart: bool = True,
    ) -> None:
        import pyvista

        self._trace = trace
        self._tips = trace.vectors("tool", "mm")
        self._force = tool_force(trace)
        self._turns = tool_turns(trace)
        every = slice(None, None, max(len(trace.rows) // MOST_POINTS, 1))
        path = self._tips[every]
        if len(path) > 1 and np.ptp(path, axis=0).max() > 0.0:
            plotter.add_mesh(
                pyvista.lines_from_points(path),
                color="#D55E00",
                line_width=3,
                show_scalar_bar=False,
            )
        self._peak = int(np.linalg.norm(self._force, axis=1).argmax())
        self._greatest = float(np.linalg.norm(self._force[self._peak]))
        self._longest = LONGEST * max(
            float(np.ptp(path, axis=0).max()), size_mm, tool.length if tool else 0.0, 1.0
        )
        self._tool = ToolShown(plotter, tool, longest_mm=self._longest, opacity=0.35)
        self._charted = chart
        if chart:
            self._text = add_text(plotter, "", (0.012, 0.932), size=11)
            self._chart, self._cursor = _chart(plotter, trace, every)

    @property
    def extent_mm(self) -> NDArray[np.float64]:
        """Both ends of the tool's path and of the longest arrow [mm], shape (4, 3)."""
        tip = self._tips[self._peak]
        arrow = self._longest * self._force[self._peak] / max(self._greatest, 1e-9)
        return np.stack([self._tips[0], self._tips[-1], tip, tip + arrow])

    def near_tip_mm(self, tool_mm: NDArray[np.float64], *, reach_mm: float) -> NDArray[np.float64]:
        """Return the points of the tool near its tip at the largest force [mm].

        The input points are in the tool's frame.
        """
        near = tool_mm[np.linalg.norm(tool_mm, axis=1) <= reach_mm]
        matrix = pose(self._tips[self._peak], self._turns[self._peak])
        return near @ matrix[:3, :3].T + matrix[:3, 3]

    @property
    def peak_s(self) -> float:
        """Time of the largest force [s]."""
        return float(self._trace["time_s"][self._peak])

    def row(self, time_s: float) -> int:
        """Return the row of the trace at a moment."""
        times = self._trace["time_s"]
        return int(np.clip(np.searchsorted(times, time_s - 1e-9), 0, len(times) - 1))

    def at(self, time_s: float) -> None:
        """Show the moment."""
        trace = self._trace
        row = self.row(time_s)
        force = self._tool.show(
            self._tips[row], self._turns[row], self._force[row], greatest_N=self._greatest
        )
        if not self._charted:
            return
        words = [f"{time_s:.3f} s: {force}"]
        if "layer" in trace:
            words.append(str(trace["layer"][row]))
        if "removed_mm3" in trace and trace["removed_mm3"][-1] > 0.0:
            words.append(f"removed {trace['removed_mm3'][row]:.2f} mm³")
        self._text.input = ", ".join(words)
        self._cursor.update([time_s, time_s], self._chart.y_range)


def _chart(
    plotter: Plotter, trace: Table, every: slice
) -> "tuple[pyvista.Chart2D, pyvista.plotting.charts.LinePlot2D]":
    """Add the force over time along the lower edge, with a cursor.

    The commanded force is pale and the model's force is drawn over it. Vibrating teeth would
    otherwise make a band that hides the model's force.
    """
    import pyvista

    chart = pyvista.Chart2D(
        size=(0.98, CHART_SHARE), loc=(0.01, 0.0), x_label="time / s", y_label="force / N"
    )
    time = trace["time_s"][every]
    force = trace.vectors("force", "N")[every]
    model = tool_force(trace)[every]
    low = 0.0
    high = 1e-3
    for values, opacity, width in ((force, 0.3, 1.5), (model, 1.0, 2.0)):
        shown = {"magnitude": (np.linalg.norm(values, axis=1), "black")}
        shown |= {"xyz"[c]: (values[:, c], COMPONENTS[c]) for c in range(3)}
        for name, (curve, colour) in shown.items():
            label = name if values is model else ""
            chart.line(
                time, curve, color=pyvista.Color(colour, opacity=opacity), width=width, label=label
            )
            low = min(low, float(curve.min()))
            high = max(high, float(curve.max()))
    chart.y_range = (low - 0.05 * (high - low), high + 0.05 * (high - low))
    chart.x_range = (float(time[0]), float(max(time[-1], time[0] + 1e-3)))
    cursor = chart.line([time[0], time[0]], list(chart.y_range), color=(0.4, 0.4, 0.4), width=1.5)
    chart.GetLegend().SetInline(False)  # beside the curves, for it hides what it lies upon
    for axis in (chart.x_axis, chart.y_axis):
        axis.label_size = 24
        axis.tick_label_size = 22
    chart.GetLegend().SetLabelSize(22)
    plotter.add_chart(chart)
    return chart, cursor


FORCE = "#0072B2"
LEAST = 1e-3
"""Share of the largest force below which no arrow is drawn."""


class ToolShown:
    """Tool, and an arrow in proportion to its force.

    Parameters
    ----------
    plotter
        Plotter of the tool and the arrow.
    tool
        Surface of the tool in its own frame [mm], or None.
    longest_mm
        Length of the arrow of the largest force [mm].
    opacity
        Opacity of the tool.
    """

    def __init__(
        self,
        plotter: Plotter,
        tool: "pyvista.PolyData | None",
        *,
        longest_mm: float,
        opacity: float,
    ) -> None:
        import pyvista
        from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

        self._longest = longest_mm
        grey = {"color": "gray", "opacity": opacity, "specular": 0.4, "reset_camera": False}
        self._tool = None if tool is None else plotter.add_mesh(tool, **grey)
        self._arrow = plotter.add_mesh(pyvista.Arrow(), color=FORCE, reset_camera=False)
        self._value = vtkBillboardTextActor3D()
        look = self._value.GetTextProperty()
        look.SetFontSize(22)
        look.SetBold(True)
        look.SetColor(*pyvista.Color(FORCE).float_rgb)
        look.SetBackgroundColor(1.0, 1.0, 1.0)
        look.SetBackgroundOpacity(0.6)
        self._value.SetDisplayOffset(8, 4)
        plotter.add_actor(self._value, reset_camera=False, render=False)

    def show(
        self,
        tip_mm: NDArray[np.float64],
        turn: NDArray[np.float64],
        force_N: NDArray[np.float64],
        *,
        greatest_N: float,
    ) -> str:
        """Show the tool at its tip [mm] and turn (x, y, z, w), and return its force as text.

        The text gives the force [N] next to the largest force.
        """
        import pyvista

        if self._tool is not None:
            self._tool.user_matrix = pose(tip_mm, turn)
        size = float(np.linalg.norm(force_N))
        shown = size > LEAST * max(greatest_N, 1e-9)
        self._arrow.SetVisibility(shown)
        self._value.SetVisibility(shown)
        if shown:
            length = self._longest * size / greatest_N
            self._arrow.mapper.dataset = pyvista.Arrow(
                start=tip_mm,
                direction=force_N,
                scale=length,
                shaft_radius=0.02 * self._longest / length,
                tip_radius=0.05 * self._longest / length,
                tip_length=min(0.12 * self._longest / length, 0.6),
            )
            self._value.SetInput(f"{size:.3g} N")
            self._value.SetPosition(*(tip_mm + length * force_N / size))
        parts = ", ".join(f"{one:.2f}" for one in force_N.round(2) + 0.0)
        return f"force {size:.2f} N ({parts})"
