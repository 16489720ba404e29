"""Coverage of fits to cuts.

Run: `python tests/bench/bench_fit_cutting.py [block|bone|tooth] [--truth prior|ends|cited]`.

A block is milled, a glenoid is reamed through its plate into trabecular bone, and a carious lesion
is drilled out of a molar, each at several feeds. The geometry is recorded once. Each log then has
its own constants, sensor bias, clock offset and autocorrelated noise with heavy tails, and is
fitted. `--truth` chooses the constants:

- prior: all of them drawn from their priors, a one-sided constant being its cited value in half of
  the logs;
- ends: constants whose cited value is an end of their range, such as the size exponent, at that
  value, others drawn;
- cited: all coefficients at their cited values. The densities belong to the specimen and are drawn
  as ever.

The bench prints how often the 90 % intervals hold the planted values: of the constants that the fit
calls determined, of those with a cited value at the end of their range, of combinations, and of the
offset. A count has a standard error of its own, sqrt(0.9 0.1 / fits) or 1.5 % of 400. With
`--normal` the noise has no heavy tails, which the fit does not know.
"""

import argparse
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from multiprocessing import Pool
from time import process_time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from scipy.signal import lfilter  # noqa: E402

from tissue.fitting.cutting import CuttingForward, cutting_forward  # noqa: E402
from tissue.fitting.identifiability import identified  # noqa: E402
from tissue.fitting.posterior import maximum_posterior  # noqa: E402
from tissue.fitting.problem import Parameter, block_averages  # noqa: E402
from tissue.fitting.target import OFFSET_S  # noqa: E402
from tissue.scene.load import load_scene  # noqa: E402

CUTS = {
    "block": (
        "milling",
        {"voxels.spacing_mm": 0.3, "tool.shell_spacing_mm": 0.3},
        [(-6.0, 0.3), (-6.0, -0.6), (-4.0, -0.6), (0.0, -0.6), (6.0, -0.6)],
        [0.0, 0.8, 2.0, 2.4, 2.7],
        0.01,
    ),
    "bone": (
        "glenoid",
        {"voxels.spacing_mm": 0.25},
        [(0.0, 0.5), (0.0, -1.0), (0.0, -1.4), (0.0, -3.0), (0.0, -3.3)],
        [0.0, 1.0, 2.0, 2.8, 3.8],
        0.06,
    ),
    "tooth": (
        "caries",
        {},
        [(0.0, 0.4), (0.0, -1.2), (0.0, -1.6), (0.0, -3.0), (0.0, -3.0), (0.6, -3.0)],
        [0.0, 0.8, 1.8, 2.5, 3.0, 3.8],
        0.06,
    ),
}
"""Scenes with their changes, path and noise.

The path gives positions of the tip along x and z [mm] and their times [s]. The noise is the scale
of what is added in each millisecond, as a share of the largest force, and torque, at the cited
constants. The block's log determines coefficients by itself: it has four feeds and little noise.
The other two leave some of them to their priors.
"""
BLOCK = 20
"""Ticks of a block of the log's samples, 1 kHz, that are averaged."""
BIAS, CORRELATION = 0.1, 0.9
"""Scale of the bias in the same shares, and correlation of the noise over one millisecond."""
FREEDOM = 4.0
"""Degrees of freedom of what the noise adds in a millisecond."""


@cache
def cut(kind: str) -> tuple[CuttingForward, CuttingForward]:
    """Every tick, and averaged as the fit takes it."""
    name, changes, places, times, _ = CUTS[kind]
    scene = load_scene(name, changes).model_copy(update={"stress": None})
    tips = np.zeros((len(places), 3))
    tips[:, [0, 2]] = places
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(tips), 1))
    whole = cutting_forward(scene, np.array(times), 1e-3 * tips, upright, cores=1)
    log = block_averages(whole.times_s, np.zeros((len(whole.times_s), 6)), whole.channels, BLOCK)
    return whole, whole.averaged_as(log)[0]


