"""The calls that `import tissue` offers: the engine's, with a demand on fidelity met first and pictures drawn."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.file_limits import memory_limit
from tissue.api.progress import Bar, reporting
from tissue.api.run import Run
from tissue.builders.device import opened_device
from tissue.builders.parts import Parts
from tissue.figures.report import draw_pictures
from tissue.haptics.device.device import Device
from tissue.haptics.device.safe_device import SafeDevice
from tissue.scene.scene import Scene
from tissue.simulation import simulate as engine
from tissue.simulation.live.paced import Paced
from tissue.simulation.live.prioritised import Prioritised

__all__ = ["TickRow", "simulate"]


class TickRow(Mapping[str, float]):
    """A tick's row of the trace by its columns, such as ``row["model_force_z_N"]``.

    It is the same object in every tick, and shows the present one; ``dict(row)`` keeps it.
    """

    def __init__(self, columns: tuple[str, ...]) -> None:
        self._places = {name: place for place, name in enumerate(columns)}
        self.values_of_tick: NDArray[np.float64] = np.zeros(len(columns))

    def __getitem__(self, name: str) -> float:
        return float(self.values_of_tick[self._places[name]])

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class Calls:
    """Goes along with the ticks of a run and calls a function in each."""

    timing_columns: tuple[str, ...] = ()

    def __init__(self, on_tick: Callable[[int, TickRow], object]) -> None:
        self._call = on_tick
        self._row = TickRow(())

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Take the names of the columns."""
        self._row = TickRow(columns)

    def before_tick(self, index: int) -> None:
        """Wait for nothing."""

    def on_tick(self, index: int, row: NDArray[np.float64], times: NDArray[np.float64]) -> bool:
        """Call the function; the run goes on unless it returns False."""
        self._row.values_of_tick = row
        return self._call(index, self._row) is not False

    def on_end(self) -> list[tuple[float, str]]:
        """Nothing has happened."""
        return []


def simulate(
    scene: Scene,
    /,
    *,
    compute: str = "cpu",
    cores: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Bar = None,
    allow_unstable: bool = False,
    max_memory_GB: float | None = None,
    device: Device | SafeDevice | None = None,
    on_tick: Callable[[int, TickRow], object] | None = None,
    observer: engine.RunObserver | None = None,
) -> Run:
    """Simulate a scene, at the settings that its demand on fidelity asks for.

    Parameters
    ----------
    scene
        What to simulate.
    compute
        Warp device, ``cpu`` or ``cuda:0``.
    cores
        Processor cores to use; default all. The trace does not depend on it.
    out
        Folder that takes the trace while the run goes on, so that a killed run leaves what it had; without it the run
        stays in memory until `Run.save`.
    overwrite
        Replace a run that ``out`` already holds.
    progress
        Whether a bar is shown, in a notebook or a terminal, or what is called with what is being done and its share;
        without it a notebook shows a bar.
    allow_unstable
        Run a device whose coupling is judged unstable, too.
    max_memory_GB
        Memory that a file of the scene may take [GB]; default half of the free memory.
    device
        Device to read and to play instead of the one that the scene names, by whose limits it is judged; without it a
        simulated one, or what was registered opens. See `tissue.simulation.simulate.simulate` for how it is held.
    on_tick
        Called after every tick of 1 ms with its number and its row of the trace, a mapping from column to value; the
        run ends where it returns False. It is called between two ticks, so that what it takes is added to them.
    observer
        Goes along with the ticks, in place of `on_tick`; see `tissue.simulation.simulate.RunObserver`.

    Raises
    ------
    InputError
        If a key has no effect in the scene or it cannot be built, the tool never touches, a device's coupling is
        unstable, or ``out`` holds another run; as `DeviceError`, if the device fails.
    """
    if on_tick is not None and observer is not None:
        raise InputError("on_tick must be left out with observer, got both: call it from the observer's on_tick")
    chosen: dict[str, str] = {}
    with memory_limit(max_memory_GB), reporting(progress) as report:
        if scene.fidelity is not None:
            from tissue.evaluation.charts.fidelity import with_fidelity

            scene, chosen["fidelity"] = with_fidelity(scene, report=report)
        opened = opened_device(scene) if device is None else None
        if opened is not None:
            chosen["device"] = f"{scene.held.kind} is read and played by {type(opened).__name__}"
        held = opened if device is None else device
        observer, raised = observer if on_tick is None else Calls(on_tick), None
        if getattr(held.device if isinstance(held, SafeDevice) else held, "real_time", False):
            observer = raised = Prioritised(Paced(observer))
        run = engine.simulate(
            scene,
            compute=compute,
            cores=cores,
            out=out,
            overwrite=overwrite,
            progress=report,
            allow_unstable=allow_unstable,
            device=held,
            observer=observer,
        )
    if raised is not None:
        chosen["priority"] = raised.note
    run.parts.notes |= chosen
    run.draw = draw_pictures
    return Run(run)
