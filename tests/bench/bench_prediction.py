"""Errors and costs of all predictors on the same recorded motions, scored at the motor.

Run: python tests/bench/bench_prediction.py --out DIR [--hands N] [--moved N] [--steps UM]
[--latency MS ...] [SCENE ...]

Every run is recorded once and kept in DIR, with the force that its coupling gives without delay at
the device's true positions. Predictors are scored again on the recorded runs. Printed for each
scene, latency and predictor are the error at the motor, its noise floor (the force of the encoder's
steps, predicted without error), the excess over this noise floor, the excess as a share of that of
zero-order hold with its 95 % interval over the hands, the residual latency, the worst share over
the held-out moves, and the largest excess over holding of any run, moved or not, in percent of the
force. Two processes record and score.

Besides the predictors of the program, `ridge` is a plain regression from 80 past ticks, fitted to
other hands of the unchanged scene, and `never trained` the adaptive predictor that starts from the
operators of all other scenes.
"""

import argparse
import os
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from harness import machine, table
from motor_score import motor_score
from ridge import Ridge, ridge_weights

from meshes.base.errors import InputError
from tissue.evaluation.recorded_runs import Recorder, Recording, trial
from tissue.haptics.device.device import device_parameters
from tissue.prediction.guard import Guarded
from tissue.prediction.look_ahead import LookAhead
from tissue.prediction.online import AdaptivePath
from tissue.prediction.predictor import Hold, Predictor
from tissue.prediction.trained import Trained, general_operator, shipped_file
from tissue.scene.load import changed, load_scene
from tissue.scene.registry import PREDICTORS
from tissue.scene.scene import Scene
from tissue.simulation.builders.prediction import trained_predictor

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
)  # threads of a norm waited for 80 % of the time


FIRST_SEED = 20_000
LATENCIES_MS = (2, 4, 8, 16)
MOVED_MM = {
    "wall": (80.0, 0.0),
    "palpation": (5.0, 8.0),
    "liver-press": (4.0, 4.0),
    "milling": (0.0, 2.5),
}
"""Distance by which a path is moved along the tissue's surface [mm]; 1 mm for other scenes."""
TURNED_DEG = {"wall": 90.0, "palpation": 20.0, "liver-press": 90.0, "milling": 90.0}
"""Angle by which a path is turned about its middle on the surface [deg].

Paths that a hole guides are not turned.
"""
PACES, SHARES = (0.6, 1.5), (0.7, 1.4)
PORTION = 5
"""Number of runs that one process records with the same organ."""
DRAWS = 2000
"""Draws of hands with replacement, for an interval."""
RIDGE_RUNS = 8
"""Largest number of runs to which the ridge regression is fitted."""
Scores = dict[tuple[str, int], np.ndarray]
"""Of a run, see `scores`."""
RECORDED_MS = 4
"""Latency under which runs are recorded; predictors are scored on them as if it were another."""
FORCE_LIMIT_N = 3.3
RIDGE, NEVER_TRAINED = "ridge", "never trained"
KINDS = (*PREDICTORS, RIDGE, NEVER_TRAINED)


@dataclass(frozen=True)
class Kept:
    """A run that was recorded, and the force of its coupling without delay [N]."""

    run: Recording
    ideal_N: np.ndarray

    @classmethod
    def read(cls, path: Path) -> "Kept":
        """Return the run of a file."""
        return cls(*pickle.loads(path.read_bytes()))


