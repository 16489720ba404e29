"""Controls in the window of `tissue view`: layers, clip plane, point values, fields, playback."""

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from tissue.show.viewer.fields import REFERENCE, FieldsShown, interpolated
from tissue.show.viewer.plotter import Plotter, add_slider, add_text, in_words, picked
from tissue.show.viewer.saved_surfaces import Plane
from tissue.simulation.saved_fields import field_label

if TYPE_CHECKING:
    from vtkmodules.vtkInteractionWidgets import vtkImplicitPlaneWidget

__all__ = [
    "HELP",
    "ClipPlane",
    "LayerKeys",
    "NameList",
    "Playback",
    "PlaybackWidgets",
    "PointRead",
]

MOST = 9
"""Largest number of layers that have a key. The keys are the digits from 1 on."""


class LayerKeys:
    """Keys that switch layers on and off.

    Parameters
    ----------
    plotter
        Plotter in which the digit keys are bound.
    names
        Names of the layers. The first layer has the key 1.
    hidden
        Layers that are hidden at the start.
    hide
        Function that is called with the hidden layers after each change, and at the start if layers
        are hidden then.

    Attributes
    ----------
    hidden
        Hidden layers.
    help
        Description of the keys; empty if there is only one layer.
    """

    def __init__(
        self,
        plotter: Plotter,
        names: Sequence[str],
        *,
        hidden: Sequence[str] = (),
        hide: Callable[[frozenset[str]], None],
    ) -> None:
        self._plotter = plotter
        self._hide = hide
        self.hidden: frozenset[str] = frozenset()
        self.help = ""
        # a single layer is never switched off
        keys = dict(enumerate(names[:MOST], 1)) if len(names) > 1 else {}
        if keys:
            listed = "  ".join(f"{number}: {name}" for number, name in keys.items())
            self.help = f"{listed} on or off"
        for number, name in keys.items():
            plotter.add_key_event(str(number), lambda name=name: self.toggle(name))
        if hidden:
            self.toggle(*hidden)

    def toggle(self, *names: str) -> None:
        """Hide the given layers that are shown, and show those that are hidden."""
        self.hidden ^= frozenset(names)
        self._hide(self.hidden)
        self._plotter.render()


CLIP_KEY = "x"
HELP = "x: clip plane    drag it: push it    drag its arrow: turn it"


class ClipPlane:
    """Plane at which the fields are cut open.

    Parameters
    ----------
    plotter
        Plotter of the window.
    fields
        Fields that the plane cuts.
    start
        Position of the plane when it is first switched on.
    """

    def __init__(self, plotter: Plotter, fields: FieldsShown, *, start: Plane) -> None:
        self._plotter = plotter
        self._fields = fields
        self._plane = fields.clip or start
        self._widget: vtkImplicitPlaneWidget | None = None
        self._on = fields.clip is not None
        plotter.add_key_event(CLIP_KEY, self.switch)
        fields.drawn.append(self._follow)
        self._follow()

    def switch(self) -> None:
        """Cut the mesh open at the plane, or show the whole mesh again."""
        self._on = not self._on
        self._fields.cut(self._plane if self._on else None)
        self._plotter.render()

    def move(self, normal: Sequence[float], origin: Sequence[float]) -> None:
        """Move the plane to a new normal and origin."""
        a, b, c, x, y, z = map(float, (*normal, *origin))
        self._plane = (a, b, c), (x, y, z)
        if self._on:
            self._fields.cut(self._plane)

    def _follow(self) -> None:
        """Show the handles of the plane while there is a mesh to cut."""
        wanted = self._on and self._fields.name is not None
        # the widget is made at first use, since a mesh is needed for its bounds
        if wanted and self._widget is None and self._fields.actor is not None:
            normal, origin = self._plane
            self._widget = self._plotter.add_plane_widget(
                self.move,
                normal=normal,
                origin=origin,
                bounds=self._fields.bounds_mm,
                # the handles are just outside of the mesh
                factor=1.1,
                color="#CC79A7",
                outline_opacity=0.15,
                test_callback=False,
                interaction_event="always",
            )
        elif self._widget is not None and bool(self._widget.GetEnabled()) != wanted:
            self._widget.SetEnabled(wanted)


