"""Simulation of a scene: build its motion and tissue, and run the loop of ticks."""

import gc
import warnings
from collections.abc import Sequence
from contextlib import ExitStack, nullcontext, suppress
from math import ceil, inf
from pathlib import Path
from time import perf_counter
from typing import TypedDict

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import PRESENT, InputError
from meshes.base.progress import Progress, silent
from tissue.haptics.device.device import Device, device_parameters
from tissue.haptics.device.safe_device import SafeDevice, run_held
from tissue.haptics.hand_motion import HandMotion
from tissue.haptics.loop.sampled_loop import force_later_N
from tissue.models.tissue_model import TICK_S, MayLag
from tissue.motion.motion import LONGEST_S, Events, Motion
from tissue.prediction.trained import is_trained
from tissue.scene.load import load_scene
from tissue.scene.registry import ANATOMIES, PREDICTORS
from tissue.scene.scene import Scene
from tissue.scene.used_constants import used_constants
from tissue.simulation.builders.arguments import given_note
from tissue.simulation.builders.loop import horizon_text
from tissue.simulation.builders.parts import (
    Parts,
    TissueBuilder,
    motion_of,
    require_device,
    require_no_pause,
    require_stated_rate,
)
from tissue.simulation.builders.prediction import ADAPTIVE
from tissue.simulation.findings import findings
from tissue.simulation.loop import Loop, undisturbed
from tissue.simulation.run import Run
from tissue.simulation.run_folder import RunFolder
from tissue.simulation.scheduling import Scheduling, spin_time_s
from tissue.simulation.trace import Table

__all__ = ["TICK_S", "RunObserver", "RunSettings", "build", "builder_of", "simulate", "tick_count"]


MOST_CORES = 4096
"""Largest accepted number of processor cores; a larger number is treated as a typing error."""


class RunSettings(TypedDict, total=False):
    """Settings of `simulate` that do not change the result of the simulation."""

    compute: str
    cores: int | None
    out: str | Path | None
    overwrite: bool
    progress: Progress | None
    allow_unstable: bool


class BreachWarning(UserWarning):
    """Warning that a tool starts inside a structure that it must not touch."""


class RunObserver:
    """Base class of observers; each method does nothing until it is overridden."""

    timing_columns: tuple[str, ...] = ()
    """Names of columns that the observer adds to the timing table and fills in each tick.
    """
    paces: bool = False
    """True if the observer starts the ticks in real time."""

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Prepare for a run of `parts`; `columns` are the column names of the trace."""

    def before_tick(self, index: int) -> None:
        """Wait until a tick may begin."""

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Read the trace row and the timing row of a tick; return True if the run continues."""
        return True

    def on_event(self, time_s: float, what: str) -> None:
        """Handle an event (time [s] and sentence) that the tissue reports in this tick."""

    def on_end(self) -> Events:
        """Release resources, also after an error, and return the events of the observer.

        An event is a time [s] and a sentence.
        """
        return []


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
    observers: Sequence[RunObserver] = (),
) -> Run:
    """Simulate a scene.

    Parameters
    ----------
    scene
        Scene to simulate.
    compute
        Warp device, ``cpu`` or ``cuda:0``.
    cores
        Processor cores to use; default all. The trace does not depend on their number.
    out
        Folder that receives the trace during the run, so the rows are kept if the process is
        killed. Without a folder the run stays in memory until
        :meth:`tissue.simulation.run.Run.save` is called.
    overwrite
        Whether to replace a run that ``out`` already holds.
    progress
        Function that is called with the name of the current work and its completed share.
    allow_unstable
        Whether to run a device even if the check predicts that its coupling is unstable.
    device
        Device object that replaces the simulated device and hand of the scene. The stability check
        uses the limits of the device named in the scene. If the object is a context manager, pass
        it without ``with``: the run enters and exits it. To use a device for several runs, pass
        ``held`` from ``with SafeDevice(device) as held``. The ticks run in a second thread. The
        last command to the device is zero, even if an error ends the ticks; see
        `tissue.haptics.device.safe_device.SafeDevice`.
    observers
        Observers that are called in every tick, in this order. Their method `on_begin` is called in
        reverse order, because the first observer of a live run must take over Ctrl-C after all
        other observers have begun.

    Raises
    ------
    InputError
        If a key has no effect in the scene, the scene cannot be built, the tool never touches the
        tissue, the coupling of a device is unstable, or ``out`` holds another run. If the given
        device fails, the error is a `DeviceError`.
    """
    report = progress or silent
    _require_runnable(scene, cores=cores, device=device)
    folder = RunFolder(Path(out), overwrite=overwrite) if out is not None else None
    with folder.ending() if folder is not None else nullcontext():
        parts = build(
            scene,
            compute=compute,
            cores=cores,
            report=report,
            allow_unstable=allow_unstable,
        )
        if device is not None:
            assert isinstance(parts.motion, HandMotion), "a scene with a device"
            kind = scene.held.kind
            limits = device_parameters(kind, scene.constants)
            remedy = f"write its rate as devices.{kind}.rate_Hz into the file of the key materials"
            require_stated_rate(device, limits, remedy=remedy)
            parts.motion.device = device
            # With a caller's device there is no simulated hand, which would need time to react.
            parts.motion.after_s = 0.0
        if any(each.paces for each in observers) and isinstance(parts.tissue, MayLag):
            parts.tissue.waits = False
        ticks = tick_count(scene, parts.motion)
        columns = tuple(name for each in observers for name in each.timing_columns)
        loop = Loop(parts, ticks=ticks, output=scene.output, timing_columns=columns)
        if folder is not None:
            folder.begin(scene, parts.placement)
            folder.open_tables(loop.trace, loop.timing)
        loop.place()
        if parts.keep_clear is not None and (inside := parts.keep_clear.overlaps()):
            # Level 4 is the caller of `tissue.simulate`.
            warnings.warn(
                f"the tool starts {' and '.join(inside)}. Check the path and the position of the "
                "structure. The ticks are slow while the tool is inside",
                BreachWarning,
                stacklevel=4,
            )
        scheduling = _run_ticks(
            loop, ticks, cores=cores, folder=folder, report=report, observers=observers
        )
        trace = loop.trace
        if isinstance(parts.motion, HandMotion) and parts.motion.predictor is not None:
            parts.notes |= _prediction_note(trace, parts.motion, scene)
        # With a device, the user decides when the run ends, so an early end is not noted.
        path_s = ticks * TICK_S if device is None else inf
        found, through = findings(scene, parts, trace, path_s=path_s)
        events = sorted(loop.events + parts.motion.happened() + through, key=lambda event: event[0])
        run = Run(
            scene, parts, trace, loop.timing, events=events, poses=loop.poses, compute=compute
        )
        run.begun = folder
        run.scheduling = scheduling
        run.findings = found
    return run


