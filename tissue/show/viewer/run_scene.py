"""Saved run in a plotter, for windows, files and pages: bone, fields, faces, tool and force."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Array
from tissue.scene.scene import Scene
from tissue.show.figures.figure import COMPONENTS, layer_colours
from tissue.show.figures.tool_mesh import faces_of, pose, row_at, turning_tool
from tissue.show.viewer.fields import BoneShown, FieldsShown
from tissue.show.viewer.plotter import Plotter, add_text, in_words
from tissue.show.viewer.saved_surfaces import bone_of, cut_plane, saved_fields, tool_force
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.saved_fields import SavedFields
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pyvista

CHART_SHARE = 0.27
"""Height of the chart, relative to the window."""
MOST_ROWS = 4000
"""Largest number of rows of the trace that a path or a curve shows: several for each pixel."""
LONGEST = 0.3
"""Ratio of the length of the longest arrow to the size of the touched object."""


def _chart(
    plotter: Plotter, trace: Table, every: slice
) -> "tuple[pyvista.Chart2D, pyvista.plotting.charts.LinePlot2D]":
    """Add a chart of the force over time along the lower edge, with a cursor.

    The commanded force is pale, and the force of the model is drawn in front of it. Otherwise the
    tooth-passing vibration in the commanded force would look like a band that hides the force of
    the model.
    """
    import pyvista

    # shares of the window: the lower edge from side to side
    chart = pyvista.Chart2D(
        size=(0.98, CHART_SHARE), loc=(0.01, 0.0), x_label="time / s", y_label="force / N"
    )
    time = trace["time_s"][every]
    # an axis needs a range in a run without force
    ends = [0.0, 1e-3]
    # opacity and line width: the model's force is full and wide
    forces = (trace.vectors("force", "N"), 0.3, 1.5), (tool_force(trace), 1.0, 2.0)
    for values, opacity, width in forces:
        curves = np.column_stack([np.linalg.norm(values, axis=1), values])[every].T
        ends += [float(curves.min()), float(curves.max())]
        for curve, name, colour in zip(
            curves, ("magnitude", *"xyz"), ("black", *COMPONENTS), strict=True
        ):
            look = {"color": pyvista.Color(colour, opacity=opacity), "width": width}
            chart.line(time, curve, label=name if opacity == 1.0 else "", **look)
    # the curves do not touch the frame of the chart
    border = 0.05 * (max(ends) - min(ends))
    chart.y_range = (min(ends) - border, max(ends) + border)
    chart.x_range = (float(time[0]), float(max(time[-1], time[0] + 1e-3)))
    cursor = chart.line([time[0], time[0]], list(chart.y_range), color=(0.4, 0.4, 0.4), width=1.5)
    chart.GetLegend().SetInline(False)  # next to the curves: the legend would hide curves behind it
    for axis in (chart.x_axis, chart.y_axis):
        axis.label_size = 24
        axis.tick_label_size = 22
    chart.GetLegend().SetLabelSize(22)
    plotter.add_chart(chart)
    return chart, cursor


FORCE = "#0072B2"
SMALLEST_ARROW_SHARE = 1e-3
"""Force, relative to the largest force, below which no arrow is drawn."""


class ToolShown:
    """Tool, and an arrow whose length is proportional to the force.

    Parameters
    ----------
    plotter
        Plotter of the tool and the arrow.
    tool
        Surface of the tool in the frame of the tool [mm], or None.
    longest_mm
        Length [mm] of the arrow that shows the largest force.
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
        # legible on the tissue, which still shines through; the offset is in pixels from the
        # arrow's tip
        look.SetBackgroundOpacity(0.6)
        self._value.SetDisplayOffset(8, 4)
        plotter.add_actor(self._value, reset_camera=False, render=False)

    def show(self, tip_mm: Array, turn: Array, force_N: Array, *, largest_N: float) -> None:
        """Show the tool and the force on it.

        The pose is given by the position of the tip [mm] and a quaternion (x, y, z, w).

        The length of the arrow is proportional to the force, and is `longest_mm` for the force
        `largest_N`.
        """
        import pyvista

        if self._tool is not None:
            self._tool.user_matrix = pose(tip_mm, turn)
        size = float(np.linalg.norm(force_N))
        shown = size > SMALLEST_ARROW_SHARE * largest_N
        self._arrow.SetVisibility(shown)
        self._value.SetVisibility(shown)
        # an arrow without length has no direction
        if not shown:
            return
        # radii and lengths of an arrow are shares of its scale
        length = self._longest * size / largest_N
        self._arrow.mapper.dataset = pyvista.Arrow(
            start=tip_mm,
            direction=force_N,
            scale=length,
            # 2 and 5 % of the longest arrow
            shaft_radius=0.02 * self._longest / length,
            tip_radius=0.05 * self._longest / length,
            # head and shaft keep their width whatever the length; a short arrow is not only a head
            tip_length=min(0.12 * self._longest / length, 0.6),
        )
        self._value.SetInput(f"{size:.3g} N")
        self._value.SetPosition(*(tip_mm + length * force_N / size))


