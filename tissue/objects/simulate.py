"""Simulation of a scene: `tissue.simulate`, which `tissue run` also calls."""

from collections.abc import Callable
from pathlib import Path
from typing import Unpack

from meshes.base.file_limits import memory_limit
from meshes.base.hints import suggests_arguments
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
from tissue.simulation.observer import OnTick, Paced, Prioritised, TickRow
from tissue.simulation.simulate import RunObserver, RunSettings
from tissue.system.progress import Bar, reporting

__all__ = ["TickRow", "simulate", "simulate_live"]


@suggests_arguments
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
    """Simulate a scene; return the finished run.

    Parameters
    ----------
    scene
        Scene to simulate.
    compute
        Warp device, ``cpu`` or ``cuda:0``.
    cores
        Processor cores to use; default all. The trace does not depend on their number.
    out
        Output folder. The trace is written to it during the run, so it is not lost if the process
        is killed. Without this folder, the run stays in memory until `Run.save` is called.
    overwrite
        Whether to replace a run that `out` already contains.
    progress
        Whether to show a progress bar, or a function that is called with the name of the current
        work and its completed share (0 to 1). The default is a bar in a notebook, and none
        elsewhere.
    allow_unstable
        Whether to run even if the stability check predicts that the coupling between device and
        tool is unstable.
    max_memory_GB
        Memory that an input file of the scene may take [GB]; default half of the free memory.
    device
        Device object that replaces the device named in the scene. The limits of the named device
        still apply. By default, the device of the scene is simulated, unless a real device was
        registered under its name. The device gives tip positions in the frame of the scene [m];
        their distance from the start of the path is multiplied by ``coupling.motion_scale``. The
        run is as fast as possible. If the device has the attribute ``real_time = True``, the run
        follows the wall clock. A read that takes longer than 2.5 ms of wall-clock time is not used,
        unless the device has ``in_process = True``. See `tissue.simulation.simulate.simulate`.
    on_tick
        Function that is called after every tick of 1 ms with the number of the tick and its row of
        the trace, a mapping from column to value. The run ends if the function returns False. The
        ticks wait until the function returns. A `tissue.simulation.simulate.RunObserver` is also
        called at the start and at the end.

    Raises
    ------
    InputError
        If a key has no effect in the scene, if the scene cannot be built, or if the tool never
        touches the tissue. It is also raised if the coupling of a device is unstable, or if `out`
        holds another run and `overwrite` is not set. If the device fails, the error is a
        `DeviceError`.
    """
    observers = [OnTick(on_tick) if callable(on_tick) else on_tick] if on_tick else []
    with memory_limit(max_memory_GB), reporting(progress) as report:
        scene, notes = _with_fidelity(scene, report)
        if device is None and (device := opened_device(scene)) is not None:
            notes["device"] = f"{scene.held.kind} is read and played by {type(device).__name__}"
        prioritised = None
        played_on = device.device if isinstance(device, SafeDevice) else device
        if getattr(played_on, "real_time", False):
            # A real device needs ticks on time. Other runs are as fast as possible.
            prioritised = Prioritised()
            observers = [prioritised, *observers, Paced()]
        run = engine.simulate(
            scene,
            compute=compute,
            cores=cores,
            out=out,
            overwrite=overwrite,
            progress=report,
            allow_unstable=allow_unstable,
            device=device,
            observers=observers,
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
    """Simulate a scene in real time: in a window, in a browser or with a device.

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
    """Return the scene with settings that meet its fidelity requirement, and notes on them."""
    if scene.fidelity is None:
        return scene, {}
    from tissue.evaluation.charts.frontier import with_fidelity

    scene, note = with_fidelity(scene, report=report)
    return scene, {"fidelity": note}


def _shown(run: runs.Run, notes: dict[str, str]) -> Run:
    """Return a finished run as a `tissue.Run`, with its notes and pictures."""
    run.parts.notes |= notes
    run.draw = draw_pictures
    return Run(run)