def _require_runnable(
    scene: Scene, *, cores: int | None, device: Device | SafeDevice | None
) -> None:
    """Raise an error if a scene cannot be run with the given number of cores and device."""
    if cores is not None and not 1 <= cores <= MOST_CORES:
        # The value in the message is cut, because a number may have thousands of digits.
        raise InputError(
            "cores", f"be from 1 to {MOST_CORES}", str(cores)[:12], "leave it out to use all cores"
        )
    if scene.fidelity is not None:
        raise InputError(
            "fidelity",
            "be left out, because this function does not choose settings",
            PRESENT,
            "use tissue.simulate, which chooses the settings",
        )
    require_no_pause(scene)
    if device is None:
        return
    require_device(device.device if isinstance(device, SafeDevice) else device)
    if scene.device is None:
        raise InputError(
            "device",
            "be left out for a scene without a device",
            PRESENT,
            "set a device in the scene, for example device = touch",
        )


def _run_ticks(
    loop: Loop,
    ticks: int,
    *,
    cores: int | None,
    folder: RunFolder | None,
    report: Progress,
    observers: Sequence[RunObserver],
) -> Scheduling:
    """Run all ticks of a loop with observers; report progress about ten times per second."""
    trace = loop.trace
    timing = loop.timing
    # In real time, a flush of many rows at once would delay a tick.
    each_row = len(observers) > 0
    motion = loop.parts.motion

    def go_through() -> None:
        """Run the ticks until the observer or the motion ends them."""
        reported_s = perf_counter()
        goes_on = True
        taken = 0
        while goes_on and loop.ticks < ticks:
            loop.wait()
            for each in observers:
                each.before_tick(loop.ticks)
            row = loop.step()
            while taken < len(loop.events):
                for each in observers:
                    each.on_event(*loop.events[taken])
                taken += 1
            for each in observers:
                goes_on = each.on_tick(row, trace.rows[row], timing.rows[row]) and goes_on
            if folder is not None:
                folder.flush(loop.ticks, force=each_row)
            # Ten reports per second are enough for a reader.
            if goes_on and perf_counter() - reported_s > 0.1:
                reported_s = perf_counter()
                report("simulating", loop.ticks / ticks)

    def end(each: RunObserver) -> None:
        """End an observer and take its events."""
        loop.events += each.on_end()

    # All observers are ended, even if one of them fails.
    with ExitStack() as ends:
        try:
            for each in reversed(observers):
                ends.callback(end, each)
                each.on_begin(loop.parts, trace.columns)
            # Collect garbage now, because the garbage collector is off during the ticks.
            gc.collect()
            spin_s = spin_time_s(ticks * TICK_S) if folder is not None else 0.0
            scheduling = Scheduling(loop.parts.tissue, cores=cores, spin_s=spin_s)
            with undisturbed():
                if isinstance(motion, HandMotion):
                    run_held(go_through, motion.held)
                else:
                    go_through()
        except BaseException:
            if folder is not None:
                with suppress(OSError):
                    folder.flush(loop.ticks, force=True)
            raise
    scheduling.end()
    loop.finish()
    scheduling.poll()
    loop.close()
    if folder is not None:
        folder.flush(loop.ticks, force=True)
    return scheduling


