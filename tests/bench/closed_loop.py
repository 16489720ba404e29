"""Predictors in closed loop, where a hand responds to the predicted force.

The module is part of `bench_prediction.py --closed`.

Every predictor runs at the stiffness that is chosen for a loop with zero-order hold, so that only
the prediction differs. It also runs at the stiffness chosen for itself. Finished runs are stored as
lines of a table and are not run again.
"""

import csv
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from pathlib import Path

import numpy as np
from harness import table

from meshes.base.errors import InputError
from tissue.evaluation.statistics.metrics import excess_error, force_error, latency_ms
from tissue.scene.load import changed, load_scene
from tissue.scene.registry import GROUPS
from tissue.scene.scene import Scene
from tissue.simulation.builders.loop import judged_loop, loop_settings
from tissue.simulation.reference_force import ideal_force_N, motor_forces
from tissue.simulation.simulate import TICK_S, simulate

__all__ = ["close"]

LATENCY_MS = 4
FIRST_SEED = 30_000
STIFFNESSES = ("hold's", "own")
HEAD = (
    "predictor",
    "stiffness",
    "seed",
    "stiffness_N_m",
    "error",
    "least_error",
    "excess",
    "latency_ms",
)

Task = tuple[str, str, str, int]
"""Scene, predictor, one of `STIFFNESSES`, and seed."""


@lru_cache
def stiffness_N_m(name: str, kind: str, hand: str) -> float:
    """Return the stiffness that is chosen for a predictor in a hand [N/m]."""
    return judged_loop(
        loop_settings(by_hand(name, kind, hand, FIRST_SEED)), step_s=TICK_S
    ).stiffness_N_m


def by_hand(name: str, kind: str, hand: str, seed: int) -> Scene:
    """A scene in closed loop."""
    scene = load_scene(name)
    entries = {
        "device": "touch" if scene.device is None else scene.device.kind,
        "hand": hand,
        "seed": seed,
        "prediction": kind,
        "perception": "none",
        "coupling.delay_ms": LATENCY_MS,
    }
    return changed(scene, entries | ({"stress": None} if scene.stress is not None else {}))


def run(task: Task) -> tuple[float, ...]:
    """Return stiffness [N/m], error, noise floor, excess and residual latency [ms].

    The errors are shares of the ideal force.
    """
    name, kind, at, seed = task
    hand = list(GROUPS)[seed % len(GROUPS)]
    stiffness = stiffness_N_m(name, kind if at == "own" else "hold", hand)
    scene = changed(by_hand(name, kind, hand, seed), {"coupling.stiffness_N_m": stiffness})
    found = simulate(scene, cores=1, allow_unstable=True)
    forces = motor_forces(found, ideal_force_N(found, cores=1))
    error, least = (force_error(each, forces.ideal) for each in (forces.played, forces.nearest))
    late = latency_ms(forces.played, forces.nearest, tick_s=TICK_S)
    return stiffness, error, least, excess_error(error, least), late


def close(kinds: dict[str, Sequence[str]], runs: int, folder: Path) -> None:
    """Run what is not in the folder yet, two processes at once, and print the tables.

    Parameters
    ----------
    kinds
        Predictors of every scene, `hold` first.
    runs
        Seeds of each.
    folder
        Where tables are kept.
    """
    seeds = range(FIRST_SEED, FIRST_SEED + runs)
    kept = {name: read(folder / f"closed-{name}.csv") for name in kinds}
    wanted = [
        (name, kind, at, seed)
        for name, each in kinds.items()
        for seed in seeds
        for kind in each
        for at in STIFFNESSES
        if (kind, at, seed) not in kept[name] and (kind != "hold" or at != "own")
    ]
    with ProcessPoolExecutor(2) as pool:
        tasks = {pool.submit(run, task): task for task in wanted}
        for done in as_completed(tasks):
            name, *key = tasks[done]
            try:
                values = done.result()
            except InputError as refusal:
                print(f"{name}, {key}: {refusal}", flush=True)
                continue
            write(folder / f"closed-{name}.csv", (*key, *values))
    for name, each in kinds.items():
        report(name, each, seeds, read(folder / f"closed-{name}.csv"))


def report(
    name: str,
    kinds: Sequence[str],
    seeds: range,
    kept: dict[tuple[str, str, int], tuple[float, ...]],
) -> None:
    """Print the table of a scene: means over seeds, the worst error and the excess.

    The excess is a share of that of zero-order hold at its stiffness.
    """
    rows, base = [], np.nan
    for at in STIFFNESSES:
        for kind in kinds:
            found = [kept[kind, at, seed] for seed in seeds if (kind, at, seed) in kept]
            if not found:
                continue
            stiffness, error, least, excess, late = np.mean(found, axis=0)
            worst = np.max(np.abs(found), axis=0)
            if kind == "hold":
                base = excess
            rows.append(
                (
                    kind,
                    at,
                    f"{stiffness:.0f}",
                    f"{100 * error:.2f}",
                    f"{100 * worst[1]:.2f}",
                    f"{100 * least:.2f}",
                    f"{100 * excess:.2f}",
                    f"{100 * worst[3]:.2f}",
                    f"{excess / base:.2f}",
                    f"{late:+.2f}",
                    f"{worst[4]:.2f}",
                    f"{len(found)}",
                )
            )
    print(f"\n{name} in closed loop at {LATENCY_MS} ms")
    print(
        table(
            rows,
            (
                "predictor",
                "stiffness",
                "N/m",
                "error %",
                "worst %",
                "least %",
                "excess %",
                "worst %",
                "of hold's",
                "late ms",
                "worst ms",
                "runs",
            ),
        ),
        flush=True,
    )


def read(path: Path) -> dict[tuple[str, str, int], tuple[float, ...]]:
    """Read the finished runs: values by predictor, stiffness and seed."""
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return {
        (row[0], row[1], int(row[2])): tuple(map(float, row[3:]))
        for row in rows
        if len(row) == len(HEAD)
    }


def write(path: Path, row: tuple[object, ...]) -> None:
    """Add a line."""
    fresh = not path.is_file()
    with path.open("a", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([HEAD, row] if fresh else [row])
