"""The window of `tissue view`: what is shown of a run, and how its parts answer to each other."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.figures.faces import faces_of
from tissue.figures.style import layer_colours
from tissue.figures.tool_mesh import turning_tool
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.saved_fields import SavedFields, field_label, field_names
from tissue.viewer.bone import BoneShown
from tissue.viewer.camera import aim
from tissue.viewer.carving import bone_of
from tissue.viewer.clip import HELP as CLIP_HELP
from tissue.viewer.clip import ClipPlane
from tissue.viewer.fields import FieldsShown, Plane
from tissue.viewer.layers import LayerKeys
from tissue.viewer.moment import CHART_SHARE, MomentShown
from tissue.viewer.movie import movie_times_s
from tissue.viewer.pick import NameList, PointRead
from tissue.viewer.play import Playback
from tissue.viewer.plotter import Plotter, add_names, free_keys, on_click
from tissue.viewer.still import add_scale_bar, leave_alone

if TYPE_CHECKING:
    import pyvista

__all__ = ["Choice", "Window", "cut_plane", "some_of", "times_of"]

SIZE = (1400, 950)
SLIDERS = CHART_SHARE + 0.04
"""Height of the sliders in the window."""
TISSUE = ("bone", "bone beyond the cut", "field")
"""Names of what was simulated among a plotter's actors."""
MOST_POINTS = 20_000
LARGEST = 0.3
"""Share of the mesh's size that the greatest displacement can be drawn as."""


@dataclass(frozen=True)
class Choice:
    """What is shown at first.

    Attributes
    ----------
    hide
        Layers that are off.
    field
        Field in place of the bone; without it the bone, or the first field of a run without bone.
    scale
        How many times its size the displacement is drawn.
    time_s
        The moment [s]; without it that of the greatest force.
    clean
        Whether what was simulated is shown alone, without text, widgets, marks and tool.
    """

    hide: tuple[str, ...] = ()
    field: str | None = None
    scale: float = 1.0
    time_s: float | None = None
    clean: bool = False


