"""Recorded launches that may be split over processor cores.

A Warp launch on a CPU runs on one core but releases the interpreter lock, so the halves of a launch
can run on two threads. Handing work to a thread costs about 50 us. A launch is therefore split only
while its last runs took longer than ``SPLIT_ABOVE_S`` and while splitting is measured to gain, see
`kernels.split_choice`. One run that another process interrupted does not make a launch large. A
part that no thread has begun, because other processes keep its core, is taken back. Waiting for it
would cost milliseconds. Kernels are written so that the split does not change a bit of the result.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from time import perf_counter
from typing import Any

import warp as wp

from kernels.cores import CoreThreads, core_count
from kernels.split_choice import SplitChoice, calibrate, run_split

__all__ = ["SPLIT_ABOVE_S", "LaunchCounts", "SplitLaunch", "launch_counts"]

SPLIT_ABOVE_S = 2.5e-4
GROWTH = 2.0
"""Factor by which a launch is assumed to grow from one run to the next."""
FIRST_S = 1e-5
"""Assumed time of a launch before its first run [s]."""


@dataclass
class LaunchCounts:
    """Counts of this process's launches that were large enough to be split and that were split."""

    large: int = 0
    split: int = 0


_counts = LaunchCounts()


def launch_counts() -> LaunchCounts:
    """Return a copy of this process's counts so far."""
    return LaunchCounts(_counts.large, _counts.split)


@cache
def _pool(threads: int) -> CoreThreads:
    """Return the threads that all launches of this number of parts share."""
    return CoreThreads(threads)


@cache
def _gain(threads: int) -> float:
    """Return the gain of the threads on this machine, measured once for all launches.

    Every launch starts from this gain.
    """
    return calibrate(_pool(threads), threads + 1)


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
        Place in ``inputs`` of the first thread's index; default: after the inputs.
    device
        Warp device name; default: the device of the first output. On a GPU the launch is never
        split.
    cores
        Parts to split into; 1 never splits. Default: all cores.
    """

    def __init__(
        self,
        kernel: wp.Kernel,
        *,
        dim: int | tuple[int, ...],
        inputs: Sequence[object],
        outputs: Sequence[Any],
        offset_index: int | None = None,
        device: str | None = None,
        cores: int | None = None,
    ) -> None:
        device = device or str(outputs[0].device)
        place = len(inputs) if offset_index is None else offset_index
        along, *across = (dim,) if isinstance(dim, int) else dim
        parts = 1 if device != "cpu" else min(cores or core_count(), along)

        def record(first: int, last: int) -> Callable[[], object]:
            """Run the launch of the threads from ``first`` up to ``last``."""
            arguments = list(inputs)
            arguments[place : place + 1] = [first]
            command: wp.Launch = wp.launch(
                kernel,
                dim=(last - first, *across),
                inputs=arguments,
                outputs=list(outputs),
                device=device,
                record_cmd=True,
            )
            return command.launch

        self._whole = record(0, along)
        self._work_s = FIRST_S
        self._pool = _pool(parts - 1) if parts > 1 else None
        if self._pool is not None:
            self._parts = [
                record(a, b)
                for a, b in pairwise(along * part // parts for part in range(parts + 1))
            ]
            # calibrated now, not in the first large tick
            self._choice = SplitChoice(_gain(parts - 1))

    def __call__(self) -> None:
        """Run the launch and wait until it is done (on a GPU: until it is queued)."""
        large = self._pool is not None and self._work_s > SPLIT_ABOVE_S
        start, parallel = perf_counter(), 1
        if self._pool is not None and large and self._choice.next_run():
            _counts.split += 1
            parallel = run_split(self._pool, self._parts)
        else:
            self._whole()
        took_s = perf_counter() - start
        if large:
            _counts.large += 1
            self._choice.add(took_s)
        self._work_s = min(took_s * parallel, GROWTH * self._work_s)
