"""Window of `tissue view`, also used off screen for stills and movies."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Array, Bytes
from meshes.base.errors import InputError
from tissue.show.figures.rendering import round_length
from tissue.show.viewer.fields import FieldsShown
from tissue.show.viewer.playback import Playback
from tissue.show.viewer.plotter import (
    Plotter,
    add_names,
    add_slider,
    add_text,
    aim,
    free_keys,
    new_plotter,
)
from tissue.show.viewer.run_scene import CHART_SHARE, Choice, RunScene
from tissue.show.viewer.saved_surfaces import cut_plane
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.saved_fields import SavedFields

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

PLACE_PX = (40, 380)
"""Position of the left end of a scale bar, from the lower left [pixels]."""
LONGEST = 0.15
"""Largest length of a scale bar, relative to the width of the window."""
BORDER = 0.02
"""Border of a picture without text and controls before it is cropped, relative to its size."""
FINE = 2
AROUND_PX = 8
"""Margin around the content of a picture without text and controls [pixels].

Before cropping, such a picture has `FINE` times the width and height of the window in pixels.
"""


def add_scale_bar(plotter: Plotter) -> None:
    """Draw a scale bar with a round length in a window with parallel projection."""
    import pyvista
    from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D

    camera = plotter.camera
    wide, tall = plotter.window_size
    per_mm = tall / (2.0 * camera.parallel_scale)
    length = round_length(LONGEST * wide / per_mm)
    x, y = PLACE_PX
    mapper = vtkPolyDataMapper2D()
    mapper.SetInputData(pyvista.Line((x, y, 0.0), (x + length * per_mm, y, 0.0)))
    mapper.ScalarVisibilityOff()
    bar = vtkActor2D()
    bar.SetMapper(mapper)
    # the number is written 8 pixels above the bar
    bar.GetProperty().SetColor(0.1, 0.1, 0.1)
    bar.GetProperty().SetLineWidth(5.0)
    plotter.add_actor(bar, reset_camera=False, render=False)
    plotter.add_text(f"{length:g} mm", position=(x, y + 8), font_size=11, color="black")


def write_clean(plotter: Plotter, file: Path) -> None:
    """Write the view as PNG with a transparent background, cropped to its content."""
    from PIL import Image

    drawn = np.asarray(
        plotter.screenshot(None, return_img=True, transparent_background=True, scale=FINE)
    )
    there = np.argwhere(drawn[..., 3] > 0)
    # an empty view has no content to crop to
    if len(there):
        (top, left) = np.maximum(there.min(axis=0) - AROUND_PX, 0)
        (low, right) = there.max(axis=0) + AROUND_PX + 1
        drawn = drawn[top:low, left:right]
    # the resolution that journals ask for
    Image.fromarray(drawn).save(file, dpi=(300, 300))


FRAMES_PER_S = 20
"""Frame rate of movies [1/s].

MP4 and GIF support this rate. A GIF counts time in 1/100 s, so a frame must last a whole number of
these units.
"""
SHORTEST_S = 4.0
LONGEST_S = 12.0
"""Longest duration of a movie [s]; `SHORTEST_S` is the shortest duration.

A shorter or longer run is played slower or faster.
"""
KINDS = (".mp4", ".gif")


def check_movie(path: Path) -> None:
    """Raise an error if no movie can be written to the file.

    Raises
    ------
    InputError
        If the suffix is not .mp4 or .gif, or this machine cannot write .mp4.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise InputError("movie", "be a .mp4 or .gif file", path, f"use {path.with_suffix('.gif')}")
    if kind == ".mp4":
        try:
            import imageio.v2  # noqa: F401
            import imageio_ffmpeg

            imageio_ffmpeg.get_ffmpeg_exe()
        except (ImportError, RuntimeError):
            raise InputError(
                "movie",
                "be a .gif file, because imageio-ffmpeg has no working ffmpeg on this machine",
                path,
                f"use {path.with_suffix('.gif')}, or run pip install imageio imageio-ffmpeg",
            ) from None


def movie_times_s(first_s: float, last_s: float) -> Array:
    """Return the times [s] in the run at which the frames of a movie are drawn.

    The movie lasts as long as the run, but at least 4 and at most 12 s.
    """
    lasts = float(np.clip(last_s - first_s, SHORTEST_S, LONGEST_S))
    return np.linspace(first_s, last_s, round(lasts * FRAMES_PER_S) + 1)


def write_movie(path: Path, pictures: Iterable[Bytes]) -> None:
    """Write a movie; an existing file is replaced.

    Parameters
    ----------
    path
        File with the suffix .mp4 or .gif. A GIF has half the width and height of the pictures.
    pictures
        Red, green and blue of each picture, shape (height, width, 3). Height and width are even.
    """
    (_write_mp4 if path.suffix.lower() == ".mp4" else _write_gif)(path, pictures)


