"""Recordings of runs with simulated hands, on which force predictors are trained."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import silent
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand_measures import TRUE
from tissue.haptics.hand_motion import HandMotion
from tissue.haptics.loop.filters import OBSERVER_MEMORY, VELOCITY_MEMORY, ConstantAcceleration
from tissue.models.tissue_model import TissueModel
from tissue.prediction.delays import (
    DELAYS,
    HORIZON,
    coordinates,
)
from tissue.prediction.predictor import Contact
from tissue.scene.coupling import WallAnatomy
from tissue.scene.load import changed
from tissue.scene.registry import GROUPS
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.builders.hand import hand_motion
from tissue.simulation.builders.loop import judged_loop, loop_settings
from tissue.simulation.builders.parts import Parts, motion_of
from tissue.simulation.loop import Stepper
from tissue.simulation.reference_force import ideal_scene, rendered_force_N
from tissue.simulation.simulate import TICK_S, build

IDEAL_SHARE = 0.25
"""Weight of the ideal force in the training targets of predictors, if the tool does not cut.

The ideal force is the force of a haptic loop without delay, encoder steps and filters. The weight
was chosen in the scene ``needle``. There, the excess error of predictions 4 ms ahead, relative to
zero-order hold, is 0.80 with a weight of 0, 0.57 with 0.25, and 0.94 with 0.5. With larger weights,
the predicted force differs more from the measured force, and the guard of the predictor replaces
the prediction. For a cutting tool, the ideal force is not used, because it belongs to another cut
than the recorded force. In the scene ``caries``, this target makes predictions worse.
"""
DELAYS_MS = (0, 4, 8)
"""Latencies of the haptic loop [ms], which the training runs use in turn.

