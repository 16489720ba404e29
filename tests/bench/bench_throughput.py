"""Throughput of trials x methods per second of a worker's processor, by task.

It is compared with another checkout of this project.

Run from the repository, here against the commit before the meshes, voxels and forecasts of runs
were kept:

    git worktree add ../before 502628a
    python tests/bench/bench_throughput.py --against ../before [--trials 2]
        [--tasks T1 T2 T3 needle reaming drilling]

Both checkouts run the same trials in turn, each in a process of its own with one thread, so that
both run on the same machine under the same load. The first trial of a process, which compiles
kernels and condenses organs, is not counted. Processor time is the measure least affected by
a busy machine. The rows of all trials are compared bit for bit.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from statistics import median
from time import process_time

ROOT = Path(__file__).resolve().parents[2]
TASKS = ("T1", "T2", "T3", "needle", "reaming", "drilling")
GROUPS = ("novice", "intermediate", "expert")


def names_of(task: str, trials: int) -> list[str]:
    """The trial that warms a process, and those that count."""
    return [f"{task}-{GROUPS[number % 3]}-{number:04d}" for number in range(trials + 1)]


def run_here(names: list[str]) -> None:
    """Run trials in this process and print one line for each.

    A line holds name, processor time [s] and rows, with their numbers as bits.
    """
    from tissue.evaluation.study.folder import _in_worker
    from tissue.evaluation.study.plan import Plan, TrialKey

    for name in names:
        start = process_time()
        trial = _in_worker(Plan(), TrialKey.named(name))
        took = process_time() - start
        rows = [
            {key: each if isinstance(each, str) else float(each).hex() for key, each in row.items()}
            for row in trial.rows
        ]
        print(json.dumps({"name": name, "took_s": took, "rows": rows}), flush=True)


def run_in(checkout: Path, names: list[str]) -> list[dict[str, object]]:
    """Run trials by the code of a checkout."""
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, str(Path(__file__).resolve()), "--here", *names]
    environment = os.environ | one | {"PYTHONPATH": str(checkout)}
    done = subprocess.run(
        command, env=environment, cwd=checkout, stdout=subprocess.PIPE, text=True, check=True
    )
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def compared(task: str, trials: int, checkouts: list[Path]) -> tuple[str, ...]:
    """Return one row of the table of two checkouts.

    It holds the processor time per trial in each checkout, throughput, ratio, and whether the rows
    are equal.
    """
    found = [run_in(each, names_of(task, trials)) for each in checkouts]
    methods = len(found[0][0]["rows"])
    took = [median(float(each["took_s"]) for each in trials_of[1:]) for trials_of in found]
    same = all(
        [each["rows"] for each in other] == [each["rows"] for each in found[0]] for other in found
    )
    cells = [f"{each:.2f} s, {methods / each:.2f}" for each in took]
    return task, *cells, f"{took[0] / took[-1]:.2f}", "the same" if same else "DIFFERENT"


def main() -> None:
    asked = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    asked.add_argument("--against", type=Path, help="folder of another checkout, which runs first")
    asked.add_argument("--tasks", nargs="+", default=list(TASKS), choices=TASKS)
    asked.add_argument("--trials", type=int, default=2, help="trials of each task that count")
    asked.add_argument("--here", nargs="+", help=argparse.SUPPRESS)
    given = asked.parse_args()
    if given.here:
        run_here(given.here)
        return
    from harness import machine, table

    checkouts = [ROOT] if given.against is None else [given.against.resolve(), ROOT]
    print(machine())
    columns = ["before"] * (given.against is not None) + ["now"]
    head = (
        "task",
        *(f"{each}: processor a trial, trials x methods a second" for each in columns),
        "ratio",
        "rows",
    )
    rows = []
    for task in given.tasks:
        rows.append(compared(task, given.trials, checkouts))
        print(*rows[-1], sep=" | ", flush=True)
    print("\n" + table(rows, head))


if __name__ == "__main__":
    main()
