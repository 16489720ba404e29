"""Loop of a user's device with bone or an organ: tick by tick, or for some seconds."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from copy import deepcopy
from dataclasses import fields
from functools import partial
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import (
    InputError,
    by,
    names_of_caller,
    require_direction,
    require_positive,
    require_range,
    require_vector,
)
from meshes.base.text_tables import unknown_name
from tissue.cutters import Cutter, ball_burr
from tissue.haptics.device.device import Device, DeviceParameters, device_parameters
from tissue.haptics.device.safe_device import run_held
from tissue.haptics.hand_motion import Script
from tissue.materials.scene_constants import Materials
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import TICK_S, TissueModel
from tissue.motion.motion import StaysAt
from tissue.objects.bone import Bone
from tissue.objects.cut import saved_table
from tissue.objects.cutting import Structures, clearance_of, warn_of
from tissue.objects.organ import Organ
from tissue.objects.press import organ_around
from tissue.objects.simulate import TickRow
from tissue.objects.tools import PressingTool, ball
from tissue.objects.trace import Trace
from tissue.prediction.guard import GuardedMaker, Observes
from tissue.scene.coupling import Coupling
from tissue.scene.coupling import Device as StatedDevice
from tissue.scene.registry import PREDICTORS
from tissue.scene.scene import Output
from tissue.scene.used_constants import used_of_device
from tissue.simulation import loop as engine
from tissue.simulation.builders.arguments import given_note, require_known, stated
from tissue.simulation.builders.force_met import Met, Series, scale_for, slot_force_N
from tissue.simulation.builders.hand import device_motion
from tissue.simulation.builders.loop import LoopSettings, sampled
from tissue.simulation.builders.parts import Parts, require_device, require_stated_rate
from tissue.simulation.observer import WallClock
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pandas

    from tissue.models.organ.model import LiverModel

__all__ = ["Loop"]


LONGEST_S = 3600.0
"""Longest duration of a loop for which rows are allocated [s].