class Window:
    """Everything that is shown of a run.

    Parameters
    ----------
    saved
        The run.
    title
        What is written above.
    choice
        What is shown at first.
    off_screen
        Whether it is drawn for a file, and so without buttons, lists and help.

    Attributes
    ----------
    plotter
        PyVista's plotter.
    fields, point, names, playback, bone, layers
        The parts of the window; None where the run, or a picture, has none.
    """

    def __init__(self, saved: SavedRun, title: str, choice: Choice, *, off_screen: bool) -> None:
        import pyvista

        self._saved, self._off_screen = saved, off_screen
        self.plotter: Plotter = pyvista.Plotter(
            off_screen=off_screen, window_size=list(SIZE), title=f"tissue: {saved.summary.get('scene', 'run')}"
        )
        self.plotter.background_color = pyvista.Color("white")
        scene = saved.scene
        bone = bone_of(saved, scene)
        self.bone = None if bone is None else BoneShown(self.plotter, bone)
        self._series = SavedFields(saved.path) if field_names(saved.path) else None
        self.fields: FieldsShown | None = None
        if self._series is not None:
            cut = cut_plane(saved, self._series) if self.bone is not None else None
            self.fields = FieldsShown(self.plotter, self._series, scale=choice.scale, clip=cut, fine=off_screen)
        self.names: NameList | None = None
        self.point: PointRead | None = None
        self._faces = faces_of(scene)
        self._add_layers(choice)
        points = np.zeros((1, 3)) if self.bone is None else self.bone.points_mm
        size = max(float(np.linalg.norm(np.ptp(points, axis=0))), self._series.size_mm if self._series else 0.0)
        self.moment: MomentShown | None = None
        self.playback: Playback | None = None
        if saved.trace is not None and len(saved.trace.rows):
            size = max(size, *(face.length for face in self._faces.values()), 0.0)
            tool = turning_tool(scene.tool if scene is not None else None)
            self.moment = MomentShown(self.plotter, saved.trace, tool, size_mm=size)
        self._add_time(choice)
        first = self._series.names[0] if self._series is not None and self.bone is None else None
        self.choose(choice.field or first)
        if not off_screen:
            self._add_controls(size)
        self._write(title)
        if choice.clean:
            leave_alone(self.plotter, self._simulated(), np.vstack([np.zeros((0, 3)), *self._tissue(choice)]))
            return
        aim(self.plotter, np.vstack([np.zeros((0, 3)), *self._extent(choice)]), parallel=off_screen)
        if off_screen:
            add_scale_bar(self.plotter)

    def choose(self, name: str | None) -> None:
        """Show a field, or the bone."""
        if self.fields is not None:
            self.fields.show(name)
        if self.bone is not None:
            self.bone.show(name is None)
        if self.names is not None:
            self.names.mark(name)
        self.plotter.render()

    def next(self) -> None:
        """Show the next field, after the last one the bone."""
        if self.fields is None or self._series is None:
            return
        choices = [*self._series.names, *([None] if self.bone is not None else [])]
        at = choices.index(self.fields.name) if self.fields.name in choices else -1
        self.choose(choices[(at + 1) % len(choices)])

    def at(self, time_s: float) -> None:
        """Show the moment."""
        if self.moment is not None:
            self.moment.at(time_s)
            if self.bone is not None:
                self.bone.at(self.moment.row(time_s))
        if self.fields is not None:
            self.fields.at(time_s)

    def pictures(self) -> Iterator[NDArray[np.uint8]]:
        """Pictures of a movie over the whole run; how much of it is drawn is printed, 0 to 1, a line each."""
        assert self.playback is not None
        times_s = movie_times_s(*self.playback.span_s)
        for index, time_s in enumerate(times_s.tolist(), 1):
            self.playback.to(time_s)
            yield self.plotter.screenshot(None, return_img=True)[..., :3]
            print(index / len(times_s), flush=True)

    def open(self) -> None:
        """Open the window; comes back when it was closed."""
        free_keys(self.plotter)
        if self.playback is not None:
            self.playback.start()
        self.plotter.show()

    def _add_layers(self, choice: Choice) -> None:
        """The faces, with their names, and the digits for layers of the bone, of the fields and for faces."""
        colours = layer_colours(tuple(self._faces))
        add_names(self.plotter, colours)
        actors = {n: self.plotter.add_mesh(f, color=colours[n], opacity=0.5) for n, f in self._faces.items()}
        self._face_actors = list(actors.values())

        def hide_faces(hidden: frozenset[str]) -> None:
            for name, actor in actors.items():
                actor.SetVisibility(name not in hidden)

        of_bone = self.bone.layers if self.bone is not None else ()
        of_fields = self._series.layer_names if self._series is not None else ()
        names = list(dict.fromkeys([*of_bone, *of_fields, *self._faces]))
        targets = [hide_faces, *(each.hide for each in (self.bone, self.fields) if each is not None)]
        self.layers = LayerKeys(self.plotter, names, hidden=choice.hide, targets=targets)

    def _add_time(self, choice: Choice) -> None:
        times = times_of(self._saved, self._series)
        if not len(times):
            return
        peak_s = self.moment.peak_s if self.moment is not None else float(times[-1])
        begin = peak_s if choice.time_s is None else choice.time_s
        self.at(begin)
        if len(times) > 1:
            right = 0.97 if self._series is None or self._off_screen else 0.66
            self.playback = Playback(
                self.plotter,
                self.at,
                span_s=(float(times[0]), float(times[-1])),
                begin_s=begin,
                slider=(0.03 if self._off_screen else 0.1, right, SLIDERS),
            )

    def _add_controls(self, size_mm: float) -> None:
        """What only a window has: list of fields, point that is read, clip plane, scale of the displacement."""
        fields, series, plotter = self.fields, self._series, self.plotter
        if fields is None or series is None:
            return
        plotter.add_key_event("m", self.next)
        labels = [(name, " / ".join(part for part in field_label(name) if part)) for name in series.names]
        bone = [(None, "bone")] if self.bone is not None else []
        names = self.names = NameList(plotter, "shown (click, or m)", [*bone, *labels], choose=self.choose)
        names.mark(fields.name)
        point = self.point = PointRead(plotter, fields, size_mm=0.02 * size_mm)
        ClipPlane(plotter, fields, start=cut_plane(self._saved, series))
        if series.displacement is not None and series.greatest_mm() > 0.0:
            top = max(_round_up(LARGEST * series.size_mm / series.greatest_mm()), fields.scale, 2.0)
            plotter.add_slider_widget(
                fields.enlarge,
                (0.0, top),
                value=fields.scale,
                fmt="displacement × %.3g",
                pointa=(0.72, SLIDERS),
                pointb=(0.97, SLIDERS),
                color="black",
                title_height=0.024,
                slider_width=0.012,
                tube_width=0.003,
                interaction_event="always",
            )
        on_click(plotter, lambda x, y: names.click(x, y) or point.click(x, y))

    def _extent(self, choice: Choice) -> Iterator[NDArray[np.float64]]:
        """Points that have to be seen [mm]."""
        yield from self._tissue(choice)
        if self.moment is not None:
            yield self.moment.extent_mm

    def _tissue(self, choice: Choice) -> Iterator[NDArray[np.float64]]:
        """Points of what was simulated [mm]; a field may reach far beyond the bone in whose place it is chosen."""
        if self.bone is not None:
            yield some_of(self.bone.points_mm)
        if self._series is not None and (self.bone is None or choice.field is not None):
            yield some_of(np.asarray(self._series.frames[0].points))
        yield from (some_of(np.asarray(face.points)) for face in self._faces.values())

    def _simulated(self) -> "list[pyvista.Actor]":
        """Actors of bone, fields and faces."""
        named = self.plotter.actors
        return [*(named[name] for name in TISSUE if name in named), *self._face_actors]

    def _write(self, title: str) -> None:
        lines = [(title, 11, 0.965)]
        if not self._off_screen:
            first = [self.bone.help if self.bone is not None else "", self.layers.help]
            second = [CLIP_HELP, "click: read a point"] if self.fields is not None else []
            second += ["space: play or pause"] if self.playback is not None else []
            for keys, height in ((first, 0.898), ([*second, "q: close"], 0.87)):
                lines.append(("    ".join(key for key in keys if key), 9, height))
        for words, size, height in lines:
            self.plotter.add_text(words, position=(0.012, height), viewport=True, font_size=size, color="black")


def some_of(points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Enough of many points to find their extent."""
    return points_mm[:: max(len(points_mm) // MOST_POINTS, 1)]


def times_of(saved: SavedRun, series: SavedFields | None) -> NDArray[np.float64]:
    """Moments that can be shown [s]."""
    if saved.trace is not None and len(saved.trace.rows):
        return saved.trace["time_s"]
    return np.zeros(0) if series is None else series.times_s


def cut_plane(saved: SavedRun, series: SavedFields) -> Plane:
    """Plane through where the tool was deepest, which opens the mesh towards the one who looks."""
    x, cut, z = map(float, series.frames[0].center)
    if saved.trace is not None and len(saved.trace.rows):
        cut = float(saved.trace["tool_y_mm"][saved.trace["tool_z_mm"].argmin()])
    return (0.0, -1.0, 0.0), (x, cut + 1e-4, z)


def _round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, 20 and so on."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1.0 - 1e-9)))
