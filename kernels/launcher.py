"""Recorded launches that may be split over processor cores.

A Warp launch on a CPU runs on one core but releases the interpreter lock, so the halves of a launch can run on two
threads. Handing work to a thread costs about 50 us: a launch is split only while its last runs took longer than
``SPLIT_ABOVE_S``, where one run that another process interrupted is no large launch, and while splitting is measured to
gain, see `kernels.split_choice`. A part that no thread has begun, because other processes keep its core, is taken back:
waiting for it would cost milliseconds. Kernels are written so that the split does not change a bit of the result.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from time import perf_counter

import warp as wp

from kernels.cores import CoreThreads, core_count
from kernels.split_choice import SplitChoice, calibrate, run_split

__all__ = ["SPLIT_ABOVE_S", "LaunchCounts", "SplitLaunch", "launch_counts"]

SPLIT_ABOVE_S = 2.5e-4
GROWTH = 2.0
"""Factor by which a launch is assumed to grow from one run to the next."""
QUARTERS = 4
"""Parts of a launch that measures what splitting gains: one is run as a whole, the others split."""
FIRST_S = 1e-5
"""What a launch is assumed to take before its first run [s]."""


@dataclass
class LaunchCounts:
    """Launches of this process that were large enough to be split, and those of them that were."""

    large: int = 0
    split: int = 0


_counts = LaunchCounts()


def launch_counts() -> LaunchCounts:
    """Copy of what this process has counted so far."""
    return LaunchCounts(_counts.large, _counts.split)


@cache
def _pool(threads: int) -> CoreThreads:
    """The threads that every launch of so many parts shares."""
    return CoreThreads(threads)


@cache
def _gains(threads: int) -> tuple[float, ...]:
    """What the threads gain on this machine, measured once; every launch goes on from there."""
    return tuple(calibrate(_pool(threads), threads + 1))


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
        parts = 1 if device != "cpu" else max(min(cores or core_count(), along // QUARTERS), 1)

        def record(first: int, last: int) -> Callable[[], object]:
            """Run the launch of the threads from ``first`` up to ``last``."""
            arguments = list(inputs)
            arguments[offset_index] = first
            command: wp.Launch = wp.launch(
                kernel,
                dim=(last - first, *across),
                inputs=arguments,
                outputs=list(outputs),
                device=device,
                record_cmd=True,
            )
            return command.launch

        def cut(pieces: int) -> list[Callable[[], object]]:
            """The launch in so many pieces of equal size."""
            return [record(a, b) for a, b in pairwise(along * piece // pieces for piece in range(pieces + 1))]

        self._whole = record(0, along)
        self._work_s = FIRST_S
        self._pool = _pool(parts - 1) if parts > 1 else None
        if self._pool is not None:
            self._parts, pieces = cut(parts), cut(QUARTERS * parts)
            self._quarters = [pieces[quarter * parts : (quarter + 1) * parts] for quarter in range(QUARTERS)]
            self._choice = SplitChoice(_gains(parts - 1))  # calibrated now, not in the first large tick

    def __call__(self) -> None:
        """Run the launch and wait until it is done (on a GPU: until it is queued)."""
        start, parallel = perf_counter(), 1
        if self._pool is None or self._work_s <= SPLIT_ABOVE_S:
            self._whole()
        else:
            _counts.large += 1
            if self._choice.trial_is_due():
                self._try_out(self._pool)
            elif self._choice.splits:
                _counts.split += 1
                parallel = run_split(self._pool, self._parts)
            else:
                self._whole()
        self._work_s = min((perf_counter() - start) * parallel, GROWTH * self._work_s)

    def _try_out(self, pool: CoreThreads) -> None:
        """Run one quarter of the launch as a whole, the next time another one, and the rest split; compare their times.

        Handing over work costs the same for much of it and for little: most of it is to be split, as in other runs.
        """
        whole, *rest = self._quarters
        self._quarters = [*rest, whole]
        start = perf_counter()
        _in_turn(whole)
        middle = perf_counter()
        run_split(pool, [partial(_in_turn, pieces) for pieces in zip(*rest, strict=True)])
        self._choice.add((QUARTERS - 1) * (middle - start), perf_counter() - middle)


def _in_turn(pieces: Iterable[Callable[[], object]]) -> None:
    """Run pieces one after the other."""
    for piece in pieces:
        piece()
