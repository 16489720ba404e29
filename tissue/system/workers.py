"""Worker processes of this machine, which end with this process, and detection of hung workers."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Collection, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from typing import TypeVar

from meshes.base.progress import Progress
from tissue.system.child import CHECK_S, ONE_THREAD, HangDetector, end_with

__all__ = ["first_done", "worker_pool"]

Result = TypeVar("Result")


@contextmanager
def worker_pool(workers: int) -> Iterator[Executor]:
    """Start worker processes, which end with this process for any reason."""
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
            pool.submit(int)  # starts all workers
        yield pool
        pool.shutdown()
    finally:
        for child in set(multiprocessing.active_children()) - others:
            child.kill()  # a stopped worker would not handle a request to end
        # the executor's thread joins the workers: two threads that do so would conflict
        pool.shutdown(cancel_futures=True)
        for name, value in kept.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def first_done(
    pool: Executor, futures: Collection["Future[Result]"], report: Progress
) -> "set[Future[Result]]":
    """Wait until some of the work is done; kill workers that hang, and lose their work.

    Parameters
    ----------
    pool, futures
        Executor and its work. Only local processes are checked. A scheduler checks its own workers.
    report
        Called with the reason why workers were killed.

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

    They inherit the block. Without it, they would print a traceback before they can ignore the
    signal.
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

    A killed parent could not end the worker.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent, strictly=strictly)
