"""Loop of a run, in ticks of 1 ms, that moves the tool and computes and records forces."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from math import exp
from time import perf_counter

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.loop.vibration import Vibration
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import (
    TICK_S,
    Finishes,
    HasNotices,
    HasState,
    Response,
    StartsBackground,
    TissueModel,
    ToolMotion,
    WaitsForBackground,
)
from tissue.motion.motion import Motion, quaternion_of
from tissue.motion.replay import COLUMNS
from tissue.scene.scene import Output
from tissue.simulation.builders.parts import Parts
from tissue.simulation.trace import LEAST_LOAD, TIMING_COLUMNS, Table, TraceLayout
from tissue.system.blas_threads import one_blas_thread

SWITCH_S = 5e-5
"""Longest time for which a background thread may keep the interpreter from the ticks [s].

The value is a twentieth of a tick. Python's default is five ticks.
"""


class PoseLog:
    """Record of the poses of a tool, in memory that is allocated before the first tick.

    Parameters
    ----------
    ticks
        Number of ticks of the run. Up to two poses are stored for each tick.
    """

    def __init__(self, ticks: int) -> None:
        self._rows = np.zeros((2 * ticks + 1, COLUMNS))
        self._count = 0

    def add(self, tick: int, motion: ToolMotion) -> None:
        """Append the pose of a tick; tick -1 is the pose before the first tick."""
        row = self._rows[self._count]
        row[0] = tick
        row[1:4] = motion.tip_m
        row[4:7] = motion.rotation[:, 2]
        self._count += 1

    @property
    def poses(self) -> Array:
        """Poses so far, shape (n, 7): tick, tip [m] and direction of the tool's axis."""
        return self._rows[: self._count]


