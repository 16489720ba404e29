"""Simulation of a scene: `tissue.simulate`, which `tissue run` calls too."""

from collections.abc import Callable
from pathlib import Path
from typing import Unpack

from meshes.base.file_limits import memory_limit
from meshes.base.progress import Progress, silent
from tissue.haptics.device.device import Device
from tissue.haptics.device.safe_device import SafeDevice
from tissue.objects.run import Run
from tissue.scene.scene import Scene
from tissue.show.figures import draw_pictures
from tissue.simulation import run as runs
from tissue.simulation import simulate as engine
from tissue.simulation.builders.parts import opened_device
from tissue.simulation.live.run import LiveSettings, live
from tissue.simulation.observer import Observers, OnTick, Paced, Prioritised, TickRow
from tissue.simulation.simulate import RunObserver, RunSettings
from tissue.system.progress import Bar, reporting

__all__ = ["TickRow", "simulate", "simulate_live"]


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
    on_tick: Callable[[int, TickRow], object] | RunObserver | None = None,
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
        ticks. A `tissue.simulation.simulate.RunObserver` is called at the start and the end too.

    Raises
    ------
    InputError
        If a key has no effect in the scene, the scene cannot be built, the tool never touches, a
        device's coupling is unstable, or ``out`` holds another run. If the device fails, the error
        is a `DeviceError`.
    """
    observer = OnTick(on_tick) if callable(on_tick) else on_tick
    with memory_limit(max_memory_GB), reporting(progress) as report:
        scene, notes = _with_fidelity(scene, report)
        if device is None and (device := opened_device(scene)) is not None:
            notes["device"] = f"{scene.held.kind} is read and played by {type(device).__name__}"
        prioritised = None
        played_on = device.device if isinstance(device, SafeDevice) else device
        if getattr(played_on, "real_time", False):
            # A real device needs ticks on time; other runs go as fast as they can.
            prioritised = Prioritised()
            observer = Observers(prioritised, observer or RunObserver(), Paced())
        run = engine.simulate(
            scene,
            compute=compute,
            cores=cores,
            out=out,
            overwrite=overwrite,
            progress=report,
            allow_unstable=allow_unstable,
            device=device,
            observer=observer,
        )
    if prioritised is not None:
        notes["priority"] = prioritised.note
    return _shown(run, notes)


def simulate_live(
    scene: Scene,
    how: LiveSettings,
    /,
    *,
    max_memory_GB: float | None = None,
    **settings: Unpack[RunSettings],
) -> Run:
    """Simulate a scene in real time, in a window, in a browser or with a device.

    Parameters
    ----------
    scene, how
        Scene to simulate, and the settings of the live run.
    max_memory_GB
        As for `simulate`.
    settings
        As for `tissue.simulation.simulate.simulate`.

    Raises
    ------
    InputError
        As for `simulate` and `tissue.simulation.live.run.live`.
    """
    with memory_limit(max_memory_GB):
        scene, notes = _with_fidelity(scene, settings.get("progress") or silent)
        run = live(scene, how, **settings)
    return _shown(run, notes)


def _with_fidelity(scene: Scene, report: Progress) -> tuple[Scene, dict[str, str]]:
    """Return the scene with the settings that meet its requirement, and the note on them."""
    if scene.fidelity is None:
        return scene, {}
    from tissue.evaluation.charts.frontier import with_fidelity

    scene, note = with_fidelity(scene, report=report)
    return scene, {"fidelity": note}


def _shown(run: runs.Run, notes: dict[str, str]) -> Run:
    """Return a finished run for users, with its notes and its pictures."""
    run.parts.notes |= notes
    run.draw = draw_pictures
    return Run(run)
