"""``tissue view``."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tissue.cli.terminal import console, progress

__all__ = ["view"]


def view(
    folder: Path,
    /,
    *,
    screenshot: Path | None = None,
    movie: Path | None = None,
    hide: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    field: str | None = None,
    scale: float = 1.0,
    time_s: float | None = None,
    clean: Annotated[bool, Parameter(negative="")] = False,
    web: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Show a run in a window, or an imported bone, on which a click sets the site.

    Parameters
    ----------
    folder
        Folder that `tissue run` or `tissue import` wrote.
    screenshot
        Write a picture to this .png file instead of opening a window.
    movie
        Write a movie to this .mp4 or .gif file instead of opening a window.
    hide
        Layer or part that is hidden at first; may be repeated.
    field
        Field that is shown at first, for example von_mises_MPa.
    scale
        Factor of the drawn displacement at first.
    time_s
        Moment that is shown at first, in seconds; default the moment of the largest force.
    clean
        With --screenshot: draw only the tissue on a transparent background, without text, scales,
        tool and arrows.
    web
        Use a browser on this machine in place of a window; the address is printed.
    overwrite
        Replace the file of the screenshot or movie.
    """
    from meshes.base.progress import silent
    from tissue.show.viewer.run_scene import Choice
    from tissue.show.viewer.view import view as show

    opened = (lambda address: console.print(f"open {address}; Ctrl-C ends it")) if web else None
    with nullcontext() if movie is None else progress() as report:
        shown = show(
            folder,
            Choice(hide=hide, field=field, scale=scale, time_s=time_s, clean=clean),
            screenshot=screenshot,
            movie=movie,
            overwrite=overwrite,
            progress=report or silent,
            opened=opened,
        )
    console.print(shown)
