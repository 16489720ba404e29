"""Run in real time, with the mouse as device if a window can be opened."""

import os
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter, sleep
from types import FrameType
from typing import Unpack

from meshes.base.arrays import Array
from meshes.base.errors import PRESENT, InputError
from tissue.haptics.device.recorded import MouseDevice
from tissue.motion.motion import Events
from tissue.scene.coupling import Device as StatedDevice
from tissue.scene.load import REPLACED_DEVICE
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import Parts, motion_of, opened_device, opens_device
from tissue.simulation.live.publisher import (
    Publisher,
    SlicerLink,
    SlicerPublisher,
    require_link,
    require_ros2,
)
from tissue.simulation.live.window import Page, WindowProcess, require_web
from tissue.simulation.observer import (
    LOOK_TICKS,
    Paced,
    Prioritised,
)
from tissue.simulation.run import Run
from tissue.simulation.simulate import TICK_S, RunSettings, simulate
from tissue.system.child import process_module
from tissue.system.offscreen import await_display, display_problem

LONGEST_S = 600.0
"""Default duration of a run in which the mouse moves the tool [s].

The trace of such a run stays in memory. With 600,000 rows and 60 columns, it takes 0.3 GB.
"""
ROAM_MM = 8.0
ROAM_ON_WALL_MM = 40.0
"""Largest distance from the scripted path to which a pointer can move the tool [mm].

This distance is used for the test wall, which has no edge. For all other tissues, the distance is
`ROAM_MM`. The number of voxels and the size of the compliance matrix increase with `ROAM_MM`, which
was chosen by judgement.
"""
LOOK_S = 0.01
"""Time between two checks of the window while a run is paused or waits for the window [s].

A user does not notice this delay, and the checks use almost no processor time.
"""
STALLED_S = 3.0
HELD_S = 60.0
"""Longest time for which a run waits for a window that does not respond [s].

The run begins to wait after `STALLED_S` without a picture. A window draws 30 pictures per second,
and a busy machine does not delay a picture by 3 s. Both values were chosen by judgement.
"""


@dataclass(frozen=True, kw_only=True)
class LiveSettings:
    """Settings of a live run.

    Attributes
    ----------
    duration_s
        Duration of a run in which the mouse moves the tool [s]. With None, the run lasts until the
        window is closed, at most 600 s. The scene sets the duration of a scripted run.
    opened
        Function that is called once with the address of a web page. If the function is given, this
        page shows the run, and no window opens. The ticks wait until the page is open. The user of
        the page can reset the run: the same scene is then simulated again from its start. In an
        output folder, the rows of the new run then replace the rows of the previous run.
    slicer
        Settings for publication to 3D Slicer, see `docs/guide/slicer.md`. No window opens if a
        client of 3D Slicer moves the tool.
    ros2
        Whether to publish the run on topics of ROS 2; see `docs/guide/ros2.md`.
    """

    duration_s: float | None = None
    opened: Callable[[str], object] | None = None
    slicer: SlicerLink | None = None
    ros2: bool = False

    @property
    def by_slicer(self) -> bool:
        """True if a client of 3D Slicer moves the tool."""
        return self.slicer is not None and self.slicer.drives

    def mover(self, scene: Scene) -> tuple[bool, str]:
        """Return True if a pointer or 3D Slicer moves the tool, and a sentence on what moves it."""
        if self.by_slicer:
            return True, (
                "the transform tissue-target of 3D Slicer moves the tool; it feels nothing, the "
                "force is sent"
            )
        mouse = "the mouse moves the tool in a {}; the force is shown but cannot be felt"
        if self.opened is not None:
            return True, mouse.format("browser")
        if opens_device(scene):
            kind = scene.held.kind
            return False, f"the device {kind} moves the tool and plays the force; no window"
        problem = display_problem()
        if problem is None:
            return True, mouse.format("window")
        script = "the scripted motion moves the tool"
        if scene.device is not None:
            script = f"a simulated {scene.held.hand} moves it"
        return False, f"no window, for {problem}: {script}"

    def check(self, scene: Scene) -> None:
        """Check that the display, page, port and packages that the settings request are available.

        Raises
        ------
        InputError
            If the display does not respond, a page cannot be served or is requested with a real
            device, or the port for 3D Slicer is in use. The error is also raised if 3D Slicer and
            another source would move the tool, ROS 2 is not installed, or the installed package has
            no entry point for a process of the live run.
        """
        if self.slicer is not None:
            require_link(self.slicer, scene, web=self.opened is not None)
            process_module("slicer")
        if self.ros2:
            require_ros2()
            process_module("ros2")
        if self.opened is None:
            if not self.by_slicer:
                await_display()
                if self.mover(scene)[0]:
                    process_module("window")
            return
        process_module("page")
        require_web()
        if opens_device(scene):
            raise InputError(
                "--web",
                f"be left out with the real device {scene.held.kind}, which runs without a window",
                PRESENT,
                "leave --web out, or set device = touch to use the mouse",
            )


