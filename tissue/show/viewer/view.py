"""A saved run in a window, as a screenshot or as a movie: bone or fields, the tool on its path,
and its force.
"""

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.models.tissue_model import TICK_S
from tissue.show.viewer.export import check_movie, write_clean, write_movie
from tissue.show.viewer.run_scene import Choice, times_of
from tissue.show.viewer.saved_surfaces import saved_fields
from tissue.show.viewer.site_window import is_imported, show_site
from tissue.show.viewer.window import Window
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.live.window import require_web
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.saved_fields import SavedFields, require_whole
from tissue.system.child import await_ready, child_command
from tissue.system.offscreen import (
    LONGEST_S,
    REMEDY,
    display_problem,
    draw_apart,
    drawing_environments,
)
from tissue.system.outputs import require_new_file
from tissue.system.stopping import Terminated

__all__ = ["serve_view", "show", "view"]

LONGEST_MOVIE_S = 3600.0
"""Maximum time for drawing a movie [s]."""


def view(
    path: str | Path,
    *,
    screenshot: Path | None = None,
    movie: Path | None = None,
    hide: tuple[str, ...] = (),
    field: str | None = None,
    scale: float = 1.0,
    time_s: float | None = None,
    clean: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
    opened: Callable[[str], object] | None = None,
) -> str:
    """Show a run, or draw it into a file.

    Parameters
    ----------
    path
        Folder of a finished or stopped run, written by `tissue run`, or folder of a bone, written
        by `tissue import`. The site of an imported bone is set by a click and saved into its scene.
    screenshot
        PNG file to write instead of opening a window.
    movie
        MP4 or GIF file to write instead of opening a window.
    hide
        Layers that are hidden at first.
    field
        Field that is shown at first in place of the bone, such as ``von_mises_MPa``.
    scale
        Initial factor by which the displacement is enlarged.
    time_s
        Moment that is shown at first [s]. Default: the moment of the largest force.
    clean
        If true, a screenshot shows only the simulated tissue on a transparent ground, cropped to
        it, without text, scales, tool and arrows.
    overwrite
        Replace the file of the screenshot or movie.
    progress
        Called with the finished share of a file.
    opened
        If given, the run is shown in a browser in place of a window, until the page has been closed
        for some seconds. The function is called with the address of the page.

    Returns
    -------
    Description of the view in one or two sentences.

    Raises
    ------
    InputError
        If the folder holds no run or nothing to show, the layer, field or moment does not exist,
        there is no display for a window, or the picture cannot be drawn.
    """
    _check_files(screenshot, movie, time_s, overwrite=overwrite)
    if opened is not None:
        _check_web(Path(path), screenshot, movie)
    if clean and screenshot is None:
        raise InputError(
            "clean",
            "come with a screenshot",
            "none",
            "pass --screenshot FILE.png, or leave clean out",
        )
    if is_imported(Path(path)):
        _check_imported(
            movie, Choice(hide=hide, field=field, scale=scale, time_s=time_s, clean=clean)
        )
        return _view_site(Path(path), screenshot)
    saved = SavedRun(path)
    about = _about(saved)
    require_whole(saved)
    choice = Choice(hide=hide, field=field, scale=scale, time_s=time_s, clean=clean)
    series = saved_fields(saved)
    _check(saved, choice, series)
    if movie is not None and len(times_of(saved, series)) < 2:
        raise InputError("movie", "be of a run that lasts", saved.path, "use --screenshot")
    if opened is not None:
        serve_view(saved.path, choice, opened)
    elif screenshot is None and movie is None:
        _require_display("--screenshot FILE, --movie FILE or --web")
        show(saved, about, choice)
    for kind, file in (("screenshot", screenshot), ("movie", movie)):
        if file is not None:
            _draw(saved, choice, kind, file, progress or silent)
            about += f"\n{kind} in {file}"
    return about


def _require_display(instead: str) -> None:
    problem = display_problem()
    if problem is not None:
        raise InputError(
            f"view must have a display to open a window, but {problem}: pass {instead}"
        )


def _check_web(path: Path, screenshot: Path | None, movie: Path | None) -> None:
    """Refuse a page together with a file, and a page that cannot be served."""
    for name, file in (("screenshot", screenshot), ("movie", movie)):
        if file is not None:
            raise InputError(
                "web", f"be left out with a {name}, which is a file", file, "leave one of them out"
            )
    if is_imported(path):
        raise InputError(
            "web must be left out for an imported bone, which has no run: leave it out"
        )
    require_web()


