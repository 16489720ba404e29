"""Loop of a user's device with bone or an organ: tick by tick, or for some seconds."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.errors import (
    InputError,
    require_direction,
    require_positive,
    require_range,
    require_vector,
)
from tissue.cutters import Cutter, ball_burr
from tissue.haptics.device.device import Device, DeviceParameters
from tissue.haptics.device.safe_device import run_held
from tissue.materials.scene_constants import Materials
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import StaysAt
from tissue.objects import loop_parts
from tissue.objects.bone import Bone
from tissue.objects.cut import saved_table
from tissue.objects.cutting import warn_of
from tissue.objects.kept_clear import Structures, clearance_of, refuse_structures
from tissue.objects.loop_parts import (
    bone_met,
    device_note,
    organ_met,
    require_device,
    require_match,
    settings_of,
    start_above,
)
from tissue.objects.organ import Organ
from tissue.objects.simulate import TickRow
from tissue.objects.tools import PressingTool, ball
from tissue.objects.trace import Trace
from tissue.prediction.guard import Observes
from tissue.scene.scene import Output
from tissue.simulation import loop as engine
from tissue.simulation.builders.device_motion import device_motion
from tissue.simulation.builders.force_met import fitted_scale
from tissue.simulation.builders.parts import Parts
from tissue.simulation.live.clock import WallClock
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pandas

__all__ = ["Loop"]

LONGEST_S = 3600.0
"""Longest duration of a loop for which rows are allocated [s]."""


class Loop:
    """Loop of a haptic device, a tool and a tissue, in ticks of 1 ms.

    In every tick the device is read, the tool follows it through a spring, and the tissue responds.
    The force is commanded after prediction, low-pass and the device's limits. The spring is judged
    for stability before the first tick.

    Use it as ``with Loop(...) as loop: row = loop.step()``, or ``loop.run(10.0)``, which opens and
    closes the device itself. The last command to the device is zero, whatever ends the block or the
    run.

    Attributes
    ----------
    notes
        Notes on choices and findings, by subject.
    ticks
        Number of ticks that have run.
    """

    def __init__(
        self,
        tissue: Bone | Organ,
        tool: Cutter | PressingTool | None = None,
        *,
        device: Device,
        limits: str | DeviceParameters | Mapping[str, float] = "touch",
        start_mm: ArrayLike | None = None,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        reach_mm: float = 5.0,
        predictor: str | Observes | None = None,
        predictor_file: str | Path | None = None,
        hand: str = "expert",
        materials: str | PathLike[str] | Materials | None = None,
        renderer: str = "proxy",
        stiffness_N_m: float | None = None,
        force_scale: float | None = None,
        motion_scale: float = 1.0,
        delay_ms: int = 0,
        low_pass_ms: float = 1.0,
        allow_unstable: bool = False,
        longest_s: float = 600.0,
        keep_clear: Structures | None = None,
    ) -> None:
        """Judge the loop and build it.

        Parameters
        ----------
        tissue
            Bone or organ that the tool meets.
        tool
            Cutter for bone, default a ball burr of 4 mm with 6 flutes at 20,000 revolutions a
            minute; pressing tool for an organ, default a ball of 10 mm.
        device
            Object with ``read(time_s)``, which returns a `tissue.Sample` in metres or None, and
            ``command(force_N, torque_Nm)``. A context manager is entered and exited.
        limits
            Name of a known device, `tissue.DeviceParameters`, or a mapping of these numbers.
        start_mm
            Position of the tip when the device is at its own origin [mm]; default 2 mm above the
            middle of the tissue.
        axis
            Direction of the tool from tip to shank; the device's axes are the axes of the tissue.
        reach_mm
            Distance around the tool within which bone is prepared, or from the start within which
            an organ may be touched [mm]. More bone is made when half of the distance is used up;
            that tick takes longer.
        predictor, predictor_file
            Prediction of the force over the latency: a name, or an object with ``observe`` and
            ``predict``. A trained predictor also needs the file that `tissue train` wrote.
        hand
            Hand for which stability is judged: novice, intermediate or expert.
        materials
            File of constants of device and hand, as `tissue fit` writes it.
        renderer
            Law by which the device plays the contact force: proxy, penalty or passivity.
        stiffness_N_m
            Stiffness of the coupling at the device; default half the critical one in that hand.
        force_scale, motion_scale
            Newtons at the device for each newton at the tool, and metres at the tool for each metre
            at the device. The default force scale is 1 for an organ. For bone it brings the force
            in a slot a quarter of the cutter's diameter deep within the device's range.
        delay_ms, low_pass_ms
            Latency added before the device, in whole ticks, and time constant of the low-pass
            before the device [ms].
        allow_unstable
            Whether to run a coupling that is judged unstable.
        longest_s, keep_clear
            Time for which rows are allocated [s]; structures that a cutter must not touch, as for
            `tissue.Bone.cut`.

        Raises
        ------
        InputError
            If an argument cannot be used, or the coupling is unstable and that is not allowed.
        """
        require_device(device)
        if tool is None:
            is_organ = isinstance(tissue, Organ)
            tool = (
                ball(diameter_mm=10)
                if is_organ
                else ball_burr(diameter_mm=4, flutes=6, spin_rpm=20_000)
            )
        require_match(tissue, tool)
        along = require_direction("axis", np.asarray(axis, dtype=np.float64))
        start = (
            start_above(tissue, along)
            if start_mm is None
            else np.asarray(start_mm, dtype=np.float64)
        )
        start_m = 1e-3 * require_vector("start_mm", start)
        reach_m = 1e-3 * require_range("reach_mm", reach_mm, 0.5, 100.0, "use 5")
        constants = Materials.of(materials)
        options = loop_parts.LoopOptions(
            limits=limits,
            hand=hand,
            materials=constants,
            renderer=renderer,
            contact="cuts" if isinstance(tool, Cutter) else "presses",
            low_pass_ms=require_range("low_pass_ms", low_pass_ms, 0.0, 1000.0, "use 1"),
            predictor=predictor,
            predictor_file=predictor_file,
            coupling={
                "stiffness_N_m": stiffness_N_m,
                "motion_scale": motion_scale,
                "delay_ms": delay_ms,
            },
        )
        settings = settings_of(device, options)
        scale = 1.0
        chosen_for = ""
        if force_scale is not None:
            scale = require_positive("force_scale", force_scale, "use 1")
        elif isinstance(tissue, Bone) and isinstance(tool, Cutter):
            usual = loop_parts.usual_force_N(tissue, tool)
            scale = fitted_scale(usual, settings.limits)
            chosen_for = (
                f", chosen for the {usual:.3g} N of a slot a quarter of the cutter deep at 2 mm/s"
            )
        ticks = round(require_range("longest_s", longest_s, TICK_S, LONGEST_S, "use 600") / TICK_S)
        x, y, z = along.tolist()
        with loop_parts.own_names():
            motion, found = device_motion(
                settings,
                StaysAt(start_m, (x, y, z)),
                lambda held, stiffness: device,
                force_scale=scale,
                scale_note=chosen_for,
                device_origin_m=start_m,
                rng=np.random.default_rng(0),
                step_s=TICK_S,
                allow_unstable=allow_unstable,
            )
            if isinstance(tissue, Bone):
                assert isinstance(tool, Cutter)
                model, self._keep_ready = bone_met(tissue, tool, start_m, along, reach_m=reach_m)
                clear = clearance_of(keep_clear, tool)
            else:
                assert isinstance(tool, PressingTool)
                model, self._keep_ready = organ_met(tissue, tool, start_m, along, reach_m=reach_m)
                refuse_structures(keep_clear)
                clear = None
        self.notes = dict(tissue.notes) | device_note(constants, tissue, limits=limits, hand=hand)
        self.notes["coupling"] = "; ".join(found)
        cutter = tool if isinstance(tool, Cutter) else None
        self._motion = motion
        self._most = ticks
        self._closing = ExitStack()
        self._warned = 0
        self._loop = engine.Loop(
            Parts(motion, model, cutter=cutter, keep_clear=clear),
            ticks=ticks,
            output=Output(low_pass_ms=settings.low_pass_ms),
        )
        self._limits = model.limits if isinstance(model, BoneModel) else None
        self._loop.place()
        self._row = TickRow(self._loop.trace.columns)

    @property
    def ticks(self) -> int:
        """Number of ticks that have run."""
        return self._loop.ticks

    def __enter__(self) -> Self:
        self._motion.held.in_process = True
        self._closing.enter_context(self._motion.held)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._closing.__exit__(kind, error, trace)

    def step(self) -> TickRow:
        """Run a tick; return its row of the trace by column, the same object in every tick.

        Raises
        ------
        InputError
            If the device is not held, or all rows are full. If the device fails, the error is a
            `DeviceError`.
        """
        if not self._motion.held.entered:
            raise InputError(
                "loop", "hold its device to step", "one that is not", "use it in `with loop:`"
            )
        if self.ticks == self._most:
            raise InputError(
                "longest_s",
                "hold all ticks",
                f"{TICK_S * self._most:g} s that have run",
                "make the loop with more",
            )
        self._keep_ready(self._motion.tool.tip_m)
        self._loop.wait()
        self._row.values_of_tick = self._loop.trace.rows[self._loop.step()]
        if self._limits is not None and len(self._limits.passed) > self._warned:
            warn_of(list(self._limits.passed.values())[self._warned :])
            self._warned = len(self._limits.passed)
        return self._row

    def run(
        self,
        seconds: float,
        *,
        real_time: bool = False,
        on_tick: Callable[[int, TickRow], object] | None = None,
    ) -> Self:
        """Run for some seconds of simulated time while holding the device; return the loop.

        Parameters
        ----------
        seconds
            Duration [s].
        real_time
            Whether a tick waits until it is due on the wall clock, as needed for a real device.
            Ticks then run in a second thread. A sample more than 1.5 ms late is not used, and a
            device without a command for 50 ms receives zero force.
        on_tick
            Called after every tick with its number and its row; the run ends if it returns False.
        """
        count = round(require_range("seconds", seconds, TICK_S, LONGEST_S, "use 10") / TICK_S)
        clock = WallClock(TICK_S) if real_time else None
        self._motion.held.in_process = not real_time or bool(
            getattr(self._motion.device, "in_process", False)
        )

        def go_through() -> None:
            """Run the ticks."""
            for index in range(count):
                if clock is not None:
                    clock.wait(index)
                row = self.step()
                if on_tick is not None and on_tick(self.ticks - 1, row) is False:
                    return

        with engine.undisturbed():
            if self._motion.held.entered:
                go_through()
            else:
                run_held(go_through, self._motion.held)
        return self

    @property
    def trace(self) -> Trace:
        """Trace of the ticks so far, one row each: ``loop.trace["device_force_z_N"]``."""
        whole = self._loop.trace
        return Trace(Table(whole.columns, whole.rows[: self.ticks], whole.layer_names))

    @property
    def events(self) -> list[tuple[float, str]]:
        """Events: time [s] and a sentence each."""
        return sorted(self._loop.events + self._motion.happened(), key=lambda event: event[0])

    @property
    def tick_us(self) -> Any:
        """Duration of each tick [µs], shape (n,)."""
        return self._loop.timing["tick_us"][: self.ticks]

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the ticks so far as a table, one row each."""
        return self.trace.to_pandas()

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the ticks so far to a file in the format of its suffix.

        The suffixes are .csv, .mat, .npz, .parquet and .h5.
        """
        return saved_table(self.trace, path, overwrite=overwrite)

    def __repr__(self) -> str:
        return (
            f"Loop({type(self._motion.device).__name__}, {self.ticks} ticks; "
            f"{self.notes['coupling']})"
        )
