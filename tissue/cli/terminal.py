"""Output to the terminal, types of options, and checks that all commands share."""

from collections.abc import Iterable, Sequence
from typing import Annotated, Any

from cyclopts import CoercionError, Parameter, Token
from rich.console import Console

from meshes.base.errors import PRESENT, InputError
from meshes.base.text_tables import visible, whole_number_in


class _Terminal(Console):
    """Console that prints text unchanged.

    The console interprets no markup unless requested, does not wrap lines, and prints control
    characters as escape codes.
    """

    def print(self, *objects: Any, **options: Any) -> None:
        """Print objects as ``rich.console.Console.print`` does."""
        if all(isinstance(each, str) for each in objects):
            objects = tuple(map(visible, objects))
            options = {"soft_wrap": True, "highlight": False} | options
        super().print(*objects, **options)


console = _Terminal(emoji=False, markup=False)
problems = _Terminal(stderr=True, emoji=False, markup=False)
pending_notes: list[str] = []
"""Notes that are not yet printed."""


def print_notes() -> None:
    """Print each pending note once."""
    for note in dict.fromkeys(pending_notes):
        problems.print(f"note: {note}")
    pending_notes.clear()


def whole(_: object, tokens: Sequence[Token]) -> int:
    """Parse a whole number from the command line; raise an error for a fraction."""
    try:
        return whole_number_in(tokens[0].value)
    except ValueError:
        raise CoercionError(token=tokens[0], target_type=int) from None


Flag = Annotated[bool, Parameter(negative="")]
Texts = Annotated[tuple[str, ...], Parameter(negative="")]
Formats = Annotated[tuple[str, ...], Parameter(name="--format", negative="")]
Overrides = Annotated[tuple[str, ...], Parameter(name="--set", negative="")]
Whole = Annotated[int, Parameter(converter=whole)]
MaybeWhole = Annotated[int | None, Parameter(converter=whole)]
ADDRESS = {"hardware.address": "--address"}
"""Command-line options that replace scene keys in messages, keyed by scene key."""
Numbers = Annotated[str | None, Parameter(allow_leading_hyphen=True)]
"""Type of an option with numbers separated by commas; the first number may be negative."""
MemoryGB = Annotated[float | None, Parameter(name="--max-memory-GB")]


def print_table(
    titles: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str | None = None
) -> None:
    """Print a table; all columns but the first are aligned to the right."""
    from rich.table import Table

    table = Table(titles[0], title=caption)
    for title in titles[1:]:
        table.add_column(title, justify="right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)


def left_out(where: str, remedy: str, **flags: object) -> None:
    """Raise an error if one of the `flags` is given although it has no effect.

    Raises
    ------
    InputError
        If a flag is given. The message contains the option, the situation `where` and the `remedy`.
    """
    for name, value in flags.items():
        if value is not None and value is not False and value != ():
            raise InputError(f"--{name.replace('_', '-')}", f"be left out {where}", PRESENT, remedy)