def _write_gif(path: Path, pictures: Iterable[Bytes]) -> None:
    from PIL import Image

    def small(picture: Bytes) -> "Picture":
        # a quarter of the pixels keeps a GIF small; it has 256 colours, and dithering would
        # flicker from picture to picture
        return Image.fromarray(picture).reduce(2).quantize(256, dither=Image.Dither.NONE)

    each = iter(pictures)
    small(next(each)).save(
        path,
        format="GIF",
        save_all=True,
        append_images=(small(picture) for picture in each),
        # milliseconds
        duration=1000 // FRAMES_PER_S,
        loop=0,
    )


def _write_mp4(path: Path, pictures: Iterable[Bytes]) -> None:
    import imageio.v2
    from imageio.core.format import Format

    # quality 8 of 10: 30 frames of a shaded sphere are as close to the drawn ones as with 10 (RMS
    # 1.8 of 255). Blocks of 2 keep the size of the pictures, which is even
    with imageio.v2.get_writer(path, fps=FRAMES_PER_S, quality=8, macro_block_size=2) as writer:
        assert isinstance(writer, Format.Writer)
        for picture in pictures:
            writer.append_data(picture)


SIZE = (1400, 950)
SLIDERS = CHART_SHARE + 0.04
"""Vertical position of the sliders, relative to the height of the window."""
LARGEST = 0.3
"""Largest drawn displacement that the slider allows, relative to the size of the mesh."""
PUSH = 0.02
"""Distance by which a key moves the plane that cuts the mesh, relative to the size of the mesh."""
EVERY_MS = 40
"""Time between two updates during playback [ms]: 25 updates per second."""
MOST_KEYS = 9
"""Largest number of layers that have a key. The keys are the digits from 1 on."""


