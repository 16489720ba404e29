"""Coverage of fits to an organ.

Run: `python tests/bench/bench_fit_organ.py [elastic|viscous] [--fits 1000] [--noise 0.005]`.

A ball is pressed 3 mm into a small coarse slab, held, slid and lifted. Modulus, Poisson's ratio,
friction and, of a viscous slab, its Prony series are drawn from their priors, and so are the
sensor's bias and the offset of its clock; a run with them gets autocorrelated noise with heavy
tails, and the log is fitted as `tissue fit` does, by runs of its own. Printed: how often the 90 %
intervals of what the fit calls identified, constants and combinations, and that of the offset, hold
what was planted. Such a count has an error of its own, sqrt(0.9 0.1 / fits): 0.9 % for 1,000.
"""

import argparse
import os
from collections import Counter
from functools import cache
from multiprocessing import get_context
from tempfile import mkdtemp
from time import process_time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ["TISSUE_CACHE"] = mkdtemp(prefix="bench-fit-organ-")

import numpy as np  # noqa: E402
from scipy.signal import lfilter  # noqa: E402

from meshes.base.progress import silent  # noqa: E402
from tissue.fitting.identifiability import identified  # noqa: E402
from tissue.fitting.log_files import CHANNELS  # noqa: E402
from tissue.fitting.organ_problem import EVERY, SETTLED, settled  # noqa: E402
from tissue.fitting.organ_runs import (  # noqa: E402
    OrganRuns,
    Poses,
    organ_parameters,
)
from tissue.fitting.problem import block_averages, block_ticks  # noqa: E402
from tissue.fitting.target import OFFSET_S  # noqa: E402
from tissue.models.tissue_model import TICK_S  # noqa: E402
from tissue.scene.load import load_scene  # noqa: E402

SLAB = {
    "anatomy.size_mm": [50, 40, 20],
    "anatomy.nodule_diameter_mm": 0.0,
    "anatomy.edge_mm": 8.0,
    "anatomy.touch_edge_mm": 5.0,
    "organ.young_kPa": None,
    "organ.young_end_kPa": None,
    "organ.parts": None,
    "organ.interval_ms": 0.0,
    "organ.friction": 0.3,
}
TIMES_S = np.array([0.0, 0.1, 0.9, 1.3, 1.5, 1.8])
TIPS_MM = np.array([[-8, 0, 0.5], [-8, 0, -3], [-8, 0, -3], [4, 0, -3], [4, 0, -2], [4, 0, 0.5]])
"""Corners of the ball's path."""
BLOCK = block_ticks(float(TIMES_S[-1]), TICK_S)
"""Ticks of a block of the log's samples, 1 kHz, that are averaged."""
SHOWN = 20
"""Fits after which their count so far is printed."""
BIAS, CORRELATION = 0.1, 0.9
"""Scale of the bias as a share of the largest force, and correlation of the noise.

The largest force is the one at the cited constants.
"""


@cache
def setting(kind: str) -> tuple:
    """Return free constants, moduli among them, two runs of the slab, and the force.

    One run has every tick, the other the ticks that a fit uses.
    """
    scene = load_scene("palpation", SLAB | {"organ.viscous": kind == "viscous"})
    poses = Poses(TIMES_S, 1e-3 * TIPS_MM, np.tile([0.0, 0.0, 0.0, 1.0], (len(TIMES_S), 1)))
    parameters, moduli = organ_parameters(scene, ())
    whole, few = (
        OrganRuns(scene, poses, CHANNELS[:3]),
        OrganRuns(scene, poses, CHANNELS[:3], every=EVERY),
    )
    (usual,) = whole([{each.name: each.prior.value for each in parameters}])
    return parameters, moduli, whole, few, float(np.abs(usual).max())


def one(task: tuple[str, int, float]) -> dict:
    """One log, planted and fitted."""
    kind, seed, noise = task
    parameters, moduli, whole, runs, size = setting(kind)
    rng = np.random.default_rng(seed)
    z = rng.standard_normal(len(parameters))
    true = np.array([float(each.prior.x(at)) for each, at in zip(parameters, z, strict=True)])
    offset_s, start = OFFSET_S * rng.standard_normal(), process_time()
    (loads,) = whole([{each.name: float(x) for each, x in zip(parameters, true, strict=True)}])
    times_s = TICK_S * np.arange(len(loads))
    values = np.column_stack([np.interp(times_s - offset_s, times_s, each) for each in loads.T])
    noises = lfilter(
        [1.0], [1.0, -CORRELATION], noise * size * rng.standard_t(4, values.shape), axis=0
    )
    measured = values + noises + BIAS * size * rng.standard_normal(3)
    log, before = block_averages(times_s, measured, CHANNELS[:3], BLOCK), runs.count
    found = settled(parameters, moduli, runs, log, silent)
    posterior = found.posterior
    result = identified(posterior)
    low, high = posterior.offset_interval_s
    held = [("offset", low <= offset_s <= high)]
    for at, name in enumerate(posterior.names):
        low, _, high = posterior.interval(at)
        state = "constant" if name in result.determined else "other"
        held.append((f"{state} {name}", bool(low <= true[at] <= high)))
    held += [
        ("combinations", bool(each.low <= each.exact_value(true) <= each.high))
        for each in result.combinations
    ]
    return {
        "seed": seed,
        "held": held,
        "runs": runs.count - before,
        "settled": found.away < SETTLED,
        "converged": posterior.converged,
        "seconds": process_time() - start,
        "contraction": result.contraction,
        "off": (posterior.mean_z - z) / np.sqrt(np.diag(posterior.covariance_z)),
    }


def main() -> None:
    """Fit and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=["elastic", "viscous"])
    parser.add_argument("--fits", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first fit")
    parser.add_argument(
        "--noise", type=float, default=0.005, help="scale in shares of the largest force"
    )
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    for kind in options.kinds:
        fits = []
        with get_context("spawn").Pool(options.processes) as pool:
            seeds = range(options.first, options.first + options.fits)
            for fit in pool.imap(one, [(kind, seed, options.noise) for seed in seeds]):
                fits.append(fit)
                if len(fits) % SHOWN == 0 or len(fits) == options.fits:
                    show(kind, fits)


def show(kind: str, fits: list[dict]) -> None:
    """Print how often intervals of some fits hold what was planted."""
    hits, counts = Counter(), Counter()
    for fit in fits:
        for name, inside in fit["held"]:
            more = ["constants that are determined", "the same of fits that settled"][
                : 1 + fit["settled"]
            ]
            for each in (name, *(more if name.startswith("constant ") else [])):
                counts[each] += 1
                hits[each] += inside
    print(
        f"{kind}: {len(fits)} fits, {sum(each['settled'] for each in fits)} settled, "
        f"{sum(each['converged'] for each in fits)} converged, medians "
        f"{np.median([each['runs'] for each in fits]):.0f} "
        f"runs and {np.median([each['seconds'] for each in fits]):.1f} s of processor time"
    )
    for name, count in sorted(counts.items(), key=lambda each: -each[1]):
        print(f"  {name:55s} {100 * hits[name] / count:5.1f} % of {count}", flush=True)


if __name__ == "__main__":
    main()
