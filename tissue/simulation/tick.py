"""One tick of 1 ms: motion, removal, force, low-pass, trace."""

from math import exp
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from tissue.builders.parts import Parts
from tissue.haptics.loop.vibration import Vibration
from tissue.models.tissue_model import TICK_S, Response, StartsBackground, ToolMotion
from tissue.motion.motion import quaternion_of
from tissue.motion.pose_file import COLUMNS
from tissue.scene.scene import Output
from tissue.simulation.trace import LEAST_LOAD, TIMING_COLUMNS, Table, TraceLayout, load_columns

__all__ = ["PoseLog", "Tick"]


class PoseLog:
    """Poses that a tool was brought to, in memory that is allocated before the first tick.

    Parameters
    ----------
    ticks
        Ticks of the run; each may bring the tool to two poses.
    """

    def __init__(self, ticks: int) -> None:
        self._rows = np.zeros((2 * ticks + 1, COLUMNS))
        self._count = 0

    def add(self, tick: int, motion: ToolMotion) -> None:
        """Append the pose of a tick; -1 is the pose at which the tool was placed."""
        row = self._rows[self._count]
        row[0] = tick
        row[1:4] = motion.tip_m
        row[4:7] = motion.rotation[:, 2]
        row[7:].reshape(2, 3)[:] = motion.heading
        self._count += 1

    @property
    def poses(self) -> NDArray[np.float64]:
        """Poses so far, shape (n, 13): tick, tip [m], axis, heading of the tip and of the pose."""
        return self._rows[: self._count]


class Tick:
    """One tick: motion, removal, force, output, record. Everything it needs is allocated here, once."""

    def __init__(self, parts: Parts, output: Output, layout: TraceLayout, trace: Table, timing: Table) -> None:
        self._motion, self._tissue, self._clear = parts.motion, parts.tissue, parts.keep_clear
        self._background = parts.tissue if isinstance(parts.tissue, StartsBackground) else None
        tissue, self._model_ticks = parts.tissue, parts.motion.model_ticks
        self._rows, self._times = trace.rows, timing.rows
        self.tool = ToolMotion()
        self._response = Response.empty(len(tissue.layer_names))
        lag = output.low_pass_ms * 1e-3
        self._gain = 1.0 - exp(-TICK_S / lag) if lag > 0.0 else 1.0
        self._filtered, self._commanded = np.zeros(6), np.zeros(6)
        passing = parts.cutter.tooth_passing_Hz if parts.cutter is not None else 0.0
        self._vibration = Vibration(passing, share=output.vibration_share, step_s=TICK_S)
        self._at, first = layout, layout.measures.start
        self._tissue_measures = slice(first, first + len(tissue.measure_names))
        moved = self._tissue_measures.stop + len(parts.motion.measure_names)
        self._motion_measures = slice(self._tissue_measures.stop, moved)
        self._clear_measures = slice(moved, layout.measures.stop)
        self._loads = load_columns(trace.columns)
        self._rotation, self._quaternion = b"", np.zeros(4)
        carves = parts.cutter is not None and parts.cutter.spin_rad_s != 0.0
        self._log = PoseLog(len(trace.rows)) if carves else None
        self._balances = carves and parts.motion.balances

    @property
    def poses(self) -> NDArray[np.float64] | None:
        """Poses of a tool that cuts, see `PoseLog`."""
        return self._log.poses if self._log is not None else None

    def place(self, *, resume: bool = False) -> None:
        """Put the tool where the motion starts; what that costs belongs to no tick."""
        self._motion.begin(self.tool)
        if not resume:
            self._tissue.place(self.tool)
        self._keep(-1)
        if self._clear is not None:
            self._clear.measure(self.tool, placed=True)
        self._record(self._rows[0], 0, self._tissue.respond(self.tool))

    def __call__(self, index: int) -> None:
        """Run one tick and record its trace and timings in row `index`."""
        start = perf_counter()
        self._motion.advance(index * TICK_S, TICK_S, self._response, self.tool)
        moved = searched = removed = perf_counter()  # where the model rests, all three stay alike
        response = self._response
        if index % self._model_ticks == 0:
            if self._balances:
                response = self._response = self._balance()
                searched = perf_counter()
            self._tissue.advance(self.tool)
            self._keep(index)
            removed = perf_counter()
            if not self._balances:
                response = self._response = self._tissue.respond(self.tool)
                if self._motion.correct(response, self.tool):
                    self._tissue.advance(self.tool)
                    self._keep(index)
                    response = self._response = self._tissue.respond(self.tool)
        self._motion.play(response)
        if self._clear is not None:
            self._clear.measure(self.tool)
        forced = perf_counter()
        self._filtered += self._gain * (response.wrench - self._filtered)
        np.multiply(self._filtered, 1.0 + self._vibration.factor(index), out=self._commanded)
        self._record(self._rows[index], index, response)
        recorded = perf_counter()
        if self._background is not None:
            self._background.start_background(index * TICK_S, self.tool)
        end = perf_counter()
        self._times[index, : len(TIMING_COLUMNS)] = (
            (end - start) * 1e6,
            (moved - start) * 1e6,
            (removed - searched) * 1e6,
            (forced - removed + searched - moved) * 1e6,
            (recorded - forced) * 1e6,
            (end - recorded) * 1e6,
        )

    def _balance(self) -> Response:
        """Return the force at the pose where it balances what pushes the tool.

        Poses are tried before the bone there is cut: a pose that is not kept must remove nothing. The cutting force
        depends on the bone as it was before the present pass, so that it is the same before and after the cut.
        """
        response = self._tissue.respond(self.tool)
        while self._motion.correct(response, self.tool):
            response = self._tissue.respond(self.tool)
        return response

    def _keep(self, index: int) -> None:
        if self._log is not None:
            self._log.add(index, self.tool)

    def _record(self, row: np.ndarray, index: int, response: Response) -> None:
        """Write one row of the trace, in the units of its columns."""
        tool, at = self.tool, self._at
        if tool.rotation.tobytes() != self._rotation:
            self._rotation = tool.rotation.tobytes()
            self._quaternion[:] = quaternion_of(tool.rotation)
        moved, turned = tool.heading
        row[at.time] = index * TICK_S
        row[at.tip] = 1e3 * tool.tip_m
        row[at.quaternion] = self._quaternion
        row[at.velocity] = (1e3 * tool.speed_m_s) * moved
        row[at.spin] = tool.speed_m_s * turned
        row[at.commanded] = self._commanded
        row[at.wrench] = response.wrench
        row[at.removal_rate] = response.removal_rate_m3_s * 1e9
        row[at.removed_by_layer] = volumes = 1e9 * self._tissue.removed_m3
        row[at.removed] = np.add.reduce(volumes)
        area = np.add.reduce(response.engaged_m2)
        row[at.contact] = area * 1e6
        row[self._tissue_measures] = response.measures
        row[self._motion_measures] = self._motion.measures
        if self._clear is not None:
            row[self._clear_measures] = self._clear.measures
        row[at.layer] = response.engaged_m2.argmax() if area > 0.0 else -1.0
        row[self._loads[np.abs(row[self._loads]) < LEAST_LOAD]] = 0.0
