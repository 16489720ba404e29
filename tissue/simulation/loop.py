"""What moves a tool and what it meets, tick by tick, with the trace that they leave."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from meshes.base.arrays import Array
from tissue.builders.parts import Parts
from tissue.models.tissue_model import TICK_S, Finishes, HasNotices
from tissue.scene.scene import Output
from tissue.simulation.tick import Tick
from tissue.simulation.trace import TIMING_COLUMNS, Table, TraceLayout

__all__ = ["Loop", "undisturbed"]

SWITCH_S = 5e-5
"""How long a background thread may keep the interpreter from the ticks [s]."""


@contextmanager
def undisturbed() -> Iterator[None]:
    """Keep the garbage collector and other threads from the ticks of a block."""
    was_enabled, switching = gc.isenabled(), sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
        sys.setswitchinterval(switching)


class Loop:
    """The loop of a run: motion, removal, force, output and record, one tick of 1 ms after another.

    Parameters
    ----------
    parts
        What moves the tool, and what it meets.
    ticks
        Ticks for which memory is laid out now.
    output
        What is made of the model's force before it is commanded.
    timing_columns
        Columns of the timing beside those of the tick itself.

    Attributes
    ----------
    parts
        The same.
    trace, timing
        One row a tick; those of ticks to come are 0.
    events
        What the tissue has reported: time [s] and a sentence each.
    ticks
        Ticks that have run.
    """

    def __init__(self, parts: Parts, *, ticks: int, output: Output, timing_columns: tuple[str, ...] = ()) -> None:
        tissue = parts.tissue
        self.parts = parts
        self.ticks = 0
        self.events = list(parts.events)
        self._notices = tissue.notices if isinstance(tissue, HasNotices) else []
        self._clear = parts.keep_clear
        clear = () if self._clear is None else self._clear.names
        layout = TraceLayout.of(tissue.layer_names, tissue.measure_names + parts.motion.measure_names + clear)
        self.trace = Table(layout.columns, np.zeros((ticks, len(layout.columns))), tissue.layer_names)
        timed = TIMING_COLUMNS + timing_columns
        self.timing = Table(timed, np.zeros((ticks, len(timed))))
        self._tick = Tick(parts, output, layout, self.trace, self.timing)

    def place(self, *, resume: bool = False) -> None:
        """Put the tool where the motion starts, before the first tick; what that costs belongs to none.

        With `resume` the tissue goes on from a loop that ended there.
        """
        self._tick.place(resume=resume)

    def wait(self) -> None:
        """Wait for work in the background whose result is due at the next tick."""
        self._tick.stepper.wait(self.ticks)

    def step(self) -> int:
        """Run a tick and return its row."""
        row = self.ticks
        self._tick(row)
        self._take_notices(row * TICK_S)
        self.ticks = row + 1
        return row

    def finish(self) -> None:
        """Complete what was spread over ticks; the tables end with the last tick."""
        self.trace.rows, self.timing.rows = self.trace.rows[: self.ticks], self.timing.rows[: self.ticks]
        if isinstance(self.parts.tissue, Finishes):
            self.parts.tissue.finish()

    def close(self) -> None:
        """Take what the tissue has reported since the last tick."""
        if self._clear is not None:
            self._clear.finish()
        self._take_notices(self.ticks * TICK_S)

    @property
    def poses(self) -> Array | None:
        """Poses of a tool that cuts, see `tissue.simulation.tick.PoseLog`."""
        return self._tick.poses

    def _take_notices(self, time_s: float) -> None:
        while self._notices:
            self.events.append((time_s, self._notices.pop(0)))
        while self._clear is not None and self._clear.notices:
            self.events.append((time_s, self._clear.notices.pop(0)))
