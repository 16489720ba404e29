"""The ``tissue`` command: its subcommands, exit codes and shell completion."""

import errno
import os
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

from cyclopts import (
    App,
    Argument,
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    Parameter,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

import tissue
from meshes.base.errors import InputError, enumerated
from tissue.cli.calibrate import calibrate
from tissue.cli.chart import chart
from tissue.cli.devices import devices
from tissue.cli.fit import fit
from tissue.cli.import_ import import_
from tissue.cli.run import run
from tissue.cli.saved_runs import assess, compare, report, view
from tissue.cli.scenes import scenes, schema
from tissue.cli.serve import serve
from tissue.cli.stability import stability
from tissue.cli.study import study
from tissue.cli.sweep import sweep
from tissue.cli.terminal import console, pending_notes, print_notes, problems
from tissue.cli.train import train
from tissue.system.child import HelperLostError
from tissue.system.owned_folder import anything_claimed
from tissue.system.stopping import Terminated, terminated_as_exception

COMMANDS = (
    run,
    import_,
    scenes,
    view,
    report,
    fit,
    sweep,
    compare,
    stability,
    devices,
    serve,
    calibrate,
    assess,
    train,
    chart,
    study,
    schema,
)
"""Commands, in the order in which the help lists them."""


PIPE_CLOSED = 141
"""Exit code if the program that reads the output has ended: 128 plus the number of SIGPIPE."""


def open_streams() -> None:
    """Replace closed standard streams, and escape characters that a stream cannot encode.

    If a stream stayed closed, the next file that is opened would get its file descriptor. Libraries
    that print to this descriptor would then write into that file.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _default(value: object) -> str | None:
    """Return the text of a default for the help; None for no default, or for False."""
    return None if value is None or value is False or value in ((), "") else str(value)


app = App(
    name="tissue",
    version=lambda: tissue.__version__,  # read only on request
    help="Simulate cutting bone, drilling teeth and pressing soft organs.",
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(show_default=_default),
)
for command in COMMANDS:
    app.command(command)

app.register_install_completion_command(
    add_to_startup=False, help="Install completion of commands and options in a shell."
)


BAD_INPUT = 2
"""Exit code for errors that the user can fix by changing the input."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
CLOSED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG)