MARK = "#56B4E9"
NEGLIGIBLE = 1e-5
"""Share of a vector below which a component counts as a rounding error."""
LEFT = 0.012
TOP = 0.80
ROW = 0.032
WIDTH = 0.2
LETTER = 0.024
"""Position and size of the list, relative to the window; a row lies on the base line of its
letters.
"""
CHOSEN = "#0072B2"
OTHER = (0.45, 0.45, 0.45)


class PointRead:
    """Material point marked by a click, and the field values at it.

    Parameters
    ----------
    plotter
        Plotter in which the mark is drawn.
    fields
        Fields that are read.
    size_mm
        Diameter of the mark [mm].

    Attributes
    ----------
    reference_mm
        Position of the point before loading [mm]; None while no point is marked.
    text
        Description of the point.
    """

    def __init__(self, plotter: Plotter, fields: FieldsShown, *, size_mm: float) -> None:
        import pyvista

        self._plotter = plotter
        self._fields = fields
        self.reference_mm: Array | None = None
        self.text = ""
        self._mark = plotter.add_mesh(
            pyvista.Sphere(radius=0.5 * size_mm),
            color=MARK,
            name="mark",
            reset_camera=False,
            render=False,
        )
        self._mark.SetVisibility(False)
        # at the left, below the list of fields
        self._words = add_text(plotter, "", (0.012, 0.36), size=10)
        fields.drawn.append(self.update)

    def click(self, x: int, y: int) -> bool:
        """Mark the point of the mesh under a pixel; return False if there is no mesh.

        `x` and `y` are counted in pixels from the lower left corner of the window.
        """
        actor = self._fields.actor
        found = None if actor is None else picked(self._plotter, actor, x, y)
        if actor is None or found is None:
            return False
        self.reference_mm = interpolated(actor.mapper.dataset, *found, REFERENCE)
        self.update()
        return True

    def update(self) -> None:
        """Update the mark and the text for the shown time."""
        if self.reference_mm is None:
            return
        found = self._fields.read(self.reference_mm) if self._fields.name is not None else None
        self._mark.SetVisibility(found is not None)
        if found is None:
            self.text = "the marked point is gone" if self._fields.name is not None else ""
        else:
            self._mark.SetPosition(*found.place_mm)
            at = in_words(self.reference_mm)
            lines = [f"{found.layer or 'point'} at ({at}) mm before loading"]
            lines += [_line(name, value) for name, value in found.values.items()]
            self.text = "\n".join(lines)
        self._words.input = self.text


def _line(name: str, value: Array) -> str:
    """Return the value of a field as text."""
    words, unit = field_label(name)
    if value.ndim == 0:
        return f"{words}: {value:.3g} {unit}".rstrip()
    size = float(np.linalg.norm(value))
    parts = ", ".join(f"{one if abs(one) > NEGLIGIBLE * size else 0.0:.3g}" for one in value)
    return f"{words}: {size:.3g} {unit} ({parts})"


