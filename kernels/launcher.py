"""Recorded kernel launches that may be split into parts for several processor cores.

On a CPU, a Warp kernel launch runs on one core but releases the interpreter lock, so two halves of
a launch can run in two threads. Passing work to a thread takes about 50 us. A launch is therefore
split only if its last runs took longer than ``SPLIT_ABOVE_S``. In addition, measurements must show
that splitting saves time, see `SplitChoice`. A single slow run does not count, because another
process may have interrupted it. Other processes may occupy the core of a thread, so that the thread
does not begin its part. The calling thread then runs this part itself, because waiting would cost
milliseconds. Kernels are written so that splitting does not change any bit of the result.

Two logical processors may share one core, or other processes may keep a core busy. Half of the work
then takes as long as the whole work, and splitting only adds time. The gain is the ratio of the
time without splitting to the time with splitting. The first long runs of a launch measure the gain.
The gain is measured again while the launches run, at first often and later less and less often.
"""

import ctypes
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from statistics import geometric_mean, median
from time import perf_counter
from typing import Any

import warp as wp

from kernels.cores import CoreThreads, core_count, current_core
from kernels.mirror import placed

LEAST_GAIN = 1.1
"""Smallest gain (time without splitting / time with splitting) at which a launch is split.

The value was chosen by judgement. With a smaller value, further cores are occupied although they
save less than a tenth of the time.
"""
ORDER = tuple(number.bit_count() % 2 == 1 for number in range(16))
"""Order of the runs in a trial: True for a split run, False for a run as a whole.

A trial measures how much time splitting saves. Both halves of a trial have the same number of split
runs. The order is not periodic, so it cannot coincide with a period of the work.
"""
MOST_RATIO = 4.0
"""Upper limit for the time of a run in a trial, relative to the median time of the trial.

Longer times are replaced by this limit. A single interruption therefore does not change the outcome
of the trial.
"""
RECENT_GAINS = 4
"""Number of most recent gains that are used. Older gains may belong to another machine load."""
SHORTEST_PERIOD, LONGEST_PERIOD = 32, 2048
"""Smallest and largest number of long runs between trials.

The first trial begins with the first long run. A run is long if it takes long enough to be split.
After each trial that confirms the choice, the number of long runs before the next trial is doubled.
"""


class SplitChoice:
    """Choice for one kernel launch: run it as a whole, or split it over several cores.

    The work of a launch changes from run to run, so the choice is based on trials. A trial compares
    the times of equally many whole and split runs in mixed order.
    """

    def __init__(self) -> None:
        self._gains = deque[float](maxlen=RECENT_GAINS)
        self._period = SHORTEST_PERIOD
        self._due = 0
        self._trial: list[float] = []

    @property
    def gain(self) -> float:
        """Geometric mean of recent gains (time without splitting / time with splitting), or 1."""
        return geometric_mean(self._gains) if self._gains else 1.0

    @property
    def splits(self) -> bool:
        """True if the gain is large enough to split the launch."""
        return self.gain >= LEAST_GAIN

    def next_run(self) -> bool:
        """Return whether to split the next run.

        The run must be long enough to be split.
        """
        return self.splits if self._due > 0 else ORDER[len(self._trial)]

    def add(self, seconds: float) -> None:
        """Record the time [s] of the run that followed the last call of `next_run`."""
        if self._due > 0:
            self._due -= 1
            return
        self._trial.append(seconds)
        if len(self._trial) == len(ORDER):
            self._judge()

    def _judge(self) -> None:
        """Compare the whole and the split runs of a trial, and schedule the next trial."""
        most, before = MOST_RATIO * median(self._trial), self.splits
        times = [min(each, most) for each in self._trial]
        split = sum(each for each, was_split in zip(times, ORDER, strict=True) if was_split)
        whole = sum(times) - split
        self._trial.clear()
        if whole > 0.0 and split > 0.0:
            self._gains.append(whole / split)
        self._period = (
            min(2 * self._period, LONGEST_PERIOD) if self.splits == before else SHORTEST_PERIOD
        )
        self._due = self._period


def run_split(pool: CoreThreads, parts: list[Callable[[], object]]) -> int:
    """Run the first part in this thread, and the other parts in the threads of a pool.

    When the first part is done, this thread also runs every part that no thread of the pool has
    begun.

    Returns
    -------
    Number of parts that ran in parallel, that is, 1 plus the number of parts that the pool ran.
    """
    pool.keep_off(current_core())
    waiting = [(pool.submit(part), part) for part in parts[1:]]
    parts[0]()
    parallel = 1
    for begun, part in waiting:
        if begun.cancel():
            part()
        else:
            begun.result()
            parallel += 1
    return parallel


