"""The ``tissue`` command."""

import errno
import sys
from importlib.metadata import version
from typing import NoReturn

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

from tissue.commands import COMMANDS
from tissue.commands.terminal import problems

__all__ = ["app", "main"]


def _default(value: object) -> str | None:
    """What help tells as a default: nothing where nothing is given, or of a switch that is off."""
    return None if value is None or value is False or value == () else str(value)


app = App(
    name="tissue",
    version=lambda: version("tissue-sim"),  # read only when asked for
    help="Simulate cutting bone, drilling teeth and pressing soft organs.",
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(show_default=_default),
)
for command in COMMANDS:
    app.command(command)

BAD_INPUT = 2
"""Exit code for anything a person can mend by other input."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
CLOSED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG)


def main() -> NoReturn:
    """Entry point: bad input becomes one sentence and exit code 2."""
    try:
        app(sys.argv[1:], exit_on_error=False, print_error=False)
    except CycloptsError as error:
        _refuse(_usage(error))
    except ValueError as error:
        from meshes.errors import InputError  # brings NumPy, which help does without

        if not isinstance(error, InputError):
            raise
        _refuse(str(error))
    except OSError as error:
        if error.errno not in FULL + CLOSED:
            raise
        what, remedy = ("have room", "free some space or choose") if error.errno in FULL else ("be writable", "choose")
        where = f" at {error.filename}" if error.filename else ""
        _refuse(f"out must {what}, got {(error.strerror or '').lower()}{where}: {remedy} another --out")
    except KeyboardInterrupt:
        seen = ", see `tissue view`" if sys.argv[1:2] == ["run"] else ""
        problems.print(f"stopped: what was written so far is kept{seen}", highlight=False, soft_wrap=True)
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
