"""Coverage of fits to a needle's log: `python tests/bench/bench_fit_needle.py [--fits 1000] [--known] [--first N]`.

A needle goes 60 mm deep through a liver's capsule, rests and is drawn back to 15 mm. For each fit the constants, the
sensor's bias and the offset of its clock are drawn from their priors, none is left out; the engine's law runs at 1 kHz,
and autocorrelated noise with heavy tails is added. The jumps of the force are found in that log, as a person's fit
finds them. Printed: how often the 90 % intervals of what the fit calls identified, constants and combinations, and that
of the offset, hold what was planted; of all constants, in brackets, too. Such a count has an error of its own,
sqrt(0.9 0.1 / fits): 0.9 % for 1,000. With `--known` the moments of the jumps are given.
"""

import argparse
import os
from collections import Counter
from dataclasses import replace
from multiprocessing import Pool
from time import process_time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from scipy.signal import lfilter  # noqa: E402

from tissue.fitting.averaged import block_averages, block_ticks  # noqa: E402
from tissue.fitting.identifiability import identified  # noqa: E402
from tissue.fitting.measured import MeasuredLoads  # noqa: E402
from tissue.fitting.needle import CHANNEL, NeedleForward, needle_names  # noqa: E402
from tissue.fitting.needle_problem import STEP_S  # noqa: E402
from tissue.fitting.needle_search import with_jumps  # noqa: E402
from tissue.fitting.parameter import Parameter  # noqa: E402
from tissue.fitting.posterior import maximum_posterior  # noqa: E402
from tissue.fitting.target import OFFSET_S  # noqa: E402
from tissue.materials.constants import constants  # noqa: E402
from tissue.materials.prior import Prior  # noqa: E402

FEED_M_S, DEPTH_M, REST_S, OUT_M, TICK_S = 0.01, 0.06, 0.3, 0.015, 1e-3
NOISE_N, CORRELATION, FREEDOM, BIAS_N = 0.008, 0.9, 4.0, 0.2
"""Scale of what the noise adds in a millisecond (a standard deviation of 0.026 N in all, 1 % of the puncture), its
correlation and degrees of freedom; standard deviation of the sensor's bias."""


def law() -> tuple[NeedleForward, NeedleForward]:
    """The law along the log at 1 kHz, and as a fit has it."""
    inwards = np.arange(-0.003, DEPTH_M, FEED_M_S * TICK_S)
    rest = np.full(round(REST_S / TICK_S), inwards[-1])
    travel = np.concatenate([inwards, rest, np.arange(inwards[-1], OUT_M, -FEED_M_S * TICK_S)])
    times = TICK_S * np.arange(len(travel))
    names = needle_names()
    cited = {name: constants(*name.split(".")[:2])[name.split(".")[2]] for name in names}
    parameters = tuple(Parameter(name, Prior.of(entry, name)) for name, entry in cited.items())
    fine = NeedleForward(parameters, {name: entry.value for name, entry in cited.items()}, times, travel)
    few = STEP_S * np.arange(int(times[-1] / STEP_S) + 1)
    return fine, replace(fine, times_s=few, travel_m=np.interp(few, times, travel))


def planted(seed: int) -> tuple[NeedleForward, NeedleForward, MeasuredLoads, np.ndarray, float]:
    """The law without and with its jumps, the log, the constants' numbers and the offset."""
    fine, plain = law()
    rng = np.random.default_rng(seed)
    z = rng.standard_normal(len(fine.parameters))
    x = np.array([float(each.prior.x(at)) for each, at in zip(fine.parameters, z, strict=True)])
    true = replace(fine, known=dict(zip(fine.names, x.tolist(), strict=True)))
    events = true.expected_events()
    force = replace(true, events=tuple(replace(each, seen=False) for each in events)).loads(x)[:, 0]
    offset_s = OFFSET_S * rng.standard_normal()
    noise = lfilter([1.0], [1.0, -CORRELATION], NOISE_N * rng.standard_t(FREEDOM, len(force)))
    values = np.interp(fine.times_s - offset_s, fine.times_s, force) + noise + BIAS_N * rng.standard_normal()
    ticks = block_ticks(float(fine.times_s[-1]), TICK_S)
    log = block_averages(fine.times_s, values[:, None], (CHANNEL,), ticks)
    moments = [each.at_s(fine.times_s) for each in events]
    given = tuple(replace(each, sample=int(at / STEP_S), moment_s=at) for each, at in zip(events, moments, strict=True))
    return plain, replace(plain, events=given), log, z, offset_s


def one(task: tuple[int, bool]) -> tuple[list[tuple[str, bool]], bool, float, list[str]]:
    seed, known = task
    plain, given, log, z, offset_s = planted(seed)
    start = process_time()
    if known:
        out = given.unusable(log.times_s - offset_s, 0.011)
        forward, usable = given, replace(log, values=np.where(out[:, None], np.nan, log.values))
    else:
        forward, usable = with_jumps(plain, log)
    posterior = maximum_posterior(forward, usable)
    result, took = identified(posterior), process_time() - start
    true = np.array([float(prior.x(at)) for prior, at in zip(posterior.priors, z, strict=True)])
    low, high = posterior.offset_interval_s
    held, missed = [("offset", low <= offset_s <= high)], []
    for at, name in enumerate(posterior.names):
        low, _, high = posterior.interval(at)
        inside = low <= true[at] <= high
        held.append((f"({name})", inside))
        if name in result.determined:
            held.append((f"constant {name}", inside))
            if not inside:
                off = (posterior.mean_z[at] - z[at]) / posterior.spreads[at]
                missed.append(f"{name.rpartition('.')[2]} {off:+.1f}")
    held += [("combinations", bool(each.low <= each.of(true) <= each.high)) for each in result.combinations]
    jumps = [f"{a.kind} {a.at_s(plain.times_s):.4f}" for a in given.events]
    jumps += [f"found {a.kind} {a.at_s(plain.times_s):.4f}{'' if a.seen else '?'}" for a in forward.events]
    return held, posterior.converged, took, [f"{seed}: {', '.join(jumps)}; {', '.join(missed)}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--known", action="store_true")
    parser.add_argument("--each", action="store_true", help="print jumps and misses of every fit")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    hits, counts, seconds, converged = Counter(), Counter(), [], 0
    seeds = [(seed, options.known) for seed in range(options.first, options.first + options.fits)]
    with Pool(options.processes) as pool:
        for held, found, took, lines in pool.imap_unordered(one, seeds, 2):
            seconds.append(took)
            converged += found
            if options.each:
                print(*lines, sep="\n", flush=True)
            for name, inside in held:
                kinds = ["constants"] if name.startswith("constant ") else ["(all)"] if name.startswith("(") else []
                identified_too = ["all identified"] if name.startswith(("constant ", "combinations")) else []
                for each in (name, *kinds, *identified_too):
                    counts[each] += 1
                    hits[each] += inside
    print(f"{options.fits} fits, {converged} converged, median {np.median(seconds):.2f} s of processor time")
    for name, count in sorted(counts.items(), key=lambda each: (each[0][0] == "(", -each[1])):
        print(f"  {name:45s} {100 * hits[name] / count:5.1f} % of {count}", flush=True)


if __name__ == "__main__":
    main()
