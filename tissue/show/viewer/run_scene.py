"""A saved run in a plotter: bone, fields, faces, tool and force at any moment, for windows,
files and pages alike.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.show.figures.faces import faces_of
from tissue.show.figures.figure import layer_colours
from tissue.show.figures.tool_mesh import turning_tool
from tissue.show.viewer.bone import BoneShown
from tissue.show.viewer.fields import FieldsShown
from tissue.show.viewer.moment import MomentShown
from tissue.show.viewer.plotter import Plotter
from tissue.show.viewer.saved_surfaces import bone_of, cut_plane, saved_fields
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.saved_fields import SavedFields

if TYPE_CHECKING:
    import pyvista

__all__ = ["Choice", "RunScene", "times_of"]

TISSUE = ("bone", "bone beyond the cut", "field")
"""Names of the simulated tissue among the meshes of a scene."""
MOST_POINTS = 20_000
"""Maximum number of points of a surface for its extent."""
NEAR_TIP = 0.5
"""Part of the tool from its tip that has to be seen, as a share of the size of the tissue."""


@dataclass(frozen=True)
class Choice:
    """First view of a run.

    Attributes
    ----------
    hide
        Hidden layers.
    field
        Field that is shown in place of the bone. Default: the bone, or the first field of a run
        without bone.
    scale
        Factor by which the displacement is enlarged.
    time_s
        Shown moment [s]. Default: the moment of the largest force.
    clean
        If true, only the simulated tissue is shown, without text, widgets, marks and tool.
    """

    hide: tuple[str, ...] = ()
    field: str | None = None
    scale: float = 1.0
    time_s: float | None = None
    clean: bool = False


class RunScene:
    """Bone, fields, faces, tool and force of a run.

    Parameters
    ----------
    saved
        Saved run.
    choice
        First view. Its layers, field and moment are applied by the caller.
    plotter
        Plotter of the run.
    fine
        If true, tetrahedra are drawn without facets, as needed for a still picture.
    annotated
        If true, the legend of the layers and the chart of the force are drawn into the plotter.

    Attributes
    ----------
    bone, fields, moment
        Parts of the scene. None if the run does not have the part.
    series
        The fields of the run over time, or None.
    colours
        Red, green and blue of every switchable layer and face, 0 to 1.
    face_colours
        Colours of the faces only.
    times_s
        Moments that can be shown [s].
    start_s
        Moment that is shown at first [s].
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
        of_bone = (
            {}
            if self.bone is None
            else {name: self.bone.colours[name] for name in self.bone.layers}
        )
        of_fields = {} if self.series is None else layer_colours(tuple(self.series.layer_names))
        self.colours = of_bone | {
            name: of_fields[name] for name in of_fields if name not in of_bone
        }
        self.colours |= self.face_colours

        self._points = [some_of(np.asarray(face.points)) for face in faces.values()]
        if self.bone is not None:
            self._points.append(some_of(self.bone.points_mm))
        # A field may reach far beyond the bone in whose place it is chosen.
        if self.series is not None and (self.bone is None or choice.field is not None):
            self._points.append(some_of(np.asarray(self.series.frames[0].points)))
        sizes = [float(np.linalg.norm(np.ptp(each, axis=0))) for each in self._points]
        self.size_mm = max([*sizes, 0.0 if self.series is None else self.series.size_mm])

        self.moment: MomentShown | None = None
        self._tool: pyvista.PolyData | None = None
        if saved.trace is not None and len(saved.trace.rows):
            self._tool = turning_tool(scene.tool if scene is not None else None)
            self.moment = MomentShown(
                plotter, saved.trace, self._tool, size_mm=self.size_mm, chart=annotated
            )
        self.times_s = times_of(saved, self.series)
        last_s = float(self.times_s[-1]) if len(self.times_s) else 0.0
        peak_s = self.moment.peak_s if self.moment is not None else last_s
        self.start_s = peak_s if choice.time_s is None else choice.time_s

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last moment [s]."""
        return (
            (float(self.times_s[0]), float(self.times_s[-1])) if len(self.times_s) else (0.0, 0.0)
        )

    @property
    def tissue_mm(self) -> NDArray[np.float64]:
        """Points of the simulated tissue [mm], shape (n, 3)."""
        return np.vstack([np.zeros((0, 3)), *self._points])

    def extent_mm(self, *, near_tip: bool = False) -> NDArray[np.float64]:
        """Return the points to keep in view [mm], shape (n, 3).

        On request they include the points of the tool near its tip.
        """
        points = [self.tissue_mm]
        if self.moment is not None:
            points.append(self.moment.extent_mm)
            if near_tip and self._tool is not None:
                points.append(
                    self.moment.near_tip_mm(
                        np.asarray(self._tool.points), reach_mm=NEAR_TIP * self.size_mm
                    )
                )
        return np.vstack(points)

    def tissue_actors(self) -> "Iterator[pyvista.Actor]":
        """Return the actors of bone, fields and faces."""
        yield from (self._plotter.actors[name] for name in TISSUE if name in self._plotter.actors)
        yield from self._face_actors.values()

    def at(self, time_s: float) -> None:
        """Show a moment."""
        if self.moment is not None:
            self.moment.at(time_s)
            if self.bone is not None:
                self.bone.at(self.moment.row(time_s))
        if self.fields is not None:
            self.fields.at(time_s)

    def show(self, field: str | None) -> None:
        """Show a field, or the bone for None."""
        if self.fields is not None:
            self.fields.show(field)
        if self.bone is not None:
            self.bone.show(field is None)

    def hide(self, hidden: frozenset[str]) -> None:
        """Leave out some layers and faces."""
        for each in (self.bone, self.fields):
            if each is not None:
                each.hide(hidden)
        for name, actor in self._face_actors.items():
            actor.SetVisibility(name not in hidden)


def some_of(points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return enough of many points to find their extent."""
    return points_mm[:: max(len(points_mm) // MOST_POINTS, 1)]


def times_of(saved: SavedRun, series: SavedFields | None) -> NDArray[np.float64]:
    """Return the moments that can be shown [s]."""
    if saved.trace is not None and len(saved.trace.rows):
        return saved.trace["time_s"]
    return np.zeros(0) if series is None else series.times_s
