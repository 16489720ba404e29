"""Calibration of draws by NUTS: `python tests/bench/bench_fit_nuts.py [--fits 100] [--feeds 1,2,3] [--seconds 600]`.

A slot of 10 s with chip and edge forces along two directions is cut at some feeds. Constants are drawn from their priors,
with autocorrelated noise of heavy tails, a bias and an offset of the clocks; the log is fitted and the posterior drawn
from. Printed: how often the 90 % intervals of draws and of the normal law hold the planted constants, a chi-squared of
the places of the planted among the draws in five equal shares (Talts et al. 2018; 4 degrees of freedom), R-hat, effective
sample sizes, and the time a fit. Coverage has an error of its own, sqrt(0.9 0.1 / constants) where they are independent.
At one feed chip and edge coefficients are known only together.
"""

import argparse
import os
import sys
from pathlib import Path
from time import perf_counter, process_time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

sys.path.insert(0, str(Path(__file__).parents[1] / "fixtures"))

from planted_logs import planted, slot  # noqa: E402

from tissue.fitting.nuts import draw_by_nuts  # noqa: E402
from tissue.fitting.posterior import maximum_posterior  # noqa: E402

SHARES = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=100)
    parser.add_argument("--feeds", default="1,2,3")
    parser.add_argument("--seconds", type=float, default=600.0, help="no fit begins later")
    parser.add_argument("--chains", type=int, default=2)
    parser.add_argument("--draws", type=int, default=300)
    options = parser.parse_args()
    forward = slot(tuple(float(each) for each in options.feeds.split(",")))
    places, drawn, normal, r_hat, effective, diverged, seconds = [], [], [], [], [], [], []
    start = perf_counter()
    for seed in range(options.fits):
        if perf_counter() - start > options.seconds:
            break
        log, z = planted(forward, np.random.default_rng([21, seed]))
        began = process_time()
        law = maximum_posterior(forward, log)
        draws = draw_by_nuts(
            law.target, law.maximum, law.covariance, seed=seed, chains=options.chains, warm_up=200, draws=options.draws
        )
        seconds.append(process_time() - began)
        place = np.mean(draws.together[:, : len(z)] < z, axis=0)
        places.append(place)
        drawn.append((place > 0.05) & (place < 0.95))
        normal.append(np.abs(law.mean_z - z) < 1.645 * np.sqrt(np.diag(law.covariance_z)))
        r_hat.append(draws.r_hat.max())
        effective.append(draws.effective.min())
        diverged.append(draws.divergences)
    count = np.size(drawn)
    bins = np.bincount(np.minimum((SHARES * np.ravel(places)).astype(int), SHARES - 1), minlength=SHARES)
    print(f"feeds {options.feeds}: {len(drawn)} fits, {count} constants")
    print(f"  90 % intervals hold {100 * np.mean(drawn):.1f} % by draws, {100 * np.mean(normal):.1f} % by the normal law, "
          f"of {count}")  # fmt: skip
    print(f"  places of the planted in {SHARES} shares: {bins.tolist()}, chi-squared "
          f"{np.sum((bins - count / SHARES) ** 2) / (count / SHARES):.1f}")  # fmt: skip
    print(f"  R-hat at most {np.median(r_hat):.3f} in the median fit, {max(r_hat):.3f} in the worst; least effective sample "
          f"size {np.median(effective):.0f} and {min(effective):.0f}; {sum(diverged)} divergences")  # fmt: skip
    print(f"  {np.median(seconds):.1f} s of processor time a fit in the median, {max(seconds):.1f} at most", flush=True)


if __name__ == "__main__":
    main()