def planted(parameters: Sequence[Parameter], truth: str, rng: np.random.Generator) -> np.ndarray:
    """Standard normal numbers of the constants of a log, shape (p,)."""
    z = rng.standard_normal(len(parameters))
    sides = np.array([each.side for each in parameters])
    if truth == "cited":
        return np.where([each.name.startswith("density.") for each in parameters], z, 0.0)
    if truth == "ends":
        return np.where(sides == 0.0, z, 0.0)
    return np.where(sides * z < 0.0, 0.0, z)


def one(task: tuple[str, int, str, bool]) -> tuple[list[tuple[str, bool]], bool, float]:
    """Fit one log and return the coverage, the convergence and the processor time [s].

    The coverage lists for each interval whether it holds the planted value.
    """
    kind, seed, truth, normal = task
    (whole, forward), rng = cut(kind), np.random.default_rng(seed)
    priors = [each.prior for each in forward.parameters]
    largest = np.abs(forward.loads(np.array([float(each.x(0.0)) for each in priors]))).max(axis=0)
    size = np.repeat([largest[:3].max(), largest[3:].max()], 3)
    z = planted(forward.parameters, truth, rng)
    loads = whole.loads(np.array([float(each.x(at)) for each, at in zip(priors, z, strict=True)]))
    offset_s = OFFSET_S * rng.standard_normal()
    values = np.column_stack(
        [np.interp(whole.times_s - offset_s, whole.times_s, each) for each in loads.T]
    )
    fresh = rng.standard_normal(values.shape) if normal else rng.standard_t(FREEDOM, values.shape)
    noise = lfilter([1.0], [1.0, -CORRELATION], CUTS[kind][-1] * size * fresh, axis=0)
    measured = values + noise + BIAS * size * rng.standard_normal(6)
    log = replace(block_averages(whole.times_s, measured, whole.channels, BLOCK), within_s=(0.0,))
    start = process_time()
    posterior = maximum_posterior(forward, log)
    result = identified(posterior)
    took = process_time() - start
    true = {
        name: float(prior.x(at)) for name, prior, at in zip(posterior.names, priors, z, strict=True)
    }
    sides = {each.name: each.side for each in forward.parameters}
    held = []
    low, high = posterior.offset_interval_s
    held.append(("offset", low <= offset_s <= high))
    for name in result.determined:
        low, _, high = posterior.interval(posterior.names.index(name))
        what = "constant at an end" if sides[name] else "constant"
        held.append((f"{what} {name}", low <= true[name] <= high))
    for each in result.combinations:
        value = each.exact_value(np.array(list(true.values())))
        held.append(("combinations", bool(each.low <= value <= each.high)))
    return held, posterior.converged, took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=list(CUTS))
    parser.add_argument("--fits", type=int, default=1000)
    parser.add_argument("--truth", choices=["prior", "ends", "cited"], default="prior")
    parser.add_argument("--normal", action="store_true")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    for kind in options.kinds:
        hits, counts, seconds, converged = Counter(), Counter(), [], 0
        with Pool(options.processes) as pool:
            for held, found, took in pool.imap_unordered(
                one,
                [(kind, seed, options.truth, options.normal) for seed in range(options.fits)],
                5,
            ):
                seconds.append(took)
                converged += found
                for name, inside in held:
                    kinds = (
                        ["constants"]
                        if name.startswith("constant cutting") or "density" in name
                        else []
                    )
                    kinds += (
                        ["constants at an end"] if name.startswith("constant at an end") else []
                    )
                    for each in (name, *kinds):
                        counts[each] += 1
                        hits[each] += inside
        _, forward = cut(kind)
        print(
            f"{kind}, {options.truth}: {options.fits} fits of "
            f"{len(cut(kind)[0].times_s) // BLOCK} samples, {len(forward.parameters)} "
            "constants, "
            f"{converged} converged, median {np.median(seconds):.2f} s of processor time"
        )
        for name, count in sorted(counts.items(), key=lambda each: -each[1]):
            print(f"  {name:55s} {100 * hits[name] / count:5.1f} % of {count}", flush=True)


if __name__ == "__main__":
    main()
