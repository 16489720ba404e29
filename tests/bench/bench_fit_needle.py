"""Share of planted constants of a needle inside their 90 % intervals, all fits and by constant.

`python tests/bench/bench_fit_needle.py FITS SEED [--offset]`; with --offset the clocks differ by N(0, 20 ms).
"""

import sys
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from tissue.fitting.measured import MeasuredLoads
from tissue.fitting.needle import NeedleForward, needle_names
from tissue.fitting.needle_track import followed
from tissue.fitting.parameter import Parameter
from tissue.fitting.posterior import maximum_posterior
from tissue.materials.constants import constants
from tissue.materials.prior import Prior

STEP_S, FEED_M_S, NOISE_N, CORRELATION, OFFSET_S = 0.01, 0.01, 0.014, 0.5, 0.02


def main(fits: int, seed: int, clocks: bool) -> None:
    """Plant, fit and count."""
    names = needle_names(vessel_wall=False)
    cited = {name: constants(*name.split(".")[:2])[name.split(".")[2]] for name in names}
    deep = np.arange(-0.002, 0.06, STEP_S * FEED_M_S)
    travel = np.concatenate([deep, np.full(20, deep[-1]), np.arange(deep[-1], 0.015, -STEP_S * FEED_M_S)])
    plain = NeedleForward(
        tuple(Parameter(name, Prior.of(entry, name)) for name, entry in cited.items()),
        {name: entry.value for name, entry in cited.items()},
        STEP_S * np.arange(len(travel)), travel,
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    inside, widths, failed = [], [], 0
    while len(inside) < fits:
        z = rng.standard_normal(len(names))
        x = np.array([each.prior.x(value) for each, value in zip(plain.parameters, z, strict=True)])
        if x[9] < x[5] or x[10] < x[6]:
            continue
        fine = np.repeat(np.arange(len(travel) - 1), 10) + np.tile(np.arange(10) / 10, len(travel) - 1)
        quick = replace(
            plain, times_s=STEP_S * fine, travel_m=np.interp(fine, np.arange(len(travel)), travel),
            known=dict(zip(names, x.tolist(), strict=True)),
        )  # fmt: skip
        values = quick._values([])
        events = followed(quick._tissue(values), quick.travel_m, quick._speed_m_s, None).events
        force = replace(quick, events=events).loads(x)[:, 0]
        offset = OFFSET_S * rng.standard_normal() if clocks else 0.0
        seen = np.interp(plain.times_s - offset, quick.times_s, force)
        noise = lfilter([1.0], [1.0, -CORRELATION], NOISE_N * rng.standard_t(4.0, len(seen)))
        forward = replace(plain, events=plain.events_of(seen + noise))
        values = (seen + noise)[:, None]
        values[forward.unusable(plain.times_s, 0.06 if clocks else 0.011)] = np.nan
        found = maximum_posterior(forward, MeasuredLoads(plain.times_s, values, forward.channels))
        if not found.converged:
            failed += 1
        sd = np.sqrt(np.diag(found.covariance_z))
        inside.append(np.abs(found.mean_z - z) < 1.645 * sd)
        widths.append(sd)
    share, width = np.mean(inside, axis=0), np.mean(widths, axis=0)
    for name, each, sd in zip(names, share, width, strict=True):
        print(f"{name:36} inside {each:6.1%}   sd of z after the log {sd:.3f}")
    print(f"all {np.mean(inside):6.1%} of {fits} fits, {failed} not converged")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), "--offset" in sys.argv)