TISSUE = ("bone", "bone beyond the cut", "field")
"""Names of the meshes of a scene that show the simulated tissue."""
MOST_POINTS = 20_000
"""Largest number of points that represent the extent of a surface; the camera needs no more."""
NEAR_TIP = 0.5
"""Length of the tool from its tip that must be in view, relative to the size of the tissue."""


@dataclass(frozen=True)
class Choice:
    """Options of the initial view of a run.

    Attributes
    ----------
    hide
        Hidden layers.
    field
        Field that is shown instead of the bone. Default: the bone, or the first field of a run
        without bone.
    scale
        Factor by which the displacement is multiplied.
    time_s
        Time that is shown at the start [s]. Default: the time of the largest force.
    clean
        If true, only the simulated tissue is shown, without text, widgets, marks and tool.
    """

    hide: tuple[str, ...] = ()
    field: str | None = None
    scale: float = 1.0
    time_s: float | None = None
    clean: bool = False

    @classmethod
    def of_json(cls, text: str) -> "Choice":
        """Return the choice that another process wrote as JSON."""
        found = json.loads(text)
        return cls(**found | {"hide": tuple(found["hide"])})


class RunScene:
    """Bone, fields, faces, tool and force of a run.

    Parameters
    ----------
    saved
        Saved run.
    choice
        Initial view. The caller must still apply the hidden layers, the field and the time of this
        view.
    plotter
        Plotter of the run.
    fine
        If true, tetrahedra are drawn without facets, as in a still picture.
    annotated
        If true, the legend of the layers and the chart of the force are drawn in the plotter.

    Attributes
    ----------
    bone, fields
        Parts of the scene; None for a part that the run does not have.
    trace
        Trace of the run; None for a run without ticks.
    series
        Fields of the run over time, or None.
    colours
        Colour (red, green and blue, 0 to 1) of each layer and face that can be hidden, keyed by
        name.
    face_colours
        Colours of the faces.
    times_s
        Times that can be shown [s].
    span_s
        First and last time [s].
    start_s
        Time that is shown at the start [s].
    tissue_mm
        Points of the simulated tissue [mm], shape (n, 3).
    size_mm
        Size of the tissue [mm].
    """

    def __init__(
        self,
        saved: SavedRun,
        choice: Choice,
        plotter: Plotter,
        *,
        fine: bool = False,
        annotated: bool = True,
    ) -> None:
        scene = saved.scene
        self._plotter = plotter
        bone = bone_of(saved, scene)
        self.bone = None if bone is None else BoneShown(plotter, bone, legend=annotated)
        self.series = saved_fields(saved)
        self.fields: FieldsShown | None = None
        if self.series is not None:
            cut = cut_plane(saved, self.series) if self.bone is not None else None
            self.fields = FieldsShown(plotter, self.series, scale=choice.scale, clip=cut, fine=fine)

        faces = faces_of(scene)
        self.face_colours = layer_colours(tuple(faces))
        self._face_actors = {
            name: plotter.add_mesh(face, color=self.face_colours[name], opacity=0.5)
            for name, face in faces.items()
        }
        of_fields = () if self.series is None else self.series.layer_names
        of_bone = [] if self.bone is None else self.bone.layers
        self.colours = layer_colours((*dict.fromkeys((*of_bone, *of_fields)),)) | self.face_colours

        points = [np.asarray(face.points) for face in faces.values()]
        if self.bone is not None:
            points.append(self.bone.points_mm)
        # A field may extend far beyond the bone that it replaces.
        if self.series is not None and (self.bone is None or choice.field is not None):
            points.append(np.asarray(self.series.frames[0].points))
        sizes = [float(np.linalg.norm(np.ptp(each, axis=0))) for each in points]
        self.size_mm = max([*sizes, 0.0 if self.series is None else self.series.size_mm])
        # a subset of many points is enough to find their extent
        some = (each[:: max(len(each) // MOST_POINTS, 1)] for each in points)
        self.tissue_mm: Array = np.vstack([np.zeros((0, 3)), *some])
        self.times_s = times_of(saved, self.series)
        ends = self.times_s if len(self.times_s) else np.zeros(1)
        self.span_s = float(ends[0]), float(ends[-1])
        self.start_s = self.span_s[1]
        self.trace: Table | None = None
        if saved.trace is not None and len(saved.trace.rows):
            self.trace = saved.trace
            self._add_tool(saved.trace, scene, annotated=annotated)
        if choice.time_s is not None:
            self.start_s = choice.time_s

    def _add_tool(self, trace: Table, scene: Scene | None, *, annotated: bool) -> None:
        """Add the tool, the force on the tool, the path of the tip, and the chart of the force."""
        import pyvista

        self._tips = trace.vectors("tool", "mm")
        self._force = tool_force(trace)
        self._turns = trace.quaternions()
        every = slice(None, None, max(len(trace.rows) // MOST_ROWS, 1))
        path = self._tips[every]
        travel_mm = float(np.ptp(path, axis=0).max())
        if travel_mm > 0.0:
            self._plotter.add_mesh(pyvista.lines_from_points(path), color="#D55E00", line_width=3)
        self._peak = int(np.linalg.norm(self._force, axis=1).argmax())
        # a divisor, also in a run without force
        self._largest_N = max(float(np.linalg.norm(self._force[self._peak])), 1e-9)
        self.start_s = float(trace["time_s"][self._peak])
        self._body = turning_tool(scene.tool if scene is not None else None)
        length_mm = self._body.length if self._body is not None else 0.0
        # at least 0.3 mm long where nothing has a size
        self._longest_mm = LONGEST * max(travel_mm, self.size_mm, length_mm, 1.0)
        self._tool = ToolShown(self._plotter, self._body, longest_mm=self._longest_mm, opacity=0.35)
        self._text: Any = None
        if annotated:
            self._text = add_text(self._plotter, "", (0.012, 0.932), size=11)
            self._chart, self._cursor = _chart(self._plotter, trace, every)

    def extent_mm(self, *, near_tip: bool = False) -> Array:
        """Return the points that must stay in view [mm], shape (n, 3).

        The points include the tissue, the first and last tip position, and the longest force arrow.
        With `near_tip`, the points of the tool near its tip are included.
        """
        if self.trace is None:
            return self.tissue_mm
        tip = self._tips[self._peak]
        arrow = self._longest_mm * self._force[self._peak] / self._largest_N
        points = [self.tissue_mm, np.stack([self._tips[0], self._tips[-1], tip, tip + arrow])]
        if near_tip and self._body is not None:
            body = np.asarray(self._body.points)
            near = body[np.linalg.norm(body, axis=1) <= NEAR_TIP * self.size_mm]
            matrix = pose(tip, self._turns[self._peak])
            points.append(near @ matrix[:3, :3].T + tip)
        return np.vstack(points)

    def tissue_actors(self) -> "Iterator[pyvista.Actor]":
        """Return the actors of bone, fields and faces."""
        yield from (self._plotter.actors[name] for name in TISSUE if name in self._plotter.actors)
        yield from self._face_actors.values()

    def at(self, time_s: float) -> None:
        """Show a time."""
        if self.fields is not None:
            self.fields.at(time_s)
        if self.trace is None:
            return
        trace = self.trace
        row = row_at(trace, time_s)
        force = self._force[row]
        self._tool.show(self._tips[row], self._turns[row], force, largest_N=self._largest_N)
        if self.bone is not None:
            self.bone.at(row)
        if self._text is None:
            return
        words = [f"{time_s:.3f} s: force {np.linalg.norm(force):.2f} N ({in_words(force)})"]
        if "layer" in trace:
            words.append(str(trace["layer"][row]))
        if "removed_mm3" in trace and trace["removed_mm3"][-1] > 0.0:
            words.append(f"removed {trace['removed_mm3'][row]:.2f} mm³")
        self._text.input = ", ".join(words)
        self._cursor.update([time_s, time_s], self._chart.y_range)

    def show(self, field: str | None) -> None:
        """Show a field; for None, show the bone."""
        if self.fields is not None:
            self.fields.show(field)
        if self.bone is not None:
            self.bone.show(field is None)

    def hide(self, hidden: frozenset[str]) -> None:
        """Hide some layers and faces."""
        for each in (self.bone, self.fields):
            if each is not None:
                each.hide(hidden)
        for name, actor in self._face_actors.items():
            actor.SetVisibility(name not in hidden)


def times_of(saved: SavedRun, series: SavedFields | None) -> Array:
    """Return the times [s] of the trace rows of a run or, without a trace, of its saved fields."""
    if saved.trace is not None and len(saved.trace.rows):
        return saved.trace["time_s"]
    return np.zeros(0) if series is None else series.times_s
