"""The window of `tissue view`, and the same view off screen for stills and movies."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tissue.show.figures.figure import field_words
from tissue.show.viewer.controls import HELP as CLIP_HELP
from tissue.show.viewer.controls import ClipPlane, LayerKeys, NameList, Playback, PointRead
from tissue.show.viewer.export import add_scale_bar, leave_alone, movie_times_s
from tissue.show.viewer.moment import CHART_SHARE
from tissue.show.viewer.plotter import (
    add_names,
    add_slider,
    add_text,
    aim,
    free_keys,
    new_plotter,
    on_click,
)
from tissue.show.viewer.run_scene import Choice, RunScene
from tissue.show.viewer.saved_surfaces import cut_plane
from tissue.simulation.run_folder import SavedRun

__all__ = ["Window"]

SIZE = (1400, 950)
SLIDERS = CHART_SHARE + 0.04
"""Height of the sliders in the window."""
LARGEST = 0.3
"""Share of the mesh's size that the largest displacement can be drawn as."""


class Window:
    """Window with all parts of a run.

    Parameters
    ----------
    saved
        Saved run.
    title
        Title above the view.
    choice
        First view of the run.
    off_screen
        If true, the view is drawn for a file, without buttons, lists and help.

    Attributes
    ----------
    plotter
        PyVista's plotter.
    fields, point, names, playback, bone, layers
        Parts of the window. None if the run, or a picture, does not have the part.
    """

    def __init__(self, saved: SavedRun, title: str, choice: Choice, *, off_screen: bool) -> None:
        self._saved = saved
        self._off_screen = off_screen
        title_bar = f"tissue: {saved.summary.get('scene', 'run')}"
        self.plotter = new_plotter(SIZE, title=title_bar, off_screen=off_screen)
        shown = self._shown = RunScene(saved, choice, self.plotter, fine=off_screen)
        self.bone = shown.bone
        self.fields = shown.fields
        self.names: NameList | None = None
        self.point: PointRead | None = None
        self.playback: Playback | None = None
        add_names(self.plotter, shown.face_colours)
        self.layers = LayerKeys(
            self.plotter, list(shown.colours), hidden=choice.hide, hide=shown.hide
        )
        if len(shown.times_s):
            self._add_time()
        first = shown.series.names[0] if shown.series is not None and self.bone is None else None
        self.choose(choice.field or first)
        if not off_screen:
            self._add_controls()
        self._write(title)
        if choice.clean:
            leave_alone(self.plotter, list(shown.tissue_actors()), shown.tissue_mm)
            return
        aim(self.plotter, shown.extent_mm(), parallel=off_screen)
        if off_screen:
            add_scale_bar(self.plotter)

    def choose(self, name: str | None) -> None:
        """Show a field, or the bone."""
        self._shown.show(name)
        if self.names is not None:
            self.names.mark(name)
        self.plotter.render()

    def next(self) -> None:
        """Show the next field, after the last one the bone."""
        if self.fields is None or self._shown.series is None:
            return
        choices = [*self._shown.series.names, *([None] if self.bone is not None else [])]
        at = choices.index(self.fields.name) if self.fields.name in choices else -1
        self.choose(choices[(at + 1) % len(choices)])

    def pictures(self) -> Iterator[NDArray[np.uint8]]:
        """Yield the pictures of a movie over the whole run.

        The finished share, 0 to 1, is printed once per picture, one line each.
        """
        assert self.playback is not None
        times_s = movie_times_s(*self.playback.span_s)
        for index, time_s in enumerate(times_s.tolist(), 1):
            self.playback.to(time_s)
            yield self.plotter.screenshot(None, return_img=True)[..., :3]
            print(index / len(times_s), flush=True)

    def open(self) -> None:
        """Open the window, and return when it was closed."""
        free_keys(self.plotter)
        if self.playback is not None:
            self.playback.start()
        self.plotter.show()

    def _add_time(self) -> None:
        """Show the first moment, and add the slider of a run that lasts."""
        shown = self._shown
        shown.at(shown.start_s)
        if len(shown.times_s) > 1:
            left = 0.03 if self._off_screen else 0.1
            right = 0.97 if shown.series is None or self._off_screen else 0.66
            slider = (left, right, SLIDERS)
            self.playback = Playback(
                self.plotter, shown.at, span_s=shown.span_s, begin_s=shown.start_s, slider=slider
            )

    def _add_controls(self) -> None:
        """Add the controls of a window: list of fields, point values, clip plane, scale of the
        displacement.
        """
        fields = self.fields
        series = self._shown.series
        plotter = self.plotter
        if fields is None or series is None:
            return
        plotter.add_key_event("m", self.next)
        labels = [(name, field_words(name)) for name in series.names]
        bone = [(None, "bone")] if self.bone is not None else []
        names = self.names = NameList(
            plotter, "shown (click, or m)", [*bone, *labels], choose=self.choose
        )
        names.mark(fields.name)
        point = self.point = PointRead(plotter, fields, size_mm=0.02 * self._shown.size_mm)
        ClipPlane(plotter, fields, start=cut_plane(self._saved, series))
        if series.displacement is not None and series.greatest_mm() > 0.0:
            top = max(_round_up(LARGEST * series.size_mm / series.greatest_mm()), fields.scale, 2.0)
            place = (0.72, 0.97, SLIDERS)
            add_slider(
                plotter,
                fields.enlarge,
                (0.0, top),
                fields.scale,
                place=place,
                fmt="displacement × %.3g",
            )
        on_click(plotter, lambda x, y: names.click(x, y) or point.click(x, y))

    def _write(self, title: str) -> None:
        lines = [(title, 11, 0.965)]
        if not self._off_screen:
            first = [self.bone.help if self.bone is not None else "", self.layers.help]
            second = [CLIP_HELP, "click: read a point"] if self.fields is not None else []
            second += ["space: play or pause"] if self.playback is not None else []
            for keys, height in ((first, 0.898), ([*second, "q: close"], 0.87)):
                lines.append(("    ".join(key for key in keys if key), 9, height))
        for words, size, height in lines:
            add_text(self.plotter, words, (0.012, height), size=size)


def _round_up(value: float) -> float:
    """Return the next of 1, 2, 5, 10, 20 and so on."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(
        next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1.0 - 1e-9))
    )
