"""Cost and error of a hyperelastic organ at 1 kHz.

Run: `python tests/bench/chart_law.py --out DIR [--ratio 0.45]`.

A ball of 16 mm is pressed 6.4 mm into a slab at 20 mm/s and rests there, neo-Hookean: by the linear
law, by the compliance at rest with an offset solved on coarser meshes and at other intervals, and
by Newton's method, which is the reference. Force while it moves and at rest, displacement of the
surface at rest, time of a solve between ticks and of a tick, both processor time of one core.
Writes `law.csv`.
"""

import argparse
import csv
from pathlib import Path
from time import process_time

import numpy as np
from harness import machine, table  # adds the fixtures to the path
from pressed_deep import by_newton, moving_N, scene_of, surface_error

from tissue.models.organ.law_offset import LawOffset
from tissue.simulation.simulate import simulate

RATIOS, INTERVALS_MS = (1.0, 1.4, 2.0, 2.8), (10.0, 25.0, 100.0)
HEAD = (
    "law",
    "ratio",
    "interval ms",
    "unknowns",
    "solve ms",
    "99 %",
    "tick us",
    "99 %",
    "moving %",
    "at rest %",
    "displacement %",
)
TOUCHED_N = 1e-3
"""Force from which a tick and a solve count."""


def measured(scene):
    """A run, and the processor time of its solves in contact [s]."""
    taken, plain = [], LawOffset.renew

    def timed(self, time_s, depth_m, contact):
        start, due = process_time(), time_s >= self._next_s - 1e-9
        plain(self, time_s, depth_m, contact)
        if due and np.abs(contact.result.force_N).sum() > TOUCHED_N:
            taken.append(process_time() - start)

    LawOffset.renew = timed
    try:
        return simulate(scene, cores=1), np.array(taken or [0.0])
    finally:
        LawOffset.renew = plain


def row_of(name, scene, exact):
    run, taken = measured(scene)
    ticks = run.timing["tick_us"][run.trace["force_z_N"] > TOUCHED_N]
    unknowns = 0 if name == "linear" else run.parts.notes["law"].split(" on ")[1].split()[0]
    moving = np.linalg.norm(moving_N(run) - exact.force_N) / np.linalg.norm(exact.force_N)
    rest = abs(run.trace["force_z_N"][-1] / exact.force_N[-1] - 1.0)
    late = [float(1e3 * np.percentile(taken, share)) for share in (50, 99)]
    tick = [float(np.percentile(ticks, share)) for share in (50, 99)]
    return [
        name,
        scene.organ.law_edge_ratio,
        scene.organ.law_interval_ms,
        int(unknowns),
        *late,
        *tick,
        100.0 * moving,
        100.0 * rest,
        100.0 * surface_error(run, exact),
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--ratio", type=float, default=0.45, help="Poisson's ratio")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    print(machine())
    neo = {"law": "neo-hookean", "poisson_ratio": asked.ratio}
    exact = by_newton(scene_of(**neo))
    rows = [row_of("linear", scene_of(poisson_ratio=asked.ratio), exact)]
    for ratio in RATIOS:
        for interval in INTERVALS_MS:
            scene = scene_of(**neo, law_edge_ratio=ratio, law_interval_ms=interval)
            rows.append(row_of("neo-Hookean", scene, exact))
    with (asked.out / "law.csv").open("w", newline="") as file:
        csv.writer(file).writerows([HEAD, *rows])
    print(
        table(
            [
                [f"{value:.3g}" if isinstance(value, float) else str(value) for value in row]
                for row in rows
            ],
            HEAD,
        )
    )


if __name__ == "__main__":
    main()
