"""Where work of many processes runs: on this machine, or on those of a Dask scheduler, behind one standard executor."""

import asyncio
import logging
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from contextlib import AbstractContextManager, contextmanager

from meshes.base.errors import InputError
from meshes.base.file_version import package_version
from tissue.system.workers import worker_pool

__all__ = ["LOST", "executor"]

LOST = (BrokenExecutor, CancelledError, ConnectionError, TimeoutError)
"""Errors that mean that workers are gone, and not that the work is wrong."""


def executor(workers: int, scheduler: str | None, *, patience_s: float) -> AbstractContextManager[Executor]:
    """Own processes, or those of a Dask scheduler.

    Parameters
    ----------
    workers
        Own processes.
    scheduler
        ``dask://ADDRESS``, or None.
    patience_s
        How long a scheduler may take to answer [s].

    Raises
    ------
    InputError
        If the scheduler's name cannot be read, Dask is not installed, or its workers have another version.
    ConnectionError
        If no scheduler answers.
    """
    return worker_pool(workers) if scheduler is None else _dask(scheduler, patience_s)


@contextmanager
def _dask(scheduler: str, patience_s: float) -> Iterator[Executor]:
    """Workers of a Dask scheduler."""
    kind, sign, address = scheduler.partition("://")
    if kind != "dask" or not sign or not address:
        raise InputError(f"scheduler must be dask://ADDRESS, got {scheduler}: use for example dask://node1:8786")
    try:
        from distributed import Client
        from distributed.comm.core import CommClosedError
    except ImportError:
        raise InputError(
            "scheduler must have dask.distributed, got none installed: pip install 'tissue-sim[cluster]'"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # losses are reported by who hands out the work
    try:
        client = Client(f"tcp://{address}", timeout=f"{patience_s:g}s", set_as_default=False)
    except OSError as error:
        raise ConnectionError(f"no Dask scheduler answers at {address}") from error
    with client:
        try:
            versions = client.run(package_version, on_error="return")
        except OSError as error:
            raise ConnectionError(f"the Dask scheduler at {address} was lost") from error
        for worker, version in versions.items():
            # A worker that is lost while it is asked is no reason to stop.
            if version != package_version() and not isinstance(version, OSError):
                raise InputError(f"workers must have version {package_version()}, got {version} at {worker}: update it")
        try:
            yield client.get_executor(pure=False)
        except (asyncio.CancelledError, CommClosedError) as error:  # not of the kinds that executors raise
            raise ConnectionError(f"the Dask scheduler at {address} was lost") from error
