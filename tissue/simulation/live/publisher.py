"""What publishes a live run in a process beside its ticks: begun with it, looked after by the ticks, ended with it."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from tissue.builders.parts import Parts
from tissue.scene.scene import Scene
from tissue.simulation.live.window import WindowProcess
from tissue.simulation.simulate import RunObserver, TakesEvents

__all__ = ["Publisher", "PublishingProcess"]

LOOK_TICKS = 200
"""Ticks between two looks whether the process is still there."""
Array = NDArray[np.float64]


class PublishingProcess(WindowProcess, ABC):
    """A process that is shown a run and publishes it."""

    @abstractmethod
    def note(self) -> str:
        """What was published, in half a sentence."""


Process = TypeVar("Process", bound=PublishingProcess)


class Publisher(ABC, Generic[Process]):
    """Goes along with a live run and publishes it; the ticks never wait for its process, and go on without it.

    Parameters
    ----------
    scene
        What is run.
    along
        The run's other observer.
    box
        Gives the corners of the box about the path [m].

    Attributes
    ----------
    note
        What was published, once the run has ended.
    """

    what = ""
    """What it is called where its process ends by itself."""
    ends_run = False
    """Whether the run ends with its process."""

    def __init__(self, scene: Scene, along: RunObserver, *, box: Callable[[Parts], tuple[Array, Array]]) -> None:
        self.timing_columns = along.timing_columns
        self.note = ""
        self._scene, self._along, self._box = scene, along, box
        self._process: Process | None = None
        self._failed: list[tuple[float, str]] = []

    @abstractmethod
    def _begun(self, parts: Parts, columns: tuple[str, ...], low_m: Array, high_m: Array) -> Process:
        """The process, begun for a run within a box [m]."""

    @abstractmethod
    def _show(self, process: Process, index: int, row: Array, times: Array) -> None:
        """Show the process a tick."""

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Begin to publish."""
        self._process = self._begun(parts, columns, *self._box(parts))
        try:
            self._on_opened(self._process)
            self._along.on_begin(parts, columns)
        except BaseException:
            self._process.end()
            raise

    def _on_opened(self, process: Process) -> None:
        """What is done once the process is there, before the first tick."""

    def before_tick(self, index: int) -> None:
        """Wait with the other observer."""
        self._along.before_tick(index)

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Publish the tick; whether the run goes on."""
        goes_on = self._along.on_tick(index, row, times)
        process = self._process
        if process is None:
            return goes_on
        self._show(process, index, row, times)
        if index % LOOK_TICKS == 0 and (words := process.failed()) is not None:
            with_run = ", and the run with it" * self.ends_run
            self._failed.append((float(row[0]), f"{self.what} ended by itself{with_run}: {words}"))
            self._end()
            return goes_on and not self.ends_run
        return goes_on

    def on_event(self, time_s: float, what: str) -> None:
        """Publish what has happened, and hand it on."""
        if self._process is not None:
            self._report(self._process, time_s, what)
        along: Any = self._along
        if isinstance(along, TakesEvents):
            along.on_event(time_s, what)

    def _report(self, process: Process, time_s: float, what: str) -> None:
        """Tell the process what has happened, where it publishes that."""

    def on_end(self) -> list[tuple[float, str]]:
        """End the other observer and the process."""
        try:
            return self._along.on_end() + self._failed
        finally:
            self._end()

    def _end(self) -> None:
        if self._process is not None:
            process, self._process = self._process, None
            process.end()
            self.note = process.note()
