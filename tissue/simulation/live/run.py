"""A run against the wall clock: the ticks paced, the mouse as device where a window can open."""

import os
import signal
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter, sleep
from types import FrameType

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.builders.device import opened_device, opens_device
from tissue.builders.parts import Parts
from tissue.haptics.device.recorded import MouseDevice
from tissue.scene.coupling import Device as StatedDevice
from tissue.scene.scene import Scene
from tissue.simulation.live.clock import BEHIND_S, WallClock
from tissue.simulation.live.page import Page, require_web
from tissue.simulation.live.prioritised import Prioritised
from tissue.simulation.live.reach import reach_m, start_m
from tissue.simulation.live.ros2 import Ros2Observer, require_ros2
from tissue.simulation.live.slicer import SlicerLink, SlicerObserver, require_link
from tissue.simulation.live.window import WindowProcess
from tissue.simulation.run import DEADLINE_US, Run
from tissue.simulation.simulate import TICK_S, RunObserver, simulate
from tissue.system.offscreen import await_display, display_problem

__all__ = ["LiveObserver", "live", "moved_by"]

LONGEST_S = 600.0
"""How long a run by the mouse lasts without a duration [s]; its trace is held in memory."""
REPLACED_DEVICE = "touch"
"""Device whose numbers a mouse takes in a scene without one."""
ROAM_MM, ROAM_ON_WALL_MM = 8.0, 40.0
"""How far from the scripted path the pointer may take the tool; a wall goes on for ever."""
LOOK_S = 0.01
"""Time between two looks while the run waits [s]."""
LOOK_TICKS = 200
"""Ticks between two looks whether the window's process is still there and draws."""
STALLED_S, HELD_S = 3.0, 60.0
"""How long a window may draw nothing before the run waits for it, and how long it waits [s]."""


def moved_by(scene: Scene, *, web: bool = False, slicer: bool = False) -> tuple[bool, str]:
    """Whether a person moves the tool of a live run by a pointer or in 3D Slicer, and what moves it, in a sentence."""
    if slicer:
        return True, "the transform tissue-target of 3D Slicer moves the tool; it feels nothing, the force is sent"
    if web:
        return True, "the mouse moves the tool in a browser; it feels nothing, the force is shown"
    if opens_device(scene):
        return False, f"the device {scene.held.kind} moves the tool and plays the force; no window"
    problem = display_problem()
    if problem is None:
        return True, "the mouse moves the tool in a window; it feels nothing, the force is shown"
    script = "the scripted motion moves the tool" if scene.device is None else f"a simulated {scene.held.hand} moves it"
    return False, f"no window, for {problem}: {script}"


