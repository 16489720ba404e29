"""Bands of built-in scenes: their cost beside the plain run, and how far their ends are from those of many samples."""

from time import process_time

import numpy as np
from harness import machine

from tissue.scene.load import load_scene
from tissue.simulation.load_record import record_loads
from tissue.simulation.simulate import simulate
from tissue.uncertainty.band import band_of
from tissue.uncertainty.reweighed import Reweighed
from tissue.uncertainty.sample import normals

ENDS = (0.05, 0.5, 0.95)
SEEDS = range(10)


def spent_s(work):
    """Processor time of a call, after one that compiles."""
    started = process_time()
    found = work()
    return process_time() - started, found


def cost(name):
    """Cost of a band of 200 samples, in runs."""
    scene = load_scene(name)
    simulate(scene, cores=1)
    run_s, _ = spent_s(lambda: simulate(scene, cores=1))
    band_s, band = spent_s(lambda: band_of(scene, 200, cores=1))
    peak = band.summary["force_N"]["peak"]
    print(f"{name}: run {run_s:.2f} s, band {band_s:.2f} s of processor time, {band_s / run_s:.1f} runs; ", end="")
    print(f"peak force {peak['p50']:.1f} N, 90 % {peak['p05']:.2f} to {peak['p95']:.1f} N")


def convergence():
    """Root mean square error over seeds of the quantiles of milling's peak force."""
    reweighed = Reweighed(record_loads(load_scene("milling"), cores=1))
    width = len(reweighed.ranges.names)

    def ends(count, seed):
        figures = reweighed.figures(reweighed.ranges.x(normals(count, width, seed=seed)))
        return np.quantile(figures[:, 0], ENDS)

    reference = np.mean([ends(4096, 100 + seed) for seed in range(4)], axis=0)
    for count in (64, 256, 1024):
        errors = np.array([ends(count, seed) for seed in SEEDS]) / reference - 1.0
        print(f"{count} samples: 5, 50, 95 % of the peak off by {np.sqrt((errors**2).mean(axis=0)).round(4)}")


if __name__ == "__main__":
    print(machine())
    for name in ("milling", "glenoid"):
        cost(name)
    convergence()
