"""Coverage of fits to cuts: `python tests/bench/bench_fit_cutting.py [bone|tooth] [--fits 1000] [--normal]`.

A glenoid is reamed through its plate into trabecular bone, and a carious lesion drilled out of a molar, each at two
feeds. The geometry is recorded once; then constants, densities, the sensor's bias and the offset of its clock are drawn
from their priors, autocorrelated noise with heavy tails is added, and the log is fitted. Printed: how often the 90 %
intervals of what the fit calls identified, constants and combinations, and that of the offset, hold what was planted.
Such a count has an error of its own, sqrt(0.9 0.1 / fits): 0.9 % for 1,000. With `--normal` the noise has no heavy
tails, which the fit does not know.
"""

import argparse
import os
from collections import Counter
from dataclasses import replace
from functools import cache
from multiprocessing import Pool
from time import process_time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from scipy.signal import lfilter  # noqa: E402

from tissue.fitting.averaged import block_averages  # noqa: E402
from tissue.fitting.cutting import CuttingForward, cutting_forward  # noqa: E402
from tissue.fitting.identifiability import identified  # noqa: E402
from tissue.fitting.posterior import maximum_posterior  # noqa: E402
from tissue.fitting.target import OFFSET_S  # noqa: E402
from tissue.scene.load import load_scene  # noqa: E402

CUTS = {
    "bone": ("glenoid", {"voxels.spacing_mm": 0.25}, [0.5, -1.0, -1.4, -3.0, -3.3], [0.0, 1.0, 2.0, 2.8, 3.8], 0.0),
    "tooth": ("caries", {}, [0.4, -1.2, -1.6, -3.0, -3.0, -3.0], [0.0, 0.8, 1.8, 2.5, 3.0, 3.8], 0.6),
}
"""Scene, changes, heights of the tip [mm] and their times [s], and how far it goes aside at the end [mm]."""
BLOCK = 20
"""Ticks of a block of the log's samples, 1 kHz, that are averaged."""
NOISE, BIAS, CORRELATION = 0.06, 0.1, 0.9
"""Scale of the noise and of the bias in shares of the greatest force, and torque, at the cited constants; of noise."""
FREEDOM = 4.0
"""Degrees of freedom of what the noise adds in a millisecond."""


@cache
def cut(kind: str) -> tuple[CuttingForward, CuttingForward]:
    """Every tick, and averaged as the fit takes it."""
    name, changes, heights, times, aside = CUTS[kind]
    scene = load_scene(name, changes).model_copy(update={"stress": None})
    tips = np.zeros((len(heights), 3))
    tips[:, 2] = heights
    tips[-1, 0] = aside
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(tips), 1))
    whole = cutting_forward(scene, np.array(times), 1e-3 * tips, upright, cores=1)
    log = block_averages(whole.times_s, np.zeros((len(whole.times_s), 6)), whole.channels, BLOCK)
    return whole, whole.averaged_as(log)[0]


def one(task: tuple[str, int, bool]) -> tuple[list[tuple[str, bool]], bool, float]:
    kind, seed, normal = task
    (whole, forward), rng = cut(kind), np.random.default_rng(seed)
    priors = [each.prior for each in forward.parameters]
    largest = np.abs(forward.loads(np.array([float(each.x(0.0)) for each in priors]))).max(axis=0)
    size = np.repeat([largest[:3].max(), largest[3:].max()], 3)
    z = rng.standard_normal(len(priors))
    loads = whole.loads(np.array([float(each.x(at)) for each, at in zip(priors, z, strict=True)]))
    offset_s = OFFSET_S * rng.standard_normal()
    values = np.column_stack([np.interp(whole.times_s - offset_s, whole.times_s, each) for each in loads.T])
    fresh = rng.standard_normal(values.shape) if normal else rng.standard_t(FREEDOM, values.shape)
    noise = lfilter([1.0], [1.0, -CORRELATION], NOISE * size * fresh, axis=0)
    measured = values + noise + BIAS * size * rng.standard_normal(6)
    log = replace(block_averages(whole.times_s, measured, whole.channels, BLOCK), within_s=(0.0,))
    start = process_time()
    posterior = maximum_posterior(forward, log)
    took, result = process_time() - start, identified(posterior)
    true = {name: float(prior.x(at)) for name, prior, at in zip(posterior.names, priors, z, strict=True)}
    low, high = posterior.offset_interval_s
    held = [("offset", low <= offset_s <= high)]
    for name in result.determined:
        low, _, high = posterior.interval(posterior.names.index(name))
        held.append((f"constant {name}", low <= true[name] <= high))
    for each in result.combinations:
        planted = each.of(np.array(list(true.values())))
        held.append(("combinations", bool(each.low <= planted <= each.high)))
    return held, posterior.converged, took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=list(CUTS))
    parser.add_argument("--fits", type=int, default=1000)
    parser.add_argument("--normal", action="store_true")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    for kind in options.kinds:
        hits, counts, seconds, converged = Counter(), Counter(), [], 0
        with Pool(options.processes) as pool:
            for held, found, took in pool.imap_unordered(
                one, [(kind, seed, options.normal) for seed in range(options.fits)], 5
            ):
                seconds.append(took)
                converged += found
                if len(seconds) % 50 == 0:
                    print(
                        f"{len(seconds)} fits, {hits['all identified']} of {counts['all identified']} held", flush=True
                    )
                for name, inside in held:
                    kinds = ["constants"] if name.startswith("constant ") else []
                    for each in (name, *kinds, *([] if name == "offset" else ["all identified"])):
                        counts[each] += 1
                        hits[each] += inside
        _, forward = cut(kind)
        print(f"{kind}: {options.fits} fits of {len(cut(kind)[0].times_s) // BLOCK} samples, {len(forward.parameters)} constants, "
              f"{converged} converged, median {np.median(seconds):.2f} s of processor time")  # fmt: skip
        for name, count in sorted(counts.items(), key=lambda each: -each[1]):
            print(f"  {name:55s} {100 * hits[name] / count:5.1f} % of {count}", flush=True)


if __name__ == "__main__":
    main()
