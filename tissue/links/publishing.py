"""Base class of publishers of a live run, and main function of their processes."""

import json
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path

from meshes.base.errors import InputError
from tissue.simulation.live.shared import SharedArrays
from tissue.system.child import own_process


class RunPublisher(ABC):
    """Publisher of the trace rows of a live run.

    Parameters
    ----------
    folder
        Folder in which the run has written its shared arrays and their column names.

    Attributes
    ----------
    address
        Network address, or ROS topics, of the published data. The run shows this text to the user.
    """

    address = ""

    def __init__(self, folder: Path) -> None:
        self._arrays = SharedArrays(folder)
        self._columns = tuple(json.loads((folder / "columns.json").read_text("utf-8")))
        self._turn = 0

    def _places(self, names: tuple[str, ...]) -> list[int]:
        """Return the indices of the columns with the given names."""
        return [self._columns.index(name) for name in names]

    @abstractmethod
    def step(self) -> None:
        """Publish the data that are due, then wait briefly."""

    @abstractmethod
    def end(self) -> None:
        """Publish the remaining data and the end of the run."""

    def run(self) -> None:
        """Publish rows until the simulation computes no more ticks."""
        while not self._arrays["ended"][0]:
            self.step()
        self.end()


def publish(make: Callable[[Path], RunPublisher], folder: str) -> None:
    """Make a publisher, report its address on standard output, and run it."""
    standard_output = own_process(beside_ticks=True)
    try:
        publisher = make(Path(folder))
    except Exception as error:
        # A middleware has its own error types. The user sees the last printed line.
        words = " ".join(str(error).split())
        sys.exit(words if isinstance(error, InputError) else f"{type(error).__name__}: {words}")
    print(f"ready {publisher.address}", file=standard_output, flush=True)
    publisher.run()
