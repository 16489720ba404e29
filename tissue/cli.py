"""The ``tissue`` command."""

import errno
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any, NoReturn

from cyclopts import (
    App,
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    Parameter,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)
from rich.console import Console

from meshes.errors import InputError

__all__ = ["app", "main"]

app = App(
    name="tissue",
    help="Simulate cutting bone, drilling teeth and pressing soft organs.",
    suppress_keyboard_interrupt=False,
)
console = Console()
problems = Console(stderr=True)

BAD_INPUT = 2
"""Exit code for anything a person can mend by other input."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
CLOSED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG)


def _whole(_: Any, tokens: Any) -> int:
    """A whole number from the command line, which would otherwise be rounded to one."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise CoercionError(token=tokens[0], target_type=int) from None


@app.command
def run(
    scene: str,
    /,
    *,
    out: Path | None = None,
    seed: Annotated[int | None, Parameter(converter=_whole)] = None,
    duration_s: float | None = None,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    compute: str = "cpu",
    cores: Annotated[int | None, Parameter(converter=_whole)] = None,
    format_: Annotated[tuple[str, ...], Parameter(name="--format", negative="")] = (),
    pictures: bool = True,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    allow_unstable: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Simulate a scene and write its trace, bone and pictures.

    Parameters
    ----------
    scene
        Name of a built-in scene (see `tissue scenes`) or a TOML file.
    out
        Folder to write; default runs/NAME.
    seed
        Seed of every random draw.
    duration_s
        Simulated time in seconds.
    set_
        KEY=VALUE, replaces an entry of the scene, such as voxels.spacing_mm=0.2; may be repeated.
    compute
        Device for the kernels: cpu or cuda:0.
    cores
        Processor cores to use; default all. The trace does not depend on it.
    format_
        Further formats of the trace beside CSV: parquet, npz, mat, h5; may be repeated.
    pictures
        Draw pictures.
    overwrite
        Replace the run that the folder already holds.
    allow_unstable
        Run a device whose coupling is judged unstable, too.
    """
    from tissue.formats import check_formats
    from tissue.load import load_scene, parse_override
    from tissue.run_folder import RunFolder

    check_formats(format_)
    overrides = dict(parse_override(text) for text in set_)
    if seed is not None:
        overrides["seed"] = seed
    if duration_s is not None:
        overrides["duration_s"] = duration_s
    loaded = load_scene(scene, overrides)
    folder = out or Path("runs") / loaded.name
    RunFolder.check(folder, overwrite=overwrite)
    started = perf_counter()
    with _progress() as tell:
        tell("starting Warp", 0.0)
        from tissue.simulation import simulate
        from tissue.summary_table import print_summary

        finished = simulate(
            loaded,
            compute=compute,
            cores=cores,
            out=folder,
            overwrite=overwrite,
            progress=tell,
            allow_unstable=allow_unstable,
        )
        simulated = perf_counter()
        finished.save(folder, formats=format_, pictures=pictures, progress=tell)
    print_summary(
        console, finished.summary(), folder, wall_s=perf_counter() - started, saving_s=perf_counter() - simulated
    )


@app.command
def scenes(name: str | None = None, /) -> None:
    """List the built-in scenes, or print one as TOML, ready to copy and edit.

    Parameters
    ----------
    name
        Scene to print.
    """
    from tissue.load import load_scene, scene_names, scene_text

    if name is not None:
        sys.stdout.write(scene_text(name))
        return
    for each in scene_names():
        console.print(f"[bold]{each:<12}[/bold] {load_scene(each).description}", soft_wrap=True)


@app.command
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
) -> None:
    """Show a run in a window.

    Parameters
    ----------
    folder
        Folder that `tissue run` wrote.
    screenshot
        Write a picture to this .png file instead of opening a window.
    movie
        Write a movie to this .mp4 or .gif file instead of opening a window.
    hide
        Layer or part that is switched off at first; may be given more than once.
    field
        Field that is shown at first, for example von_mises_MPa.
    scale
        How many times its size the displacement is drawn at first.
    time_s
        Moment that is shown at first, in seconds; default that of the greatest force.
    """
    from tissue.view import view as show

    with problems.status("drawing the movie") if movie is not None else nullcontext():
        said = show(folder, screenshot=screenshot, movie=movie, hide=hide, field=field, scale=scale, time_s=time_s)
    console.print(said, soft_wrap=True, highlight=False)


@app.command
def stability(
    scene: str,
    /,
    *,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    out: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Say whether a scene's device is stable in its hand, and map stiffness against damping and delay.

    Parameters
    ----------
    scene
        Name of a built-in scene or a TOML file.
    set_
        KEY=VALUE, replaces an entry of the scene, such as device=six-dof; may be repeated.
    out
        Folder that takes the picture and the data; without it they are only printed.
    overwrite
        Replace the map that the folder already holds.
    """
    from tissue.load import load_scene, parse_override
    from tissue.stability_report import scene_stability, stability_lines, write_stability_files

    loaded = load_scene(scene, dict(parse_override(text) for text in set_))
    with problems.status("running the loop at many stiffnesses"):
        found = scene_stability(loaded)
    for line in stability_lines(loaded, found):
        console.print(line, soft_wrap=True, highlight=False)
    if out is not None:
        written = write_stability_files(loaded, found, out, overwrite=overwrite)
        console.print(f"files in {out}: {', '.join(path.name for path in written)}", soft_wrap=True, highlight=False)


def main() -> NoReturn:
    """Entry point: bad input becomes one sentence and exit code 2."""
    try:
        app(sys.argv[1:], exit_on_error=False, print_error=False)
    except InputError as error:
        _refuse(str(error))
    except CycloptsError as error:
        _refuse(_usage(error))
    except OSError as error:
        if error.errno not in FULL + CLOSED:
            raise
        what, remedy = ("have room", "free some space or choose") if error.errno in FULL else ("be writable", "choose")
        where = f" at {error.filename}" if error.filename else ""
        _refuse(f"out must {what}, got {(error.strerror or '').lower()}{where}: {remedy} another --out")
    except KeyboardInterrupt:
        problems.print("stopped: what was written so far is kept, see `tissue view`", highlight=False, soft_wrap=True)
        sys.exit(130)
    sys.exit(0)


def _refuse(sentence: str) -> NoReturn:
    problems.print(f"[red]error:[/red] {_escaped(sentence)}", soft_wrap=True, highlight=False)
    sys.exit(BAD_INPUT)


def _usage(error: CycloptsError) -> str:
    """One sentence for a command line that cannot be read."""
    from tissue.faults import nearest

    command = " ".join(["tissue", *(error.command_chain or ())])
    match error:
        case UnknownCommandError(unused_tokens=[word, *_]):
            known = [name for name in app if not name.startswith("-")]
            return f"command must be one of {', '.join(known)}, got {word}{nearest(word, known)}: see `tissue --help`"
        case UnknownOptionError(token=token, argument_collection=arguments):
            word = (token.keyword or token.value).split("=")[0]
            known = [name for argument in arguments for name in argument.names if name.startswith("-")]
            return f"option must be one of {', '.join(known)}, got {word}{nearest(word, known)}: see `{command} --help`"
        case MissingArgumentError(argument=argument) if argument is not None:
            name = argument.name if argument.name.startswith("-") else argument.name.lower()
            return f"{name} must be given, got nothing: see `{command} --help`"
        case CoercionError(token=token, target_type=kind) if token is not None:
            what = {int: "a whole number", float: "a number"}.get(kind or str, "readable")
            return f"{token.keyword or 'value'} must be {what}, got {token.value}: see `{command} --help`"
        case UnusedCliTokensError(unused_tokens=[word, *_]):
            return f"{command} must be given nothing more, got {word}: see `{command} --help`"
        case _:
            return " ".join(str(error).split()).rstrip(".").replace(". ", "; ") + f": see `{command} --help`"


def _escaped(text: str) -> str:
    from rich.markup import escape

    return escape(text)


@contextmanager
def _progress() -> Iterator[Any]:
    """A progress bar that names what is being done."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=problems, transient=True, disable=not problems.is_terminal) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda doing, share: bar.update(task, description=doing, completed=share)