def _check_imported(movie: Path | None, choice: Choice) -> None:
    """Refuse options that only apply to a run."""
    given = [name for name, value in asdict(choice).items() if value != getattr(Choice(), name)]
    given += ["movie"] if movie is not None else []
    if given:
        raise InputError(
            f"{given[0]} must be left out for an imported bone, which has no run: leave it out"
        )


def _view_site(folder: Path, screenshot: Path | None) -> str:
    """Show an imported bone, or draw it into a file."""
    if screenshot is None:
        _require_display("--screenshot FILE")
        return show_site(folder)
    with whole_file(screenshot) as temporary, TemporaryDirectory(prefix="tissue-") as apart:
        drawn = Path(apart) / "site.png"
        problem = draw_apart("tissue.show.viewer.site_window", str(folder), str(drawn))
        if problem is not None:
            raise InputError(f"screenshot must be drawn in 3D, but {problem}")
        shutil.copyfile(drawn, temporary)
    return f"imported bone in {folder}\nscreenshot in {screenshot}"


def _draw(saved: SavedRun, choice: Choice, kind: str, file: Path, report: Progress) -> None:
    """Draw a file in a separate process. The file is complete, or unchanged on failure."""
    longest_s = LONGEST_MOVIE_S if kind == "movie" else LONGEST_S
    chosen = json.dumps(asdict(choice))
    doing = f"drawing the {kind}"
    report(doing, 0.0)
    with (
        whole_file(file) as temporary,
        TemporaryDirectory(prefix="tissue-", ignore_cleanup_errors=True) as folder,
    ):
        temporary.touch()
        temporary.unlink()  # a folder that takes no file is refused before anything is drawn
        drawn = Path(folder) / file.name
        problem = draw_apart(
            "tissue.show.viewer.view",
            str(saved.path),
            kind,
            str(drawn),
            chosen,
            longest_s=longest_s,
            drawn=lambda share: report(doing, share),
        )
        if problem is not None:
            raise InputError(f"{kind} must be drawn in 3D, but {problem}")
        shutil.copyfile(drawn, temporary)


def _check_files(
    screenshot: Path | None, movie: Path | None, time_s: float | None, *, overwrite: bool
) -> None:
    """Check that the output files are writable before reading the run."""
    if movie is not None:
        check_movie(movie)
        if time_s is not None:
            raise InputError(
                "time_s",
                "be left out with movie, which shows all of them",
                f"{time_s:g}",
                "leave it out",
            )
    if screenshot is not None and screenshot.suffix.lower() != ".png":
        raise InputError(
            "screenshot", "be a .png file", screenshot, f"use {screenshot.with_suffix('.png')}"
        )
    for kind, file in (("screenshot", screenshot), ("movie", movie)):
        if file is not None:
            require_new_file(file, overwrite=overwrite, name=kind)
    if overwrite and screenshot is None and movie is None:
        raise InputError(
            "overwrite", "come with a screenshot or a movie", "neither", "leave it out"
        )


def _check(saved: SavedRun, choice: Choice, series: SavedFields | None) -> None:
    """Refuse a choice that the run does not offer."""
    times = times_of(saved, series)
    fields = [] if series is None else series.names
    if saved.complete and not len(times) and not (saved.path / "bone.vti").is_file():
        raise InputError(
            "run",
            "hold a trace, bone or frames to be shown",
            f"none of them in {saved.path}",
            "run the scene again",
        )
    layers = dict.fromkeys(
        [*saved.summary.get("layers", []), *(() if series is None else series.layer_names)]
    )
    for name in choice.hide:
        if name not in layers:
            raise InputError(
                "hide", "name a layer of the run", name, f"use one of {', '.join(layers)}"
            )
    if choice.field is not None and choice.field not in fields:
        known = f"use one of {', '.join(fields)}" if fields else "this run has none, leave it out"
        raise InputError("field", "name a field of the run", choice.field, known)
    if not (math.isfinite(choice.scale) and choice.scale >= 0.0):
        raise InputError(
            "scale", "be a number of at least 0", f"{choice.scale:g}", "use 1 for true size"
        )
    if choice.scale != 1.0 and (series is None or series.displacement is None):
        raise InputError(
            "scale",
            "be left out for a run without displacement",
            f"{choice.scale:g}",
            "leave it out",
        )
    if choice.time_s is not None:
        if not len(times):
            raise InputError(
                "time_s",
                "lie in the run",
                f"{choice.time_s:g} for a run without ticks",
                "leave it out",
            )
        first = float(times[0])
        last = float(times[-1])
        if not first - 1e-9 <= choice.time_s <= last + 1e-9:
            nearest = last if choice.time_s > last else first
            raise InputError(
                "time_s",
                f"lie in the run, {first:g} to {last:g} s",
                f"{choice.time_s:g}",
                f"use {nearest:g}",
            )


