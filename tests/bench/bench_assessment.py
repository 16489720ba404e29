"""Order of simulated hands by the score of an assessment, on any device and at any pace.

Run: python tests/bench/bench_assessment.py --out DIR [--people N] [--sticks] [SCENE ...]

Every run is recorded once and kept in DIR: N novices, intermediates and experts, each with a Touch,
with an omega.x at 0.7 of the pace, and with an Inverse3 at 1.4 of the pace. Printed is the
probability that the score of a person of the better group exceeds that of the next group (area
under the curve, 0.5 for chance): with the Touch alone, with its first half alone, and over all
devices and paces. The same is printed for the other measures of an assessment, over all devices and
paces. Runs without a score, whose device moves too slowly, are counted. With --sticks, the areas of
the score follow for other speeds at which friction is viscous.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from harness import machine, table

from meshes.base.errors import InputError
from tissue.evaluation import steadiness as engine
from tissue.evaluation.statistics.metrics import (
    aligned_rows,
    deviation_mm,
    force_error,
    spectral_arc_length,
)
from tissue.evaluation.steadiness import steadiness
from tissue.haptics.device.device import device_parameters
from tissue.scene.load import changed, load_scene
from tissue.scene.registry import GROUPS
from tissue.scene.scene import Scene
from tissue.simulation.simulate import TICK_S, simulate

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

SCENES = (
    "wall",
    "palpation",
    "liver-press",
    "needle",
    "incision",
    "milling",
    "caries",
    "molar",
    "pedicle",
    "glenoid",
)
CHANGES = {"liver-press": {"organ.law": "linear"}}
"""Changes of a scene that only make its runs shorter to compute."""
CONDITIONS = (("touch", 1.0), ("forcedimension", 0.7), ("haply", 1.4))
"""Device, and pace relative to the scene's."""
FIRST_SEED = 100
ORDER = ("novice", "intermediate", "expert")
VECTORS = (("device", "mm"), ("device_force", "N"), ("tool", "mm"), ("model_force", "N"))
STICKS_M_S = (0.005, 0.01, 0.02, 0.05, 0.1)
OTHERS = ("deviation", "force error", "arc length")
Runs = dict[tuple[str, str], list[dict[str, np.ndarray]]]
"""Runs of a group under a condition."""


def paced(scene: Scene, pace: float) -> dict[str, object]:
    """Return the changes of a scene for another pace."""
    # The pace of a thrust follows from the force of the hand.
    if not hasattr(scene.motion, "feed_mm_s"):
        return {}
    found: dict[str, object] = {"motion.feed_mm_s": pace * scene.motion.feed_mm_s}
    if scene.duration_s is not None:
        found["duration_s"] = round(scene.duration_s / pace + 0.5, 3)
    return found


def record(name: str, path: Path, changes: dict[str, object]) -> str:
    """Record a run, unless its file exists; return what prevented it."""
    if path.exists():
        return ""
    try:
        scene = load_scene(name, CHANGES.get(name, {}) | changes)
        scene = changed(scene, {"stress": None}) if scene.stress is not None else scene
        trace = simulate(scene, cores=1).trace
    except InputError as refusal:
        return f"{path.stem}: {refusal}"
    held = [each for each in VECTORS if f"{each[0]}_x_{each[1]}" in trace.columns]
    arrays = {f"{each}": trace.vectors(each, unit).astype(np.float32) for each, unit in held}
    np.savez_compressed(path, **arrays)
    return ""


def recorded(name: str, people: int, folder: Path, pool: ProcessPoolExecutor) -> Runs:
    """Return all runs of a scene, and under ("", "") its reference."""
    scene = load_scene(name, CHANGES.get(name, {}))
    held = scene.device is not None
    first = {"hand": "expert", "seed": 0} if held else {}
    jobs = {folder / f"{name}-reference.npz": ("", "", first)}
    for seed in range(FIRST_SEED, FIRST_SEED + people):
        for group in GROUPS:
            for device, pace in CONDITIONS:
                changes = {"device": device, "hand": group, "seed": seed} | paced(scene, pace)
                jobs[folder / f"{name}-{group}-{device}-{seed}.npz"] = (group, device, changes)
    tasks = [pool.submit(record, name, path, each[2]) for path, each in jobs.items()]
    for task in tasks:
        if problem := task.result():
            print(problem, flush=True)
    found: Runs = {}
    for path, (group, device, _) in jobs.items():
        if path.exists():
            with np.load(path) as kept:
                found.setdefault((group, device), []).append({k: kept[k] for k in kept.files})
    return found