class Window:
    """Window that shows a run, with all controls.

    Parameters
    ----------
    saved
        Saved run.
    title
        Title above the view.
    choice
        First view of the run.
    off_screen
        If true, the view is drawn off screen for a file, and without keyboard control, marks and
        help text.

    Attributes
    ----------
    plotter
        PyVista's plotter.
    fields, bone
        Parts of the window; None for a part that the run or a still picture does not have.
    playback
        Shown time.
    hidden
        Hidden layers.
    """

    def __init__(self, saved: SavedRun, title: str, choice: Choice, *, off_screen: bool) -> None:
        self._off_screen = off_screen
        title_bar = f"tissue: {saved.summary.get('scene', 'run')}"
        self.plotter = new_plotter(SIZE, title=title_bar, off_screen=off_screen)
        shown = self._shown = RunScene(
            saved, choice, self.plotter, fine=off_screen, annotated=not choice.clean
        )
        self.bone = shown.bone
        self.fields = shown.fields
        self.playback = Playback(shown.span_s, shown.start_s)
        self.hidden: frozenset[str] = frozenset()
        self._slider: Any = None
        if not choice.clean:
            add_names(self.plotter, shown.face_colours)
        if choice.hide:
            self.toggle(*choice.hide)
        if len(shown.times_s):
            shown.at(shown.start_s)
        if len(shown.times_s) > 1 and not choice.clean:
            right = 0.97 if shown.series is None or off_screen else 0.66
            self._slider = add_slider(
                self.plotter,
                self._drag,
                shown.span_s,
                shown.start_s,
                place=(0.03, right, SLIDERS),
                fmt="%.3f s",
            )
        fields = [] if shown.series is None else shown.series.names
        # bone is shown before fields
        self._names = [*([None] if self.bone is not None else []), *fields]
        self.choose(choice.field or next(iter(self._names), None))
        self._plane = cut_plane(saved, shown.series) if shown.series is not None else None
        if choice.clean:
            kept = list(shown.tissue_actors())
            for actor in [each for each in self.plotter.actors.values() if each not in kept]:
                self.plotter.remove_actor(actor, reset_camera=False, render=False)
            area = (BORDER, 1.0 - BORDER, BORDER, 1.0 - BORDER)
            aim(self.plotter, shown.tissue_mm, margins=area, parallel=True)
            return
        lines = [(title, 11)]
        if not off_screen:
            lines += [("", 11), *((words, 9) for words in self._add_keys())]
        for row, (words, size) in enumerate(lines):
            # the second line has the readings of the moment, which `run_scene` writes
            add_text(self.plotter, words, (0.012, 0.965 - 0.033 * row), size=size)
        aim(self.plotter, shown.extent_mm(), parallel=off_screen)
        if off_screen:
            add_scale_bar(self.plotter)

    def choose(self, name: str | None) -> None:
        """Show a field, or the bone."""
        self._name = name
        self._shown.show(name)
        self.plotter.render()

    def choose_next(self) -> None:
        """Show the next field, or the bone after the last field."""
        place = self._names.index(self._name) + 1
        self.choose(self._names[place % len(self._names)])

    def toggle(self, *names: str) -> None:
        """Toggle the given layers: hide the shown ones, and show the hidden ones."""
        self.hidden ^= frozenset(names)
        self._shown.hide(self.hidden)
        self.plotter.render()

    def switch_plane(self) -> None:
        """Toggle between the mesh cut open at the cutting plane, and the whole mesh."""
        if self.fields is not None:
            self.fields.cut(self._plane if self.fields.clip is None else None)
            self.plotter.render()

    def push_plane(self, share: float) -> None:
        """Move the cutting plane along its normal by a share of the mesh's size."""
        if self._plane is None or self.fields is None or self._shown.series is None:
            return
        normal, origin = np.array(self._plane)
        x, y, z = (origin + share * self._shown.series.size_mm * normal).tolist()
        self._plane = self._plane[0], (x, y, z)
        if self.fields.clip is not None:
            self.fields.cut(self._plane)
            self.plotter.render()

    def play(self, playing: bool) -> None:
        """Play or pause."""
        self.playback.play(playing)
        self.to(self.playback.time_s)

    def to(self, time_s: float) -> None:
        """Show the run at a time."""
        if self._slider is not None:
            self._slider.GetRepresentation().SetValue(time_s)
        self._drag(time_s)
        self.plotter.render()

    def pictures(self) -> Iterator[Bytes]:
        """Yield the pictures of a movie over the whole run.

        After each picture, the finished share (0 to 1) is printed on a line.
        """
        times_s = movie_times_s(*self.playback.span_s)
        for index, time_s in enumerate(times_s.tolist(), 1):
            self.to(time_s)
            yield self.plotter.screenshot(None, return_img=True)[..., :3]
            print(index / len(times_s), flush=True)

    def open(self) -> None:
        """Open the window; return after it was closed."""
        free_keys(self.plotter)
        if self._slider is not None:
            interactor = self.plotter.iren
            interactor.add_observer("TimerEvent", lambda *_: self._tick())
            interactor.initialize()
            interactor.interactor.CreateRepeatingTimer(EVERY_MS)
        self.plotter.show()

    def _tick(self) -> None:
        if self.playback.advance():
            self.to(self.playback.time_s)

    def _drag(self, time_s: float) -> None:
        self.playback.time_s = time_s
        self._shown.at(time_s)

    def _add_keys(self) -> tuple[str, str]:
        """Add the keys, and a slider for the displacement factor; return two lines of help."""
        plotter = self.plotter
        shown = self._shown
        first = [self.bone.help] if self.bone is not None else []
        # a single layer is never switched off
        names = list(shown.colours)[:MOST_KEYS] if len(shown.colours) > 1 else []
        for number, name in enumerate(names, 1):
            plotter.add_key_event(str(number), lambda name=name: self.toggle(name))
            first.append(f"{number}: {name} on or off")
        second = ["q: close"]
        if self._slider is not None:
            plotter.add_key_event("space", lambda: self.play(not self.playback.playing))
            second.insert(0, "space: play or pause")
        if len(self._names) > 1:
            plotter.add_key_event("m", self.choose_next)
            first.append("m: next field")
        if self.fields is not None and shown.series is not None:
            plotter.add_key_event("x", self.switch_plane)
            plotter.add_key_event("comma", lambda: self.push_plane(-PUSH))
            plotter.add_key_event("period", lambda: self.push_plane(PUSH))
            second[:0] = ["x: cut open", ", and .: move the cut"]
            self._add_scale(self.fields, shown.series)
        return "    ".join(filter(None, first)), "    ".join(second)

    def _add_scale(self, fields: FieldsShown, series: SavedFields) -> None:
        """Add a slider for the factor of the drawn displacement."""
        largest_mm = series.largest_mm()
        if largest_mm > 0.0:
            # the largest displacement becomes a fraction of the mesh, and true size and twice that
            # are always in range
            top = max(LARGEST * series.size_mm / largest_mm, fields.scale, 2.0)
            # to the right of the slider of the time
            add_slider(
                self.plotter,
                fields.enlarge,
                (0.0, top),
                fields.scale,
                place=(0.72, 0.97, SLIDERS),
                fmt="displacement × %.3g",
            )