def _about(saved: SavedRun) -> str:
    """Return a sentence about the run: its largest loads, or where it was stopped."""
    if saved.complete:
        force = saved.summary["force_N"]["peak"]
        torque = saved.summary["torque_Nm"]["peak"]
        seconds = saved.summary["simulated_s"]
        return (
            f"{saved.summary['scene']}: {seconds:g} s, force up to {force:.3g} N, torque up to "
            f"{torque:.3g} N·m"
        )
    begun = {"running": "goes on", "failed": "failed"}.get(saved.status, "was interrupted")
    if saved.trace is None or not len(saved.trace.rows):
        where = "before its first tick was written"
    else:
        last = float(saved.trace["time_s"][-1])
        planned = None
        if saved.scene is not None:
            with suppress(InputError):
                planned = saved.scene.duration_s or motion_of(saved.scene, step_s=TICK_S).duration_s
        where = f"at {last:.3f} s" + (f" of {planned:g} s" if planned else "")
        if planned and last > planned - 1.5 * TICK_S:
            where = "after its last tick, while its files were written"
    if saved.status == "running":
        where += f", process {saved.summary['process']['id']} writes it"
    return f"run is incomplete: it {begun} {where}" + (
        f" ({saved.problem})" if saved.problem else ""
    )


def show(
    saved: SavedRun,
    title: str,
    choice: Choice,
    *,
    screenshot: Path | None = None,
    movie: Path | None = None,
) -> None:
    """Open the window, or draw it off screen into files.

    Parameters
    ----------
    saved
        Saved run.
    title
        Title above the view.
    choice
        First view of the run.
    screenshot
        PNG file.
    movie
        MP4 or GIF file. The finished share is printed.
    """
    window = Window(saved, title, choice, off_screen=screenshot is not None or movie is not None)
    if screenshot is not None:
        if choice.clean:
            write_clean(window.plotter, screenshot)
        else:
            window.plotter.screenshot(str(screenshot))
    if movie is not None:
        write_movie(movie, window.pictures())
    if screenshot is None and movie is None:
        window.open()
    window.plotter.close()


PAGE = "tissue.show.viewer.web.view_page"
OPENS_S, CLOSES_S = 120.0, 10.0
"""Maximum time until a page is served, and until it is closed [s]."""


def serve_view(folder: Path, choice: Choice, opened: Callable[[str], object]) -> None:
    """Serve the page of a run until it has been closed for some seconds, or Ctrl-C.

    Parameters
    ----------
    folder
        Folder of the run.
    choice
        First view of the run.
    opened
        Called with the address, which holds a random token.

    Raises
    ------
    InputError
        If nothing can be drawn or served here.
    """
    why = "this machine has no OpenGL library"
    for environment in drawing_environments():
        with TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
            child = _start(folder, choice, environment, output)
            try:
                address, problem = await_ready(child, longest_s=OPENS_S, closes_s=CLOSES_S)
                if problem is None:
                    opened(address)
                    child.wait()
                    return
                why = (
                    problem
                    or _last_line(output)
                    or f"its process ended with exit code {child.returncode}"
                )
            except Terminated:
                raise
            except KeyboardInterrupt:
                return
            finally:
                child.kill()
                child.communicate()
    raise InputError(f"--web must serve a page, but {why[:200]}: {REMEDY}")


def _start(
    folder: Path, choice: Choice, environment: dict[str, str], output: IO[str]
) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        child_command(PAGE, str(folder), json.dumps(asdict(choice))),
        env=os.environ | environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=output,
        text=True,
    )


def _last_line(output: IO[str]) -> str:
    output.seek(0)
    return (output.read().strip().splitlines() or [""])[-1]


if __name__ == "__main__":
    finished = SavedRun(sys.argv[1])
    wanted, into, chosen = sys.argv[2:]
    shown = json.loads(chosen)
    show(
        finished,
        _about(finished),
        Choice(**shown | {"hide": tuple(shown["hide"])}),
        **{wanted: Path(into)},
    )