def score(run: dict[str, np.ndarray], device: str, *, share: float = 1.0) -> float:
    """Return the score of the first part of a run, NaN without one."""
    rows = slice(round(share * len(run["device"])))
    position_m = 1e-3 * run["device"][rows].astype(float)
    force_N = run["device_force"][rows].astype(float)
    try:
        return steadiness(position_m, force_N, device_parameters(device)).score
    except InputError:
        return float("nan")


def others(run: dict[str, np.ndarray], reference: dict[str, np.ndarray]) -> tuple[float, ...]:
    """Return the negative of the measures of `OTHERS`, of which less is better."""
    path = run["tool"].astype(float)
    model = reference["tool"].astype(float)
    rows = aligned_rows(path, model)
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / TICK_S
    return (
        -float(deviation_mm(path, model, rows).mean()),
        -force_error(run["model_force"], reference["model_force"][rows]),
        spectral_arc_length(speed, tick_s=TICK_S),
    )


def area(better: np.ndarray, worse: np.ndarray) -> float:
    """Return the probability that a value of the first is larger, ties counted as a half."""
    above = better[:, None] - worse[None]
    return float((above > 0.0).mean() + 0.5 * (above == 0.0).mean())


def areas(values: dict[str, np.ndarray]) -> str:
    """Return the areas between neighbouring groups as text, of the runs that have a value."""
    held = {group: each[~np.isnan(each)] for group, each in values.items()}
    if not all(map(len, held.values())):
        return "-"
    pairs = zip(ORDER[1:], ORDER[:-1], strict=True)
    return " ".join(f"{area(held[better], held[worse]):.2f}" for better, worse in pairs)


def of_group(runs: Runs, devices: tuple[str, ...], value) -> dict[str, np.ndarray]:
    """Return a value of the runs of each group on some devices."""
    return {
        group: np.array(
            [value(run, device) for device in devices for run in runs.get((group, device), [])]
        )
        for group in ORDER
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--people", type=int, default=8, help="persons of each group")
    parser.add_argument("--sticks", action="store_true", help="vary the speed of viscous friction")
    parser.add_argument("--out", type=Path, default=Path("assessed"), help="folder of recordings")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    print(machine())
    devices = tuple(device for device, _ in CONDITIONS)
    rows = []
    varied = []
    with ProcessPoolExecutor(2) as pool:
        for name in given.scenes:
            runs = recorded(name, given.people, given.out, pool)
            reference = runs[("", "")][0]
            scores = of_group(runs, devices, score)
            first = devices[:1]
            half = of_group(runs, first, lambda run, device: score(run, device, share=0.5))
            measured = of_group(runs, devices, lambda run, _: others(run, reference))  # noqa: B023
            rows.append(
                (
                    name,
                    areas(of_group(runs, first, score)),
                    areas(half),
                    areas(scores),
                    str(sum(int(np.isnan(each).sum()) for each in scores.values())),
                    " ".join(f"{np.nanmean([*scores[group], np.nan]):.0f}" for group in ORDER),
                    *(
                        areas({group: each[:, column] for group, each in measured.items()})
                        for column in range(len(OTHERS))
                    ),
                )
            )
            if given.sticks:
                kept = engine.STICKS_M_S
                line = [name]
                for engine.STICKS_M_S in STICKS_M_S:
                    line.append(areas(of_group(runs, devices, score)))
                engine.STICKS_M_S = kept
                varied.append(line)
            print(f"{name} is done", flush=True)
    head = ("scene", "one device", "half the time", "all", "no score", "mean scores", *OTHERS)
    print(f"\n{given.people} persons a group; intermediate over novice, expert over intermediate")
    print(table(rows, head))
    if varied:
        print("\nFriction viscous below, in m/s:")
        print(table(varied, ("scene", *(f"{each:g}" for each in STICKS_M_S))))


if __name__ == "__main__":
    main()
