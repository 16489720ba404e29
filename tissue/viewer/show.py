"""A run in the window of `tissue view`, or drawn off screen into files."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue.simulation.run_folder import SavedRun
from tissue.viewer.movie import write_movie
from tissue.viewer.window import Choice, Window

__all__ = ["show"]


def show(
    saved: SavedRun, title: str, choice: Choice, *, screenshot: Path | None = None, movie: Path | None = None
) -> None:
    """Open the window, or draw it off screen into files.

    Parameters
    ----------
    saved
        The run.
    title
        What is written above.
    choice
        What is shown at first.
    screenshot
        PNG file.
    movie
        MP4 or GIF file; how much of it is drawn is printed, 0 to 1, a line each.
    """
    window = Window(saved, title, choice, off_screen=screenshot is not None or movie is not None)
    if screenshot is not None:
        window.plotter.screenshot(str(screenshot))
    if movie is not None:
        write_movie(movie, _frames(window))
    if screenshot is None and movie is None:
        window.open()
    window.plotter.close()


def _frames(window: Window) -> Iterator[NDArray[np.uint8]]:
    count = window.picture_count
    for index, picture in enumerate(window.pictures()):
        yield picture
        print((index + 1) / count, flush=True)