class Stepper:
    """Object that moves the tool in each tick and computes the response of the tissue.

    The forces are neither processed for a device nor recorded. Every part of the package that
    simulates ticks uses this class. The cutting force depends on the bone before the current pass
    of the tool. In a tick, the force may therefore be computed before or after bone is removed.

    Parameters
    ----------
    motion
        Motion of the tool.
    tissue
        Tissue that the tool cuts or presses.
    balances
        Whether to search for the pose at which the tissue force balances the thrust on the tool.
        Bone is removed only after the search, at the final pose.
    log
        Record of the poses of a tool that cuts; None to record no poses.

    Attributes
    ----------
    tool
        Current pose of the tool.
    response
        Response of the tissue at the current pose.
    moved_s, searched_s, removed_s
        Clock times at which motion, search for the balance, and removal of material ended in the
        last tick [s].
    """

    def __init__(
        self,
        motion: Motion,
        tissue: TissueModel,
        *,
        balances: bool = False,
        log: PoseLog | None = None,
    ) -> None:
        self._motion = motion
        self._tissue = tissue
        self._balances = balances
        self._log = log
        self._starts = tissue if isinstance(tissue, StartsBackground) else None
        self._waits = tissue if isinstance(tissue, WaitsForBackground) else None
        self.tool = ToolMotion()
        self.response = Response.empty(len(tissue.layer_names))
        self.moved_s = self.searched_s = self.removed_s = 0.0

    def place(self, *, resume: bool = False) -> Response:
        """Put the tool at the start of the motion and return the response there.

        Call this before the first tick. If `resume` is True, the tissue keeps the state that it has
        from another loop, which must have ended at the same pose.
        """
        self._motion.set_tissue(self._tissue)
        self._motion.begin(self.tool)
        if not resume:
            self._tissue.place(self.tool)
        self._keep(-1)
        return self._tissue.respond(self.tool)

    def wait(self, index: int) -> None:
        """Wait for the background work whose result is needed at a tick."""
        if self._waits is not None:
            self._waits.wait_for_background(index * TICK_S)

    def step(self, index: int, *, step_s: float = TICK_S) -> None:
        """Move the tool by a time step [s] and evaluate the tissue.

        A slow tissue model responds only every few ticks. In the other ticks, only the motion
        advances.
        """
        motion = self._motion
        tissue = self._tissue
        tool = self.tool
        motion.advance(index * TICK_S, step_s, self.response, tool)
        self.moved_s = self.searched_s = self.removed_s = perf_counter()
        if index % motion.model_ticks != 0:
            return
        # A motion with a thrust tries poses before any bone is cut. Other motions are corrected
        # after the cut.
        if self._balances:
            response = tissue.respond(tool)
            while motion.correct(response, tool):
                response = tissue.respond(tool)
            self.searched_s = perf_counter()
            self._cut(index)
            self.removed_s = perf_counter()
        else:
            self._cut(index)
            self.removed_s = perf_counter()
            response = tissue.respond(tool)
            if motion.correct(response, tool):
                self._cut(index)
                response = tissue.respond(tool)
        self.response = response

    def state(self) -> State:
        """Return a copy of the state of tool, response and tissue, without the state of the motion.

        Raises
        ------
        InputError
            If the tissue cannot copy its state.
        """
        tissue = self._tissue
        if not isinstance(tissue, HasState):
            raise InputError(
                "tissue",
                "be able to copy its state",
                f"{type(tissue).__name__} without state()",
                "add the method state()",
            )
        return {"own": copied(self, ("tool", "response")), "tissue": tissue.state()}

    def restore(self, state: State) -> None:
        """Restore a state that `state` returned."""
        assert isinstance(self._tissue, HasState)
        self._tissue.restore(state["tissue"])
        put_back(self, state["own"])

    def start_background(self, index: int) -> None:
        """Start the background work that must follow a tick."""
        if self._starts is not None:
            self._starts.start_background(index * TICK_S, self.tool)

    def _cut(self, index: int) -> None:
        self._tissue.advance(self.tool)
        self._keep(index)

    def _keep(self, index: int) -> None:
        if self._log is not None:
            self._log.add(index, self.tool)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Keep the garbage collector and other threads from delaying the ticks in a ``with`` block.

    Inside the block, linear algebra uses one thread.
    """
    was_enabled = gc.isenabled()
    switching = sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(SWITCH_S)
    try:
        with one_blas_thread():
            yield
    finally:
        if was_enabled:
            gc.enable()
        sys.setswitchinterval(switching)


class Loop:
    """Loop that advances a run in ticks of 1 ms, and processes and records the forces.

    All memory that a tick needs is allocated once, when the loop is made.

    Parameters
    ----------
    parts
        Objects that simulate the scene, such as the motion of the tool and the tissue.
    ticks
        Number of ticks for which memory is allocated.
    output
        Processing of the tissue force before it is sent to a device.
    timing_columns
        Additional columns of the timing table, which observers fill.

    Attributes
    ----------
    parts
        The argument `parts`.
    trace, timing
        Tables with one row per tick; rows of future ticks are 0.
    events
        Events that the tissue has reported, each with a time [s] and a sentence.
    ticks
        Number of ticks that have run. When all rows of the tables are used, a new tick replaces the
        oldest row.
    """

    def __init__(
        self, parts: Parts, *, ticks: int, output: Output, timing_columns: tuple[str, ...] = ()
    ) -> None:
        tissue = parts.tissue
        motion = parts.motion
        cutter = parts.cutter
        clear = parts.keep_clear
        self.parts = parts
        self.ticks = 0
        self.events = list(parts.events)
        self._notices = [tissue.notices] if isinstance(tissue, HasNotices) else []
        clear_names: tuple[str, ...] = ()
        if clear is not None:
            self._notices.append(clear.notices)
            clear_names = clear.names
        layout = TraceLayout.of(
            tissue.layer_names, tissue.measure_names, motion.measure_names, clear_names
        )
        self._at = layout.at
        is_load = [name.endswith(("_N", "_Nm")) for name in layout.columns]
        self._loads = np.flatnonzero(is_load)
        self.trace = Table(
            layout.columns, np.zeros((ticks, len(layout.columns))), tissue.layer_names
        )
        timed = TIMING_COLUMNS + timing_columns
        self.timing = Table(timed, np.zeros((ticks, len(timed))))
        carves = cutter is not None and cutter.spin_rad_s != 0.0
        self._log = PoseLog(ticks) if carves else None
        self._stepper = Stepper(motion, tissue, balances=carves and motion.balances, log=self._log)
        lag_s = output.low_pass_ms * 1e-3
        self._gain = 1.0 - exp(-TICK_S / lag_s) if lag_s > 0.0 else 1.0
        self._filtered = np.zeros(6)
        self._commanded = np.zeros(6)
        self._vibration: Vibration | None = None
        if cutter is not None and output.vibration_share > 0.0:
            self._vibration = Vibration(
                cutter.tooth_passing_Hz, share=output.vibration_share, step_s=TICK_S
            )
        self._rotation = b""
        self._quaternion = np.zeros(4)

    @property
    def poses(self) -> Array | None:
        """Poses of a cutting tool; see `PoseLog`."""
        return self._log.poses if self._log is not None else None

    def place(self, *, resume: bool = False) -> None:
        """Put the tool at the start of the motion; call this before the first tick.

        The duration of this call is not recorded in the timing. If `resume` is True, the tissue
        keeps the state that it has from another loop, which must have ended at the same pose.
        """
        response = self._stepper.place(resume=resume)
        if self.parts.keep_clear is not None:
            self.parts.keep_clear.measure(self._stepper.tool, placed=True)
        self._record(self.trace.rows[0], 0, response)

    def wait(self) -> None:
        """Wait for the background work whose result is needed at the next tick."""
        self._stepper.wait(self.ticks)

    def step(self) -> int:
        """Run a tick, record trace and timing, and return the index of the row."""
        index = self.ticks
        stepper = self._stepper
        start = perf_counter()
        stepper.step(index)
        response = stepper.response
        self.parts.motion.play(response)
        if self.parts.keep_clear is not None:
            self.parts.keep_clear.measure(stepper.tool)
        forced = perf_counter()
        self._filtered += self._gain * (response.wrench - self._filtered)
        factor = 1.0
        if self._vibration is not None:
            factor += self._vibration.factor(index)
        np.multiply(self._filtered, factor, out=self._commanded)
        row = index % len(self.trace.rows)
        self._record(self.trace.rows[row], index, response)
        recorded = perf_counter()
        stepper.start_background(index)
        end = perf_counter()
        # The search for a balance evaluates forces, so its time counts as force.
        self.timing.rows[row, : len(TIMING_COLUMNS)] = (
            (end - start) * 1e6,
            (stepper.moved_s - start) * 1e6,
            (stepper.removed_s - stepper.searched_s) * 1e6,
            (forced - stepper.removed_s + stepper.searched_s - stepper.moved_s) * 1e6,
            (recorded - forced) * 1e6,
            (end - recorded) * 1e6,
        )
        self._take_notices(index * TICK_S)
        end_of_region = self.parts.region_end
        if end_of_region is not None and (left := end_of_region.check(index, stepper.tool)):
            self.events.append((index * TICK_S, left))
        self.ticks = index + 1
        return row

    @property
    def tool(self) -> ToolMotion:
        """Current pose of the tool."""
        return self._stepper.tool

    @property
    def response(self) -> Response:
        """Response of the tissue in the last tick."""
        return self._stepper.response

    def state(self) -> State:
        """Return a copy of the state on which later ticks depend, without trace and timing."""
        clear = self.parts.keep_clear
        return {
            "own": copied(self, ("ticks", "events", "_filtered", "_commanded")),
            "stepper": self._stepper.state(),
            "keep_clear": None if clear is None else clear.state(),
        }

    def restore(self, state: State) -> None:
        """Restore a state that `state` returned."""
        # The tissue is restored first, so the loop stays unchanged if the tissue refuses the state.
        self._stepper.restore(state["stepper"])
        put_back(self, state["own"])
        if self.parts.keep_clear is not None:
            self.parts.keep_clear.restore(state["keep_clear"])
        if self.ticks > 0:
            last = self.ticks - 1
            self._record(self.trace.rows[last % len(self.trace.rows)], last, self.response)

    def _record(self, row: Array, index: int, response: Response) -> None:
        """Write one row of the trace, in the units of its columns."""
        tool = self._stepper.tool
        at = self._at
        # Most tools never turn, so the quaternion is computed only after a change.
        if tool.rotation.tobytes() != self._rotation:
            self._rotation = tool.rotation.tobytes()
            self._quaternion[:] = quaternion_of(tool.rotation)
        moved, turned = tool.heading
        row[at["time"]] = index * TICK_S
        row[at["tip"]] = 1e3 * tool.tip_m
        row[at["quaternion"]] = self._quaternion
        row[at["velocity"]] = (1e3 * tool.speed_m_s) * moved
        row[at["spin"]] = tool.speed_m_s * turned
        row[at["commanded"]] = self._commanded
        row[at["wrench"]] = response.wrench
        row[at["removal_rate"]] = response.removal_rate_m3_s * 1e9
        row[at["removed_by_layer"]] = volumes = 1e9 * self.parts.tissue.removed_m3
        row[at["removed"]] = np.add.reduce(volumes)
        area = np.add.reduce(response.engaged_m2)
        row[at["contact"]] = area * 1e6
        row[at["tissue_measures"]] = response.measures
        row[at["motion_measures"]] = self.parts.motion.measures
        if self.parts.keep_clear is not None:
            row[at["clear_measures"]] = self.parts.keep_clear.measures
        # -1 stands for no layer, see `Table`.
        row[at["layer"]] = response.engaged_m2.argmax() if area > 0.0 else -1.0
        row[self._loads[np.abs(row[self._loads]) < LEAST_LOAD]] = 0.0

    def finish(self) -> None:
        """Complete the work that the tissue has postponed, and remove unused table rows."""
        self.trace.rows = self.trace.rows[: self.ticks]
        self.timing.rows = self.timing.rows[: self.ticks]
        if isinstance(self.parts.tissue, Finishes):
            self.parts.tissue.finish()

    def close(self) -> None:
        """Collect the events that the tissue has reported since the last tick."""
        if self.parts.keep_clear is not None:
            self.parts.keep_clear.finish()
        self._take_notices(self.ticks * TICK_S)

    def _take_notices(self, time_s: float) -> None:
        for notices in self._notices:
            while notices:
                self.events.append((time_s, notices.pop(0)))