def live(scene: Scene, how: LiveSettings | None = None, **settings: Unpack[RunSettings]) -> Run:
    """Simulate a scene in real time, with the mouse as device.

    Without a display, the scripted motion or a simulated hand moves the tool.

    If the scene names a real device, this device is used and no window opens. Otherwise the mouse
    replaces the device of the scene. The spring of the coupling then connects the tool to the
    mouse. Trace and window show the forces that the replaced device would apply to the hand. A
    scene without a device is treated like a scene with a device of kind ``touch``. A tick misses
    its deadline if it is not complete 1 ms after it was due. See `WallClock` for late ticks. The
    priority of the ticks is raised as far as the system allows, and reported in the note
    ``priority`` of the run. Ctrl-C or closing the window ends the run. The function returns the
    run, like `tissue.simulate`.

    Parameters
    ----------
    scene
        Scene to simulate.
    how
        Settings of the live run.
    settings
        As for `tissue.simulation.simulate.simulate`. With a mouse, the loop cannot be unstable,
        because a mouse applies no force. If a window opens, the default of ``cores`` leaves one
        core for the window.

    Raises
    ------
    InputError
        As for `tissue.simulate` and `LiveSettings.check`, or if a window or page does not open in
        time.
    """
    how = how or LiveSettings()
    how.check(scene)
    by_mouse, note = how.mover(scene)
    if by_mouse:
        device = scene.device or StatedDevice(kind=REPLACED_DEVICE)
        roam_mm = ROAM_ON_WALL_MM if scene.anatomy.kind == "wall" else ROAM_MM
        if device.coupling.roam_mm is None:
            coupling = device.coupling.model_copy(update={"roam_mm": roam_mm})
            device = device.model_copy(update={"coupling": coupling})
        changes = {"device": device, "duration_s": how.duration_s or LONGEST_S}
        scene = scene.model_copy(update=changes)
        # One core is left for the window.
        settings["cores"] = settings.get("cores") or max((os.cpu_count() or 2) - 1, 1)
        # A mouse plays no force, so the loop cannot become unstable.
        settings["allow_unstable"] = True
    page = None if how.opened is None else Page(how.opened)
    try:
        while True:
            mouse = None
            if by_mouse:
                x, y, z = motion_of(scene).sweep_m()[0].tolist()
                mouse = MouseDevice((x, y, z))
            pointer = None if how.by_slicer else mouse
            observer = LiveObserver(scene, pointer, page)
            prioritised = Prioritised()
            publishers: dict[str, Publisher] = {}
            if how.slicer is not None:
                driven = mouse if how.by_slicer else None
                publishers["slicer"] = SlicerPublisher(scene, how.slicer, driven)
            if how.ros2:
                publishers["ros2"] = Publisher(scene)
            run = simulate(
                scene,
                device=mouse if by_mouse else opened_device(scene),
                observers=(prioritised, observer, *publishers.values()),
                **settings,
            )
            if not observer.reset:
                break
            run.discard("reset")
            settings["overwrite"] = True
    finally:
        if page is not None:
            page.close()
    run.parts.notes |= {"live": note, "priority": prioritised.note}
    run.parts.notes |= {name: publisher.note for name, publisher in publishers.items()}
    if mouse is not None:
        held = "a pose from 3D Slicer" if how.by_slicer else "a mouse"
        run.parts.notes["coupling"] = (
            f"{held} in place of the {scene.held.kind} and its hand, " + scene.held.renderer
        )
    return run