def main() -> NoReturn:
    """Run the command and exit.

    If the input is invalid, one sentence is printed and the exit code is 2. The exit code is 130
    after Ctrl-C and 143 after SIGTERM.
    """
    open_streams()
    try:
        os.getcwd()
    except FileNotFoundError:
        _refuse("the working directory was removed. Change to another directory")
    if sys.argv[1:] in ([], ["--help"], ["-h"]):
        # The list of commands has no Markdown, and importing its parser takes 0.1 s.
        app.help_format = "plaintext"
    try:
        with terminated_as_exception(), _plain_warnings():
            try:
                app(sys.argv[1:], exit_on_error=False, print_error=False)
            finally:
                # Names of parts appear only in the help of a command. Searching the packages takes
                # time.
                if len(sys.argv) > 2 and sys.argv[-1] in ("--help", "-h"):
                    _print_offered()
    except CycloptsError as error:
        _refuse(_usage(error))
    except ValueError as error:
        if not isinstance(error, InputError):
            raise
        _refuse(str(error))
    except BrokenPipeError:
        # No program reads the output, so the buffered output is discarded.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(PIPE_CLOSED)
    except OSError as error:
        if error.errno not in FULL + CLOSED:
            # An error without a file is a fault of the program, not of the disk.
            if not error.filename or not error.strerror:
                raise
            changed = f'the error "{error.strerror.lower()}" at {error.filename}'
            required = "stay unchanged while a command runs"
            _refuse(str(InputError("files", required, changed, "check this path")))
        is_full = error.errno in FULL
        required = "have free space" if is_full else "be writable"
        remedy = "free some space or choose" if is_full else "choose"
        where = f" at {error.filename}" if error.filename else ""
        place, other = _place(error.filename)
        got = f"{(error.strerror or '').lower()}{where}"
        _refuse(str(InputError(place, required, got, f"{remedy} {other}")))
    except HelperLostError as lost:
        _refuse(f"{lost}. Run the command again", code=1)
    except KeyboardInterrupt as stopped:
        remedies = {"run": ", see `tissue view`", "sweep": "; the same command continues the sweep"}
        seen = remedies.get("".join(sys.argv[1:2]), "")
        kept = f"stopped: the files written so far are kept{seen}"
        if not anything_claimed():
            kept = "stopped before anything was written"
        # Code that knows more about the file has added this information to the exception.
        sentence = next(filter(lambda each: isinstance(each, str), stopped.args), "") or kept
        with suppress(OSError):  # such as a terminal that was closed
            problems.print(sentence)
        # 130: 128 plus the number of SIGINT, as shells expect it.
        sys.exit(stopped.exit_code if isinstance(stopped, Terminated) else 130)
    sys.exit(0)


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show warnings of this program as one line, without the code location.

    Notes on keys without effect are shown after the command, unless the command has shown them by
    `print_notes`. They are not shown if the command ends with an error.
    """
    pending_notes.clear()
    with warnings.catch_warnings():
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            """Print a warning of this program; pass other warnings to the interpreter."""
            # compared by name, since help does not import their modules
            if category.__name__ == "DroppedKeyWarning":
                return pending_notes.append(str(message))
            if category.__name__ not in ("PluginWarning", "OldSceneWarning", "BreachWarning"):
                return others(message, category, *where, **more)
            from rich.markup import escape

            problems.print(f"[yellow]warning:[/yellow] {escape(str(message))}", markup=True)

        warnings.showwarning = show
        try:
            yield
        finally:
            # A command without an error ends with SystemExit.
            if not isinstance(sys.exception(), Exception):
                print_notes()


def _print_offered() -> None:
    """Print names of plugins in installed packages that a command accepts."""
    from tissue.scene.plugins import offered_names

    if offered := offered_names():
        console.print(
            "Installed packages add "
            + "; ".join(f"{k} {', '.join(names)}" for k, names in offered.items())
        )


def _place(file: object) -> tuple[str, str]:
    """Return a name for a file that could not be written, and advice for another location."""
    from meshes.base.cache import cache_folder

    warp = sys.modules.get("warp")
    kernels = getattr(getattr(warp, "config", None), "kernel_cache_dir", None)
    caches = (
        (cache_folder(), "another folder by TISSUE_CACHE"),
        (kernels, "another folder by WARP_CACHE_PATH"),
    )
    for folder, other in caches:
        if folder and file and Path(str(file)).absolute().is_relative_to(Path(folder).absolute()):
            return "cache", other
    return "out", "another --out"


def _refuse(sentence: str, *, code: int = BAD_INPUT) -> NoReturn:
    from rich.markup import escape

    problems.print(f"[red]error:[/red] {escape(sentence)}", markup=True)
    sys.exit(code)


def _usage(error: CycloptsError) -> str:
    """Return one sentence that explains why a command line cannot be parsed."""
    from meshes.base.hints import nearest

    command = " ".join(["tissue", *(error.command_chain or ())])
    match error:
        case UnknownCommandError(unused_tokens=[word, *_]):
            known = [name for name in app if not name.startswith("-")]
            what = f"command must be {enumerated(known, 'or')}, got {word}{nearest(word, known)}"
            command = "tissue"
        case UnknownOptionError(token=token, argument_collection=arguments):
            word = (token.keyword or token.value).split("=")[0]
            known = _options(arguments)
            hint = nearest(word, known) or _other_use(word, known)
            what = f"option must be {enumerated(known, 'or')}, got {word}{hint}"
        case MissingArgumentError(argument=argument) if argument is not None:
            name = argument.name
            what = (
                f"{name} is missing or has no value"
                if name.startswith("-")
                else f"the argument {name.upper()} is missing"
            )
        case CoercionError(token=token, target_type=kind) if token is not None:
            noun = {int: "a whole number", float: "a number"}.get(kind or str, "readable")
            what = f"{token.keyword or 'value'} must be {noun}, got {token.value}"
        case UnusedCliTokensError(unused_tokens=[word, *_]):
            what = f"{command} takes no further argument, got {word}"
        case _:
            what = " ".join(str(error).split()).rstrip(".")
    return f"{what}. See `{command} --help`"


def _options(arguments: Iterable[Argument]) -> list[str]:
    """Return the names of the options among a command's arguments."""
    return [name for each in arguments for name in each.names if name.startswith("-")]


def _other_use(word: str, known: list[str]) -> str:
    """Return advice on an unknown option: a command with this option, or a scene key; else ""."""
    commands = [name for name in app if not name.startswith("-") and app[name].default_command]
    holders = [
        f"`tissue {name}`"
        for name in commands
        if word in _options(app[name].assemble_argument_collection())
    ]
    if holders:
        return f" (an option of {', '.join(holders)})"
    return " (keys of the scene are set by --set KEY=VALUE)" if "--set" in known else ""