def live(
    scene: Scene,
    *,
    compute: str = "cpu",
    cores: int | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    allow_unstable: bool = False,
    duration_s: float | None = None,
    opened: Callable[[str], object] | None = None,
    slicer: SlicerLink | None = None,
    ros2: bool = False,
) -> Run:
    """Simulate a scene against the wall clock, in a window with the mouse as device or, without a display, scripted.

    A device that was registered with what opens the real one is held, without a window. Else the tool hangs on the
    mouse as on the scene's device, by the same spring, and the forces that the device would play are in the trace and
    shown; in a scene without a device a mouse acts as a touch. A tick has missed its deadline if it is not done within
    1 ms of when it was due. See `WallClock` for what happens when the ticks fall behind. The ticks have a raised
    priority as far as the system grants one, which the note ``priority`` states. Ctrl-C or closing the window ends the
    run, and what there is of it is a run like any other.

    Parameters
    ----------
    scene, compute, cores, out, overwrite, progress, allow_unstable
        As for `tissue.simulate`; a mouse cannot be unstable, for it feels nothing. Where a window opens, ``cores``
        leaves one to it by default.
    duration_s
        How long a run by the mouse lasts [s]; without it until the window is closed, 600 s at most. A scripted run
        lasts as long as its scene states.
    opened
        Show the run in a browser in place of a window, and call this once with the address of its page. The ticks wait
        until the page is open. It can reset the run: then the same scene is simulated from its start once more, and
        of the run before only the rows stay, until those of the next replace them.
    slicer
        Publish the run for 3D Slicer beside that, see `docs/guide/slicer.md`; where it also drives the tool, no window
        opens.
    ros2
        Publish the run on topics of ROS 2 beside that, see `docs/guide/ros2.md`.

    Raises
    ------
    InputError
        As `tissue.simulate`; if a display does not answer, or a window does not open on it, in time; if a page is
        asked for with a real device, which only works without a window, or it cannot be drawn or served; if the port
        for 3D Slicer is taken, or something else moves the tool; and if ROS 2 is asked for and not installed.
    """
    page = None
    by_slicer = slicer is not None and slicer.drives
    if slicer is not None:
        require_link(slicer, scene, web=opened is not None)
    if ros2:
        require_ros2()
    if opened is None and not by_slicer:
        await_display()
    elif opened is not None:
        require_web()
        if opens_device(scene):
            raise InputError(
                f"--web must be left out with a real device, which runs without any window, got {scene.held.kind}: "
                "leave it out, or set device = touch to use the mouse"
            )
        page = Page(opened)
    by_mouse, note = moved_by(scene, web=page is not None, slicer=by_slicer)
    if by_mouse:
        device = scene.device or StatedDevice(kind=REPLACED_DEVICE)
        roam_mm = ROAM_ON_WALL_MM if scene.anatomy.kind == "wall" else ROAM_MM
        coupling = device.coupling.model_copy(update={"roam_mm": device.coupling.roam_mm or roam_mm})
        device = device.model_copy(update={"coupling": coupling})
        changes = {"device": device, "duration_s": duration_s or LONGEST_S}
        scene = scene.model_copy(update=changes)
        cores = cores or max((os.cpu_count() or 2) - 1, 1)
    try:
        while True:
            mouse = MouseDevice(start_m(scene)) if by_mouse else None
            observer = LiveObserver(scene, None if by_slicer else mouse, WallClock(TICK_S), page)
            prioritised = Prioritised(observer)
            along: RunObserver = prioritised
            linked = topics = None
            if slicer is not None:
                moved = mouse if by_slicer else None
                along = linked = SlicerObserver(scene, along, slicer, box=partial(reach_m, scene), mouse=moved)
            if ros2:
                along = topics = Ros2Observer(scene, along, box=partial(reach_m, scene))
            run = simulate(
                scene,
                compute=compute,
                cores=cores,
                out=out,
                overwrite=overwrite,
                progress=progress,
                allow_unstable=allow_unstable or by_mouse,
                device=mouse if by_mouse else opened_device(scene),
                observer=along,
            )
            if not observer.reset:
                break
            run.discard("reset")
            overwrite = True
    finally:
        if page is not None:
            page.close()
    run.parts.notes["live"] = note
    run.parts.notes["priority"] = prioritised.note
    if topics is not None:
        run.parts.notes["ros2"] = topics.note
    if linked is not None:
        run.parts.notes["slicer"] = linked.note
    if mouse is not None:
        held = "a pose from 3D Slicer" if by_slicer else "a mouse"
        run.parts.notes["coupling"] = f"{held} in place of the {scene.held.kind} and its hand, " + scene.held.renderer
    return run


