"""Window of a live run in a separate process, which returns positions of the pointer."""

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from tempfile import gettempdir, mkdtemp

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.extras import install_command
from tissue.haptics.device.recorded import MouseDevice
from tissue.motion.quaternion import UPRIGHT
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool
from tissue.simulation.builders.parts import Parts
from tissue.simulation.live.shared import (
    MEMORY,
    AnyArray,
    Layout,
    SharedArrays,
    SharedTissue,
    shared_tissue,
)
from tissue.simulation.run import DEADLINE_US
from tissue.simulation.trace import components
from tissue.system.child import await_ready, child_command, process_module
from tissue.system.offscreen import REMEDY, drawing_environments

CLOCK = ("tick_us", "late_us", "missed", "skipped_ms")
"""Names of the clock values that the process of the window receives in each tick."""
LOAD = ("time_s", *components("model_force", "N"))
"""Columns of the trace that a window plots over time."""
ROW_TICKS = 8
"""Ticks between two rows that a window receives; each picture then has about four new rows."""
LOADS = 1024
"""Number of rows of time and force that are kept for the plots of a window (8 s)."""
COLOURS = re.compile(r"\x1b\[[0-9;]*m")
"""Pattern of terminal colours in the output of a process."""
CLOSES_S = 10.0
"""Longest time for a window to close [s]; after this time its process is killed."""
OPENS_S = 120.0
"""Longest time for a window to open [s]; if it takes longer, the run fails."""
FOLDER = "tissue-live-"
COUNTERS = (
    "row_turn",
    "pointer_turn",
    "loads_count",
    "ended",
    "closed",
    "frames",
    "paused",
    "resets",
    "runs",
)
"""Names of the counters and states that the processes of window and run share."""

ABOVE_M = 0.02
BELOW_M = 0.01
"""Largest distance below the scripted path to which a pointer can move the tool [m].

This distance limits how far a probe can be pressed beyond the path. For a cutting tool,
``voxels.margin_mm`` is used instead. `ABOVE_M` limits how far a tool can be withdrawn above the
path.
"""


def reach_m(scene: Scene, parts: Parts) -> tuple[Array, Array]:
    """Return the corners of a box around the scripted path [m].

    The pointer may move the tool within this box.
    """
    path = parts.motion.sweep_m()
    axis = parts.motion.rotations()[0][:, 2]
    below_m = 1e-3 * scene.voxels.margin_mm if isinstance(scene.tool, Tool) else BELOW_M
    points = np.concatenate([path + ABOVE_M * axis, path - below_m * axis])
    return points.min(axis=0), points.max(axis=0)


