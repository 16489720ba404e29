"""Scores of all predictors on one recorded run, at every latency.

This is the work of one process of `bench_prediction.py`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from motor_score import motor_score

from tissue.evaluation.training import Recording, trial
from tissue.prediction.look_ahead import LookAhead
from tissue.prediction.predictor import Predictor
from tissue.prediction.trained import Trained, shipped_file
from tissue.scene.registry import PREDICTORS
from tissue.scene.scene import Scene
from tissue.simulation.builders.prediction import trained_predictor

__all__ = ["FORCE_LIMIT_N", "KNOWN", "RECORDED_MS", "Kept", "scores"]

RECORDED_MS = 4
"""Latency under which runs are recorded; predictors are scored on them as if it were another."""
FORCE_LIMIT_N = 3.3
KNOWN = "(path known)"
"""Name of look-ahead on the device's true path, without a guard.

Its error is that of the law; it is not a predictor.
"""


class KnownPath:
    """Path along which a recorded device moves; the stretch stays."""

    trusted = True

    def __init__(self, run: Recording) -> None:
        self._places, self._at = run.position_m, -1
        self._stretch = np.zeros(3)

    def observe(self, position_m: np.ndarray, stretch_m: np.ndarray) -> None:
        self._at += 1
        self._stretch = stretch_m.copy()

    def displacement_m(self, ticks: float) -> np.ndarray:
        count = np.arange(len(self._places))
        there = [np.interp(self._at + ticks, count, axis) for axis in self._places.T]
        return np.array(there) - self._places[self._at]

    def stretch_m(self, ticks: float) -> np.ndarray:
        return self._stretch

    def pause(self) -> None:
        pass


@dataclass(frozen=True)
class Kept:
    """A run that was recorded, and the force of its coupling without delay [N]."""

    run: Recording
    ideal_N: np.ndarray

    @classmethod
    def read(cls, path: Path) -> "Kept":
        """The run of a file, whose name ends with its seed."""
        with np.load(path) as kept:
            seed = int(path.stem.rsplit("-", 1)[1])
            run = Recording(
                kept["position"], kept["velocity"], kept["force"], kept["contact"], "", seed
            )
            return cls(run, kept["ideal"])


def scores(
    path: Path, variant: Scene, share: float, latencies_ms: list[int]
) -> dict[tuple[str, int], np.ndarray]:
    """Return error, noise floor, excess and residual latency [ms] by predictor and latency.

    Every latency has a pass of its own: a guard judges only the lead that it is asked for first.

    Every latency has a pass of its own: a guard judges the one lead that it is asked for first.
    """
    kept, trained = Kept.read(path), Trained.read(shipped_file(variant.name), scene=variant.name)
    one = trial(variant, kept.run.seed, delay_ms=RECORDED_MS, share=share)
    found = {}
    for kind in (*PREDICTORS, KNOWN):
        for late in latencies_ms:
            if kind == KNOWN:
                made: Predictor = LookAhead(KnownPath(kept.run))
            else:
                made = trained_predictor(kind, trained, force_limit_N=FORCE_LIMIT_N)
            score = motor_score(made, one, kept.run, kept.ideal_N, delay_ms=late)
            found[kind, late] = np.array(
                (score.error, score.least_error, score.excess, score.latency_ms)
            )
    return found