An hour of 60 columns takes 1.7 GB.
"""
CLEARANCE_MM = 2.0
"""Default height of the tool above the surface at the start [mm]."""
ARGUMENTS = {
    **{f"coupling.{key}": key for key in Coupling.model_fields},
    "output.low_pass_ms": "low_pass_ms",
    "prediction": "predictor",
    "kind": "limits",
}
"""Arguments of `Loop` by the keys of a scene that errors name."""


class LoopOptions(TypedDict, total=False):
    """Options of the part between device and tool; see `Loop`."""

    limits: str | DeviceParameters | Mapping[str, float]
    predictor: str | Observes | None
    predictor_file: str | Path | None
    hand: str
    materials: str | PathLike[str] | Materials | None
    renderer: str
    stiffness_N_m: float | None
    force_scale: float | None
    motion_scale: float
    delay_ms: int
    low_pass_ms: float
    allow_unstable: bool


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
        start_mm: ArrayLike | None = None,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        reach_mm: float = 5.0,
        longest_s: float = 600.0,
        keep_clear: Structures | None = None,
        **options: Unpack[LoopOptions],
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
        start_mm
            Position of the tip when the device is at its own origin [mm]; default 2 mm above the
            middle of the tissue.
        axis
            Direction of the tool from tip to shank; the device's axes are the axes of the tissue.
        reach_mm
            Distance around the tool within which bone is prepared, or from the start within which
            an organ may be touched [mm]. More bone is made when half of the distance is used up;
            that tick takes longer.
        longest_s, keep_clear
            Time for which rows are allocated [s]; structures that a cutter must not touch, as for
            `tissue.Bone.cut`.
        limits
            Name of a known device, `tissue.DeviceParameters`, or a mapping of these numbers;
            default touch.
        predictor, predictor_file
            Prediction of the force over the latency: a name, or an object with ``observe`` and
            ``predict``. A trained predictor also needs the file that `tissue train` wrote.
        hand
            Hand for which stability is judged: novice, intermediate or expert, the default.
        materials
            File of constants of device and hand, as `tissue fit` writes it.
        renderer
            Law by which the device plays the contact force: proxy, the default, penalty or
            passivity.
        stiffness_N_m
            Stiffness of the coupling at the device; default half the critical one in that hand.
        force_scale, motion_scale
            Newtons at the device for each newton at the tool, and metres at the tool for each metre
            at the device, default 1. The default force scale is 1 for an organ. For bone it brings
            the force in a slot a quarter of the cutter's diameter deep within the device's range.
        delay_ms, low_pass_ms
            Latency added before the device, in whole ticks, and time constant of the low-pass
            before the device [ms], default 0 and 1.
        allow_unstable
            Whether to run a coupling that is judged unstable.

        Raises
        ------
        InputError
            If an argument cannot be used, or the coupling is unstable and that is not allowed.
        """
        require_known(options, LoopOptions, of="Loop")
        if isinstance(device, type):
            name = device.__name__
            raise InputError("device", "be an object", f"the class {name}", f"give {name}()")
        require_device(device)
        if not isinstance(tissue, Bone | Organ):
            raise InputError(
                "tissue", "be a Bone or an Organ", type(tissue).__name__, "make one of these"
            )
        along = require_direction("axis", np.asarray(axis, dtype=np.float64))
        start = _start_above(tissue, along) if start_mm is None else start_mm
        start_m = 1e-3 * require_vector("start_mm", np.asarray(start, dtype=np.float64))
        reach_m = 1e-3 * require_range("reach_mm", reach_mm, 0.5, 100.0, "use 5")
        longest = require_range("longest_s", longest_s, TICK_S, LONGEST_S, "use 600")
        self._most = round(longest / TICK_S)
        constants = Materials.of(options.get("materials"))
        with names_of_caller(ARGUMENTS):
            settings = _settings(device, options, constants, cuts=isinstance(tissue, Bone))
        scale = options.get("force_scale")
        scale_note = ""
        cutter: Cutter | None = None
        probe: PressingTool | None = None
        if isinstance(tissue, Bone):
            # Sizes of a burr and of a fingertip's ball, for a first try without a tool.
            burr = tool or ball_burr(diameter_mm=4, flutes=6, spin_rpm=20_000)
            tissue.require_cutter(burr)
            assert isinstance(burr, Cutter)
            cutter = burr
            if scale is None:
                usual_N = slot_force_N(tissue.voxel_bone, cutter)
                series = Series.of(settings.limits, settings.constants)
                scale = scale_for(Met(usual_N), settings.limits, series)
                scale_note = (
                    f", chosen for the {usual_N:.3g} N of a slot a quarter of the cutter deep at "
                    "2 mm/s"
                )
        else:
            if keep_clear:
                raise InputError(
                    "keep_clear", "be left out for an organ", "structures", "use it in bone"
                )
            pressing = tool or ball(diameter_mm=10)
            if not isinstance(pressing, PressingTool):
                raise InputError(
                    "tool", "press an organ", type(tool).__name__, "make one by tissue.ball"
                )
            probe = pressing
        x, y, z = along.tolist()
        script = Script(
            motion=StaysAt(start_m, (x, y, z)),
            motion_scale=settings.coupling.motion_scale,
            device_origin_m=start_m,
        )
        with names_of_caller(ARGUMENTS):
            self._motion, found = device_motion(
                settings,
                script,
                lambda held, stiffness: device,
                force_scale=(
                    require_positive("force_scale", 1.0 if scale is None else scale, "use 1"),
                    scale_note,
                ),
                # Only a perception draws, and a caller's loop has none.
                rng=np.random.default_rng(0),
                allow_unstable=options.get("allow_unstable", False),
            )
        # A refused coupling leaves the bone as it was: the tissue is prepared after the judgement.
        clear = None
        model: TissueModel
        self._organ: LiverModel | None = None
        if isinstance(tissue, Bone):
            assert cutter is not None
            model, self._keep_ready = tissue.voxel_bone.around(
                cutter, start_m, along, reach_m=reach_m
            )
            clear = clearance_of(keep_clear, cutter)
        else:
            assert probe is not None
            self._organ = organ_around(tissue.soft, probe, start_m, along, reach_m=reach_m)
            # The caller's own clock may not wait for a solve of a law; see `run`.
            self._organ.waits = False
            model = self._organ
            self._keep_ready = lambda tip_m: None
        self.notes = dict(tissue.notes) | _constants_note(constants, tissue, options)
        self.notes["coupling"] = "; ".join(found)
        self._closing = ExitStack()
        self._warned = 0
        parts = Parts(self._motion, model, cutter=cutter, keep_clear=clear)
        self._loop = engine.Loop(parts, ticks=self._most, output=settings.output)
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
            Ticks then run in a second thread, and a law of large strains is solved in a third one.
            Without real time the ticks wait for a law. A sample more than 1.5 ms late is not used,
            and a device without a command for 50 ms receives zero force.
        on_tick
            Called after every tick with its number and its row; the run ends if it returns False.
        """
        count = round(require_range("seconds", seconds, TICK_S, LONGEST_S, "use 10") / TICK_S)
        clock = WallClock(TICK_S) if real_time else None
        if self._organ is not None:
            self._organ.waits = not real_time
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


def _start_above(tissue: Bone | Organ, axis: Array) -> Array:
    """Return a tip above the middle of a bone or an organ, along the tool's axis [mm]."""
    surface = tissue.surface()
    low, high = np.array(surface.bounds).reshape(3, 2).T
    middle = 0.5 * (low + high)
    size = float(np.linalg.norm(high - low))
    found, _ = surface.ray_trace(middle + size * axis, middle - size * axis, first_point=True)
    if np.size(found) == 0:
        raise InputError(
            "start_mm",
            f"be given where nothing lies under the middle {by(middle, '.4g')} mm",
            "none",
            "give a place above the surface",
        )
    return np.asarray(found, dtype=np.float64).reshape(-1, 3)[0] + CLEARANCE_MM * axis