class WindowProcess:
    """Window that shows a live run and reports the tool position that the pointer requests.

    The window runs in a separate process. The ticks never wait for this process, because both
    processes map the same memory. Ctrl-C does not interrupt the window. The window closes when the
    ticks end.

    Parameters
    ----------
    scene, parts
        Scene of the run, and the objects that simulate the scene.
    columns
        Names of the columns of the trace.
    environment
        Additional environment variables for the process of the window.
    more_layout, more_start
        Additional arrays that change during the run, and additional arrays that the window needs at
        its start.

    Attributes
    ----------
    arrays
        Arrays that both processes share.
    address
        Address of the page that the process serves; empty for a window on the display.

    Raises
    ------
    InputError
        If the installed package has no entry point for this process, or the window does not open.
    """

    process = "window"
    """Name of the entry point, in the group ``tissue.processes``, that runs the window."""
    place = "must open its window where there is a display"
    remedy = "Fix the display, or unset DISPLAY to run without a window"
    shows_tissue = True
    """True if the process receives the changes of the tissue."""
    request = "pointer"
    """Name of the shared array with the pose to which the process requests to move the tool.

    The array contains the position of the tip [mm] and, optionally, a quaternion (x, y, z, w).
    """

    def __init__(
        self,
        scene: Scene,
        parts: Parts,
        columns: tuple[str, ...],
        *,
        environment: Mapping[str, str] | None = None,
        more_layout: Layout | None = None,
        more_start: Mapping[str, AnyArray] | None = None,
    ) -> None:
        # A missing entry point is refused before the folder is made, because the folder would be
        # left behind.
        module = process_module(self.process)
        self._folder = _new_folder()
        self._shared = shared_tissue(parts) if self.shows_tissue else SharedTissue()
        layout: Layout = {
            "row": ("float64", (len(columns) + len(CLOCK),)),
            "pointer": ("float64", (3,)),
            "loads": ("float64", (LOADS, 4)),
            **dict.fromkeys(COUNTERS, ("int64", (1,))),
        }
        self.arrays = SharedArrays(self._folder, layout | self._shared.layout | (more_layout or {}))
        self._row = np.zeros(len(columns) + len(CLOCK))
        self._missed = 0
        self._skipped_ms = 0.0
        self._start_mm = 1e3 * parts.motion.sweep_m()[0]
        self._scale = scene.motion_scale
        self._load = np.array([columns.index(name) for name in LOAD], dtype=np.intp)
        self._seen = 0
        self._reset = 0
        (self._folder / "scene.json").write_text(
            scene.model_dump_json(exclude_unset=True), "utf-8"
        )  # the scene with the changes for the mouse
        (self._folder / "columns.json").write_text(json.dumps([*columns, *CLOCK]), "utf-8")
        low_m, high_m = reach_m(scene, parts)
        start: dict[str, AnyArray] = {
            "low_m": low_m,
            "high_m": high_m,
            "start_m": 1e-3 * self._start_mm,
            "axis": parts.motion.rotations()[0][:, 2],
            "layer_names": np.array(parts.tissue.layer_names),
            **self._shared.start,
            **(more_start or {}),
        }
        np.savez(self._folder / "start.npz", allow_pickle=False, **start)
        self._shared.publish(self.arrays, 0)
        with (self._folder / "output.txt").open("w+", encoding="utf-8", errors="replace") as output:
            self._child = subprocess.Popen(
                child_command(module, str(self._folder)),
                env={**os.environ, **(environment or {})},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=output,
                # in this session its lower priority counts against the ticks, see `Helper`
                process_group=0,
                text=True,
            )
        self._words = (self._folder / "output.txt").open(encoding="utf-8", errors="replace")
        try:
            self.address, last = await_ready(self._child, longest_s=OPENS_S, closes_s=CLOSES_S)
            if last is not None:
                last = last or self._last_words()
                # The output of a library may be long, so only its end is used.
                raise InputError(
                    f"--live {self.place}, but {last[:200].rstrip('.')}. {self.remedy}"
                )
        except BaseException:
            self._child.kill()
            self.end()
            raise
        # Both processes have the files open, so the folder can be removed now. No files are left
        # behind if a process is killed.
        shutil.rmtree(self._folder, ignore_errors=True)

    def _count(self, name: str) -> int:
        """Return one of the shared numbers in `COUNTERS`."""
        return int(self.arrays[name][0])

    @property
    def frames(self) -> int:
        """Number of pictures that the window has drawn."""
        return self._count("frames")

    @property
    def closed(self) -> bool:
        """True if the user has closed the window."""
        return self._count("closed") > 0

    @property
    def paused(self) -> bool:
        """True if the user has paused the run, or no page of the run is open."""
        return self._count("paused") > 0

    @property
    def reset(self) -> bool:
        """True if the user requests a restart of the run."""
        return self._count("resets") != self._reset

    def begin_again(self, parts: Parts) -> None:
        """Show a new run of the same scene from its start."""
        self._shared = shared_tissue(parts)
        self._shared.publish(self.arrays, 0)
        self._reset = self._count("resets")
        self._seen = self._count(f"{self.request}_turn")
        self._missed = 0
        self._skipped_ms = 0.0
        self.arrays["runs"][0] += 1

    def failed(self) -> str | None:
        """Return the last output of a process that ended unexpectedly, or None."""
        return self._last_words() if self._child.poll() is not None and not self.closed else None

    def steer(self, mouse: MouseDevice) -> None:
        """Move a mouse device so that the tool moves to the pose that the process requests.

        The tool moves by the motion of the mouse times the motion scale of the scene. Without a new
        request, the mouse stays at its place.
        """
        is_new = self._count(f"{self.request}_turn") != self._seen
        if not is_new or (message := self.arrays.read(self.request)) is None:
            return
        writes, pose = message
        # The counter increases before and after each write; see `SharedArrays.read`.
        self._seen = 2 * writes
        away_mm = pose[:3] - self._start_mm
        x, y, z = (1e-3 * (self._start_mm + away_mm / self._scale)).tolist()
        mouse.push((x, y, z), tuple(pose[3:].tolist()) or UPRIGHT)

    def show(self, index: int, row: Array, times: Array) -> None:
        """Send the trace row and the clock values (see `CLOCK`) of a tick to the window.

        `times` is the timing row of the tick. Its last two columns must be the lateness of the tick
        and the skipped time [µs].
        """
        tick_us = float(times[0])
        late_us = float(times[-2])
        self._missed += tick_us + late_us > DEADLINE_US
        self._skipped_ms += 1e-3 * float(times[-1])
        if index % ROW_TICKS == 0:
            self._row[: len(row)] = row
            self._row[len(row) :] = tick_us, late_us, self._missed, self._skipped_ms
            self.arrays.write("row", self._row)
            count = self.arrays["loads_count"]
            np.take(row, self._load, out=self.arrays["loads"][count[0] % LOADS])
            count[0] += 1
        self._shared.publish(self.arrays, index)

    def end(self) -> None:
        """Close the window."""
        self.arrays["ended"][0] = 1
        try:
            self._child.communicate(timeout=CLOSES_S)
        # A window that does not respond must not prevent the end of the run.
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.communicate()
        self._words.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _last_words(self) -> str:
        self._words.seek(0)
        output = COLOURS.sub("", self._words.read())
        words = output.strip().splitlines()
        return words[-1] if words else f"its process ended with exit code {self._child.returncode}"


