"""Simulation of a scene: `tissue.simulate`, which `tissue run` calls too."""

from collections.abc import Callable
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.file_limits import memory_limit
from tissue.haptics.device.device import Device
from tissue.haptics.device.safe_device import SafeDevice
from tissue.objects.progress import Bar, reporting
from tissue.objects.run import Run
from tissue.scene.scene import Scene
from tissue.show.figures import draw_pictures
from tissue.simulation import simulate as engine
from tissue.simulation.builders.parts import opened_device
from tissue.simulation.live.run import LiveSettings
from tissue.simulation.live.run import live as simulate_live
from tissue.simulation.observer import Observers, OnTick, Paced, Prioritised, RunObserver, TickRow

__all__ = ["TickRow", "simulate"]


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
    observer: RunObserver | None = None,
    live: LiveSettings | None = None,
) -> Run:
    """Simulate a scene with the settings that meet its fidelity requirement.

    Parameters
    ----------
    scene
        Scene to simulate.
    compute
        Warp device, ``cpu`` or ``cuda:0``.
    cores
        Processor cores to use; default all. The trace does not depend on it.
    out
        Folder that receives the trace during the run, so a killed run keeps its rows. Without it
        the run stays in memory until `Run.save`.
    overwrite
        Replace a run that ``out`` already holds.
    progress
        Whether to show a bar, or a function called with the present work and its share; default a
        bar in a notebook.
    allow_unstable
        Whether to run a device even if its coupling is judged unstable.
    max_memory_GB
        Memory that a file of the scene may take [GB]; default half of the free memory.
    device
        Device to use instead of the scene's device, within the limits of the scene's device;
        default a simulated device or a registered real one. See
        `tissue.simulation.simulate.simulate`.
    on_tick
        Called after every tick of 1 ms with its number and its row of the trace, a mapping from
        column to value; the run ends if it returns False. Its duration adds to the time between two
        ticks.
    observer
        Observer of the ticks instead of `on_tick`; see `tissue.simulation.observer.RunObserver`.
    live
        Settings of a run in real time, in a window, in a browser or with a device.

    Raises
    ------
    InputError
        If a key has no effect in the scene, the scene cannot be built, the tool never touches, a
        device's coupling is unstable, or ``out`` holds another run. If the device fails, the error
        is a `DeviceError`.
    """
    if on_tick is not None and observer is not None:
        raise InputError(
            "on_tick", "be left out with observer", "both", "call it from the observer's on_tick"
        )
    if live is not None and any(each is not None for each in (on_tick, observer, device)):
        raise InputError(
            "live",
            "be left out with a device, on_tick or observer",
            "both",
            "leave one of them out",
        )
    if on_tick is not None:
        observer = OnTick(on_tick)
    notes: dict[str, str] = {}
    with memory_limit(max_memory_GB), reporting(progress) as report:
        settings: engine.RunSettings = {
            "compute": compute,
            "cores": cores,
            "out": out,
            "overwrite": overwrite,
            "progress": report,
            "allow_unstable": allow_unstable,
        }
        if scene.fidelity is not None:
            from tissue.evaluation.charts.frontier import with_fidelity

            scene, notes["fidelity"] = with_fidelity(scene, report=report)
        if live is not None:
            run = simulate_live(scene, live, **settings)
        else:
            if device is None and (device := opened_device(scene)) is not None:
                notes["device"] = f"{scene.held.kind} is read and played by {type(device).__name__}"
            if getattr(
                device.device if isinstance(device, SafeDevice) else device, "real_time", False
            ):
                # A real device needs ticks on time; other runs go as fast as they can.
                prioritised = Prioritised()
                observer = Observers(prioritised, observer or RunObserver(), Paced())
                run = engine.simulate(scene, device=device, observer=observer, **settings)
                notes["priority"] = prioritised.note
            else:
                run = engine.simulate(scene, device=device, observer=observer, **settings)
    run.parts.notes |= notes
    run.draw = draw_pictures
    return Run(run)