def _settings(
    device: Device, options: LoopOptions, constants: Materials, *, cuts: bool
) -> LoopSettings:
    """Return the settings between a device and a tool, from a caller's options."""
    given = options.get("limits", "touch")
    limits = sampled(_limits(given, constants))
    require_stated_rate(device, limits, remedy="give this rate_Hz by limits")
    predictor = options.get("predictor")
    file = options.get("predictor_file")
    name = predictor if isinstance(predictor, str) else None
    own_predictor = None
    if isinstance(predictor, type):
        kind = predictor.__name__
        raise InputError("predictor", "be an object", f"the class {kind}", f"give {kind}()")
    if file is not None and name is None:
        raise InputError(
            "predictor_file", "come with a predictor's name", repr(predictor), "name one"
        )
    if predictor is not None and name is None:
        guarded = GuardedMaker(type(predictor).__name__, lambda: deepcopy(predictor))
        own_predictor = partial(guarded, None, limits.force_limit_N)
    coupling = {key: options.get(key) for key in ("stiffness_N_m", "motion_scale", "delay_ms")}
    is_trained = name is not None and name in PREDICTORS and PREDICTORS[name].trained
    if is_trained:
        if file is None:
            raise InputError(
                "predictor_file",
                f"be given for the predictor {name}",
                "nothing",
                "give the file that `tissue train SCENE --out FILE` wrote",
            )
        coupling["predictor_file"] = str(file)
    held = {
        # Numbers without a name: the name is not used.
        "kind": given if isinstance(given, str) else "touch",
        "hand": options.get("hand"),
        "renderer": options.get("renderer"),
        "prediction": name,
        "coupling": stated(Coupling, coupling),
    }
    return LoopSettings(
        stated(StatedDevice, held),
        stated(Output, {"low_pass_ms": options.get("low_pass_ms")}),
        type(device).__name__,
        limits,
        constants,
        "cuts" if cuts else "presses",
        own_predictor=own_predictor,
    )


def _limits(
    given: str | DeviceParameters | Mapping[str, float], constants: Materials
) -> DeviceParameters:
    """Return the parameters of a device from its name, themselves or a mapping."""
    if isinstance(given, str):
        return device_parameters(given, constants)
    if isinstance(given, Mapping):
        known = [each.name for each in fields(DeviceParameters)]
        if unknown := [name for name in given if name not in known]:
            raise InputError(unknown_name("limits", known, str(unknown[0])))
        try:
            return DeviceParameters(**given)
        except TypeError:
            raise InputError(
                "limits", "give mass_kg and damping_N_s_m", "neither or one", "add both"
            ) from None
    if isinstance(given, DeviceParameters):
        return given
    raise InputError(
        "limits",
        "be a device's name, tissue.DeviceParameters or a mapping of its numbers",
        type(given).__name__,
        "give one of these",
    )


def _constants_note(given: Materials, tissue: Bone | Organ, options: LoopOptions) -> dict[str, str]:
    """Return a note on the constants of a named device and of the hand that come from a file."""
    limits = options.get("limits", "touch")
    layers = tissue.layer_names if isinstance(tissue, Bone) else ()
    kind = limits if isinstance(limits, str) else None
    used = used_of_device(given, kind, options.get("hand", "expert"))
    found = given_note(given, used, layers=layers, by="loop")
    return {f"{name} of device and hand": note for name, note in found.items()}
