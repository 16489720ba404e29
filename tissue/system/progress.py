"""Display of progress in a notebook or a terminal."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from time import perf_counter
from typing import Any

from meshes.base.progress import Progress, silent
from meshes.base.text_tables import visible

Bar = Progress | bool | None
"""Type of an argument ``progress``: a function, True for a bar, False for no bar, or None.

With the default None, a bar is shown only in a notebook.
"""
EVERY_S = 0.2
"""Time between two updates of the progress bar in a notebook [s]."""
TRUSTED = 0.03
"""Completed share of the work above which the remaining time is shown.

Earlier estimates would be wrong, because the first steps include the loading of code.
"""
SHORT_S = 10.0
"""Smallest remaining time that is shown [s]."""
QUIET_S = 30.0
"""Time between two printed lines if the output is not a terminal [s]; this keeps logs short."""


def in_notebook() -> bool:
    """Return True if a Jupyter kernel runs this code."""
    module = sys.modules.get("IPython")
    shell: Any = module.get_ipython() if module is not None else None
    return shell is not None and hasattr(shell, "kernel")


@contextmanager
def reporting(wanted: Bar) -> Iterator[Progress]:
    """Yield a progress function: the given function, one that updates a bar, or a no-op."""
    if callable(wanted):
        yield wanted
    elif in_notebook() and wanted is not False:
        with _notebook_bar() as report:
            yield report
    elif wanted:
        with _terminal_bar(silent) as report:
            yield report
    else:
        yield silent


@contextmanager
def progress(*, quiet_s: float = QUIET_S) -> Iterator[Progress]:
    """Show the progress of a command: as a bar in a terminal, otherwise as printed lines.

    Parameters
    ----------
    quiet_s
        Time between two printed lines if the output is not a terminal [s].

    Yields
    ------
    Function to call with the name of the current work and the completed share of the work, 0 to 1.
    """
    printed_s = perf_counter()
    remaining = Remaining()

    def print_sometimes(doing: str, share: float) -> None:
        nonlocal printed_s
        if perf_counter() - printed_s >= quiet_s:
            printed_s = perf_counter()
            print(f"{visible(doing)}, {100.0 * share:.0f} %", file=sys.stderr, flush=True)

    with _terminal_bar(print_sometimes) as report:
        yield lambda doing, share: report(doing + remaining.text(share), share)


class Remaining:
    """Remaining time of a command, estimated from its pace so far."""

    def __init__(self) -> None:
        self._begun = 1.0
        self._begun_s = 0.0
        self._last = 1.0

    def text(self, share: float) -> str:
        """Return the remaining time as text; empty if it cannot be estimated yet.

        `share` is the completed share of the work, 0 to 1. The pace is measured from the first
        reported share. This share is above zero if an interrupted command continues. If the share
        decreases, a new stage has begun and the measurement restarts.
        """
        now_s = perf_counter()
        if share < self._last:
            self._begun = share
            self._begun_s = now_s
        self._last = share
        done = share - self._begun
        if not TRUSTED * (1.0 - self._begun) < done < 1.0 - self._begun:
            return ""
        seconds = (now_s - self._begun_s) * (1.0 - share) / done
        return f", {duration_text(seconds)} left" if seconds > SHORT_S else ""


def duration_text(seconds: float) -> str:
    """Return a time in words, such as ``25 min``."""
    minutes = seconds / 60.0
    if minutes < 1.0:
        return "less than 1 min"
    # From 100 min, hours with one decimal are easier to read.
    return f"{minutes:.0f} min" if minutes < 100.0 else f"{minutes / 60.0:.1f} h"


@contextmanager
def _terminal_bar(otherwise: Progress) -> Iterator[Progress]:
    """Yield a function that updates a temporary bar; without a terminal, yield `otherwise`."""
    from rich import progress as bars
    from rich.console import Console

    console = Console(stderr=True, emoji=False, markup=False)
    if not console.is_terminal:  # older versions of rich end even a disabled bar with an empty line
        yield otherwise
        return
    text = bars.TextColumn("{task.description}", markup=False)
    columns = (text, bars.BarColumn(), bars.TaskProgressColumn(), bars.TimeElapsedColumn())
    with bars.Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda doing, share: bar.update(task, description=visible(doing), completed=share)


@contextmanager
def _notebook_bar() -> Iterator[Progress]:
    """Yield a function that updates a temporary HTML bar in the output of a notebook cell.

    The bar does not need Jupyter widgets.
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