class LiveObserver:
    """What goes along with a live run: the clock, the window, and the wish to end it.

    Parameters
    ----------
    scene
        What is run.
    mouse
        The device that the window's pointer moves; None for no window.
    clock
        The clock that paces it.
    page
        Page that shows it in place of a window on the display, and outlives it.

    Attributes
    ----------
    reset
        Whether a person wants the same scene once more from its start.
    """

    timing_columns: tuple[str, ...] = ("late_us", "skipped_us")

    def __init__(self, scene: Scene, mouse: MouseDevice | None, clock: WallClock, page: Page | None = None) -> None:
        self._scene, self._mouse, self._clock, self._page = scene, mouse, clock, page
        self.reset = False
        self._window: WindowProcess | None = None
        self._stopped, self._missed, self._skipped_s = False, 0, 0.0
        self._events: list[tuple[float, str]] = []
        self._handler: Callable[[int, FrameType | None], object] | int | None = None
        self._frames, self._drawn_s = -1, 0.0
        self._start, self._scale = np.array(start_m(scene)), scene.motion_scale

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Open the window; from here on Ctrl-C ends the run after its tick."""
        if self._mouse is not None:
            low, high = reach_m(self._scene, parts)
            show = WindowProcess if self._page is None else self._page.show
            self._window = show(self._scene, parts, columns, low_m=low, high_m=high)
        if threading.current_thread() is threading.main_thread():
            self._handler = signal.signal(signal.SIGINT, self._stop)

    def before_tick(self, index: int) -> None:
        """Wait until a tick is due, while it is paused and for a window that hangs; take what the pointer wants."""
        if self._window is not None:
            if self._window.paused:
                self._pause(self._window, index)
            if index % LOOK_TICKS == 0:
                self._hold(self._window, index)
        self._clock.wait(index)
        if self._window is not None and self._mouse is not None:
            pointed = self._window.pointed_m()
            if pointed is not None:
                x, y, z = (self._start + (np.array(pointed) - self._start) / self._scale).tolist()
                self._mouse.push((x, y, z))

    def on_tick(self, index: int, row: NDArray[np.float64], times: NDArray[np.float64]) -> bool:
        """Write lateness into a tick's row of timing and show the tick; whether the run goes on."""
        late, skipped = 1e6 * self._clock.late_s, 1e6 * self._clock.skipped_s
        times[-2:] = late, skipped
        self._missed += times[0] + late > DEADLINE_US
        if skipped > 0.0:
            if self._skipped_s == 0.0:
                self._events.append(
                    (float(row[0]), f"the ticks were more than {1e3 * BEHIND_S:g} ms behind: the clock skips from here")
                )
            self._skipped_s += self._clock.skipped_s
        if self._window is None:
            return not self._stopped
        self._window.show(index, row, (float(times[0]), late, float(self._missed), 1e3 * self._skipped_s))
        if index % LOOK_TICKS == 0 and (words := self._window.failed()) is not None:
            self._events.append((float(row[0]), f"the window ended by itself, and the run with it: {words}"))
            self._stopped = True
        self.reset = self._window.reset and not (self._stopped or self._window.closed)
        return not (self._stopped or self._window.closed or self.reset)

    def _pause(self, window: WindowProcess, index: int) -> None:
        """Let the run wait as long as a person wants."""
        began = perf_counter()
        while window.paused and not (self._stopped or window.closed or window.reset) and window.failed() is None:
            sleep(LOOK_S)
        now = perf_counter()
        self._clock.hold(now - began)
        self._drawn_s = now
        if index > 0:
            self._events.append((index * TICK_S, f"the run was paused for {now - began:.1f} s"))

    def _hold(self, window: WindowProcess, index: int) -> None:
        """Let the run wait while its window draws nothing: nobody could see or move the tool."""
        began = now = perf_counter()
        if window.frames != self._frames:
            self._frames, self._drawn_s = window.frames, now
        if now - self._drawn_s < STALLED_S:
            return
        while window.frames == self._frames and now - began < HELD_S and not self._stopped and not window.closed:
            if window.failed() is not None:
                break
            sleep(LOOK_S)
            now = perf_counter()
        self._clock.hold(now - began)
        self._drawn_s, waited_s = now, now - began
        if window.frames == self._frames and waited_s >= HELD_S:
            self._stopped = True
            self._events.append((index * TICK_S, f"the window drew nothing for {waited_s:.0f} s: the run ended"))
        else:
            self._events.append((index * TICK_S, f"the window drew nothing: the run waited {waited_s:.1f} s for it"))

    def on_end(self) -> list[tuple[float, str]]:
        """Close the window and leave Ctrl-C as it was; what has happened, as `Motion.happened`."""
        if self._handler is not None:
            signal.signal(signal.SIGINT, self._handler)
            self._handler = None
        if self._window is not None and self._page is None:
            self._window.end()
        self._window = None
        return self._events

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self._stopped = True
