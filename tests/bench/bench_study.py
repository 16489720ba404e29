"""Throughput of the study: trials per minute with one and two workers, and costs of the tasks.

Run: `python tests/bench/bench_study.py [--trials 4] [--tasks T1 T2 T3] [--costs]`.

The same trials run with one worker and with two. Printed are the trials of all six methods per
minute, from the end of the first trial of each worker to the end of the last trial, and the
efficiency: the rate with two workers over twice the rate with one.

With `--costs`, one warm trial of each task is timed instead. Printed are the times of one method
over that of `tissue.evaluation.study.duration.probe_s`, which are the figures of `COSTS`.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, process_time

from harness import machine, table

from tissue.evaluation.study.duration import probe_s
from tissue.evaluation.study.folder import run_study
from tissue.evaluation.study.plan import Plan, TrialKey
from tissue.evaluation.study.trial import run_trial

WORKERS = (1, 2)
GROUP = "intermediate"


def rate_per_min(plan: Plan, workers: int) -> float:
    """Return the trials of a plan per minute, without the first trial of each worker.

    The first trials also start the processes, load the code and judge the loops.
    """
    ends: list[float] = []

    def note(doing: str, _share: float) -> None:
        """Note the time at which a trial ends."""
        if doing.startswith("trial "):
            ends.append(perf_counter())

    with tempfile.TemporaryDirectory() as folder:
        run_study(plan, Path(folder) / "study", workers=workers, report=note)
    counted = len(list(plan.all_trials()))
    # Several trials may be reported at a time.
    first = min(workers, len(ends) - 1)
    share = (len(ends) - first) / len(ends)
    return 60.0 * counted * share / (ends[-1] - ends[first - 1])


def print_rates(trials: int, tasks: Sequence[str]) -> None:
    """Print the rates with one and two workers."""
    # The other groups cost the same. With one group, each worker judges every loop in its first
    # round of tasks.
    plan = Plan(trials=trials, tasks=tuple(tasks), groups=(GROUP,))
    rates = {workers: rate_per_min(plan, workers) for workers in WORKERS}
    rows = [
        (f"{workers}", f"{rate:.1f}", f"{rate / (workers * rates[1]):.2f}")
        for workers, rate in rates.items()
    ]
    print(f"{', '.join(tasks)}, {len(plan.methods)} methods, {trials} trials each")
    print(table(rows, ("workers", "trials / min", "efficiency")))


def print_costs(tasks: Sequence[str]) -> None:
    """Print the processor time of one method of a warm trial."""
    plan = Plan()
    unit_s = probe_s(process_time)
    rows = []
    for task in tasks:
        key = TrialKey(task, GROUP, 0)
        # the first trial loads the code and judges the loops
        run_trial(plan, key)
        times = [timed_s(plan, TrialKey(task, GROUP, each)) for each in (1, 2)]
        method_s = sum(times) / len(times) / len(plan.methods)
        unit_s = 0.5 * (unit_s + probe_s(process_time))
        rows.append((task, f"{method_s:.2f}", f"{method_s / unit_s:.1f}"))
        print(*rows[-1], flush=True)
    print(table(rows, ("task", "one method / s", "over the probe")))


def timed_s(plan: Plan, key: TrialKey) -> float:
    """Return the processor time of a trial [s]."""
    begun_s = process_time()
    run_trial(plan, key)
    return process_time() - begun_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=4)
    parser.add_argument("--tasks", nargs="*", default=["T1", "T2", "T3"])
    parser.add_argument("--costs", action="store_true")
    given = parser.parse_args()
    print(machine())
    if given.costs:
        print_costs(given.tasks)
    else:
        print_rates(given.trials, given.tasks)


if __name__ == "__main__":
    main()
