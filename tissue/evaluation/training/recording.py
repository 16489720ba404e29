"""Runs of a scene by hands of all groups, as what a predictor sees of them."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import silent
from tissue.builders.hand import hand_motion
from tissue.builders.loop import judged_loop
from tissue.builders.registry import build, motion_of
from tissue.haptics.hand_motion import HandMotion
from tissue.models.tissue_model import Response, TissueModel, ToolMotion, WaitsForBackground
from tissue.prediction.edmd.episodes import Episode
from tissue.scene.coupling import WallAnatomy
from tissue.scene.load import changed
from tissue.scene.registry import GROUPS
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.simulation.simulate import TICK_S

__all__ = ["DELAYS_MS", "Recorder", "Recording", "trial"]

DELAYS_MS = (0, 4, 8)
"""Latencies of training runs, in turn: a late force makes a hand move otherwise."""
DITHER_N = 1e-6
"""Noise that is added to a force to learn from [N], so that an axis on which nothing acts can be scaled."""


@dataclass(frozen=True)
class Recording:
    """What a predictor sees of a run: one row a tick.

    Attributes
    ----------
    position_m, velocity_m_s
        Of the device, as its encoders measure them, shape (n, 3).
    force_N
        On the device, without delay, shape (n, 3).
    group, seed
        Whose hand, and its seed.
    model_s
        Median time that the tissue took to answer in a tick [s].
    """

    position_m: Array
    velocity_m_s: Array
    force_N: Array
    group: str
    seed: int
    model_s: float = 0.0

    def dithered_N(self) -> Array:
        """The force with a little noise, the same every time."""
        return self.force_N + DITHER_N * np.random.default_rng(self.seed).standard_normal(self.force_N.shape)

    def episode(self) -> Episode:
        """States of the lifted predictor: position and force, shape (n, 6)."""
        return Episode(np.hstack((self.position_m, self.dithered_N())), None, TICK_S)

    def driven_episode(self) -> Episode:
        """States and inputs of linear dynamic mode decomposition: force, shape (n, 3), by the device, shape (n, 6)."""
        return Episode(self.dithered_N(), np.hstack((self.position_m, self.velocity_m_s)), TICK_S)


def trial(scene: Scene, index: int, *, delay_ms: int | None = None, share: float = 1.0) -> Scene:
    """The scene of a trial: hands, seeds and latencies in turn, nothing predicted, no stress beside the ticks.

    Parameters
    ----------
    scene
        The scene; without a device it gets a touch.
    index
        Number of the trial, and its seed.
    delay_ms
        Latency; without it those of `DELAYS_MS` in turn.
    share
        Force of the tissue at the same motion over that of the scene. In a tissue whose force is linear in its moduli
        or cutting coefficients this is the same as all of those changed by it.
    """
    delay = DELAYS_MS[index // len(GROUPS) % len(DELAYS_MS)] if delay_ms is None else delay_ms
    entries = {
        "device": "touch" if scene.device == "none" else scene.device,
        "hand": GROUPS[index % len(GROUPS)],
        "seed": index,
        "prediction": "none",
        "perception": "none",
        "coupling.delay_ms": delay,
        "coupling.model_ms": 1,
        "coupling.force_scale": share * scene.force_scale,
    }
    made = changed(scene, entries | ({"stress": None} if scene.stress is not None else {}))
    # A loop whose latency is hidden is as stiff as a prompt one, whatever the latency of the trial.
    prompt = changed(made, {"coupling.delay_ms": 0})
    return changed(made, {"coupling.stiffness_N_m": judged_loop(prompt, step_s=TICK_S).stiffness_N_m})


class Recorder:
    """Runs trials of one scene; an elastic organ, which a run leaves as it was, is built once."""

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
        tool = ToolMotion()
        motion.begin(tool)
        tissue.place(tool)
        ticks = round((scene.duration_s or motion.duration_s) / TICK_S)
        rows = np.zeros((ticks, 6))
        response = Response.empty(len(tissue.layer_names))
        raw = slice(motion.measure_names.index("raw_force_x_N"), motion.measure_names.index("raw_force_z_N") + 1)
        begin = 1e-3 * motion.measures[:3]
        took = np.zeros(ticks)
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
            row[:3], row[3:] = 1e-3 * motion.measures[:3], motion.measures[raw]
        if not np.isfinite(rows).all():
            raise InputError(f"scene must give finite forces, got others with seed {scene.seed}: use another --trials")
        velocity = np.diff(rows[:, :3], axis=0, prepend=begin[None]) / TICK_S
        return Recording(rows[:, :3], velocity, rows[:, 3:], scene.hand, scene.seed, float(np.median(took)))

    def _parts(self, scene: Scene) -> tuple[HandMotion, TissueModel]:
        """The hand of a scene and what it meets."""
        organ = isinstance(scene.tool, Probe) and not isinstance(scene.anatomy, WallAnatomy) and not scene.organ.viscous
        if organ and self._organ is not None:
            motion, _ = hand_motion(scene, motion_of(scene, step_s=TICK_S), step_s=TICK_S, allow_unstable=True)
            return motion, self._organ
        parts = build(scene, step_s=TICK_S, compute="cpu", cores=self._cores, report=silent, allow_unstable=True)
        assert isinstance(parts.motion, HandMotion)
        if organ:
            self._organ = parts.tissue
        return parts.motion, parts.tissue
