"""Time of a tick by stage and scene, for scripted motion and for a hand.

Run: `python tests/bench/profile_ticks.py [--added] [SCENE ...]`.

Stages are medians over ticks in contact [us], of the faster of two runs. For a hand, the stage
`motion` includes the simulated device and hand, which a real device does not need. `--added` prints the time
that hand, coupling, prediction by koopman-look-ahead and perception add to the same scripted scene.
It is given as percentiles of ticks with a hand minus ticks with a script. The smallest time over
some runs is used for every tick, since another process on the machine can only add time.
"""

import argparse
from collections.abc import Sequence
from time import thread_time
from typing import Any

import numpy as np
from harness import machine, table

from meshes.base.errors import InputError
from tissue.evaluation.charts.measure import excerpt
from tissue.evaluation.charts.settings import by_hand
from tissue.scene.load import changed, load_scene, scene_names
from tissue.scene.scene import Scene
from tissue.simulation.run import Run
from tissue.simulation.simulate import RunObserver, simulate
from tissue.simulation.trace import TIMING_COLUMNS

STAGES = tuple(name.removesuffix("_us") for name in TIMING_COLUMNS[1:])
ADDED_RUNS, GAP_US = 3, 200.0
SETTLED = 20
"""Ticks in contact that are not counted: the first ones load code."""
HEAD = (
    "scene",
    "script",
    "by hand",
    "simulated device, hand",
    "added",
    "without those",
    "added, wall clock",
)
HANDED = {"prediction": "koopman-look-ahead", "perception": "population"}


def ran(scene: Scene) -> Run:
    """The faster of two runs."""
    return min(
        (simulate(scene, allow_unstable=True) for _ in range(2)),
        key=lambda run: np.median(run.timing["tick_us"]),
    )


def stages(run: Run) -> dict[str, float]:
    """Median of the tick and of each stage in contact [us], and the 99th percentile of the tick."""
    touching = np.flatnonzero(run.trace["contact_mm2"] > 0.0)[SETTLED:]
    counted = touching if touching.size else np.arange(len(run.trace.rows))
    found = {
        name: float(np.median(run.timing[f"{name}_us"][counted])) for name in ("tick", *STAGES)
    }
    return found | {"p99": float(np.percentile(run.timing["tick_us"][counted], 99))}


class Clocked(RunObserver):
    """Observer of a run that measures the processor time of its ticks [us].

    It also measures the time of the simulated device and hand within them.
    """

    def __init__(self) -> None:
        self.ticks_us: list[float] = []
        self.device_us: list[float] = []
        self._start_s = self._device_s = 0.0

    def on_begin(self, parts: Any, columns: tuple[str, ...]) -> None:
        if hasattr(parts.motion, "held"):
            device = parts.motion.held.device
            device.read = self._timed(device.read)

    def before_tick(self, index: int) -> None:
        self._device_s, self._start_s = 0.0, thread_time()

    def on_tick(self, index: int, row: np.ndarray, times: np.ndarray) -> bool:
        self.ticks_us.append(1e6 * (thread_time() - self._start_s))
        self.device_us.append(1e6 * self._device_s)
        return True

    def _timed(self, read: Any) -> Any:
        def timed(time_s: float) -> Any:
            start_s = thread_time()
            sample = read(time_s)
            self._device_s += thread_time() - start_s
            return sample

        return timed


def least_us(scenes: Sequence[Scene]) -> list[np.ndarray]:
    """Return the ticks in contact of each scene: wall, processor and simulated device [us].

    Each tick has the smallest value of the runs.

    A run does the same work each time. The scenes take turns, so that the load of the machine is
    the same for both.
    """
    found: list[list[np.ndarray]] = [[] for _ in scenes]
    for _ in range(ADDED_RUNS):
        for scene, runs in zip(scenes, found, strict=True):
            clocked = Clocked()
            run = simulate(scene, allow_unstable=True, observers=[clocked])
            touching = np.flatnonzero(run.trace["contact_mm2"] > 0.0)[SETTLED:]
            if not touching.size:
                raise InputError(
                    "duration_s",
                    f"include more than {SETTLED} ticks in contact",
                    "fewer",
                    "run longer",
                )
            times = np.array([run.timing["tick_us"], clocked.ticks_us, clocked.device_us])
            runs.append(times[:, touching])
    for runs in found:
        gaps = 100.0 * np.mean([each[0] - each[1] > GAP_US for each in runs])
        print(f"  {gaps:.2g} % of the ticks met a gap of the machine over {GAP_US:g} us")
    return [np.min(runs, axis=0) for runs in found]


def row_added(name: str) -> tuple[str, ...]:
    """Measure one scene by hand and by script, and return its row of the table."""
    scene = load_scene(name)
    by_script = [scene] * (scene.device is None)
    both = [changed(by_hand(scene), HANDED), *by_script]
    found = least_us([excerpt(each, {}, quick=True) for each in both])
    hand = found[0]
    # A wall is touched by a hand only, so that all of its time is added.
    script = found[1] if by_script else np.zeros((3, 1))
    cells = [
        f"{np.median(each):.0f}, {np.percentile(each, 99):.0f}"
        for each in (script[1], hand[1], hand[2])
    ]
    for whole, before in (
        (hand[1], script[1]),
        (hand[1] - hand[2], script[1]),
        (hand[0], script[0]),
    ):
        added_us = np.percentile(whole, (50, 99)) - np.percentile(before, (50, 99))
        cells.append(", ".join(f"{each:.0f}" for each in added_us))
    if not by_script:
        cells[0] = "none"
    return (name, *cells)


def added(names: Sequence[str]) -> None:
    """Print the time that a hand and its coupling add to each scripted scene.

    Each scene is printed as soon as it is measured, and all scenes as a table at the end. A scene
    that cannot run does not stop the others.
    """
    rows = []
    failed = []
    for name in names:
        print(name, flush=True)
        try:
            rows.append(row_added(name))
        except InputError as error:
            failed.append(name)
            print(f"  not measured: {error}", flush=True)
            continue
        shown = (f"{title} {cell}" for title, cell in zip(HEAD[1:], rows[-1][1:], strict=True))
        print(f"  {'; '.join(shown)}", flush=True)
    print("\nMedian, 99 % of ticks in contact [us], processor time\n\n" + table(rows, HEAD))
    if failed:
        raise SystemExit(f"not measured: {', '.join(failed)}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", help="default: all")
    parser.add_argument("--added", action="store_true", help="what a hand adds to the script")
    given = parser.parse_args()
    print(machine())
    if given.added:
        added(given.scenes or scene_names())
        return
    rows = []
    for name in given.scenes or scene_names():
        scene = load_scene(name)
        kinds = {"hand": by_hand(scene)} | ({"script": scene} if scene.device is None else {})
        for kind, whole in sorted(kinds.items(), reverse=True):
            short = excerpt(whole, {}, quick=True)
            at = stages(ran(short))
            largest = max(STAGES, key=at.__getitem__)
            rows.append(
                (
                    name,
                    kind,
                    f"{at['tick']:.0f}",
                    f"{at['p99']:.0f}",
                    *(f"{at[s]:.0f}" for s in STAGES),
                    largest,
                )
            )
            print(f"{name}, {kind}", flush=True)
    print("\n" + table(rows, ("scene", "moved by", "tick", "99 %", *STAGES, "largest")))


if __name__ == "__main__":
    main()
