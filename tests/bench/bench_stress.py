"""Processor time of the stress of `molar` along its own path.

Run: `python tests/bench/bench_stress.py [CELL_MM ...]`.

Each solve of the scene (update, solve and recovery) runs on one core between the ticks. Printed are
the solves under load, in ms of processor time. A busy machine raises this time by up to half, since
its cores share caches. A rate of 10 Hz leaves 100 ms.
"""

import os
import sys
from time import process_time

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import numpy as np
from harness import machine, table

from tissue.models.tooth import stress_process
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate


class TimedSolver(stress_process.InlineStressSolver):
    """Solves here, and keeps what the loaded solves took [s] and their iterations."""

    taken: list[tuple[float, int]] = []  # noqa: RUF012

    def wait(self):
        loaded = self._begun is not None and self._begun.force_N.any()
        start = process_time()
        record = super().wait()
        if loaded:
            self.taken.append((process_time() - start, record.iterations))
        return record


def main():
    print(machine())
    stress_process.StressProcess = TimedSolver
    rows = []
    for cell in [float(each) for each in sys.argv[1:]] or [0.5, 0.4, 0.3]:
        TimedSolver.taken = []
        simulate(load_scene("molar", {"stress.cell_mm": cell}))
        taken, iterations = np.array(TimedSolver.taken).T
        ms = 1e3 * np.array([taken.min(), *np.quantile(taken, (0.5, 0.9)), taken.max()])
        rows.append(
            (
                f"{cell:g} mm",
                f"{len(taken)}",
                *(f"{each:.0f}" for each in ms),
                f"{iterations.mean():.1f}",
            )
        )
    print(table(rows, ("cell", "solves", "least ms", "median", "90 %", "worst", "iterations")))


if __name__ == "__main__":
    main()
