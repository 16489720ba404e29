"""Processes of this machine that share work, end with this one, and are not waited for in vain."""

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
    """Some worker processes, which end with this one, whatever ends it."""
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
            pool.submit(int)  # starts all of them
        yield pool
        pool.shutdown()
    finally:
        for child in set(multiprocessing.active_children()) - others:
            child.kill()  # one that was stopped would not take a request to end
        # its thread takes leave of them: two that do would miss each other
        pool.shutdown(cancel_futures=True)
        for name, value in kept.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def first_done(
    pool: Executor, futures: Collection["Future[Result]"], report: Progress
) -> "set[Future[Result]]":
    """Await work until some of it is done; workers that have stopped working are ended, and what
    they did is lost.

    Parameters
    ----------
    pool, futures
        Who works, and at what; of processes elsewhere their scheduler knows whether they still
        work.
    report
        Called with why workers were ended.

    Returns
    -------
    What is done; its results raise `concurrent.futures.BrokenExecutor` where the workers are gone.
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
    """Hold Ctrl-C back while processes start, which inherit that and would print it before they
    can ignore it.
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
    """Leave Ctrl-C to the process that began this one, and end when it ends: killed, it could
    not ask for it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent, strictly=strictly)
