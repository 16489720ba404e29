"""Parallel execution of jobs in processes of this computer or on workers of a Dask scheduler.

Local worker processes end when this process ends. Processes that hang are killed.
"""

import asyncio
import logging
import multiprocessing
import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager
from itertools import islice
from pathlib import Path
from time import sleep
from typing import TypeVar

from meshes.base.errors import InputError, counted
from meshes.base.extras import install_command
from meshes.base.progress import Progress
from meshes.base.whole_file import package_version
from tissue.system.child import CHECK_S, ONE_THREAD, HangDetector, end_with

Job = TypeVar("Job")
Result = TypeVar("Result")


@contextmanager
def worker_pool(workers: int) -> Iterator[Executor]:
    """Yield an executor whose processes end when this process ends for any reason."""
    kept = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    others = set(multiprocessing.active_children())
    strictly = threading.current_thread() is threading.main_thread()
    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin_worker,
        initargs=(os.getpid(), strictly),
    )
    try:
        with _interrupted_later():
            pool.submit(int)  # this starts all workers
        yield pool
        pool.shutdown()
    finally:
        for child in set(multiprocessing.active_children()) - others:
            child.kill()  # a stopped worker would not react to a request to end
        # the executor's thread joins the workers; a second thread would conflict with it
        pool.shutdown(cancel_futures=True)
        for name, value in kept.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def first_done(
    pool: Executor, futures: Collection["Future[Result]"], report: Progress
) -> "set[Future[Result]]":
    """Wait until at least one future is finished; kill worker processes that hang.

    Parameters
    ----------
    pool, futures
        Executor, and futures of the work that was submitted to it. Only local processes are checked
        for hanging, because a Dask scheduler checks its own workers.
    report
        Function that is called with the reason if workers are killed.

    Returns
    -------
    The finished futures. After workers were killed, the ``result`` of a future raises
    `concurrent.futures.BrokenExecutor`.
    """
    detector = HangDetector(
        lambda: [number for child in multiprocessing.active_children() if (number := child.pid)]
    )
    while True:
        done = wait(futures, timeout=CHECK_S, return_when=FIRST_COMPLETED).done
        if done:
            return done
        why = detector.check() if isinstance(pool, ProcessPoolExecutor) else None
        if why is not None:
            report(f"a worker {why}: it is ended", 0.0)
            for child in multiprocessing.active_children():
                child.kill()


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """Block Ctrl-C while processes start.

    The processes inherit the blocked signal. Without this, a process that receives Ctrl-C before it
    ignores the signal would print a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(parent: int, strictly: bool) -> None:
    """Prepare a worker process: ignore Ctrl-C, and end when the parent process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent, strictly=strictly)


AHEAD = 3
"""Number of submitted and unfinished jobs for each worker.

With three jobs, no worker has to wait, and memory does not grow with the total number of jobs.
"""
LOSSES = 3
"""Number of crashed workers after which a job that may be the cause is run alone.

Each crash counts for all jobs that were submitted and unfinished at that time. If a worker crashes
while a job is run alone, this job is the cause.

One or two crashes may be due to other jobs or to the machine.
"""
BARREN = 20
"""Number of consecutive crashes of workers, without a finished job, after which an error is raised.

The pauses after these crashes take 21 s in total.
"""
PATIENCE_S = 30.0
"""Time that a Dask scheduler may take to answer [s]; a cluster may still be starting."""


def finished(
    work: Callable[[Job], Result],
    jobs: Iterable[Job],
    *,
    workers: int,
    scheduler: str | None,
    report: Callable[[str], None],
) -> Iterator[list[tuple[Job, Result | Exception]]]:
    """Run jobs in other processes; yield lists of pairs (finished job, result).

    If a worker crashes, it is replaced and its jobs are run again. If a job raises an error or
    crashes its worker each time, the error is returned as its result.

    Parameters
    ----------
    work
        Function that is run with each job.
    jobs
        Jobs to run: arguments of `work`, hashable and distinct.
    workers, scheduler
        Number of local processes, and the address of a Dask scheduler that replaces them, or None.
        See `executor`.
    report
        Function that is called with the reason if workers crash.

    Raises
    ------
    InputError
        If the scheduler does not answer, or workers crash repeatedly without a finished job.
    """
    waiting = dict.fromkeys(jobs)
    losses: Counter[Job] = Counter()
    barren = 0
    connected = False
    while waiting:
        before = len(waiting)
        suspects = [job for job in waiting if losses[job] >= LOSSES]
        running: dict[Future[Result], Job] = {}
        try:
            with executor(1 if suspects else workers, scheduler, patience_s=PATIENCE_S) as pool:
                connected = True
                most = 1 if suspects else AHEAD * workers
                fresh = iter(suspects[:1] or list(waiting))
                while True:
                    for job in islice(fresh, most - len(running)):
                        running[pool.submit(work, job)] = job
                    if not running:
                        break
                    done: list[tuple[Job, Result | Exception]] = []
                    for future in first_done(pool, running, lambda doing, _: report(doing)):
                        error = future.exception()
                        if isinstance(error, LOST):
                            raise error
                        job = running.pop(future)
                        found = error if isinstance(error, Exception) else future.result()
                        done.append((job, found))
                    for job, _ in done:
                        del waiting[job]
                    yield done
        except LOST as error:
            if not connected:
                raise InputError(
                    "scheduler",
                    "answer",
                    f"no answer from {scheduler} ({error})",
                    "start it with `dask scheduler`",
                ) from error
            # consecutive losses without a finished job
            barren = barren + 1 if len(waiting) == before else 1
            if barren > BARREN:
                raise InputError(
                    "workers",
                    "stay alive",
                    f"{barren} losses in a row, with {counted(len(waiting), 'job')} left",
                    "find out why they end, for example too little memory, and start again",
                ) from error
            report(
                f"workers were lost ({type(error).__name__}), "
                f"{counted(len(waiting), 'job')} left to run"
            )
            # a suspected job was alone on its worker, so it caused the loss
            if suspects and running:
                del waiting[suspects[0]]
                why = RuntimeError("the worker was lost each time this job ran on it")
                yield [(suspects[0], why)]
            else:
                losses.update(running.values())
            # the pause [s] grows with the number of consecutive losses: a temporary cause, such as
            # a full memory, then costs no jobs
            sleep(min(2.0, 0.1 * barren))