SPLIT_ABOVE_S = 2.5e-4
"""Expected time of a launch above which the launch may be split [s].

Passing work to a thread takes 50 us, a fifth of this time.
"""
GROWTH = 2.0
"""Largest factor by which the expected time of a launch increases after one run."""
FIRST_S = 1e-5
"""Expected time of a launch before its first run [s].

With `GROWTH`, a launch is split in its sixth run at the earliest.
"""


@dataclass
class LaunchCounts:
    """Number of kernel launches that are long enough to split, and number that were split."""

    large: int = 0
    split: int = 0


_counts = LaunchCounts()


def launch_counts() -> LaunchCounts:
    """Return a copy of the `LaunchCounts` of this process."""
    return LaunchCounts(_counts.large, _counts.split)


@cache
def _pool(threads: int) -> CoreThreads:
    """Return the pool of threads that all launches with ``threads`` + 1 parts share."""
    return CoreThreads(threads)


def recorded(
    kernel: wp.Kernel,
    *,
    dim: int | tuple[int, ...],
    inputs: Sequence[object],
    outputs: Sequence[object] = (),
    device: str,
) -> Callable[[], object]:
    """Record a kernel launch, and return a function that runs the launch.

    On a CPU, the arguments are packed once, and each call of the function passes them to the
    compiled kernel. For six arguments, a call takes 0.6 us. Warp's own `Launch.launch` packs the
    arguments in every call and takes 5 us.
    """
    command: wp.Launch = wp.launch(
        kernel,
        dim=dim,
        inputs=placed(kernel, inputs, device),
        outputs=list(outputs),
        device=device,
        record_cmd=True,
    )
    if not command.device.is_cpu or command.block_dim != 1:
        return command.launch
    bounds, *values = command.params
    labels = [argument.label for argument in command.kernel.adj.args]
    names = [(label, type(value)) for label, value in zip(labels, values, strict=True)]
    packed = type("Arguments", (ctypes.Structure,), {"_fields_": names})(*values)
    run = command.hooks.forward
    size = ctypes.byref(bounds)
    arguments = ctypes.byref(packed)

    def launch() -> None:
        """Run the kernel. The recorded command keeps its arrays alive."""
        assert command is not None
        run(size, arguments)

    return launch


def run_once(kernel: wp.Kernel, dim: int, inputs: Sequence[object], outputs: Sequence[Any]) -> None:
    """Launch a kernel once, without splitting, on the device of the first output.

    The value 0, the index of the first thread, is appended to the inputs. NumPy arrays are copied
    to the device.
    """
    device = str(outputs[0].device)
    arguments = [*placed(kernel, inputs, device), 0]
    wp.launch(kernel, dim=dim, inputs=arguments, outputs=list(outputs), device=device)


class SplitLaunch:
    """Kernel launch that is recorded once and run many times, as a whole or in parts.

    Parameters
    ----------
    kernel
        Kernel whose last input is an integer, the index of the first thread. The kernel must add
        this index to its thread index.
    dim
        Number of Warp threads of the whole launch. If there are several dimensions, the first is
        split.
    inputs, outputs
        Arguments of the kernel, without the index of the first thread. NumPy arrays among the
        inputs are copied to the device.
    device
        Warp device name. If not given, the device of the first output is used. On a GPU the launch
        is never split.
    cores
        Largest number of parts. If it is 1, the launch is never split. Default: number of available
        cores.
    """

    def __init__(
        self,
        kernel: wp.Kernel,
        dim: int | tuple[int, ...],
        inputs: Sequence[object],
        outputs: Sequence[Any],
        *,
        device: str | None = None,
        cores: int | None = None,
    ) -> None:
        device = device or str(outputs[0].device)
        inputs = placed(kernel, inputs, device)
        along, *across = (dim,) if isinstance(dim, int) else dim
        parts = 1 if device != "cpu" else min(cores or core_count(), along)

        def record(first: int, last: int) -> Callable[[], object]:
            """Record the launch of the threads ``first`` to ``last`` - 1."""
            return recorded(
                kernel,
                dim=(last - first, *across),
                inputs=[*inputs, first],
                outputs=outputs,
                device=device,
            )

        self._whole = record(0, along)
        self._work_s = FIRST_S
        self._pool = _pool(parts - 1) if parts > 1 else None
        if self._pool is not None:
            self._parts = [
                record(a, b)
                for a, b in pairwise(along * part // parts for part in range(parts + 1))
            ]
            self._choice = SplitChoice()

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