def scores(
    path: Path, variant: Scene, share: float, latencies_ms: list[int]
) -> dict[tuple[str, int], np.ndarray]:
    """Return error, noise floor, excess and residual latency [ms] by predictor and latency.

    Every latency has a pass of its own: a guard judges the one lead that it is asked for first.
    """
    kept, trained = Kept.read(path), Trained.read(shipped_file(variant.name), scene=variant.name)
    one = trial(variant, kept.run.seed, delay_ms=RECORDED_MS, share=share)
    step_m = device_parameters(one.held.kind, one.constants).encoder_step_m
    trained = trained.at_step(step_m)
    same = sorted(path.parent.glob(f"{variant.name}-same-*.pickle"))
    others = [Kept.read(each).run for each in same[: RIDGE_RUNS + 1]]
    others = [run for run in others if run.seed != kept.run.seed]
    weights = ridge_weights(others[:RIDGE_RUNS])

    def made(kind: str) -> Predictor:
        """Return a new predictor of a kind."""
        if kind == RIDGE:
            return Ridge(weights)
        if kind == NEVER_TRAINED:
            path = AdaptivePath(general_operator(without=variant.name, step_m=step_m))
            return Guarded(LookAhead(path, slopes="given"), Hold(), reach_N=FORCE_LIMIT_N)
        return trained_predictor(kind, trained, force_limit_N=FORCE_LIMIT_N)

    found = {}
    for kind in KINDS:
        for late in latencies_ms:
            score = motor_score(made(kind), one, kept.run, kept.ideal_N, delay_ms=late)
            found[kind, late] = np.array(
                (score.error, score.least_error, score.excess, score.latency_ms)
            )
    return found


def moves(name: str, folder: Path, steps_um: float | None) -> dict[str, tuple[Scene, float]]:
    """Return the scene and its held-out moves.

    They are other places, directions, speeds and force scales (or moduli); people are held out
    separately. Steps of the encoders [um] other than the device's are written to the folder.
    """
    scene = load_scene(name)
    if steps_um is not None:
        device = scene.device.kind if scene.device is not None else "touch"
        constants = folder / "steps.toml"
        value = 1e-6 * steps_um
        constants.write_text(
            f"[devices.{device}.encoder_step_m]\nvalue = {value}\nrange = [{value}, {value}]\n"
            'source = "chosen"\nconfidence = "L"\n'
        )
        scene = changed(scene, {"materials": str(constants)})
    found = {"same": (scene, 1.0)}
    points, motion = np.array(getattr(scene.motion, "points_mm", [])), scene.motion
    for share in SHARES:
        found[f"force x {share:g}"] = scene, share
    if not len(points):
        return found
    aside = points.copy()
    aside[:, :2] += MOVED_MM.get(scene.name, (1.0, 0.0))
    found["moved"] = changed(scene, {"motion.points_mm": aside.tolist()}), 1.0
    if angle := np.radians(TURNED_DEG.get(scene.name, 0.0)):
        turned, middle = points.copy(), points[:, :2].mean(axis=0)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        turned[:, :2] = middle + (points[:, :2] - middle) @ turn.T
        found["turned"] = changed(scene, {"motion.points_mm": turned.round(4).tolist()}), 1.0
    for pace in PACES:
        lasts = None if scene.duration_s is None else scene.duration_s / pace + 0.3
        found[f"pace x {pace:g}"] = (
            changed(scene, {"motion.feed_mm_s": pace * motion.feed_mm_s, "duration_s": lasts}),
            1.0,
        )
    return found


def portions(runs: int) -> list[range]:
    """Return the seeds of runs in portions, each recorded by one process."""
    last = FIRST_SEED + runs
    return [range(first, min(first + PORTION, last)) for first in range(FIRST_SEED, last, PORTION)]


def record(scene: Scene, share: float, move: str, seeds: range, folder: Path) -> None:
    """Record what is not in the folder yet."""
    recorder = Recorder(cores=1)
    for index in seeds:
        path = folder / f"{scene.name}-{move.replace(' ', '_')}-{index}.pickle"
        if path.exists():
            continue
        one = trial(scene, index, delay_ms=RECORDED_MS, share=share)
        try:
            run = recorder.record(one)
            ideal = recorder.ideal_force_N(one, run)
        except InputError as refusal:
            print(f"{scene.name}, {move}, seed {index}: {refusal}", flush=True)
            return
        path.write_bytes(pickle.dumps((run, ideal)))