SCHEMES = {"tcp": "tcp", "tls": "tls", "dask": "tcp"}
"""Schemes of scheduler addresses that users may write, with the schemes that Dask uses for them."""
CERTIFICATES = ("ca-file", "client.cert", "client.key")
"""Keys of Dask's configuration that must contain paths of certificate files for a TLS client.

The keys are in the section ``distributed.comm.tls``.
"""
LOST = (BrokenExecutor, CancelledError, ConnectionError, TimeoutError)
"""Errors that indicate a crashed worker or a lost connection, not an error in a job."""


def executor(
    workers: int, scheduler: str | None, *, patience_s: float
) -> AbstractContextManager[Executor]:
    """Return an executor that uses processes on this computer or workers of a Dask scheduler.

    Parameters
    ----------
    workers
        Number of processes of this computer.
    scheduler
        Address of a Dask scheduler, or None for local processes. The address is ``tcp://HOST:PORT``
        or ``tls://HOST:PORT``; ``dask://`` is an alias of ``tcp://``. For a ``tls`` address, the
        certificates of Dask's configuration are used.
    patience_s
        Longest wait for an answer of the scheduler [s].

    Raises
    ------
    InputError
        If the scheduler's address is not valid, Dask is not installed, certificates are missing, or
        a worker runs another version of this package than this process.
    ConnectionError
        If the scheduler does not answer.
    """
    return worker_pool(workers) if scheduler is None else _dask(scheduler, patience_s)


@contextmanager
def _dask(scheduler: str, patience_s: float) -> Iterator[Executor]:
    """Connect to a Dask scheduler and yield its executor."""
    kind, _, place = scheduler.partition("://")
    if kind not in SCHEMES or not place:
        raise InputError(
            "scheduler",
            "be the address that Dask prints, tcp://HOST:PORT or tls://HOST:PORT",
            scheduler,
            "use for example tcp://node1:8786",
        )
    address = f"{SCHEMES[kind]}://{place}"
    try:
        from distributed import Client
        from distributed.comm.core import CommClosedError
    except ImportError:
        raise InputError(
            "scheduler",
            "be used with the package dask.distributed",
            "a Python environment without it",
            f"run {install_command('cluster')}",
        ) from None
    if SCHEMES[kind] == "tls":
        _require_certificates(scheduler)
    # the code that submits the work reports lost workers
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=f"{patience_s:g}s", set_as_default=False)
    except OSError as error:
        raise ConnectionError(f"no Dask scheduler answers at {address}") from error
    with client:
        try:
            versions = client.run(package_version, on_error="return")
        except OSError as error:
            raise ConnectionError(f"the Dask scheduler at {address} was lost") from error
        for worker, version in versions.items():
            # A worker that is lost during the query is not a reason to stop.
            if version != package_version() and not isinstance(version, OSError):
                raise InputError(
                    "workers",
                    f"have version {package_version()} of tissue",
                    f"{version} at {worker}",
                    "update tissue on this worker",
                )
        try:
            yield client.get_executor(pure=False)
        except (asyncio.CancelledError, CommClosedError) as error:
            # errors of these types do not come from executors
            raise ConnectionError(f"the Dask scheduler at {address} was lost") from error


def _require_certificates(scheduler: str) -> None:
    """Check that Dask's configuration names existing certificate files for TLS."""
    import dask.config

    for entry in CERTIFICATES:
        name = f"distributed.comm.tls.{entry}"
        file = dask.config.get(name, None)
        if file is None or not Path(file).is_file():
            variable = "DASK_" + name.upper().replace(".", "__").replace("-", "_")
            got = "none" if file is None else f"{file}, which is not a file"
            raise InputError(
                variable,
                f"be the path of a certificate file for the scheduler {scheduler}",
                got,
                f"set this variable, or set {name} in Dask's configuration",
            )
