"""Stills and movies of a run."""

import subprocess
from collections.abc import Collection, Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file
from tissue.show.figures.rendering import round_length
from tissue.show.viewer.plotter import Plotter, aim

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

__all__ = [
    "FRAMES_PER_S",
    "add_scale_bar",
    "check_movie",
    "leave_alone",
    "movie_times_s",
    "write_clean",
    "write_movie",
]

PLACE_PX = (40, 380)
"""Lower left end of a scale bar [pixel]."""
LONGEST = 0.15
"""Longest scale bar, as a share of the window's width."""
BORDER = 0.02
"""Free border of a clean picture before it is cropped, as a share of its edges."""
FINE, AROUND_PX = 2, 8
"""Pixels of a clean picture per window pixel, and margin around the content [pixel]."""


def add_scale_bar(plotter: Plotter) -> None:
    """Draw a bar of a round length in a window with a parallel projection."""
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
    bar.GetProperty().SetColor(0.1, 0.1, 0.1)
    bar.GetProperty().SetLineWidth(5.0)
    plotter.add_actor(bar, reset_camera=False, render=False)
    plotter.add_text(f"{length:g} mm", position=(x, y + 8), font_size=11, color="black")


def leave_alone(plotter: Plotter, kept: Collection[object], points_mm: NDArray[np.float64]) -> None:
    """Remove text, widgets, scales and most actors, and let the points fill the window.

    The actors in `kept` stay.
    """
    plotter.clear_slider_widgets()
    plotter.remove_legend(render=False)
    plotter.remove_chart(*plotter.renderer._charts)
    for actor in list(plotter.actors.values()):
        if actor not in kept:
            plotter.remove_actor(actor, reset_camera=False, render=False)
    aim(plotter, points_mm, margins=(BORDER, 1.0 - BORDER, BORDER, 1.0 - BORDER), parallel=True)


def write_clean(plotter: Plotter, file: Path) -> None:
    """Write the view as PNG on a transparent ground, cropped to its content."""
    from PIL import Image

    drawn = np.asarray(
        plotter.screenshot(None, return_img=True, transparent_background=True, scale=FINE)
    )
    there = np.argwhere(drawn[..., 3] > 0)
    if len(there):
        (top, left) = np.maximum(there.min(axis=0) - AROUND_PX, 0)
        (low, right) = there.max(axis=0) + AROUND_PX + 1
        drawn = drawn[top:low, left:right]
    Image.fromarray(drawn).save(file, dpi=(300, 300))


FRAMES_PER_S = 20
"""Both kinds can hold it: a GIF counts in hundredths of a second."""
SHORTEST_S, LONGEST_S = 4.0, 12.0
"""A movie that would be shorter or longer plays slower or faster than it really was [s]."""
KINDS = (".mp4", ".gif")


def check_movie(path: Path) -> None:
    """Refuse a file that no movie can be written to.

    Raises
    ------
    InputError
        If its ending is not .mp4 or .gif, or .mp4 cannot be written here.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise InputError("movie", "be a .mp4 or .gif file", path, f"use {path.with_suffix('.gif')}")
    problem = _encoder_problem() if kind == ".mp4" else None
    if problem is not None:
        raise InputError(
            "movie",
            f"be a .gif where {problem}",
            path,
            f"use {path.with_suffix('.gif')} or pip install imageio imageio-ffmpeg",
        )


def _encoder_problem() -> str | None:
    """Return why no MP4 can be encoded here, or None."""
    if find_spec("imageio") is None or find_spec("imageio_ffmpeg") is None:
        return "imageio and imageio-ffmpeg are not installed"
    import imageio_ffmpeg

    try:
        encoder = imageio_ffmpeg.get_ffmpeg_exe()
        subprocess.run(
            [encoder, "-version"],
            check=True,
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=60.0,
        )
    except (RuntimeError, OSError, subprocess.SubprocessError):
        return "imageio-ffmpeg has no ffmpeg that runs"
    return None


def movie_times_s(first_s: float, last_s: float) -> NDArray[np.float64]:
    """Return the times of a movie's frames [s].

    The movie lasts as long as the run, but at least 4 and at most 12 s.
    """
    lasts = float(np.clip(last_s - first_s, SHORTEST_S, LONGEST_S))
    return np.linspace(first_s, last_s, round(lasts * FRAMES_PER_S) + 1)


def write_movie(path: Path, pictures: Iterable[NDArray[np.uint8]]) -> None:
    """Write a movie and replace an existing file once the new file is complete.

    Parameters
    ----------
    path
        File with the ending .mp4, or .gif with half the width and height.
    pictures
        Red, green and blue of every picture, shape (height, width, 3). Height and width are even.
    """
    with whole_file(path) as temporary:
        (_write_mp4 if path.suffix.lower() == ".mp4" else _write_gif)(temporary, pictures)


def _write_gif(path: Path, pictures: Iterable[NDArray[np.uint8]]) -> None:
    from PIL import Image

    def small(picture: NDArray[np.uint8]) -> "Picture":
        return Image.fromarray(picture).reduce(2).quantize(256, dither=Image.Dither.NONE)

    each = iter(pictures)
    small(next(each)).save(
        path,
        format="GIF",
        save_all=True,
        append_images=(small(picture) for picture in each),
        duration=1000 // FRAMES_PER_S,
        loop=0,
    )


def _write_mp4(path: Path, pictures: Iterable[NDArray[np.uint8]]) -> None:
    import imageio.v2
    from imageio.core.format import Format

    with imageio.v2.get_writer(path, fps=FRAMES_PER_S, quality=8, macro_block_size=2) as writer:
        assert isinstance(writer, Format.Writer)
        for picture in pictures:
            writer.append_data(picture)
