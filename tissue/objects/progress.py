"""Progress in a notebook or in a terminal, and VTK's warnings there."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from time import perf_counter
from typing import TYPE_CHECKING, Any

from meshes.base.progress import Progress, silent
from meshes.base.text_tables import visible

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["Bar", "in_notebook", "quiet_without_display", "reporting", "terminal_bar"]


Bar = Progress | bool | None
"""Argument ``progress`` of a call: a function, or whether to show a bar.

The default None shows a bar in a notebook only.
"""
EVERY_S = 0.2
"""Time between two updates of a notebook's bar [s]: each is a message to the browser."""


def in_notebook() -> bool:
    """Return whether a Jupyter kernel runs this code."""
    module = sys.modules.get("IPython")
    shell: Any = module.get_ipython() if module is not None else None
    return shell is not None and hasattr(shell, "kernel")


@contextmanager
def quiet_without_display() -> Iterator[None]:
    """Restrict VTK's output to errors if no display is set.

    VTK warns about a missing display, and then draws without one.
    """
    if os.environ.get("DISPLAY"):
        yield
        return
    import pyvista

    with pyvista.vtk_verbosity("error"):
        yield


@contextmanager
def reporting(wanted: Bar) -> Iterator[Progress]:
    """Yield the function that a call reports progress to: the given one, a bar, or a no-op."""
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
    """Yield the report function of a temporary bar; it does nothing without a terminal."""
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
    """Yield the report function of a temporary bar of plain HTML in the output of a cell.

    The bar needs no widgets.
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
