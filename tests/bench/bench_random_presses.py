"""Outcomes of random presses on organs under hyperelastic laws.

Run: `python tests/bench/bench_random_presses.py [--presses 1000] [--seed 0] [--first 0]`.

Each press has a generator of its own, spawned from the seed, so that a press can be repeated alone.
Printed: the numbers of presses that converged, ended with a sentence on the contact or on the law,
were refused or failed with a traceback, by law, shape and order, and the reasons.
"""

import argparse
import os
from collections import Counter
from time import perf_counter

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from harness import machine, table  # noqa: E402
from random_presses import OUTCOMES, draw, run_press  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    seeds = np.random.SeedSequence(arguments.seed).spawn(arguments.first + arguments.presses)
    counts: Counter[tuple[str, str]] = Counter()
    print(machine())
    for number in range(arguments.first, arguments.first + arguments.presses):
        press = draw(np.random.default_rng(seeds[number]))
        started = perf_counter()
        outcome = run_press(press)
        took_s = perf_counter() - started
        for group in (
            "all",
            str(press.law["law"]),
            press.shape,
            f"order {press.material['order']}",
        ):
            counts[group, outcome.kind] += 1
        if outcome.kind not in ("converged", "contact") or took_s > 30.0:
            print(f"{number} {took_s:.1f} s {outcome.kind}: {outcome.why}\n  {press}", flush=True)
    groups = sorted({group for group, _ in counts})
    rows = [(group, *(str(counts[group, kind]) for kind in OUTCOMES)) for group in groups]
    print("\n" + table(rows, ("presses", *OUTCOMES)))


if __name__ == "__main__":
    main()
