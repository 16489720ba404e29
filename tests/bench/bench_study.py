"""Cost of a study: seconds per trial, efficiency and memory.

Seconds per trial are given by task, efficiency against the number of workers, and memory against
the number of trials.

Run from the repository: python tests/bench/bench_study.py [--trials 4] [--workers 1 2 4] [--out
study_cost.png] [--tasks T1 T2 T3] [--methods penalty koopman]

The same study, its tasks in turn, is run by each number of workers. Efficiency is t_1 / (n t_n): of
the whole study, the workers' start included, and of its steady part, from the trial at which every
worker has done one to the last. More workers than cores cannot be efficient; they show what
crowding costs.
"""

import argparse
import os
import tempfile
import threading
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter

import numpy as np
import psutil
from harness import machine, table

from tissue.evaluation.study.folder import StudyFolder, run_study
from tissue.evaluation.study.plan import METHODS, Plan, TrialKey
from tissue.evaluation.study.trial import run_trial

TASKS = ("T1", "T2", "T3")
PAPER_TRIALS = 300
"""Trials a task in the whole study: 3 groups of 100."""
SAMPLE_S = 0.25


def main() -> None:
    asked = argparse.ArgumentParser()
    asked.add_argument("--trials", type=int, default=4, help="trials for each task and group")
    asked.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    asked.add_argument("--tasks", nargs="+", default=list(TASKS))
    asked.add_argument("--methods", nargs="+", default=list(METHODS))
    asked.add_argument("--out", type=Path, default=Path("study_cost.png"))
    chosen = asked.parse_args()
    print(machine())
    plan = Plan(
        trials=chosen.trials, tasks=(*chosen.tasks,), methods=(*chosen.methods,), sensitivity=False
    )
    warm_caches(plan)
    runs = [measured(plan, workers) for workers in chosen.workers]
    if any(each.rows != runs[0].rows for each in runs):
        raise SystemExit("the tables of the workers differ")
    print(f"{runs[0].done[-1][1]} trials of {len(plan.methods)} methods, the same table each time")
    print(table([efficiency(each, runs[0]) for each in runs], HEADER))
    head = (
        "workers",
        *(f"{task} s" for task in plan.tasks),
        "trials x methods a second",
        "300 trials a task, min",
    )
    print(table([costs(each, len(plan.methods)) for each in runs], head))
    draw(runs, chosen.out)
    print(chosen.out)


def warm_caches(plan: Plan) -> None:
    """One trial of each task, so that no run pays for compiling kernels or condensing organs."""
    for task in plan.tasks:
        run_trial(plan, TrialKey(task, "novice", 0))


@dataclass
class Measured:
    """Study and its cost: wall time [s], times of finished trials [s], memory samples [MB]."""

    workers: int
    wall_s: float = 0.0
    done: list[tuple[float, int]] = field(default_factory=list)
    rows: bytes = b""
    took_s: dict[str, float] = field(default_factory=dict)
    memory: list[tuple[int, float, float]] = field(default_factory=list)
    """Finished trials, memory of the runner and of its largest worker [MB]."""
    threads: int = 0
    processor_s: dict[int, float] = field(default_factory=dict)
    """Processor time of each worker."""

    @property
    def steady_s(self) -> float:
        """Time a trial after every worker has done one [s]."""
        began = next((each for each in self.done if each[1] >= self.workers), self.done[0])
        ended = self.done[-1]
        return (ended[0] - began[0]) / max(1, ended[1] - began[1])


def measured(plan: Plan, workers: int) -> Measured:
    """Run a study, looking at its processes meanwhile."""
    found, over = Measured(workers), threading.Event()
    start = perf_counter()
    with tempfile.TemporaryDirectory() as held:
        folder = StudyFolder(Path(held) / "study")
        kept = folder.path / "trials"

        def look() -> None:
            while not over.wait(SAMPLE_S):
                sample(found, len(list(kept.glob("*.json"))) if kept.is_dir() else 0)

        def report(doing: str, share: float) -> None:
            found.done.append((perf_counter() - start, len(list(kept.glob("*.json")))))

        watcher = threading.Thread(target=look)
        watcher.start()
        try:
            run_study(plan, folder.path, workers=workers, report=report)
        finally:
            over.set()
            watcher.join()
        found.wall_s = perf_counter() - start
        found.rows = (folder.path / "trials.csv").read_bytes()
        for task in plan.tasks:
            took = [each.took_s for each in folder.trials() if each.key.task == task]
            found.took_s[task] = float(np.median(took))
    return found


