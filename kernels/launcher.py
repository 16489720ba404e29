"""Recorded launches that may be split over processor cores.

A Warp launch on a CPU runs on one core but releases the interpreter lock, so the halves of a launch can run on two
threads. Handing work to a thread costs about 50 us: a launch is split only while its last runs took longer than
``SPLIT_ABOVE_S``; one run that another process interrupted is no large launch. A part that no thread has begun, because
other processes keep its core, is taken back: waiting for it would cost milliseconds. Kernels are written so that the
split does not change a bit of the result.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from time import perf_counter

import warp as wp

__all__ = ["SPLIT_ABOVE_S", "SplitLaunch", "core_count"]

SPLIT_ABOVE_S = 2.5e-4
GROWTH = 2.0
"""Factor by which a launch is assumed to grow from one run to the next."""
FIRST_S = 1e-5
"""What a launch is assumed to take before its first run [s]."""


def core_count() -> int:
    """Processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """The threads that every launch of so many parts shares."""
    return ThreadPoolExecutor(threads, thread_name_prefix="kernel")


class SplitLaunch:
    """A kernel launch recorded once, whole and in parts, and run many times.

    Parameters
    ----------
    kernel
        A kernel whose thread index starts at the integer input at ``offset_index``.
    dim
        Number of threads of the whole launch; of several dimensions the first is split.
    inputs, outputs
        Arguments of the kernel.
    offset_index
        Place in ``inputs`` of the first thread's index.
    device
        Warp device name; on a GPU the launch is never split.
    cores
        Parts to split into; 1 never splits. Default: all cores.
    """

    def __init__(
        self,
        kernel: wp.Kernel,
        *,
        dim: int | tuple[int, ...],
        inputs: Sequence[object],
        outputs: Sequence[object],
        offset_index: int,
        device: str,
        cores: int | None = None,
    ) -> None:
        along, *across = (dim,) if isinstance(dim, int) else dim
        parts = 1 if device != "cpu" else min(cores or core_count(), along)

        def record(first: int, last: int) -> wp.Launch:
            """The launch of the threads from ``first`` up to ``last``."""
            arguments = list(inputs)
            arguments[offset_index] = first
            return wp.launch(
                kernel,
                dim=(last - first, *across),
                inputs=arguments,
                outputs=list(outputs),
                device=device,
                record_cmd=True,
            )

        cuts = [along * part // parts for part in range(parts + 1)]
        self._whole = record(0, along)
        self._parts = [record(a, b) for a, b in pairwise(cuts)] if parts > 1 else []
        self._pool = _pool(parts - 1) if parts > 1 else None
        for waiting in [self._pool.submit(perf_counter) for _ in self._parts[1:]] if self._pool is not None else []:
            waiting.result()  # threads start now, not in the first large tick
        self._work_s = FIRST_S

    def __call__(self) -> None:
        """Run the launch and wait until it is done (on a GPU: until it is queued)."""
        start, parallel = perf_counter(), 1
        if self._pool is not None and self._work_s > SPLIT_ABOVE_S:
            waiting = [(self._pool.submit(part.launch), part) for part in self._parts[1:]]
            self._parts[0].launch()
            for begun, part in waiting:
                if begun.cancel():
                    part.launch()
                else:
                    begun.result()
                    parallel += 1
        else:
            self._whole.launch()
        self._work_s = min((perf_counter() - start) * parallel, GROWTH * self._work_s)
