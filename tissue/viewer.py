"""A run in the window of `tissue view`, or drawn off screen into files."""

from pathlib import Path

from tissue.movie import write_movie
from tissue.run_folder import SavedRun
from tissue.viewer_window import Choice, Window

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
        MP4 or GIF file.
    """
    window = Window(saved, title, choice, off_screen=screenshot is not None or movie is not None)
    if screenshot is not None:
        window.plotter.screenshot(str(screenshot))
    if movie is not None:
        write_movie(movie, window.pictures())
    if screenshot is None and movie is None:
        window.open()
    window.plotter.close()
