"""A progress bar where a person looks: in a notebook or in a terminal."""

from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from time import perf_counter
from typing import TYPE_CHECKING, Any

from meshes.base.progress import Progress, silent
from meshes.base.visible_text import visible
from tissue.objects.show import in_notebook

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["Bar", "reporting", "terminal_bar"]

Bar = Progress | bool | None
"""What a call takes as ``progress``: what is called, or whether a bar is shown; without either
one in a notebook.
"""
EVERY_S = 0.2
"""Time between two updates of a notebook's bar [s]."""


@contextmanager
def reporting(wanted: Bar) -> Iterator[Progress]:
    """What a call reports to: what it was given, a bar, or nobody."""
    if callable(wanted):
        yield wanted
    elif in_notebook() and wanted is not False:
        with _notebook_bar() as report:
            yield report
    elif wanted:
        from rich.console import Console

        with terminal_bar(Console(stderr=True, emoji=False, markup=False)) as report:
            yield report
    else:
        yield silent


@contextmanager
def terminal_bar(console: "Console") -> Iterator[Progress]:
    """A bar that goes when it is done; nothing where the console is no terminal."""
    from rich import progress as bars

    if not console.is_terminal:  # older versions of rich end even a disabled bar with an empty line
        yield silent
        return
    text = bars.TextColumn("{task.description}", markup=False)
    columns = (text, bars.BarColumn(), bars.TaskProgressColumn(), bars.TimeElapsedColumn())
    with bars.Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda doing, share: bar.update(task, description=visible(doing), completed=share)


@contextmanager
def _notebook_bar() -> Iterator[Progress]:
    """A bar of plain HTML, which needs no widgets, in the output of the cell that runs; it goes
    when it is done.
    """
    from IPython import display

    begun_s = perf_counter()
    shown_s = 0.0
    handle: Any = display.display(display.HTML(""), display_id=True)

    def report(doing: str, share: float) -> None:
        nonlocal shown_s
        now_s = perf_counter()
        if now_s - shown_s < EVERY_S:
            return
        shown_s = now_s
        bar = f'<progress value="{min(max(share, 0.0), 1.0):.3f}"></progress>'
        handle.update(display.HTML(f"{bar} {escape(visible(doing))}, {now_s - begun_s:.0f} s"))

    try:
        yield report
    finally:
        handle.update(display.HTML(""))
