"""View of a saved run in a window, as a screenshot or as a movie."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO

from meshes.base.errors import PRESENT, InputError, enumerated, require_range
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import require_new_file, whole_file
from tissue.show.viewer.run_scene import Choice, times_of
from tissue.show.viewer.saved_surfaces import is_bone_from_file, saved_fields
from tissue.show.viewer.site_window import is_imported, show_site
from tissue.show.viewer.window import Window, check_movie, write_clean, write_movie
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
from tissue.system.stopping import Terminated

LONGEST_MOVIE_S = 3600.0
"""Longest time for drawing a movie [s]."""
BEGUN = {"running": "is running", "failed": "failed"}
"""Words for the status of an incomplete run."""
LARGEST_SCALE = 1e9
"""Largest factor of a displacement: nanometres are drawn as metres."""


def view(
    path: str | Path,
    choice: Choice | None = None,
    *,
    screenshot: Path | None = None,
    movie: Path | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
    opened: Callable[[str], object] | None = None,
) -> str:
    """Show a run, or draw it to a file.

    Parameters
    ----------
    path
        Folder of a finished or stopped run, written by `tissue run`, or folder of a bone, written
        by `tissue import`. On an imported bone, a click sets the site where the tool works. This
        site can be saved to the scene file.
    choice
        Initial view of the run.
    screenshot
        PNG file to write instead of opening a window.
    movie
        MP4 or GIF file to write instead of opening a window.
    overwrite
        Whether to replace an existing screenshot or movie file.
    progress
        Function that is called with a description of the work and the finished share, 0 to 1.
    opened
        Function that is called with the address of a page. If `opened` is given, the run is shown
        in a browser instead of a window, until the page has been closed for some seconds.

    Returns
    -------
    Description of the view in one or two sentences.

    Raises
    ------
    InputError
        If the folder contains no run or nothing to show; if a layer, the field or the time does not
        exist; if there is no display for a window; or if the picture cannot be drawn.
    """
    folder = Path(path)
    choice = choice or Choice()
    given = {"screenshot": screenshot, "movie": movie}
    files = {kind: file for kind, file in given.items() if file is not None}
    _check_arguments(folder, choice, files, web=opened is not None, overwrite=overwrite)
    if is_imported(folder):
        return _view_site(folder, screenshot)
    saved = SavedRun(folder)
    about = _about(saved)
    require_whole(saved)
    series = saved_fields(saved)
    _check(saved, choice, series)
    if movie is not None and len(times_of(saved, series)) < 2:
        raise InputError(
            "movie", "show a run with at least two moments", saved.path, "use --screenshot instead"
        )
    if opened is not None:
        serve_view(saved.path, choice, opened)
    elif not files:
        _require_display("--screenshot FILE, --movie FILE or --web")
        show(saved, about, choice)
    for kind, file in files.items():
        _draw(saved, choice, kind, file, progress)
        about += f"\n{kind} in {file}"
    return about


def _check_arguments(
    folder: Path, choice: Choice, files: dict[str, Path], *, web: bool, overwrite: bool
) -> None:
    """Check options and output files before the run is read."""
    refused = {
        ("time_s", "with a movie, which shows all moments"): "movie" in files
        and choice.time_s is not None,
        ("web", "with a screenshot or a movie"): web and files,
        ("clean", "without a screenshot"): choice.clean and "screenshot" not in files,
        ("overwrite", "without a screenshot or a movie"): overwrite and not files,
    }
    if is_imported(folder):
        changed = [name for name, value in vars(choice).items() if value != vars(Choice())[name]]
        options = [*changed, *(["web"] if web else []), *(["movie"] if "movie" in files else [])]
        refused |= {(name, "for an imported bone"): True for name in options}
    for (name, where), is_refused in refused.items():
        if is_refused:
            raise InputError(name, f"be left out {where}", PRESENT, "leave it out")
    if web:
        require_web()
    if "movie" in files:
        check_movie(files["movie"])
    if "screenshot" in files and files["screenshot"].suffix.lower() != ".png":
        file = files["screenshot"]
        raise InputError("screenshot", "be a .png file", file, f"use {file.with_suffix('.png')}")
    for kind, file in files.items():
        require_new_file(file, overwrite=overwrite, name=kind)


def _require_display(instead: str) -> None:
    problem = display_problem()
    if problem is not None:
        raise InputError(f"tissue view cannot open a window: {problem}. Pass {instead}")


def _view_site(folder: Path, screenshot: Path | None) -> str:
    """Show an imported bone, or draw it to a file."""
    if screenshot is None:
        _require_display("--screenshot FILE")
        return show_site(folder)
    _draw_apart("screenshot", screenshot, "tissue.show.viewer.site_window", str(folder))
    return f"imported bone in {folder}\nscreenshot in {screenshot}"


def _draw_apart(
    kind: str,
    file: Path,
    *command: str,
    longest_s: float = LONGEST_S,
    drawn: Callable[[float], None] | None = None,
) -> None:
    """Draw a file in a separate process; if this fails, an existing file stays unchanged.

    The command is a module and its arguments. The path of the file is added as the last argument.
    """
    with (
        whole_file(file) as temporary,
        TemporaryDirectory(prefix="tissue-", ignore_cleanup_errors=True) as folder,
    ):
        temporary.touch()
        temporary.unlink()  # a folder that takes no file is refused before anything is drawn
        apart = Path(folder) / file.name
        problem = draw_apart(*command, str(apart), longest_s=longest_s, drawn=drawn)
        if problem is not None:
            raise InputError(f"the {kind} cannot be drawn in 3D: {problem}")
        shutil.copyfile(apart, temporary)


def _draw(saved: SavedRun, choice: Choice, kind: str, file: Path, report: Progress) -> None:
    """Draw a view of a run to a file."""
    doing = f"drawing the {kind}"
    report(doing, 0.0)
    _draw_apart(
        kind,
        file,
        "tissue.show.viewer.view",
        str(saved.path),
        kind,
        json.dumps(asdict(choice)),
        longest_s=LONGEST_MOVIE_S if kind == "movie" else LONGEST_S,
        drawn=lambda share: report(doing, share),
    )


def _check(saved: SavedRun, choice: Choice, series: SavedFields | None) -> None:
    """Refuse a choice that is not possible for the run."""
    times = times_of(saved, series)
    fields = [] if series is None else series.names
    if saved.complete and not len(times) and not (saved.path / "bone.vti").is_file():
        raise InputError(
            "run", "contain a trace, bone or frames to show", saved.path, "run the scene again"
        )
    layers = [*saved.summary.get("layers", []), *(() if series is None else series.layer_names)]
    asked = {"layer": choice.hide, "field": [] if choice.field is None else [choice.field]}
    for (kind, names), known in zip(asked.items(), (layers, fields), strict=True):
        for name in names:
            if name not in known:
                argument = "hide" if kind == "layer" else kind
                remedy = f"leave it out: this run has no {kind}"
                if known:
                    remedy = f"use {enumerated(dict.fromkeys(known), 'or')}"
                raise InputError(argument, f"name a {kind} of the run", name, remedy)
    can_move = series is not None and series.displacement is not None
    most = LARGEST_SCALE if can_move else 1.0
    require_range("scale", choice.scale, 0.0 if can_move else 1.0, most, "use 1 for true size")
    if choice.time_s is not None:
        first, last = (times[0], times[-1]) if len(times) else (0.0, 0.0)
        nearest = f"use a time such as {min(max(choice.time_s, first), last):g}"
        # rounding of times in a file
        require_range("time_s", choice.time_s, first - 1e-9, last + 1e-9, nearest)


def _about(saved: SavedRun) -> str:
    """Return a sentence with the largest loads of a run, or with the time at which it stopped."""
    if saved.complete:
        force, torque = (saved.summary[name]["peak"] for name in ("force_N", "torque_Nm"))
        return (
            f"{saved.summary['scene']}: {saved.summary['simulated_s']:g} s, force up to "
            f"{force:.3g} N, torque up to {torque:.3g} N·m"
        )
    where = "before its first tick was written"
    if saved.trace is not None and len(saved.trace.rows):
        where = f"at {saved.trace['time_s'][-1]:.3f} s"
    about = f"run is incomplete: it {BEGUN.get(saved.status, 'was interrupted')} {where}"
    if saved.status == "running":
        about += f", process {saved.summary['process']['id']} writes it"
    if saved.problem:
        about += f" ({saved.problem})"
    if saved.scene is not None and is_bone_from_file(saved.scene):
        about += (
            ". The tissue is not shown, because tissue from a file is saved at the end of a run"
        )
    return about


def show(
    saved: SavedRun,
    title: str,
    choice: Choice,
    *,
    kind: str = "",
    file: Path | None = None,
) -> None:
    """Open the window, or draw the view to files.

    Parameters
    ----------
    saved
        Saved run.
    title
        Title above the view.
    choice
        Initial view of the run.
    kind, file
        `file` is written instead of opening a window; `kind` is ``screenshot`` (PNG) or ``movie``
        (MP4 or GIF). While a movie is written, the finished share is printed.
    """
    window = Window(saved, title, choice, off_screen=file is not None)
    if file is None:
        window.open()
    elif kind == "movie":
        write_movie(file, window.pictures())
    elif choice.clean:
        write_clean(window.plotter, file)
    else:
        window.plotter.screenshot(str(file))
    window.plotter.close()


PAGE = "tissue.show.viewer.web.view_page"
OPENS_S = 120.0
CLOSES_S = 10.0
"""Longest time until a page is closed [s].

`OPENS_S` is the longest time until a page is served. It is longer, because a large run must be read
and drawn first.
"""


def serve_view(folder: Path, choice: Choice, opened: Callable[[str], object]) -> None:
    """Serve the page of a run until the page has been closed for some seconds, or until Ctrl-C.

    Parameters
    ----------
    folder
        Folder of the run.
    choice
        Initial view of the run.
    opened
        Function that is called with the address, which contains a random token.

    Raises
    ------
    InputError
        If this machine can neither draw nor serve the page.
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
                output.seek(0)
                lines = output.read().strip().splitlines()
                ended = f"its process ended with exit code {child.returncode}"
                why = problem or (lines or [ended])[-1]
            except Terminated:
                raise
            except KeyboardInterrupt:
                return
            finally:
                child.kill()
                child.communicate()
    # the last line of a driver's output may be long
    raise InputError(f"--web cannot serve a page: {why[:200]}. {REMEDY[:1].upper()}{REMEDY[1:]}")


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


if __name__ == "__main__":
    finished = SavedRun(sys.argv[1])
    wanted, chosen, into = sys.argv[2:]
    show(finished, _about(finished), Choice.of_json(chosen), kind=wanted, file=Path(into))
