"""Late ticks, compared with the gaps of the machine itself.

Run: `python tests/bench/bench_tail.py [--rounds 3] [--seconds 1.5] [SCENE ...]`.

Each round runs every variant in turn, so that all run under the same load. The variants are
launches as chosen, never and always split, ticks pinned to one core, and both threads on one core
(as where two processors share it). With stress there is one more: its process at ordinary priority
on every core. Printed are medians over rounds, next to gaps over 0.2 ms that a spinning clock found
just before and after the ticks.
"""

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np
from harness import machine, table

from kernels.cores import CoreThreads, current_core
from tissue.scene.load import load_scene, parse_override
from tissue.scene.scene import Scene
from tissue.simulation.observer import RunObserver
from tissue.simulation.run import DEADLINE_US, Run
from tissue.simulation.simulate import simulate
from tissue.system.priorities import BackgroundPriority, spin

SPLIT = "kernels.split_choice.LEAST_GAIN"
SPUN_S = 0.3
HEAD = (
    "scene",
    "variant",
    "median",
    "99 %",
    "missed",
    "expected gaps",
    "missed / gaps",
    "split of large",
)


class Pinned(RunObserver):
    """Goes along with a run and keeps its ticks on the core on which they begin."""

    def on_begin(self, parts: Any, columns: tuple[str, ...]) -> None:
        self._allowed = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {current_core()})

    def on_end(self) -> list[tuple[float, str]]:
        os.sched_setaffinity(0, self._allowed)
        return []


@contextmanager
def on_one_core() -> Iterator[None]:
    """All threads of this process on one core."""
    allowed = os.sched_getaffinity(0)
    threads = [int(number) for number in os.listdir("/proc/self/task")]
    try:
        for number in threads:
            os.sched_setaffinity(number, {max(allowed)})
        yield
    finally:
        for number in threads:
            os.sched_setaffinity(number, allowed)


def variants(scene: Scene) -> dict[str, Callable[[], Run]]:
    """Return the variants that are compared."""

    def always() -> Run:
        with patch(SPLIT, 0.0):
            return simulate(scene, allow_unstable=True)

    def shared() -> Run:
        with on_one_core(), patch.object(CoreThreads, "keep_off", lambda self, core: None):
            return simulate(scene, allow_unstable=True, cores=2)

    def ordinary() -> Run:
        with patch.object(BackgroundPriority, "step_back", lambda self: None):
            return simulate(scene, allow_unstable=True)

    found = {
        "as chosen": lambda: simulate(scene, allow_unstable=True),
        "never split": lambda: simulate(scene, allow_unstable=True, cores=1),
        "always split": always,
        "as chosen, ticks pinned": lambda: simulate(scene, allow_unstable=True, observer=Pinned()),
        "as chosen, one core for two threads": shared,
    }
    return found | ({"stress at ordinary priority": ordinary} if scene.stress is not None else {})


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "scenes", nargs="*", default=["glenoid", "caries"], help="default: glenoid caries"
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=1.5, help="simulated")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="as for `tissue run`"
    )
    parser.add_argument(
        "--only", action="append", default=[], metavar="VARIANT", help="default: all"
    )
    given = parser.parse_args()
    print(machine())
    rows = []
    changes = dict(parse_override(text) for text in given.set)
    for name in given.scenes:
        scene = load_scene(name, changes | {"duration_s": given.seconds})
        kinds = {
            kind: call
            for kind, call in variants(scene).items()
            if not given.only or kind in given.only
        }
        figures: dict[str, list[tuple[float, ...]]] = {kind: [] for kind in kinds}
        for index in range(given.rounds + 1):
            for kind, call in kinds.items():
                before = spin(SPUN_S)
                run = call()
                gaps = before + spin(SPUN_S)
                if index > 0:  # the first round warms up
                    ticks, chosen = run.timing["tick_us"], run.summary["scheduling"]
                    figures[kind].append(
                        (
                            float(np.median(ticks)),
                            float(np.percentile(ticks, 99)),
                            float((ticks > DEADLINE_US).sum()),
                            gaps.expected(1e-6 * float(ticks.sum())),
                            chosen["split_launches"],
                            chosen["large_launches"],
                        )
                    )
        for kind, found in figures.items():
            median, p99 = np.median(found, axis=0)[:2]
            missed, gaps, split, large = np.sum(found, axis=0)[2:]
            ratio = f"{missed / gaps:.2f}" if gaps else "-"
            rows.append(
                (
                    name,
                    kind,
                    f"{median:.0f}",
                    f"{p99:.0f}",
                    f"{missed:.0f}",
                    f"{gaps:.1f}",
                    ratio,
                    f"{split:.0f} of {large:.0f}",
                )
            )
    print("\n" + table(rows, HEAD))


if __name__ == "__main__":
    main()
