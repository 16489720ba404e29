"""Conditioning of a tool in a hand: response to small changes of the device path.

Run: `python tests/bench/bench_held_tool.py [--hands 10] [--seconds 3] [SCENE ...]`.

For each scene and hand, the closed loop runs once and the true device path is recorded. The path is
then replayed without feedback: unchanged, shifted by a constant, and rounded to encoder steps.
Amplification is the distance between the tool paths of the changed and the unchanged device path,
over the shift or encoder step. Two values are printed: one second after the first contact, and the
largest of the run. Force error is the RMS difference of the force over the RMS force of the
unchanged path, over ticks in contact in either run. Tasks of the study, such as T3, count as
scenes.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from harness import machine, table

from tissue.evaluation.atlas.held_tool import (
    OBLIQUE,
    DevicePath,
    amplification,
    force_error,
    in_a_hand,
    recorded_path,
    replayed,
)
from tissue.evaluation.study.plan import TASKS
from tissue.scene.load import load_scene, scene_names
from tissue.scene.scene import Scene

Change = Callable[[DevicePath], DevicePath]
SEED = 100
"""Seed of the first hand."""
HEAD = (
    "scene",
    "change of the path",
    "after 1 s: median",
    "max",
    "largest: median",
    "max",
    "force error %: median",
    "max",
)


def shift(size_m: float, direction: np.ndarray) -> tuple[float, Change]:
    """Return the size of a shift [m] and the shift of a path."""
    return size_m, lambda path: path.shifted(size_m * direction)


def steps(size_m: float) -> tuple[float, Change]:
    """Return the size of encoder steps [m] and the rounding of a path."""
    return size_m, lambda path: replace(
        path, positions_m=size_m * np.round(path.positions_m / size_m)
    )


CHANGES: dict[str, tuple[float, Change]] = {
    "1 nm": shift(1e-9, OBLIQUE),
    "1 um": shift(1e-6, OBLIQUE),
    "10 um": shift(1e-5, OBLIQUE),
    "steps of 10 um": steps(1e-5),
    "steps of 55 um": steps(5.5e-5),
}


def scene_of(name: str, seed: int, seconds: float) -> Scene:
    """Return a scene, or the scene of a task, in the hand of an expert."""
    task = TASKS.get(name)
    scene = load_scene(name) if task is None else load_scene(task.scene, task.changes)
    return in_a_hand(scene, seed=seed, seconds=seconds)


def measured(scene: Scene) -> tuple[dict[str, tuple[float, ...]], float, int]:
    """Measure every change, the noise floor and the first tick in contact.

    The noise floor is the largest difference of tips [m] and forces [N] between two equal replays.
    """
    path = recorded_path(scene)
    reference = replayed(scene, path)
    again = replayed(scene, path)
    noise = max(
        float(np.abs(again.tips_m - reference.tips_m).max()),
        float(np.abs(again.forces_N - reference.forces_N).max()),
    )
    found = {}
    # A shift of the device moves the tool by this factor.
    scale = scene.held.coupling.motion_scale
    for name, (size_m, change) in CHANGES.items():
        course = replayed(scene, change(path))
        grown = amplification(course, reference, scale * size_m)
        found[name] = (*grown, 100.0 * force_error(course, reference))
    return found, noise, reference.first


def main() -> None:
    """Measure and print a table for each scene."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", help="default: all scenes, and T3")
    parser.add_argument("--hands", type=int, default=10, help="number of hands (seeds)")
    parser.add_argument("--seconds", type=float, default=3.0, help="duration of a run")
    given = parser.parse_args()
    print(machine())
    unequal = []
    for name in given.scenes or (*scene_names(), "T3"):
        hands = [
            measured(scene_of(name, SEED + hand, given.seconds)) for hand in range(given.hands)
        ]
        noise = max(each for _, each, _ in hands)
        touched = ", ".join(f"{1e-3 * first:.2f}" for *_, first in hands)
        print(f"\n{name}: noise floor {noise:g} m, N; first contact at {touched} s")
        # Two replays of one path do the same work, so that any difference is an error of the bench.
        if noise != 0.0:
            unequal.append(name)
        rows = []
        for change in CHANGES:
            values = np.array([found[change] for found, *_ in hands])
            both = np.stack([np.median(values, axis=0), values.max(axis=0)], axis=1).ravel()
            rows.append((name, change, *(f"{each:.4g}" for each in both)))
        print(table(rows, HEAD), flush=True)
    if unequal:
        raise SystemExit(f"equal paths give different runs: {', '.join(unequal)}")


if __name__ == "__main__":
    main()
