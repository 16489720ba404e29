"""Runs of a scene by hands of all groups, as the inputs that a predictor receives."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import silent
from tissue.haptics.hand_measures import TRUE
from tissue.haptics.hand_motion import HandMotion
from tissue.haptics.loop.filters import VELOCITY_MEMORY, ConstantAcceleration
from tissue.models.tissue_model import Response, TissueModel, ToolMotion, WaitsForBackground
from tissue.prediction.contact import CONTACT_WIDTH
from tissue.prediction.edmd.episodes import Episode
from tissue.scene.coupling import WallAnatomy
from tissue.scene.load import changed
from tissue.scene.registry import GROUPS
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.simulation.builders.force_met import chosen_scale
from tissue.simulation.builders.hand import hand_motion
from tissue.simulation.builders.loop import judged_loop, loop_settings
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.simulate import TICK_S, build

__all__ = ["DELAYS_MS", "Recorder", "Recording", "trial"]

DELAYS_MS = (0, 4, 8)
"""Latencies of training runs, in turn: a late force makes a hand move otherwise."""
DITHER_N = 1e-6
"""Noise added to a training force [N], so that an axis without force can be scaled."""


@dataclass(frozen=True)
class Recording:
    """Data of a run that a predictor receives, one row per tick.

    Attributes
    ----------
    position_m, velocity_m_s
        Position of the device as measured by its encoders, and velocity as estimated by the loop's
        filter, shape (n, 3).
    force_N
        Force on the device, without delay, shape (n, 3).
    contact
        Contact as a loop receives it in every tick, rows of `Contact`, shape (n, CONTACT_WIDTH).
    group, seed
        Group of the hand, and its seed.
    model_s
        Median time that the tissue took to answer in a tick [s].
    true_position_m
        Exact position of the device, without encoder steps, shape (n, 3). None if it is unknown.
    """

    position_m: Array
    velocity_m_s: Array
    force_N: Array
    contact: Array
    group: str
    seed: int
    model_s: float = 0.0
    true_position_m: Array | None = None

    def dithered_N(self) -> Array:
        """Return the force with a little noise, the same every time."""
        return self.force_N + DITHER_N * np.random.default_rng(self.seed).standard_normal(
            self.force_N.shape
        )

    def episodes(self) -> list[Episode]:
        """Return one episode per axis, each of shape (n, STATE).

        The state is the displacement since the previous tick and the stretch of the coupling [m].
        """
        moved = np.diff(self.position_m, axis=0, prepend=self.position_m[:1])
        stretch = self.force_N / self.contact[:, :1]
        return [
            Episode(np.column_stack(axis), None, TICK_S)
            for axis in zip(moved.T, stretch.T, strict=True)
        ]

    def driven_episode(self) -> Episode:
        """Return states and inputs for linear dynamic mode decomposition.

        The states are the force, shape (n, 3), and the inputs describe the device, shape (n, 6).
        """
        return Episode(self.dithered_N(), np.hstack((self.position_m, self.velocity_m_s)), TICK_S)


def trial(scene: Scene, index: int, *, delay_ms: int | None = None, share: float = 1.0) -> Scene:
    """Return the scene of a trial.

    Hands, seeds and latencies are used in turn. Nothing is predicted, and no stress is computed in
    parallel to the ticks.

    Parameters
    ----------
    scene
        Scene. A scene without a device gets a Touch.
    index
        Number of the trial, which is also its seed.
    delay_ms
        Latency [ms]. Default: the values of `DELAYS_MS` in turn.
    share
        Ratio of the tissue's force to the scene's force at the same motion. If the force is linear
        in the moduli or cutting coefficients, this equals a change of all of them by the ratio.
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
    # A loop whose latency is hidden is as stiff as a prompt one, whatever the latency of the trial.
    prompt = changed(made, {"coupling.delay_ms": 0})
    return changed(
        made,
        {"coupling.stiffness_N_m": judged_loop(loop_settings(prompt), step_s=TICK_S).stiffness_N_m},
    )


class Recorder:
    """Runner of trials of one scene.

    An elastic organ, which a run does not change, is built once.
    """

    def __init__(self, *, cores: int | None = None) -> None:
        self._cores = cores
        self._organ: TissueModel | None = None

    def record(self, scene: Scene) -> Recording:
        """Run a scene by its hand.

        Raises
        ------
        InputError
            If it cannot be built.
        """
        motion, tissue = self._parts(scene)
        begin = motion.sweep_m()[0]
        rows, contact, took = _run(
            motion, tissue, round((scene.duration_s or motion.duration_s) / TICK_S)
        )
        if not np.isfinite(rows).all():
            raise InputError(
                "scene",
                "give finite forces",
                f"others with seed {scene.seed}",
                "use another --trials",
            )
        speed = ConstantAcceleration(VELOCITY_MEMORY, step_s=TICK_S)
        velocity = np.array([speed.step(place) for place in (begin, *rows[:, :3])])[1:]
        return Recording(
            rows[:, :3],
            velocity,
            rows[:, 3:6],
            contact,
            scene.held.hand,
            scene.seed,
            float(np.median(took)),
            rows[:, 6:],
        )

    def _parts(self, scene: Scene) -> tuple[HandMotion, TissueModel]:
        """Return the hand of a scene and the tissue that it touches."""
        organ = (
            isinstance(scene.tool, Probe)
            and not isinstance(scene.anatomy, WallAnatomy)
            and not scene.organ.viscous
        )
        if organ and self._organ is not None:
            motion, _ = hand_motion(scene, motion_of(scene, step_s=TICK_S), allow_unstable=True)
            return motion, self._organ
        parts = build(
            scene,
            step_s=TICK_S,
            compute="cpu",
            cores=self._cores,
            report=silent,
            allow_unstable=True,
        )
        assert isinstance(parts.motion, HandMotion)
        if organ:
            self._organ = parts.tissue
        return parts.motion, parts.tissue


def _run(motion: HandMotion, tissue: TissueModel, ticks: int) -> tuple[Array, Array, Array]:
    """Return position, force and true position, contacts, and the times of the tissue.

    Measured position, force and true position have shape (n, 9). The seconds that the tissue took
    have shape (n,).
    """
    tool = ToolMotion()
    motion.begin(tool)
    tissue.place(tool)
    rows: Array = np.zeros((ticks, 9))
    contact = np.zeros((ticks, CONTACT_WIDTH))
    took = np.zeros(ticks)
    response = Response.empty(len(tissue.layer_names))
    raw = slice(
        motion.measure_names.index("raw_force_x_N"), motion.measure_names.index("raw_force_z_N") + 1
    )
    knows = TRUE[0] in motion.measure_names
    true = motion.measure_names.index(TRUE[0]) if knows else 0
    for index, row in enumerate(rows):
        if isinstance(tissue, WaitsForBackground):
            tissue.wait_for_background(index * TICK_S)
        motion.advance(index * TICK_S, TICK_S, response, tool)
        start = perf_counter()
        tissue.advance(tool)
        response = tissue.respond(tool)
        if motion.correct(response, tool):
            tissue.advance(tool)
            response = tissue.respond(tool)
        took[index] = perf_counter() - start
        motion.play(response)
        contact[index] = motion.contact(response).row()
        row[:3] = 1e-3 * motion.measures[:3]
        row[3:6] = motion.measures[raw]
        row[6:] = 1e-3 * motion.measures[true : true + 3]
    return rows, contact, took
