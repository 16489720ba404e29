"""Lateness of live ticks at ordinary and at raised priority.

Run: ``python tests/bench/bench_jitter.py --minutes 2``.

A scene, by default a wall by a simulated hand, runs against the wall clock without a window, in
turns of 10 s: on the machine as it is and with a process on every core that does nothing but count,
at ordinary priority and as raised as the system grants. The four take turns, so that what the
machine does besides falls on all of them. The load that was there already is printed.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402
from harness import machine, table  # noqa: E402

from tissue import load_scene  # noqa: E402
from tissue.simulation.live.run import LiveObserver  # noqa: E402
from tissue.simulation.observer import (  # noqa: E402
    Prioritised,
)
from tissue.simulation.simulate import TICK_S, simulate  # noqa: E402

TURN_S = 10.0
ORDINARY = "ordinary priority"
COUNT = "while True:\n    pass"


def ticks_of(name, raised, loaded):
    """Return the ticks of one turn, the skipped time of the clock [ms] and the priority.

    Ticks have lateness and duration [us].
    """
    count = os.cpu_count() or 1
    busy = [subprocess.Popen([sys.executable, "-c", COUNT]) for _ in range(count if loaded else 0)]
    try:
        scene = load_scene(name, {"duration_s": TURN_S})
        observer = LiveObserver(scene, None)
        prioritised = Prioritised()
        run = simulate(scene, observers=[prioritised, observer] if raised else [observer])
    finally:
        for process in busy:
            process.kill()
            process.wait()
    timing = run.timing
    return (
        timing["late_us"],
        timing["tick_us"],
        1e-3 * timing["skipped_us"].sum(),
        prioritised.note if raised else ORDINARY,
    )


def main():
    """Measure and print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=1.0, help="of each of the four")
    parser.add_argument("--scene", default="wall")
    given = parser.parse_args()
    turns = max(round(60.0 * given.minutes / TURN_S), 1)
    print(machine())
    print(f"{turns} turns of {TURN_S:g} s each; load before: {os.getloadavg()[0]:.1f}", flush=True)
    kinds = [(loaded, raised) for loaded in (False, True) for raised in (False, True)]
    found = {kind: [] for kind in kinds}
    for _ in range(turns):
        for loaded, raised in kinds:
            found[loaded, raised].append(ticks_of(given.scene, raised, loaded))
    rows = []
    for (loaded, _), parts in found.items():
        late, tick = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        figures = [*np.percentile(late, (50.0, 99.0, 99.9)), late.max()]
        rows.append(
            (
                "busy on every core" if loaded else "as it is",
                parts[0][3],
                *(f"{each:.0f}" for each in figures),
                f"{int((late + tick > 1e6 * TICK_S).sum())} of {len(late)}",
                f"{sum(part[2] for part in parts):.0f}",
            )
        )
    head = (
        "machine",
        "priority",
        "late us: median",
        "99 %",
        "99.9 %",
        "max",
        "missed ticks",
        "skipped ms",
    )
    print(table(rows, head))


if __name__ == "__main__":
    main()