def _prediction_note(trace: Table, motion: HandMotion, scene: Scene) -> dict[str, str]:
    """Return a note on the error of the predicted forces.

    There is no note if the tool was not in contact, or if the tissue model does not respond in
    every tick.
    """
    predicted = trace.vectors("predicted_force", "N")
    raw = trace.vectors("raw_force", "N")
    ticks = motion.lead_ticks
    size = float(np.linalg.norm(raw))
    if size == 0.0 or not 0 < ticks < len(raw) or motion.model_ticks > 1:
        return {}
    # In later ticks, the force that was predicted is not known.
    known = len(raw) - ceil(ticks)
    later = force_later_N(raw, ticks)
    missed, held = (
        100.0 * float(np.linalg.norm((later - force)[:known])) / size for force in (predicted, raw)
    )
    horizon = horizon_text(1e3 * ticks * TICK_S, scene.held.coupling.delay_ms)
    compared = "worse than zero-order hold with" if missed > held else "zero-order hold has"
    share = 100.0 * float(trace["predicted_by"][np.any(raw != 0.0, axis=1)].mean())
    return {
        "prediction": f"RMS error {missed:.2g} % of the force at a horizon of {horizon}; "
        f"{compared} {held:.2g} %. The predictor's own force was used in {share:.3g} % of the "
        "ticks in contact"
    }


def _training_note(scene: Scene) -> dict[str, str]:
    """Return a note if a built-in predictor was trained on a task that differs from the scene.

    The name of a scene chooses the built-in predictor.
    """
    held = scene.held
    if held.prediction == "none" or scene.predictor_file or not is_trained(scene.name):
        return {}
    if held.prediction != ADAPTIVE and not PREDICTORS[held.prediction].trained:
        return {}
    built_in = load_scene(scene.name)
    # the interval between saved frames does not affect the force
    mine, trained = (
        each.model_dump(exclude={"anatomy": {"interval_ms"}}) for each in (scene, built_in)
    )
    other = [key for key in ("anatomy", "tool", "motion", "organ") if mine[key] != trained[key]]
    if not other:
        return {}
    return {
        "predictor": f"trained on the built-in scene {scene.name}, which differs in "
        f"{', '.join(other)}. Train a predictor for this scene with 'tissue train', and set "
        "coupling.predictor_file to its file"
    }


def tick_count(scene: Scene, motion: Motion) -> int:
    """Return the number of ticks of a run.

    If the run contains the whole motion, time is added because a hand follows the motion with a
    delay.
    """
    seconds = scene.duration_s or motion.duration_s
    if seconds > LONGEST_S:
        raise InputError(
            "duration_s",
            f"be given for a motion of {seconds:g} s, which is longer than {LONGEST_S:g} s",
            "nothing",
            "set duration_s, or use a higher feed",
        )
    if scene.duration_s is not None and seconds >= motion.duration_s - motion.after_s:
        seconds += motion.after_s
    return max(round(seconds / TICK_S), 1)


def build(
    scene: Scene,
    *,
    compute: str = "cpu",
    cores: int | None = None,
    report: Progress = silent,
    allow_unstable: bool = False,
) -> Parts:
    """Build the objects that simulate a scene, such as the motion and the tissue model.

    Raises
    ------
    InputError
        If a file cannot be used, the tissue would not fit in memory, the tool never touches the
        tissue, the device is unknown, or its coupling is unstable and `allow_unstable` is not set.
    """
    if compute != "cpu":
        import warp as wp

        known = [str(device) for device in wp.get_devices()]
        if compute not in known:
            raise InputError("compute", f"be one of {', '.join(known)}", compute, "use cpu here")
    if scene.keep_clear is not None and ANATOMIES[scene.anatomy.kind].build is None:
        from tissue.simulation.builders.keep_clear import require_structures

        # An anatomy from a file may take a minute to build.
        require_structures(scene.keep_clear, scene.bone)
    motion = motion_of(scene)
    notes = {}
    if motion.notes:
        notes["motion"] = "; ".join(motion.notes)
    if scene.device is not None:
        from tissue.simulation.builders.hand import hand_motion

        motion, notes["coupling"] = hand_motion(scene, motion, allow_unstable=allow_unstable)
        notes |= _training_note(scene)
    parts = builder_of(scene.anatomy.kind)(
        scene, motion, step_s=TICK_S, compute=compute, cores=cores, report=report
    )
    parts.notes |= notes
    if scene.materials:
        layers = parts.tissue.layer_names
        used = used_constants(scene, layers)
        parts.notes |= given_note(scene.constants, used, layers=layers, by="scene")
    return parts


def builder_of(kind: str) -> TissueBuilder:
    """Return the function that builds the objects of a run for a kind of anatomy."""
    from tissue.simulation.builders import cutting, organ_scene

    outside: TissueBuilder | None = ANATOMIES[kind].build
    if outside is not None:
        return outside
    others = {
        "slab": organ_scene.pressed,
        "liver": organ_scene.pressed,
        "layers": organ_scene.pierced,
        "soft-tissue": organ_scene.incised,
        "wall": organ_scene.wall,
    }
    return others.get(kind, cutting.milled)