class NameList:
    """Vertical list of names, of which one is chosen.

    Parameters
    ----------
    plotter
        The window.
    title
        Title above the list.
    names
        Possible choices, with their labels.
    choose
        Function that is called with the clicked choice.
    """

    def __init__(
        self,
        plotter: Plotter,
        title: str,
        names: Sequence[tuple[str | None, str]],
        *,
        choose: Callable[[str | None], None],
    ) -> None:
        self._plotter = plotter
        self._names = list(names)
        self._choose = choose
        self._words = [
            add_text(plotter, words, (LEFT, TOP - ROW * row), size=10)
            for row, words in enumerate([title, *(words for _, words in self._names)])
        ][1:]

    def mark(self, name: str | None) -> None:
        """Highlight the chosen name."""
        from pyvista import Color

        for (each, words), actor in zip(self._names, self._words, strict=True):
            chosen = each == name
            actor.input = f"{'>' if chosen else '  '} {words}"
            actor.prop.color = Color(CHOSEN if chosen else OTHER)

    def click(self, x: int, y: int) -> bool:
        """Choose the name in the list under a pixel; return False if there is no name.

        `x` and `y` are counted in pixels from the lower left corner of the window.
        """
        wide, tall = self._plotter.window_size
        # the title is row 0 of the list
        row = int((TOP + LETTER - y / tall) // ROW) - 1
        if not (LEFT <= x / wide <= LEFT + WIDTH and 0 <= row < len(self._names)):
            return False
        self._choose(self._names[row][0])
        return True


EVERY_MS = 40
"""Time between two updates during playback [ms]: 25 updates per second."""
PLAY_KEY = "space"
SLOWEST_S = 4.0
"""Shortest duration of a playback [s]; a shorter run is played slower."""


class Playback:
    """Time that is shown, which the user sets or a playback advances.

    Parameters
    ----------
    span_s
        First and last time [s].
    time_s
        Time that is shown at the start [s].

    Attributes
    ----------
    time_s
        Shown time [s].
    playing
        True if the playback changes the time.
    """

    def __init__(self, span_s: tuple[float, float], time_s: float) -> None:
        self.span_s = span_s
        self.time_s = time_s
        self.playing = False
        self._rate = min((span_s[1] - span_s[0]) / SLOWEST_S, 1.0)
        self._before_s = 0.0

    def play(self, playing: bool) -> None:
        """Start or pause the playback; if the last time is shown, start from the first time."""
        self.playing = playing
        self._before_s = perf_counter()
        if playing and self.time_s >= self.span_s[1]:
            self.time_s = self.span_s[0]

    def advance(self) -> bool:
        """Advance the shown time by the elapsed time; return False while the playback is paused."""
        if not self.playing:
            return False
        now_s = perf_counter()
        passed_s = self._rate * (now_s - self._before_s)
        self._before_s = now_s
        self.time_s = min(self.time_s + passed_s, self.span_s[1])
        self.playing = self.time_s < self.span_s[1]
        return True


class PlaybackWidgets:
    """Slider, button and key for the shown time in a window.

    Parameters
    ----------
    plotter
        The window.
    playback
        Playback, which contains the shown time.
    show
        Function that is called with the time [s].
    slider
        Left end, right end and vertical position of the slider, relative to the window.
    """

    def __init__(
        self,
        plotter: Plotter,
        playback: Playback,
        show: Callable[[float], None],
        *,
        slider: tuple[float, float, float],
    ) -> None:
        self._plotter = plotter
        self._playback = playback
        self._show = show
        self._mark_button: Callable[[int], None] = lambda playing: None
        self._slider = add_slider(
            plotter, self._drag, playback.span_s, playback.time_s, place=slider, fmt="%.3f s"
        )

    def start(self) -> None:
        """Bind the key, add the button and start the clock; call this before the window opens."""
        plotter = self._plotter
        button = plotter.add_checkbox_button_widget(
            lambda pressed: self.play(bool(pressed)),
            # pixels from the lower left corner: above the chart, to the left of the slider
            position=(14.0, 282.0),
            size=28,
            border_size=3,
            color_on="#0072B2",
            color_off="#BBBBBB",
        )
        self._mark_button = button.GetRepresentation().SetState
        # to the right of the button, in shares of the window
        add_text(plotter, "play", (0.035, 0.298))
        plotter.add_key_event(PLAY_KEY, lambda: self.play(not self._playback.playing))
        plotter.iren.add_observer("TimerEvent", lambda *_: self._tick())
        plotter.iren.initialize()
        plotter.iren.interactor.CreateRepeatingTimer(EVERY_MS)

    def play(self, playing: bool) -> None:
        """Play or pause."""
        self._playback.play(playing)
        self._mark_button(int(playing))
        self.to(self._playback.time_s)

    def to(self, time_s: float) -> None:
        """Go to a time."""
        self._playback.time_s = time_s
        self._slider.GetRepresentation().SetValue(time_s)
        self._show(time_s)
        self._plotter.render()

    def _tick(self) -> None:
        if self._playback.advance():
            self._mark_button(int(self._playback.playing))
            self.to(self._playback.time_s)

    def _drag(self, time_s: float) -> None:
        self._playback.time_s = time_s
        self._show(time_s)