class LiveObserver(Paced):
    """Observer that starts ticks on time, shows the run in a window, and ends the run on request.

    Parameters
    ----------
    scene
        Scene of the run.
    mouse
        Device that the pointer in the window moves; None if no window opens.
    page
        Page that shows the run instead of a window on the display. The page stays open after the
        run.

    Attributes
    ----------
    reset
        True if the user requested that the scene runs again from its start.
    """

    timing_columns = ("late_us", "skipped_us")

    def __init__(self, scene: Scene, mouse: MouseDevice | None, page: Page | None = None) -> None:
        super().__init__()
        self._scene = scene
        self._mouse = mouse
        self._page = page
        self.reset = False
        self._window: WindowProcess | None = None
        self._stopped = False
        self._events: Events = []
        self._handler: Callable[[int, FrameType | None], object] | int | None = None
        self._frames = -1
        self._drawn_s = 0.0

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Open the window, and make Ctrl-C end the run after the current tick."""
        if self._mouse is not None:
            show = WindowProcess if self._page is None else self._page.show
            self._window = show(self._scene, parts, columns)
        if threading.current_thread() is threading.main_thread():
            self._handler = signal.signal(signal.SIGINT, self._stop)

    def before_tick(self, index: int) -> None:
        """Wait until a tick is due, then apply the position that the pointer requests.

        The method also waits while the run is paused, and while the window does not respond.
        """
        if self._window is not None:
            if self._window.paused:
                self._pause(self._window, index)
            if index % LOOK_TICKS == 0:
                self._hold(self._window, index)
        super().before_tick(index)
        if self._window is not None and self._mouse is not None:
            self._window.steer(self._mouse)

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Record the lateness of a tick and show the tick; return True if the run continues."""
        times[-2:] = 1e6 * self._clock.late_s, 1e6 * self._clock.skipped_s
        window = self._window
        if window is None:
            return not self._stopped
        window.show(index, row, times)
        if index % LOOK_TICKS == 0 and (words := window.failed()) is not None:
            what = f"the window ended unexpectedly, and the run ended with it: {words}"
            self._events.append((float(row[0]), what))
            self._stopped = True
        ends = self._stopped or window.closed
        self.reset = window.reset and not ends
        return not (ends or self.reset)

    def _waited_s(self, window: WindowProcess, goes_on: Callable[[float], bool]) -> float:
        """Wait while a condition is true, and return the waiting time [s].

        ``goes_on`` is the condition, as a function of the time waited so far [s].
        """
        began = perf_counter()
        waited_s = 0.0
        while goes_on(waited_s) and not (self._stopped or window.closed):
            if window.failed() is not None:
                break
            sleep(LOOK_S)
            waited_s = perf_counter() - began
        self._clock.hold(waited_s)
        self._drawn_s = perf_counter()
        return waited_s

    def _pause(self, window: WindowProcess, index: int) -> None:
        """Wait until the user ends the pause."""
        waited_s = self._waited_s(window, lambda _: window.paused and not window.reset)
        # Before the first tick, the run waits until the user opens the page. This does not count as
        # a pause.
        if index > 0:
            self._events.append((index * TICK_S, f"the run was paused for {waited_s:.1f} s"))

    def _hold(self, window: WindowProcess, index: int) -> None:
        """Wait while the window does not respond.

        Without a window, the user can neither see nor move the tool.
        """
        now = perf_counter()
        if window.frames != self._frames:
            self._frames = window.frames
            self._drawn_s = now
        if now - self._drawn_s < STALLED_S:
            return
        waited_s = self._waited_s(
            window, lambda waited_s: window.frames == self._frames and waited_s < HELD_S
        )
        what = f"the window drew nothing: the run waited {waited_s:.1f} s for it"
        if window.frames == self._frames and waited_s >= HELD_S:
            self._stopped = True
            what = f"the window drew nothing for {waited_s:.0f} s: the run ended"
        self._events.append((index * TICK_S, what))

    def on_end(self) -> Events:
        """Close the window, restore the effect of Ctrl-C, and return the observer's events."""
        if self._handler is not None:
            signal.signal(signal.SIGINT, self._handler)
            self._handler = None
        if self._window is not None and self._page is None:
            self._window.end()
        self._window = None
        return self._events + super().on_end()

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self._stopped = True
