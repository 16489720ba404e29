"""Executors for parallel work: processes of this machine or workers of a Dask scheduler."""

import asyncio
import logging
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.file_version import package_version
from tissue.system.workers import worker_pool

__all__ = ["LOST", "executor"]

SCHEMES = {"tcp": "tcp", "tls": "tls", "dask": "tcp"}
"""Supported address schemes, and their names in Dask."""
CERTIFICATES = ("ca-file", "client.cert", "client.key")
"""Certificate files that Dask's configuration must name for a TLS client.

The entries are below ``distributed.comm.tls``.
"""
LOST = (BrokenExecutor, CancelledError, ConnectionError, TimeoutError)
"""Errors of lost workers, in contrast to errors of the work."""


def executor(
    workers: int, scheduler: str | None, *, patience_s: float
) -> AbstractContextManager[Executor]:
    """Return an executor with processes of this machine or workers of a Dask scheduler.

    Parameters
    ----------
    workers
        Number of processes of this machine.
    scheduler
        Address that a Dask scheduler prints, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``
        (``dask://`` stands for ``tcp://``), or None. A ``tls`` address uses the certificates of
        Dask's configuration.
    patience_s
        Longest time for an answer of the scheduler [s].

    Raises
    ------
    InputError
        If the scheduler's address cannot be read, Dask is not installed, certificates are missing,
        or its workers have another version.
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
            "none installed",
            "pip install 'tissue-sim[cluster]'",
        ) from None
    if SCHEMES[kind] == "tls":
        _require_certificates(scheduler)
    # the code that submits the work reports losses
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
            # A worker lost during the query is not a reason to stop.
            if version != package_version() and not isinstance(version, OSError):
                raise InputError(
                    "workers",
                    f"have version {package_version()}",
                    f"{version} at {worker}",
                    "update it",
                )
        try:
            yield client.get_executor(pure=False)
        except (asyncio.CancelledError, CommClosedError) as error:
            # executors do not raise errors of these types
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