def scored(
    variants: dict[str, tuple[Scene, float]],
    latencies_ms: list[int],
    folder: Path,
    pool: ProcessPoolExecutor,
) -> dict[str, list[Scores]]:
    """Scores of the runs of every move that are in the folder."""
    tasks = {
        move: [
            pool.submit(scores, path, variant, share, latencies_ms)
            for path in sorted(folder.glob(f"{variant.name}-{move.replace(' ', '_')}-*.pickle"))
        ]
        for move, (variant, share) in variants.items()
    }
    return {move: [task.result() for task in each] for move, each in tasks.items() if each}


def report(name: str, late_ms: int, found: dict[str, list[Scores]]) -> None:
    """Print the table of a scene at a latency."""
    mean = {
        kind: {
            move: np.mean([run[kind, late_ms] for run in runs], axis=0)
            for move, runs in found.items()
        }
        for kind in KINDS
    }
    rows = []
    for kind, of in mean.items():
        shares = {move: share_of(each[2], mean["hold"][move][2]) for move, each in of.items()}
        worst = max(shares, key=lambda move: np.nan_to_num(shares[move], nan=-1.0))
        error, least, excess, late = of["same"]
        over = max(
            100.0 * float(run[kind, late_ms][0] - run["hold", late_ms][0])
            for runs in found.values()
            for run in runs
        )
        low, high = interval(kind, late_ms, found["same"])
        rows.append(
            (
                kind,
                f"{100 * error:.2f}",
                f"{100 * least:.2f}",
                f"{100 * excess:.2f}",
                f"{written(shares['same'])} ({written(low)}-{written(high)})",
                f"{late:+.2f}",
                f"{written(shares[worst])} {worst}",
                f"{over:+.2f}",
            )
        )
    print(f"\n{name} at {late_ms} ms: {sum(map(len, found.values()))} runs, {', '.join(found)}")
    head = (
        "predictor",
        "error %",
        "least %",
        "excess %",
        "of hold's",
        "late ms",
        "worst share",
        "over hold %",
    )
    print(table(rows, head), flush=True)


def interval(kind: str, late_ms: int, runs: list[Scores]) -> tuple[float, float]:
    """Return the 95 % interval over hands of a predictor's share of the excess of hold."""
    excess = np.array([[run[one, late_ms][2] for one in (kind, "hold")] for run in runs])
    drawn = np.random.default_rng(0).integers(len(runs), size=(DRAWS, len(runs)))
    shares = [share_of(*excess[rows].mean(axis=0)) for rows in drawn]
    low, high = np.nanquantile(shares, (0.025, 0.975))
    return float(low), float(high)


def share_of(excess: float, held: float) -> float:
    """An excess in shares of hold's; NaN where hold has none."""
    return excess / held if held > 0.0 else np.nan


def written(share: float) -> str:
    """A share as text."""
    return "-" if np.isnan(share) else f"{share:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=["wall", "palpation"])
    parser.add_argument("--hands", type=int, default=6, help="runs of the unchanged scene")
    parser.add_argument("--moved", type=int, default=1, help="runs of each move")
    parser.add_argument("--steps", type=float, help="encoder steps instead of the device's [um]")
    parser.add_argument("--latency", type=int, nargs="*", default=list(LATENCIES_MS))
    parser.add_argument(
        "--out", type=Path, default=Path("predictions"), help="folder of the recordings"
    )
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    print(machine())
    with ProcessPoolExecutor(2) as pool:
        for name in given.scenes:
            variants = moves(name, given.out, given.steps)
            for done in [
                pool.submit(record, *each, move, seeds, given.out)
                for move, each in variants.items()
                for seeds in portions(given.hands if move == "same" else given.moved)
            ]:
                done.result()
            found = scored(variants, given.latency, given.out, pool)
            for late in given.latency if "same" in found else []:
                report(name, late, found)


if __name__ == "__main__":
    main()