def sample(found: Measured, done: int) -> None:
    """Memory, threads and processor time of this process and its workers now."""
    me = psutil.Process()
    greatest = 0.0
    for child in me.children():
        try:
            if "spawn_main" in " ".join(child.cmdline()):
                greatest = max(greatest, child.memory_info().rss / 1e6)
                found.threads = max(found.threads, child.num_threads())
                used = child.cpu_times()
                found.processor_s[child.pid] = used.user + used.system
        except psutil.NoSuchProcess:
            continue
    if greatest:
        found.memory.append((done, me.memory_info().rss / 1e6, greatest))


HEADER = (
    "workers",
    "wall s",
    "efficiency",
    "steady s a trial",
    "steady efficiency",
    "processors a worker",
    "threads",
    "worker MB at a third",
    "at the end",
    "runner MB",
)


def efficiency(each: Measured, alone: Measured) -> tuple[str, ...]:
    """One row of the table of workers."""
    share, count = alone.workers / each.workers, each.done[-1][1]
    third = [row for row in each.memory if row[0] <= count / 3][-1:] or each.memory[:1]
    return (
        str(each.workers),
        f"{each.wall_s:.1f}",
        f"{share * alone.wall_s / each.wall_s:.2f}",
        f"{each.steady_s:.2f}",
        f"{share * alone.steady_s / each.steady_s:.2f}",
        f"{sum(each.processor_s.values()) / each.wall_s / each.workers:.2f}",
        str(each.threads),
        *(f"{value:.0f}" for value in (third[0][2], each.memory[-1][2], each.memory[-1][1])),
    )


def costs(each: Measured, methods: int) -> tuple[str, ...]:
    """Return the table row of a study's cost.

    It holds the median wall time of a trial of each task, the throughput of all workers, and the
    time of the whole study.
    """
    whole = PAPER_TRIALS * len(each.took_s) * each.steady_s / 60.0
    took = (f"{one:.2f}" for one in each.took_s.values())
    return str(each.workers), *took, f"{methods / each.steady_s:.2f}", f"{whole:.0f}"


def draw(runs: list[Measured], path: Path) -> None:
    """Efficiency against workers, and memory against trials."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    alone, counts = runs[0], [each.workers for each in runs]
    for times, colour, mark, what in (
        ([each.wall_s for each in runs], "#0072B2", "o-", "whole study, start of workers included"),
        ([each.steady_s for each in runs], "#E69F00", "s--", "after each worker's first trial"),
    ):
        shares = [alone.workers * times[0] / (n * t) for n, t in zip(counts, times, strict=True)]
        left.plot(counts, shares, mark, color=colour, label=what, lw=2, ms=8)
    cores = os.cpu_count() or 1
    most = np.array([min(1.0, cores / n) for n in counts])
    left.plot(counts, most, ":", color="black", lw=1.5, label=f"at most, on {cores} cores")
    left.set(xlabel="workers", ylabel="efficiency t₁ / (n tₙ)", xticks=counts, ylim=(0.0, 1.15))
    right.set(xlabel="trials done", ylabel="memory / MB")
    for each, colour in zip(runs, ("#0072B2", "#E69F00", "#009E73", "#CC79A7"), strict=False):
        counts_done = sorted({row[0] for row in each.memory})
        peaks = [
            np.max([row for row in each.memory if row[0] == count], axis=0) for count in counts_done
        ]
        done, runner, worker = np.array(peaks).T
        right.plot(done, worker, color=colour, lw=2, label=f"greatest worker of {each.workers}")
        right.plot(done, runner, ":", color=colour, lw=2, label=f"runner with {each.workers}")
    right.set_ylim(bottom=0.0)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=10)
        axes.xaxis.label.set_size(12)
        axes.yaxis.label.set_size(12)
        axes.tick_params(labelsize=11)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
