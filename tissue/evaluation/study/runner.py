"""Run a study: trials on worker processes or on a cluster, stopped and resumed at any of them."""

import gc
import os
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import Executor, Future
from functools import cache
from pathlib import Path
from time import perf_counter, sleep

from meshes.base.errors import InputError, require_range
from meshes.base.progress import Progress, silent
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import Plan, TrialKey
from tissue.evaluation.study.trial import Row, Trial, error_sentence, run_trial, trial_seed
from tissue.system.workers import LOST, executor, first_done

__all__ = ["run_study"]

TRIALS_PER_WORKER = 3
"""Trials submitted for each worker.

No worker waits, and memory does not grow with the number of trials.
"""
LOSSES = 3
"""Losses after which a running trial is run alone to check whether it ends its worker."""
BARREN = 20
"""Losses without a trial in between after which a study gives up."""
PATIENCE_S = 30.0
"""Time that a scheduler may take to answer [s]."""


def run_study(
    plan: Plan,
    out: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    report: Progress = silent,
) -> StudyFolder:
    """Run the missing trials of a plan and write the tables of all trials.

    The tables are sorted, so that they do not depend on the workers, their number or interruptions.
    A lost worker is replaced and its trials are run again. A trial that always ends its worker is
    kept as failed.

    Parameters
    ----------
    plan
        Plan of the study.
    out
        Folder of the study. A folder with a part of the study is continued.
    workers
        Number of processes. Default: one per core. A scheduler has its own workers; the number is
        then the number of submitted trials.
    scheduler
        Address of a Dask scheduler, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``, instead of own
        processes.
    retry
        Run failed trials again.
    report
        Called with the progress and with problems.

    Raises
    ------
    InputError
        If the folder holds another study, no scheduler answers, or workers are lost again and
        again.
    """
    count = int(
        require_range(
            "workers",
            (os.cpu_count() or 1) if workers is None else workers,
            1,
            4096,
            "use one a core",
        )
    )
    folder = StudyFolder(out)
    with folder.held(plan) as sentences:
        for sentence in sentences:
            report(sentence, 0.0)
        if retry:
            folder.forget_failures()
        _run_trials(plan, folder, count, scheduler, report)
        folder.write_tables()
    return folder


def _run_trials(
    plan: Plan, folder: StudyFolder, count: int, scheduler: str | None, report: Progress
) -> None:
    """Run the trials that the folder does not hold yet, and replace workers that are lost."""
    work = _Work(plan, folder, report)
    barren = 0
    connected = False
    while work.waiting:
        before = work.done
        suspects = [key for key in work.waiting if work.losses[key] >= LOSSES]
        try:
            with executor(1 if suspects else count, scheduler, patience_s=PATIENCE_S) as pool:
                connected = True
                work.drain(
                    pool,
                    suspects[:1] or list(work.waiting),
                    1 if suspects else TRIALS_PER_WORKER * count,
                )
        except LOST as error:
            if not connected:
                raise InputError(
                    "scheduler",
                    "answer",
                    f"{scheduler} ({error})",
                    "start it with `dask scheduler`",
                ) from error
            barren = barren + 1 if work.done == before else 1
            if barren > BARREN:
                raise InputError(
                    "workers",
                    "stay alive",
                    f"{barren} losses with {len(work.waiting)} trials left",
                    "look for what kills them, memory for one, and run the study again to go on",
                ) from error
            report(
                f"workers were lost ({type(error).__name__}), {len(work.waiting)} trials go on",
                work.share,
            )
            if suspects and work.running:
                work.give_up(
                    suspects[0], "RuntimeError: the worker was lost each time this trial ran on it"
                )
            else:
                work.losses.update(work.running.values())
            sleep(min(2.0, 0.1 * barren))


def _in_worker(plan: Plan, key: TrialKey) -> Trial:
    """Run a trial in a process that does nothing else."""
    trial = run_trial(plan, key)
    _keep_what_stays()
    return trial


@cache
def _keep_what_stays() -> None:
    """Exclude modules and kernels from garbage collection in all further runs.

    They exist until all trials are done.
    """
    gc.collect()
    gc.freeze()


class _Work:
    """Trials of a plan that are left."""

    def __init__(self, plan: Plan, folder: StudyFolder, report: Progress) -> None:
        self.plan = plan
        self.folder = folder
        self._report = report
        keys = list(plan.all_trials())
        self.total = len(keys)
        self.waiting = dict.fromkeys(key for key in keys if not folder.has(key))
        self.running: dict[Future[Trial], TrialKey] = {}
        self.losses: Counter[TrialKey] = Counter()
        self.done = 0
        self._began = perf_counter()
        self._at_first = len(self.waiting)

    @property
    def share(self) -> float:
        """Share that is done."""
        return 1.0 - len(self.waiting) / self.total

    def drain(self, pool: Executor, keys: Iterable[TrialKey], most: int) -> None:
        """Submit trials, a few ahead, and store the results."""
        self.running = {}
        fresh = iter(keys)
        while True:
            while len(self.running) < most and (key := next(fresh, None)) is not None:
                self.running[pool.submit(_in_worker, self.plan, key)] = key
            if not self.running:
                return
            for future in first_done(
                pool, self.running, lambda doing, _: self._report(doing, self.share)
            ):
                error = future.exception()
                if isinstance(error, LOST):
                    raise error
                key = self.running.pop(future)
                # whatever a worker met, such as a trial that ends it each time
                if isinstance(error, Exception):
                    self.give_up(key, error_sentence(error))
                else:
                    self._keep(future.result())
                    self.done += 1
            self._report(
                f"trial {self.total - len(self.waiting)} of {self.total}, {self._left()}",
                self.share,
            )

    def give_up(self, key: TrialKey, failure: str) -> None:
        """Keep a trial as failed."""
        rows: list[Row] = [{"method": method, "failure": failure} for method in self.plan.methods]
        self._keep(Trial(key, trial_seed(self.plan, key), tuple(rows), 0.0))

    def _keep(self, trial: Trial) -> None:
        """Write a trial that is still missing. A second copy is equal and ignored."""
        self.folder.write(trial)
        self.waiting.pop(trial.key, None)

    def _left(self) -> str:
        """Return the remaining time, estimated from this session's time for each trial."""
        done = self._at_first - len(self.waiting)
        seconds = (perf_counter() - self._began) / max(1, done) * len(self.waiting)
        return f"{seconds:.0f} s left" if seconds < 100.0 else f"{seconds / 60.0:.0f} min left"
