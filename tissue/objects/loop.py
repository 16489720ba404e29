"""Simulation of a tool in a tissue, tick by tick; a program or a haptic device moves the tool."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import (
    InputError,
    names_of_caller,
    require_direction,
    require_range,
    require_vector,
)
from meshes.base.hints import suggests_arguments
from tissue.cutters import Cutter
from tissue.haptics.device.device import Device
from tissue.haptics.device.safe_device import run_held
from tissue.haptics.hand_motion import HandMotion
from tissue.models.bone.law_limits import LawLimits
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import TICK_S, HasVoxels, TissueModel
from tissue.models.tooth.model import ToothModel
from tissue.motion.motion import Events, StaysAt
from tissue.objects.bone import Bone
from tissue.objects.cutting import Structures, clearance_of, saved_table, warn_of
from tissue.objects.loop_settings import (
    LONGEST_S,
    JudgedDevice,
    LoopOptions,
    checked_tool,
    extent,
    judged_device,
    made_from_of,
    region,
    start_above,
    tissue_of,
)
from tissue.objects.organ import Organ
from tissue.objects.part_checks import leave_out
from tissue.objects.press import organ_around
from tissue.objects.simulate import TickRow
from tissue.objects.tools import PressingTool
from tissue.objects.trace import Trace
from tissue.scene.scene import OWN_DISTANCES, Scene
from tissue.scene.tool import Tool
from tissue.simulation import loop as engine
from tissue.simulation.builders.arguments import require_known
from tissue.simulation.builders.parts import Parts
from tissue.simulation.observer import WallClock
from tissue.simulation.posed import PosedSession, Region, Snapshot, posed_parts, scene_arguments
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pandas
    import pyvista

    from tissue.models.organ.model import OrganModel


@suggests_arguments
class Loop:
    """Simulation of a tool in a tissue, in ticks of 1 ms; a program or a device moves the tool.

    Without a device a program moves the tool: ``wrench = loop.step(pose)`` moves the tool to a pose
    and returns the force and torque on the tool. The tool follows the given poses exactly.
    `snapshot` returns a copy of the state, and `restore` loads such a copy. `reset` returns to the
    initial state. After `restore`, the same poses give bit-identical forces.

    With a device, use ``with Loop(...) as loop: row = loop.step()`` or ``loop.run(10.0)``. In each
    tick the loop reads the device, the tool follows the device through a spring, and the tissue
    responds. The predictor, the low-pass filter and the limits of the device are applied to the
    force before it is sent to the device. The stability of the coupling is checked before the first
    tick. At the end, zero force is sent to the device, even after an error.

    Attributes
    ----------
    notes
        Notes on automatic choices and on limits of the model, keyed by subject.
    ticks
        Number of ticks that have run.
    """

    def __init__(
        self,
        tissue: Bone | Organ | Scene | str,
        tool: Cutter | PressingTool | None = None,
        *,
        device: Device | None = None,
        start_mm: ArrayLike | None = None,
        axis: ArrayLike | None = None,
        reach_mm: float | None = None,
        longest_s: float = 600.0,
        keep_clear: Structures | None = None,
        step_ms: int = 1,
        cores: int | None = None,
        **options: Unpack[LoopOptions],
    ) -> None:
        """Build the loop; with a device, check the stability of the coupling first.

        Parameters
        ----------
        tissue
            Bone or organ that the tool works on; or a scene, or the name of a scene. A scene
            contains its own tool, start position and structures to keep clear of.
        tool
            For bone a cutter, default a ball burr of 4 mm with 6 flutes at 20,000 revolutions per
            minute. For an organ a pressing tool, default a ball of 10 mm.
        device
            Object with ``read(time_s)``, which returns a `tissue.Sample` in metres or None, and
            ``command(force_N, torque_Nm)``. If the object is a context manager, the loop enters and
            exits it. None if the tool is moved by `step`. A device needs a bone or an organ. For a
            scene, use ``tissue.simulate(scene, device=...)``.
        start_mm
            Position of the tip at the start [mm], shape (3,). The origin of the device corresponds
            to this position. The default is 2 mm above the middle of the tissue. Above a curved
            organ, the default is farther away if the tool would touch the organ there.
        axis
            Direction of the tool from tip to shank; default z. The axes of the device are parallel
            to those of the tissue.
        reach_mm
            For bone: distance around the tool within which bone is prepared [mm]; default 5. When
            the tool has moved by half of this distance, bone around the new position is prepared;
            that tick takes longer. For an organ: distance from the start position within which the
            tool may touch the organ; default 5. For a scene: distance of the prepared tissue from
            the scene's path, perpendicular to the tool's axis; default 2. The deepest point of the
            path limits the depth of the prepared tissue. For an organ or a scene, tissue is
            prepared only once, at the start.
        longest_s
            Time for which rows of the trace are allocated [s]. With a device, the loop stops when
            all rows are used. Without a device, the newest rows then replace the oldest rows.
        keep_clear
            Structures that a cutter must not touch, as for `tissue.Bone.cut`.
        step_ms
            Duration of a step without a device [ms], 1 to 1000. In a step of several ticks, the
            tool moves along a straight line. A curved path is therefore replaced by chords.
        cores
            Number of processor cores for a scene; default all. The result does not depend on this
            number.
        limits
            Limits of the device: name of a known device, `tissue.DeviceParameters`, or a mapping of
            these parameters; default ``touch``. This option and all following options need a
            device.
        predictor, predictor_file
            Predictor that compensates the latency of the force: a name, or an object with the
            methods ``observe`` and ``predict``. A trained predictor also needs the file that
            `tissue train` wrote.
        hand
            Model of the user's hand, for the stability check: ``novice``, ``intermediate`` or
            ``expert``; default expert.
        materials
            File with constants of the device and the hand, in the format that `tissue fit` writes.
        renderer
            Rendering law that converts contact of the tool into a force at the device: ``proxy``,
            ``penalty`` or ``passivity``; default proxy.
        stiffness_N_m
            Stiffness of the spring between device and tool [N/m]; default half of the critical
            stiffness, above which the coupling with this hand is unstable.
        force_scale, motion_scale
            Force at the device [N] for each newton at the tool, and displacement of the tool [m]
            for each metre at the device. The default motion scale is 1. The default force scale is
            1 for an organ. For bone, the default force scale brings the force of a typical cut into
            the range of the device. This cut is a slot whose depth is a quarter of the cutter's
            diameter.
        delay_ms, low_pass_ms
            Latency that is added to the force [ms], in whole ticks, default 0. Time constant of the
            low-pass filter for the force [ms], default 1.
        allow_unstable
            Whether to run even if the stability check predicts an unstable coupling.

        Raises
        ------
        InputError
            If an argument cannot be used, or the coupling is unstable and `allow_unstable` is not
            set.
        """
        require_known(options, LoopOptions, of="Loop")
        tissue = tissue_of(tissue)
        self._most, ticks, reach_m = extent(
            is_scene=isinstance(tissue, Scene),
            longest_s=longest_s,
            step_ms=step_ms,
            reach_mm=reach_mm,
        )
        self._of = tissue.name if isinstance(tissue, Scene) else type(tissue).__name__
        self._closing = ExitStack()
        self._warned = set[str]()
        self._device: HandMotion | None = None
        self._session: PosedSession | None = None
        self._organ: OrganModel | None = None
        self._keep_ready: Callable[[Array], None] | None = None
        judged: JudgedDevice | None = None
        prepared: Region | None = None
        if isinstance(tissue, Scene):
            if device is not None:
                raise InputError(
                    "tissue.Loop couples a device to a bone or an organ, but not to a scene. For a "
                    "scene, use tissue.simulate(scene, device=...)"
                )
            given = {"tool": tool, "start_mm": start_mm, "axis": axis}
            leave_out(given | options, "with a scene")
            case = "with a scene"
            remedy = "name the structures in the table [keep_clear] of the scene"
            if not isinstance(tissue.tool, Tool):
                case = f"for a {tissue.tool.kind}"
                remedy = OWN_DISTANCES
            leave_out({"keep_clear": keep_clear}, case, remedy=remedy)
            made_from = scene_arguments(tissue)
            parts, prepared = posed_parts(tissue, reach_m=reach_m, cores=cores)
            self.notes = parts.notes
        else:
            leave_out({"cores": cores}, "without a scene")
            along = require_direction("axis", (0.0, 0.0, 1.0) if axis is None else axis)
            fitting = checked_tool(tissue, tool, keep_clear)
            above = start_above(tissue, fitting, along) if start_mm is None else start_mm
            start_m = 1e-3 * require_vector("start_mm", above)
            if device is None:
                leave_out(options, "without a device")
            elif ticks != 1:
                raise InputError("step_ms", "be 1 with a device", step_ms, "leave it out")
            else:
                judged = judged_device(device, tissue, fitting, start_m, along, options)
                self._device = judged.motion
            # The tissue is prepared after the check, so a refused coupling leaves the bone
            # unchanged.
            parts = self._prepared(tissue, fitting, start_m, along, reach_m, keep_clear)
            made_from = made_from_of(tissue, fitting, keep_clear)
            self.notes = dict(tissue.notes)
            if self._organ is not None:
                prepared = region(start_m, along, reach_m)
        if judged is None:
            self._session = PosedSession(
                parts,
                ticks=ticks,
                rows=self._most,
                made_from=made_from,
                keep_ready=self._keep_ready,
                region=prepared,
            )
            self._loop = self._session.loop
        else:
            self.notes |= judged.notes
            parts.motion = judged.motion
            self._loop = engine.Loop(parts, ticks=self._most, output=judged.output)
            with names_of_caller({"motion": "start_mm"}):
                self._loop.place()
        self._limits = _limits_of(self._loop.parts.tissue)
        self._row = TickRow(self._loop.trace.columns, self._loop.trace.layer_names)
        self._row.values_of_tick = self._loop.trace.rows[0]

    def _prepared(
        self,
        tissue: Bone | Organ,
        tool: Cutter | PressingTool,
        start_m: Array,
        along: Array,
        reach_m: float,
        keep_clear: Structures | None,
    ) -> Parts:
        """Return the objects of a run, with the tissue prepared near the tool's start position."""
        motion = StaysAt(start_m, along)
        if isinstance(tissue, Bone):
            assert isinstance(tool, Cutter)
            model, self._keep_ready = tissue.voxel_bone.around(
                tool, start_m, along, reach_m=reach_m
            )
            return Parts(motion, model, cutter=tool, keep_clear=clearance_of(keep_clear, tool))
        assert isinstance(tool, PressingTool)
        from tissue.simulation.builders.organ_scene import require_outside

        with names_of_caller({"motion": "start_mm"}):
            require_outside(tissue.soft.mesh, motion)
        self._organ = organ_around(tissue.soft, tool, start_m, along, reach_m=reach_m)
        # With a device, ticks must not wait for the solution of a law; see `run`.
        self._organ.waits = self._device is None
        return Parts(motion, self._organ)

    @property
    def ticks(self) -> int:
        """Number of ticks that have run."""
        return self._loop.ticks

    @property
    def row(self) -> TickRow:
        """Values of the last tick, keyed by column of the trace; the next tick overwrites them."""
        return self._row

    def __enter__(self) -> Self:
        if self._device is not None:
            self._device.held.in_process = True
            self._closing.enter_context(self._device.held)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._closing.__exit__(kind, error, trace)

    @overload
    def step(self) -> TickRow: ...
    @overload
    def step(self, pose: ArrayLike, velocity: ArrayLike | None = None) -> Array: ...
    def step(
        self, pose: ArrayLike | None = None, velocity: ArrayLike | None = None
    ) -> TickRow | Array:
        """Move the tool to a pose in one step; with a device, run one tick instead.

        Parameters
        ----------
        pose
            Pose of the tool at the end of the step, in the frame of the tissue. Three forms are
            accepted: a tip position [mm], shape (3,), which keeps the orientation; a tip position
            and a quaternion (x, y, z, w), shape (7,); or a homogeneous matrix, shape (4, 4). The z
            axis of the tool points from tip to shank. Leave out the pose if there is a device. The
            first pose has the time 0 in the trace. In a run of a scene, the start of the path has
            the time 0. To get the same times as in a run of the scene, give the start of its path
            as the first pose.
        velocity
            Velocity of the tip [mm/s], shape (3,), or velocity and angular velocity [rad/s] in one
            array, shape (6,). The default is the change of the pose divided by the duration of the
            step. The velocity matters for cutting: the cutting force depends on it and is zero for
            a tool at rest.

        Returns
        -------
        TickRow or array
            Without a device: the wrench at the end of the step, shape (6,). The wrench contains the
            force on the tool [N] and the torque about the tip [N m], in the frame of the tissue.
            With a device: a mapping with the values of the trace in this tick. The next tick
            overwrites the mapping.

        Raises
        ------
        InputError
            If the pose is invalid, if a loop with a device is used outside a ``with`` block, or if
            the trace is full. If the device fails, the error is a `DeviceError`.
        """
        if self._session is not None:
            if pose is None:
                raise InputError("pose", "be given without a device", "none", "give a pose")
            wrench = self._session.step(pose, velocity)
            self._show()
            return wrench
        assert self._device is not None
        if pose is not None or velocity is not None:
            raise InputError("pose", "be left out with a device", "a pose", "remove it")
        if not self._device.held.entered:
            raise InputError(
                "loop",
                "be open before a step with a device",
                "a loop that is not open",
                "call step inside `with loop:`",
            )
        if self.ticks == self._most:
            raise InputError(
                "longest_s",
                "be at least the duration of all steps",
                f"{TICK_S * self._most:g} s, which is used up",
                "make the loop with a larger longest_s",
            )
        if self._keep_ready is not None:
            self._keep_ready(self._device.tool.tip_m)
        self._loop.wait()
        self._loop.step()
        self._show()
        return self._row

    def _show(self) -> None:
        """Update `row`, and warn if the tool exceeded the limits of the cutting law."""
        self._row.values_of_tick = self._loop.trace.rows[(self.ticks - 1) % self._most]
        if self._limits is None:
            return
        passed = self._limits.exceeded
        # A reset clears the limits, but there is only one warning for each limit.
        if not passed.keys() <= self._warned:
            warn_of([what for about, what in passed.items() if about not in self._warned])
            self._warned |= passed.keys()

    def reset(self, pose: ArrayLike | None = None) -> None:
        """Restore the initial state of the tissue, and set the time to 0.

        Parameters
        ----------
        pose
            New pose of the tool, as for `step`; default the start pose.

        Raises
        ------
        InputError
            If a device moves the tool, or the pose lies inside a soft tissue.
        """
        self._posed("reset").reset(pose)
        self._row.values_of_tick = self._loop.trace.rows[0]

    def snapshot(self) -> Snapshot:
        """Return a copy of the state, which can be pickled.

        Raises
        ------
        InputError
            If a device moves the tool, or if a user-defined tissue does not support snapshots.
        """
        return self._posed("snapshot").snapshot()

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot of this loop, or of another loop made with the same arguments.

        Rows of the trace after the time of the snapshot are removed.

        Raises
        ------
        InputError
            If tissue, tool, step duration or constants of the snapshot's loop differ from those of
            this loop, or if the snapshot needs bone whose voxels this loop has not made.
        """
        self._posed("restore").restore(snapshot)
        self._row.values_of_tick = self._loop.trace.rows[max(self.ticks - 1, 0) % self._most]

    def _posed(self, method: str) -> PosedSession:
        """Return the session that moves the tool to poses; raise an error with a device."""
        if self._session is None:
            raise InputError(method, "be used without a device", "a device", "leave device out")
        return self._session

    def run(
        self,
        seconds: float,
        *,
        real_time: bool = False,
        on_tick: Callable[[int, TickRow], object] | None = None,
    ) -> Self:
        """Open the device, run for a duration of simulated time, and return the loop.

        Parameters
        ----------
        seconds
            Duration [s].
        real_time
            Whether each tick waits until it is due on the wall clock. A real device needs this. The
            ticks then run in a second thread. If the tissue is hyperelastic, its deformation is
            solved in a third thread. If a read of the device takes longer than 2.5 ms, the tick has
            no device sample. If the device gets no command for 50 ms, it receives zero force. If
            `real_time` is False, the ticks wait for the solution of the hyperelastic deformation.
        on_tick
            Function that is called after every tick with the number of the tick and its row of the
            trace. The run ends if the function returns False.
        """
        device = self._device
        if device is None:
            raise InputError("run", "have a device", "no device", "move the tool by step(pose)")
        count = round(
            require_range("seconds", seconds, TICK_S, LONGEST_S, "use a value such as 10") / TICK_S
        )
        clock = WallClock() if real_time else None
        if self._organ is not None:
            self._organ.waits = not real_time
        device.held.in_process = not real_time or bool(getattr(device.device, "in_process", False))

        def go_through() -> None:
            """Run the ticks."""
            for index in range(count):
                if clock is not None:
                    clock.wait(index)
                row = self.step()
                if on_tick is not None and on_tick(self.ticks - 1, row) is False:
                    return

        with engine.undisturbed():
            if device.held.entered:
                go_through()
            else:
                run_held(go_through, device.held)
        return self

    @property
    def trace(self) -> Trace:
        """Trace of the ticks so far, one row per tick: ``loop.trace["device_force_z_N"]``."""
        whole = self._loop.trace
        return Trace(Table(whole.columns, self._in_order(whole.rows), whole.layer_names))

    def _in_order(self, rows: Array) -> Array:
        """Return the rows of the ticks so far, the oldest first."""
        if self.ticks <= self._most:
            return rows[: self.ticks]
        return np.roll(rows, -(self.ticks % self._most), axis=0)

    @property
    def events(self) -> Events:
        """Events, each with a time [s] and a sentence."""
        return sorted(
            self._loop.events + self._loop.parts.motion.happened(), key=lambda event: event[0]
        )

    @property
    def tick_us(self) -> Any:
        """Computing time of each tick in the trace [µs], shape (n,)."""
        return self._in_order(self._loop.timing["tick_us"])

    def surface(self) -> "pyvista.PolyData":
        """Return the current surface of a scene's bone or tooth [mm], with cell data ``layer``.

        For a `tissue.Bone`, use `tissue.Bone.surface`. Do not call this method from `on_tick` in
        real time: it takes up to 1 s.

        Raises
        ------
        InputError
            If the scene has no voxels.
        """
        from tissue.simulation.bone_surface import bone_surface, with_layers

        parts = self._loop.parts
        if parts.volume is None or not isinstance(parts.tissue, HasVoxels):
            raise InputError(
                "surface",
                "belong to a scene with voxels",
                "a scene without voxels",
                "use tissue.Bone.surface for the surface of a bone",
            )
        return with_layers(bone_surface(parts.volume, parts.tissue.remaining()), parts.volume)

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the trace as a table, one row per tick."""
        return self.trace.to_pandas()

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the trace to a file; the suffix of the file name selects the format.

        The suffixes are .csv, .mat, .npz, .parquet and .h5.
        """
        return saved_table(self.trace, path, overwrite=overwrite)

    def __repr__(self) -> str:
        return (
            f"Loop({self._of}, {self.ticks} ticks; {self.notes.get('coupling', 'moved by step')})"
        )


def _limits_of(model: TissueModel) -> LawLimits | None:
    """Return the range of validity of the cutting law; None if the tissue is no bone or tooth."""
    milling = model.milling if isinstance(model, ToothModel) else model
    return milling.limits if isinstance(milling, BoneModel) else None
