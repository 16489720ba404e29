"""What every command shares: where it prints, its progress bar, and whole numbers."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cyclopts import CoercionError
from rich.console import Console

__all__ = ["console", "problems", "progress", "whole"]

console = Console(emoji=False)
problems = Console(stderr=True, emoji=False)


def whole(_: Any, tokens: Any) -> int:
    """A whole number from the command line, which would otherwise be rounded to one."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise CoercionError(token=tokens[0], target_type=int) from None


@contextmanager
def progress() -> Iterator[Any]:
    """A progress bar that names what is being done; called with what and with the share that is done."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=problems, transient=True, disable=not problems.is_terminal) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda doing, share: bar.update(task, description=doing, completed=share)