Several latencies are used, because a hand moves differently if the force is delayed.
"""


@dataclass(frozen=True)
class Recording:
    """Measured and exact data of a run, one row per tick, for the training of predictors.

    Attributes
    ----------
    position_m, velocity_m_s
        Device position [m] that the encoders measure, and device velocity [m/s] that a filter
        estimates from it, each of shape (n, 3).
    force_N
        Force [N], shape (n, 3), that the device would apply without delay.
    contact
        Contact data that predictors receive, one entry for each tick.
    group, seed
        Expertise group of the hand, and seed of the run.
    true_position_m
        Exact position of the device [m], without encoder steps, shape (n, 3). None if it is
        unknown.
    ideal_N
        Ideal force [N], shape (n, 3): the force that a loop without delay, encoder steps and
        filters gives on the same device path. None if it was not computed.
    """

    position_m: Array
    velocity_m_s: Array
    force_N: Array
    contact: Sequence[Contact]
    group: str
    seed: int
    true_position_m: Array | None = None
    ideal_N: Array | None = None

    def samples(self) -> tuple[Array, Array]:
        """Return training inputs (n, COORDINATES, 3) and targets (n, 2 HORIZON, 3).

        The n rows are the ticks for which all targets are known. Before the first tick, the device
        is assumed to be at rest. All targets are in metres.

        The first HORIZON targets are the displacements from the measured device position to the
        true device positions 1 to HORIZON ticks later.

        The other targets are changes of the stretch of the coupling spring from the present tick to
        later ticks. The stretch is the force divided by the spring stiffness. For later ticks, the
        stretch is the vector from the true device position to the tool, or zero without contact.
        For a tool that cuts, the true positions are filtered first, as in the haptic loop. For
        other tools, the stretch is a weighted mean of this vector and the ideal force divided by
        the spring stiffness; see `IDEAL_SHARE`.
        """
        true = self.position_m if self.true_position_m is None else self.true_position_m
        if self.contact[0].cuts:
            observer = ConstantAcceleration(OBSERVER_MEMORY, step_s=TICK_S)
            seen_m = np.empty_like(true)
            for index, place in enumerate(true):
                observer.step(place)
                seen_m[index] = observer.position
            true = seen_m
        springs_N_m = np.array([each.spring_N_m for each in self.contact])
        tips_m = np.array([each.tip_m for each in self.contact])
        stretch = self.force_N / springs_N_m[:, None]
        touches = self.force_N.any(axis=1, keepdims=True)
        tense = np.where(touches, tips_m - true, 0.0)
        if self.ideal_N is not None and not self.contact[0].cuts:
            tense += IDEAL_SHARE * (self.ideal_N / springs_N_m[:, None] - tense)
        ticks = np.arange(len(true) - HORIZON)
        before = np.maximum(ticks - np.array(DELAYS)[:, None], 0)
        later = ticks + np.arange(1, HORIZON + 1)[:, None]
        targets = (true[later] - self.position_m[ticks], tense[later] - stretch[ticks])
        seen = coordinates(self.position_m[before], stretch[before])
        return seen.swapaxes(0, 1), np.concatenate(targets).swapaxes(0, 1)


def trial(scene: Scene, index: int, *, delay_ms: int | None = None, share: float = 1.0) -> Scene:
    """Return the scene of a training run.

    Successive runs cycle through the simulated hands and the latencies. The run uses no predictor,
    and computes no stress field.

    Parameters
    ----------
    scene
        Scene. If it has no device, the device Touch is used.
    index
        Number of the run, which is also its seed.
    delay_ms
        Latency [ms]. Default: the values of `DELAYS_MS` in turn.
    share
        Factor on the force of the tissue. If the force is linear in the moduli or in the cutting
        coefficients, the factor has the effect of scaling these constants.
    """
    delay = DELAYS_MS[index // len(GROUPS) % len(DELAYS_MS)] if delay_ms is None else delay_ms
    held = scene if scene.device is not None else changed(scene, {"device": "touch"})
    entries = {
        "hand": GROUPS[index % len(GROUPS)],
        "seed": index,
        "prediction": "none",
        "perception": "none",
        "coupling.delay_ms": delay,
        "coupling.model_ms": 1,
        "coupling.force_scale": share * chosen_scale(held)[0],  # a scale is chosen for a device
    }
    made = changed(held, entries | ({"stress": None} if scene.stress is not None else {}))
    # A loop whose latency is hidden is as stiff as a loop without latency, whatever the latency of
    # the trial.
    prompt = changed(made, {"coupling.delay_ms": 0})
    return changed(
        made,
        {"coupling.stiffness_N_m": judged_loop(loop_settings(prompt)).stiffness_N_m},
    )


class Recorder:
    """Recorder of training runs of one scene.

    A linear elastic organ is built only once, because runs do not change the organ's model.
    """

    def __init__(self, *, cores: int | None = None) -> None:
        self._cores = cores
        self._organ: Parts | None = None

    def record(self, scene: Scene, *, encoder_step_m: float | None = None) -> Recording:
        """Run a scene with its simulated hand; return the recorded data.

        The encoder step is taken from the parameters of the simulated device, unless
        `encoder_step_m` [m] is given.

        Raises
        ------
        InputError
            If the scene cannot be built, or its forces are not finite.
        """
        parts = self._parts(scene)
        motion = parts.motion
        assert isinstance(motion, HandMotion)
        if encoder_step_m is not None:
            device = motion.device
            assert isinstance(device, SimulatedDevice)
            device.parameters = replace(device.parameters, encoder_step_m=encoder_step_m)
        begin = motion.sweep_m()[0]
        rows, contact = _run(
            motion, parts.tissue, round((scene.duration_s or motion.duration_s) / TICK_S)
        )
        if not np.isfinite(rows).all():
            raise InputError(
                "scene",
                "give finite forces",
                f"NaN or infinity with seed {scene.seed}",
                "use another number of --trials",
            )
        speed = ConstantAcceleration(VELOCITY_MEMORY, step_s=TICK_S)
        velocity = np.array([speed.step(place) for place in (begin, *rows[:, :3])])[1:]
        # columns of `_run`: measured position, force, true position
        return Recording(
            rows[:, :3],
            velocity,
            rows[:, 3:6],
            contact,
            scene.held.hand,
            scene.seed,
            rows[:, 6:],
        )

    def ideal_force_N(self, scene: Scene, run: Recording) -> Array:
        """Compute the ideal force [N] on the device path of a run, shape (n, 3).

        The ideal force is the force of a loop without delay, encoder steps and filters; see
        `tissue.simulation.reference_force.ideal_force_N`.

        Parameters
        ----------
        scene
            Scene of the run.
        run
            Run whose device path is used. True device positions are used if they are known,
            otherwise measured positions.

        Raises
        ------
        InputError
            If the scene has no device.
        """
        times_s: Array = TICK_S * np.arange(len(run.force_N), dtype=np.float64)
        at_m = run.position_m if run.true_position_m is None else run.true_position_m
        duration_s = len(times_s) * TICK_S
        parts = self._parts(ideal_scene(scene).model_copy(update={"duration_s": duration_s}))
        assert isinstance(parts.motion, HandMotion)
        parts.motion.device = RecordedDevice(times_s, at_m)
        return rendered_force_N(parts, len(times_s))

    def _parts(self, scene: Scene) -> Parts:
        """Build the objects that simulate a scene, including the hand's motion and the tissue."""
        # Only a linear elastic organ is unchanged by a run.
        organ = (
            isinstance(scene.tool, Probe)
            and not isinstance(scene.anatomy, WallAnatomy)
            and not scene.organ.viscous
            and scene.organ.law == "linear"
        )
        if organ and self._organ is not None:
            motion, _ = hand_motion(scene, motion_of(scene), allow_unstable=True)
            return replace(self._organ, motion=motion)
        parts = build(
            scene,
            compute="cpu",
            cores=self._cores,
            report=silent,
            allow_unstable=True,
        )
        if organ:
            self._organ = parts
        return parts


def _run(motion: HandMotion, tissue: TissueModel, ticks: int) -> tuple[Array, list[Contact]]:
    """Simulate a number of ticks; return a data row and the contact of each tick.

    The rows contain measured position [m], force [N] and true position [m], shape (n, 9).
    """
    stepper = Stepper(motion, tissue)
    stepper.place()
    # columns: measured position, force, true position
    rows: Array = np.zeros((ticks, 9))
    contact = []
    raw = slice(
        motion.measure_names.index("raw_force_x_N"), motion.measure_names.index("raw_force_z_N") + 1
    )
    # A recorded device has no true position.
    knows = TRUE[0] in motion.measure_names
    true = motion.measure_names.index(TRUE[0]) if knows else 0
    for index, row in enumerate(rows):
        stepper.wait(index)
        stepper.step(index)
        motion.play(stepper.response)
        contact.append(deepcopy(motion.contact(stepper.response)))
        row[:3] = 1e-3 * motion.measures[:3]
        row[3:6] = motion.measures[raw]
        if knows:
            row[6:] = 1e-3 * motion.measures[true : true + 3]
    return rows, contact
