"""How often 90 % intervals of a fit hold what was planted: 1,000 logs of each kind of scene, Laplace's approximation.

    python tests/bench/bench_fit_coverage.py [KIND ...] [--fits 1000] [--workers 2]

Constants are drawn from their priors, a density with them (10 %), the clocks' offset (10 ms), biases (half the size of the
forces) and noise: autocorrelated over 10 ms, with Student's tails, 3 % of the forces' size. Each log is made at 1 kHz, averaged and fitted as `tissue fit` does. Printed: the
share of determined constants and of identified combinations whose interval holds the planted value, and how many fits found no
maximum.
"""

import argparse
import multiprocessing
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tissue.fitting.averaged import block_averages, block_ticks
from tissue.fitting.cutting import cutting_forward
from tissue.fitting.identifiability import identified
from tissue.fitting.posterior import maximum_posterior
from tissue.models.tissue_model import TICK_S
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

NOISE, CORRELATION, BIAS, OFFSET_S = 0.03, 0.9, 0.5, 0.01
SCENES = {
    "bone": ("milling", {"voxels.spacing_mm": 0.2}),
    "glenoid": ("glenoid", {"voxels.spacing_mm": 0.3}),
    "tooth": ("caries", {}),
}
"""Kinds, the scene of each and its settings."""


def forward_of(kind):
    """A recorded cut along the scene's own path."""
    name, changes = SCENES[kind]
    scene = load_scene(name, changes)
    trace = simulate(scene).trace
    turns = np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"])
    return cutting_forward(scene, trace["time_s"], 1e-3 * trace.vectors("tool", "mm"), turns)


def log_of(forward, rng):
    """A log at 1 kHz, and the z that were planted."""
    z = rng.standard_normal(len(forward.parameters))
    x = np.array([float(each.prior.x(at)) for each, at in zip(forward.parameters, z, strict=True)])
    times, offset_s = forward.times_s, OFFSET_S * rng.standard_normal()
    loads = np.column_stack([np.interp(times - offset_s, times, one) for one in forward.loads(x).T])
    size = np.sqrt(np.mean(loads**2, axis=0))
    size = np.repeat([size[:3].max(), size[3:].max()], 3)
    fresh = NOISE * np.sqrt(1.0 - CORRELATION**2) * size * rng.standard_t(4.0, size=loads.shape) / np.sqrt(2.0)
    noise = fresh.copy()
    for row in range(1, len(noise)):
        noise[row] += CORRELATION * noise[row - 1]
    return times, loads + noise + BIAS * size * rng.standard_normal(6), z


def one(seed):
    """Errors over standard deviations of constants that are determined, and of combinations; whether it converged."""
    forward, ticks = SHARED
    times, loads, z = log_of(forward, np.random.default_rng([2026, seed]))
    found = maximum_posterior(forward, block_averages(times, loads, forward.channels, ticks))
    result = identified(found)
    spread = np.sqrt(np.diag(found.covariance_z))
    single = [
        (found.mean_z[at] - z[at]) / spread[at] for at, name in enumerate(found.names) if name in result.determined
    ]
    together = []
    for each in result.combinations:
        places = [found.names.index(name) for name in each.powers]
        planted = sum(
            power * np.log(float(found.priors[at].x(z[at])) / float(found.priors[at].x(0.0)))
            for at, power in zip(places, each.powers.values(), strict=True)
        )
        half = 0.5 * np.log(each.high / each.low) / 1.6448536
        together.append((np.log(each.value) - planted) / half)
    return single, together, found.converged


def begin(shared):
    """Keep what every fit of a worker uses."""
    global SHARED
    SHARED = shared


def main():
    """Fit and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=list(SCENES))
    parser.add_argument("--fits", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    for kind in asked.kinds:
        forward = forward_of(kind)
        ticks = block_ticks(float(forward.times_s[-1] - forward.times_s[0]))
        shared = forward, ticks
        start = time.perf_counter()
        with multiprocessing.get_context("spawn").Pool(asked.workers, begin, (shared,)) as pool:
            found = pool.map(one, range(asked.fits), chunksize=1)
        took_s = time.perf_counter() - start
        single = np.concatenate([np.array(each[0]) for each in found])
        together = np.concatenate([np.array(each[1]) for each in found])
        lost = sum(not each[2] for each in found)
        print(
            f"{kind}: {asked.fits} logs of {forward.times_s[-1]:.1f} s every {ticks * TICK_S * 1e3:g} ms, {took_s:.0f} s"
        )
        for what, errors in (("determined constants", single), ("identified combinations", together)):
            if len(errors):
                share, high, low = (100.0 * np.mean(np.abs(errors) < 1.6448536), np.mean(errors), np.std(errors))
                print(f"  {what}: {len(errors)}, 90 % intervals hold {share:.1f} %; errors {high:+.2f} +- {low:.2f}")
        print(f"  without a maximum: {lost}", flush=True)


if __name__ == "__main__":
    main()
