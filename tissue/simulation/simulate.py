"""Run a scene: the only place where motion, tissue, output and trace meet."""

import gc
from contextlib import nullcontext, suppress
from math import ceil, inf
from pathlib import Path
from time import perf_counter
from typing import Protocol, TypedDict, runtime_checkable

import numpy as np

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.haptics.device.device import Device, device_parameters
from tissue.haptics.device.safe_device import SafeDevice
from tissue.haptics.device.supervision import run_held
from tissue.haptics.loop.motor_path import force_later_N
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import LONGEST_S, Motion
from tissue.prediction.predictor import Predictor
from tissue.scene.scene import Scene
from tissue.simulation.break_through import break_throughs
from tissue.simulation.builders.device import require_stated_rate
from tissue.simulation.builders.registry import build
from tissue.simulation.loop import Loop, undisturbed
from tissue.simulation.observer import RunObserver
from tissue.simulation.run import Run
from tissue.simulation.run_folder import RunFolder
from tissue.simulation.scheduling import Scheduling, spin_time_s
from tissue.simulation.shortfalls import shortfalls
from tissue.simulation.trace import Table

__all__ = ["TICK_S", "RunObserver", "RunSettings", "simulate", "tick_count"]

MOST_CORES = 4096
"""Most processor cores that may be asked for; more is taken for a slip."""


class RunSettings(TypedDict, total=False):
    """Settings of `simulate` that do not change what is simulated."""

    compute: str
    cores: int | None
    out: str | Path | None
    overwrite: bool
    progress: Progress | None
    allow_unstable: bool


@runtime_checkable
class MovedByDevice(Protocol):
    """A motion whose tool is moved by a device, which feels a force that may be predicted."""

    device: Device | SafeDevice
    held: SafeDevice
    """The device as the run holds it while the ticks run, and leaves it without force."""
    after_s: float
    """How much later than the motion's path it ends [s]."""
    predictor: Predictor | None
    lead_ticks: float
    """Ticks by which the force is predicted."""
    model_ticks: int
    """Ticks for which one answer of the tissue holds."""


def simulate(
    scene: Scene,
    *,
    compute: str = "cpu",
    cores: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    allow_unstable: bool = False,
    device: Device | SafeDevice | None = None,
    observer: RunObserver | None = None,
) -> Run:
    """Simulate a scene.

    Parameters
    ----------
    scene
        What to simulate.
    compute
        Warp device, ``cpu`` or ``cuda:0``.
    cores
        Processor cores to use; default all. The trace does not depend on it.
    out
        Folder that takes the trace while the run goes on, so that a killed run leaves what it had;
        without it the run stays in memory until :meth:`tissue.simulation.run.Run.save`.
    overwrite
        Replace a run that ``out`` already holds.
    progress
        Called with what is being done.
    allow_unstable
        Run a device whose coupling is judged unstable, too.
    device
        Device to read and to play instead of the simulated one in a simulated hand; the scene names
        the one by whose limits it is judged. The run opens and closes one that is a context
        manager; give it without ``with``, or for several runs as ``with SafeDevice(device) as
        held``. Its ticks run in a second thread, and whatever ends them its last command is zero;
        see `tissue.haptics.device.safe_device.SafeDevice`.
    observer
        Goes along with the ticks.

    Raises
    ------
    InputError
        If a key has no effect in the scene or it cannot be built, the tool never touches, a
        device's coupling is unstable, or ``out`` holds another run; as `DeviceError`, if the given
        device fails.
    """
    report = progress or silent
    if cores is not None and not 1 <= cores <= MOST_CORES:
        raise InputError(
            "cores", f"be from 1 to {MOST_CORES}", str(cores)[:12], "leave it out to use all"
        )
    if scene.fidelity is not None:
        raise InputError(
            "scene", "hold settings", "a demand on fidelity", "choose them by tissue.simulate"
        )
    if device is not None and scene.device is None:
        raise InputError(
            "scene", "name the device that is given", "none", "set device, such as touch"
        )
    folder = RunFolder(Path(out), overwrite=overwrite) if out is not None else None
    with folder.ending() if folder is not None else nullcontext():
        parts = build(
            scene,
            step_s=TICK_S,
            compute=compute,
            cores=cores,
            report=report,
            allow_unstable=allow_unstable,
        )
        if device is not None:
            assert isinstance(parts.motion, MovedByDevice), "a scene with a device"
            require_stated_rate(
                device,
                device_parameters(scene.held.kind, scene.constants),
                remedy=(
                    f"state devices.{scene.held.kind}.rate_Hz in a file of constants for the key "
                    "materials"
                ),
            )
            parts.motion.device = device
            parts.motion.after_s = 0.0
        ticks = tick_count(scene, parts.motion)
        columns = observer.timing_columns if observer is not None else ()
        loop = Loop(parts, ticks=ticks, output=scene.output, timing_columns=columns)
        if folder is not None:
            folder.begin(scene, parts.placement)
            folder.open_tables(loop.trace, loop.timing)
        loop.place()
        scheduling = _run_ticks(
            loop, ticks, cores=cores, folder=folder, report=report, observer=observer
        )
        trace = loop.trace
        if isinstance(parts.motion, MovedByDevice) and parts.motion.predictor is not None:
            parts.notes |= _prediction_note(trace, parts.motion)
        parts.notes |= shortfalls(
            scene, parts, trace, path_s=ticks * TICK_S if device is None else inf
        )
        broke = []
        if parts.volume is not None and parts.cutter is not None and parts.cutter.spin_rad_s != 0.0:
            broke = break_throughs(parts.volume, trace, radius_m=parts.cutter.profile.radius_m)
        through = [
            (each.time_s, f"broke through, {each.plunge_mm:.2f} mm of plunge") for each in broke
        ]
        events = sorted(loop.events + parts.motion.happened() + through, key=lambda event: event[0])
        run = Run(
            scene, parts, trace, loop.timing, events=events, poses=loop.poses, compute=compute
        )
        run.begun = folder
        run.scheduling = scheduling
        run.break_throughs = broke
    return run


