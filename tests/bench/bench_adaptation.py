"""Errors of predictors after the tissue has become twice as stiff within a run.

Run: `python tests/bench/bench_adaptation.py [--hands N] [SCENE ...]`.

In every run, all forces of the tissue are doubled when a quarter of the ticks in contact is over. The
spring between tool and device is halved at the tool, which is the same for the device. Predictors
are scored on the recorded runs at a latency of 4 ms. Printed for each predictor is the error at the
motor in percent of the ideal force, before the change and in three windows after it, as means over
the hands, and the largest excess of a run over zero-order hold after the change in percent of the
force. `trained twice as stiff` is look-ahead with an operator that was trained on the stiff tissue.
`never trained` is the adaptive predictor that starts from the operators of all other scenes.
Two processes record and score.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import count

import numpy as np
from harness import machine, table
from motor_score import forces_at_motor

from meshes.base.arrays import Array
from tissue.evaluation.recorded_runs import Recorder, trial
from tissue.evaluation.statistics.metrics import force_error
from tissue.evaluation.training import fit
from tissue.haptics.hand_motion import HandMotion
from tissue.haptics.proxy.cutting_tool import CuttingTool
from tissue.haptics.proxy.held_tool import HeldTool, PressingTool
from tissue.prediction.guard import Guarded
from tissue.prediction.look_ahead import LookAhead
from tissue.prediction.online import AdaptivePath
from tissue.prediction.predictor import Hold
from tissue.prediction.trained import Trained, general_operator, shipped_file
from tissue.scene.load import load_scene
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import Parts
from tissue.simulation.builders.prediction import trained_predictor

FIRST_SEED = 40_000
TRAINING_RUNS = 6
LATENCY_MS = 4
FORCE_LIMIT_N = 3.3
STIFFER = 2.0
WINDOWS_S = ((0.0, 0.1), (0.1, 0.5), (0.5, 1.0))
"""Windows after the change [s]. The first one contains the step of the force itself."""
KINDS = (
    "hold",
    "koopman-look-ahead",
    "trained twice as stiff",
    "koopman-online",
    "never trained",
)


class Stiffening(Recorder):
    """Recorder of runs in which the tissue becomes stiffer in a tick."""

    def __init__(self, tick: int) -> None:
        super().__init__(cores=1)
        self._tick = tick

    def _parts(self, scene: Scene) -> Parts:
        """Return parts whose tool changes in the tick."""
        parts = super()._parts(scene)
        motion = parts.motion
        assert isinstance(motion, HandMotion)
        advance = motion.advance
        ticks = count()

        def changing(*arguments: object) -> None:
            if next(ticks) == self._tick:
                stiffen(motion.tool)
            advance(*arguments)  # type: ignore[arg-type]

        motion.advance = changing  # type: ignore[method-assign,assignment]
        return parts


def stiffen(tool: HeldTool) -> None:
    """Halve the spring at the tool, so that the device feels the tissue twice as stiff."""
    tool.stiffness_N_m /= STIFFER
    if isinstance(tool, PressingTool):
        tool._spring /= STIFFER
    if isinstance(tool, CuttingTool):
        tool.mass_kg /= STIFFER


def trained_on_stiff(name: str) -> Trained:
    """Return operators that are trained on tissue that is twice as stiff in all runs."""
    recorder = Recorder(cores=1)
    runs = []
    for index in range(TRAINING_RUNS):
        one = trial(load_scene(name), index, share=STIFFER)
        run = recorder.record(one)
        if not run.contact[0].cuts:
            run = replace(run, ideal_N=recorder.ideal_force_N(one, run))
        runs.append(run)
    return fit(name, runs)


def errors(name: str, index: int, stiff: Trained) -> Array:
    """Return the errors of a hand, shape (kinds, 1 + windows)."""
    scene = load_scene(name)
    one = trial(scene, index, delay_ms=LATENCY_MS)
    touched = np.flatnonzero(Recorder(cores=1).record(one).force_N.any(axis=1))
    tick = int(touched[len(touched) // 4])
    recorder = Stiffening(tick)
    run = recorder.record(one)
    ideal_N = recorder.ideal_force_N(one, run)
    shipped = Trained.read(shipped_file(name), scene=name)
    make = partial(trained_predictor, force_limit_N=FORCE_LIMIT_N)
    start = AdaptivePath(general_operator(without=name))
    made = {
        "hold": Hold(),
        "koopman-look-ahead": make("koopman-look-ahead", shipped),
        "trained twice as stiff": make(
            "koopman-look-ahead", replace(stiff, fallback=shipped.fallback)
        ),
        "koopman-online": make("koopman-online", shipped),
        "never trained": Guarded(LookAhead(start, slopes="given"), Hold(), reach_N=FORCE_LIMIT_N),
    }
    windows = [(0, tick), *(tuple(tick + round(1e3 * each) for each in w) for w in WINDOWS_S)]
    found = np.zeros((len(KINDS), len(windows)))
    for row, kind in enumerate(KINDS):
        played, _, ideal = forces_at_motor(made[kind], one, run, ideal_N, delay_ms=LATENCY_MS)
        for column, (first, last) in enumerate(windows):
            part = slice(first, last)
            if ideal[part].any():
                found[row, column] = force_error(played[part], ideal[part])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=["wall", "palpation", "milling"])
    parser.add_argument("--hands", type=int, default=6)
    given = parser.parse_args()
    print(machine())
    with ProcessPoolExecutor(2) as pool:
        for name in given.scenes:
            stiff = pool.submit(trained_on_stiff, name).result()
            seeds = range(FIRST_SEED, FIRST_SEED + given.hands)
            found = 100.0 * np.array(
                list(pool.map(partial(errors, name, stiff=stiff), seeds, chunksize=1))
            )
            over = (found - found[:, :1])[:, :, 1:].max(axis=(0, 2))
            rows = [
                (kind, *(f"{each:.2f}" for each in found[:, row].mean(axis=0)), f"{over[row]:+.2f}")
                for row, kind in enumerate(KINDS)
            ]
            names = [f"{first:g} to {last:g} s" for first, last in WINDOWS_S]
            print(f"\n{name}, {given.hands} hands, {LATENCY_MS} ms: error / %")
            print(table(rows, ("predictor", "before", *names, "over hold")), flush=True)


if __name__ == "__main__":
    main()
