"""Executors for parallel work: processes of this computer, or workers of a Dask scheduler.

Worker processes end with this process. Processes that hang are detected.
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
    """Yield an executor whose worker processes end when this process ends for any reason."""
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
    """Wait until some of the work is done; kill workers that hang.

    The work of killed workers is lost.

    Parameters
    ----------
    pool, futures
        Executor, and futures of its work. Only local processes are checked, because a Dask
        scheduler checks its own workers.
    report
        Function that is called with the reason why workers were killed.

    Returns
    -------
    The finished futures. Their results raise `concurrent.futures.BrokenExecutor` if the workers are
    lost.
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

    The processes inherit the blocking of the signal. Otherwise, Ctrl-C would make them print a
    traceback before they can ignore it.
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
    """Ignore Ctrl-C in a worker, and end the worker when its parent process ends.

    If the parent process is killed, it cannot end the worker itself.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent, strictly=strictly)


AHEAD = 3
"""Number of jobs per worker that are submitted at a time.

With this number, no worker waits, and memory does not grow with the number of jobs.
"""
LOSSES = 3
"""Number of lost workers after which a job is run alone.

The lost workers are counted for each job that was submitted at the time of the loss. If a job is
run alone, a further loss shows that this job ends its worker.

One or two lost workers may be due to other jobs, or to the machine.
"""
BARREN = 20
"""Number of consecutive losses of workers, without a finished job, after which the work stops.

The pauses between the losses take 21 s in total.
"""
PATIENCE_S = 30.0
"""Time that a scheduler may take to answer [s], because a cluster may still be starting."""


def finished(
    work: Callable[[Job], Result],
    jobs: Iterable[Job],
    *,
    workers: int,
    scheduler: str | None,
    report: Callable[[str], None],
) -> Iterator[list[tuple[Job, Result | Exception]]]:
    """Run jobs in other processes, and yield lists of finished jobs with their results.

    A lost worker is replaced and its jobs are run again. If a job always ends its worker, its
    result is an error. If a job raises an error, this error is its result.

    Parameters
    ----------
    work
        Function that is run with each job.
    jobs
        Jobs to run. They must be hashable and differ from each other.
    workers, scheduler
        Number of processes, or address of a Dask scheduler, see `executor`.
    report
        Called with the reason why workers were lost.

    Raises
    ------
    InputError
        If no scheduler answers, or workers are lost again and again.
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
                    f"{scheduler} ({error})",
                    "start it with `dask scheduler`",
                ) from error
            # consecutive losses without a finished job
            barren = barren + 1 if len(waiting) == before else 1
            if barren > BARREN:
                raise InputError(
                    "workers",
                    "stay alive",
                    f"{barren} losses with {counted(len(waiting), 'job')} left",
                    "find out why they end, for example for lack of memory, and start again",
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
"""Supported schemes of addresses, and names of these schemes in Dask."""
CERTIFICATES = ("ca-file", "client.cert", "client.key")
"""Keys of Dask's configuration that must name certificate files for a TLS client.

The keys are below ``distributed.comm.tls``.
"""
LOST = (BrokenExecutor, CancelledError, ConnectionError, TimeoutError)
"""Errors that mean that workers were lost, in contrast to errors of the work."""


def executor(
    workers: int, scheduler: str | None, *, patience_s: float
) -> AbstractContextManager[Executor]:
    """Return an executor with processes of this computer or workers of a Dask scheduler.

    Parameters
    ----------
    workers
        Number of processes of this computer.
    scheduler
        Address that a Dask scheduler prints, or None for local processes. The address is
        ``tcp://HOST:PORT`` or ``tls://HOST:PORT``; ``dask://`` means ``tcp://``. For a ``tls``
        address, the certificates of Dask's configuration are used.
    patience_s
        Longest wait for an answer of the scheduler [s].

    Raises
    ------
    InputError
        If the scheduler's address is not valid, Dask is not installed, certificates are missing, or
        a worker runs another version of this package than this process.
    ConnectionError
        If no scheduler answers.
    """
    return worker_pool(workers) if scheduler is None else _dask(scheduler, patience_s)


@contextmanager
def _dask(scheduler: str, patience_s: float) -> Iterator[Executor]:
    """Yield the executor of a Dask scheduler."""
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
            "have dask.distributed",
            "no installation of it",
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
                    f"have version {package_version()}",
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
            got = "none" if file is None else f"{file}, which is no file"
            raise InputError(
                variable,
                f"name a file of certificates for the scheduler {scheduler}",
                got,
                f"set it, or {name} in Dask's configuration",
            )