def _run_ticks(
    loop: Loop,
    ticks: int,
    *,
    cores: int | None,
    folder: RunFolder | None,
    report: Progress,
    observer: RunObserver | None,
) -> Scheduling:
    """Run all ticks of a loop with their observer, and report progress about ten times a second."""
    trace = loop.trace
    timing = loop.timing
    # many rows at once would delay a tick that follows the wall clock
    each_row = observer is not None
    observer = observer or RunObserver()
    motion = loop.parts.motion

    def go_through() -> None:
        reported_s = perf_counter()
        goes_on = True
        taken = 0
        while goes_on and loop.ticks < ticks:
            loop.wait()
            observer.before_tick(loop.ticks)
            row = loop.step()
            while taken < len(loop.events):
                observer.on_event(*loop.events[taken])
                taken += 1
            goes_on = observer.on_tick(row, trace.rows[row], timing.rows[row])
            if folder is not None:
                folder.flush(loop.ticks, force=each_row)
            if goes_on and perf_counter() - reported_s > 0.1:
                reported_s = perf_counter()
                report("simulating", loop.ticks / ticks)

    try:
        observer.on_begin(loop.parts, trace.columns)
        gc.collect()
        spin_s = spin_time_s(ticks * TICK_S) if folder is not None else 0.0
        scheduling = Scheduling(loop.parts.tissue, cores=cores, spin_s=spin_s)
        with undisturbed():
            if isinstance(motion, MovedByDevice):
                run_held(go_through, motion.held)
            else:
                go_through()
    except BaseException:
        if folder is not None:
            with suppress(OSError):
                folder.flush(loop.ticks, force=True)
        raise
    finally:
        loop.events += observer.on_end()
    scheduling.end()
    loop.finish()
    scheduling.look_again()
    loop.close()
    if folder is not None:
        folder.flush(loop.ticks, force=True)
    return scheduling


def _prediction_note(trace: Table, motion: MovedByDevice) -> dict[str, str]:
    """Return the error of the predicted forces as a note; no note without contact or for a
    slower model.
    """
    predicted = trace.vectors("predicted_force", "N")
    raw = trace.vectors("raw_force", "N")
    ticks = motion.lead_ticks
    size = float(np.linalg.norm(raw))
    if size == 0.0 or not 0 < ticks < len(raw) or motion.model_ticks > 1:
        return {}
    known = len(raw) - ceil(ticks)
    later = force_later_N(raw, ticks)
    missed, held = (
        100.0 * float(np.linalg.norm((later - force)[:known])) / size for force in (predicted, raw)
    )
    share = 100.0 * float(trace["predicted_by"][np.any(raw != 0.0, axis=1)].mean())
    return {
        "prediction": f"{ticks:.3g} ms ahead, off by {missed:.2g} % of the force where holding "
        "it is off "
        "by "
        f"{held:.2g} %; its own force in {share:.3g} % of the ticks in contact"
    }


def tick_count(scene: Scene, motion: Motion) -> int:
    """Ticks of a run; one that is to see the whole motion waits for a hand that is late."""
    seconds = scene.duration_s or motion.duration_s
    if seconds > LONGEST_S:
        raise InputError(
            "duration_s",
            f"be given for a motion of more than {LONGEST_S:g} s",
            f"nothing for one of {seconds:g} s",
            "give it, or a greater feed",
        )
    if scene.duration_s is not None and seconds >= motion.duration_s - motion.after_s:
        seconds += motion.after_s
    return max(round(seconds / TICK_S), 1)