class PageProcess(WindowProcess):
    """Window in a browser: the process draws off screen and serves a web page."""

    process = "page"
    place = "must serve its page"
    remedy = f"{REMEDY[:1].upper()}{REMEDY[1:]}"


class Page:
    """Web page of live runs, served by a process that starts with the first run.

    Parameters
    ----------
    opened
        Function that is called once with the address of the page. The address contains a random
        token.
    """

    def __init__(self, opened: Callable[[str], object]) -> None:
        self._opened = opened
        self._process: PageProcess | None = None

    def show(
        self,
        scene: Scene,
        parts: Parts,
        columns: tuple[str, ...],
    ) -> PageProcess:
        """Show a run from its start; the arguments are those of `WindowProcess`.

        Raises
        ------
        InputError
            If this computer cannot draw the page or cannot serve it.
        """
        if self._process is not None:
            self._process.begin_again(parts)
            return self._process
        failed: InputError | None = None
        # A display may exist but fail to draw. In this case the next one is tried.
        for environment in drawing_environments():
            try:
                self._process = PageProcess(scene, parts, columns, environment=environment)
            except InputError as error:
                failed = error
                continue
            self._opened(self._process.address)
            return self._process
        raise failed or InputError(
            f"--live {PageProcess.place}, but this machine has no OpenGL library. "
            f"{PageProcess.remedy}"
        )

    def close(self) -> None:
        """End the process of the page."""
        if self._process is not None:
            self._process.end()
            self._process = None


def require_web() -> None:
    """Check that the package that serves a page is installed.

    Raises
    ------
    InputError
        If aiohttp is missing.
    """
    if find_spec("aiohttp") is None:
        remedy = f"run {install_command('web')}"
        raise InputError("--web", "find the Python package aiohttp", "none", remedy)


def _new_folder() -> Path:
    """Make a folder for the arrays that both processes share.

    Folders left by killed processes are removed.
    """
    import psutil

    place = MEMORY if MEMORY.is_dir() else Path(gettempdir())
    for left in place.glob(f"{FOLDER}*-*"):
        number = left.name.removeprefix(FOLDER).split("-")[0]
        if number.isdecimal() and not psutil.pid_exists(int(number)):
            shutil.rmtree(left, ignore_errors=True)
    return Path(mkdtemp(prefix=f"{FOLDER}{os.getpid()}-", dir=place))
