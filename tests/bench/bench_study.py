"""What a study costs: seconds a trial by task, efficiency against workers, and memory against the number of trials.

Run from the repository: python tests/bench/bench_study.py
"""

import os
import resource
import tempfile
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from harness import machine, table

from tissue.study import TASKS, Plan, TrialKey, run_study, run_trial, runner
from tissue.study.trial import Trial, trial_seed

WORKERS = (1, 2, 4)


def main() -> None:
    print(machine())
    print(table([*_trials()], ("task", "processor s", "wall s", "900 trials on 2 workers, min")))
    print(table([*_efficiency()], ("workers", "wall s", "efficiency")))
    print(table([*_memory()], ("trials", "peak memory of the runner, MB")))


def _trials():
    """Three trials of each task under all methods; the first one warms caches and is left out."""
    plan, total = Plan(), 0.0
    for task in TASKS:
        took = []
        for trial in range(4):
            start, used = perf_counter(), process_time()
            run_trial(plan, TrialKey(task, "novice", trial))
            took.append((process_time() - used, perf_counter() - start))
        used_s, wall_s = np.median(took[1:], axis=0)
        total += 0.0 if TASKS[task].case else 300.0 * wall_s / 2.0 / 60.0
        yield task, f"{used_s:.2f}", f"{wall_s:.2f}", f"{total:.1f}"


def _efficiency():
    """The same twelve trials of the wall on one, two and four workers, their start included."""
    plan, alone = Plan(trials=4, tasks=("T2",), sensitivity=False), None
    for workers in WORKERS:
        with tempfile.TemporaryDirectory() as folder:
            start = perf_counter()
            run_study(plan, Path(folder) / "study", workers=workers)
            wall = perf_counter() - start
        alone = alone or wall
        yield str(workers), f"{wall:.1f}", f"{alone / wall / min(workers, os.cpu_count() or 1):.2f}"


def _memory():
    """Trials that cost nothing, so that only what the runner keeps of them counts; peaks of one process only rise."""
    kept = runner.run_trial
    runner.run_trial = _cheap
    try:
        for trials in (10, 100, 300):
            with tempfile.TemporaryDirectory() as folder:
                run_study(Plan(trials=trials, tasks=("T2",), sensitivity=False), Path(folder) / "study", workers=1)
            yield str(3 * trials), f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f}"
    finally:
        runner.run_trial = kept


def _cheap(plan: Plan, key: TrialKey) -> Trial:
    """A trial of the right size."""
    row = {f"metric_{index}": float(index) for index in range(13)}
    rows = tuple({"method": method} | row for method in plan.methods)
    return Trial(key, trial_seed(plan, key), rows, 0.0)


if __name__ == "__main__":
    main()
