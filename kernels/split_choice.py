"""Choice whether to split a launch over threads, by the measured gain on this machine.

Two processors may share one core, and other processes may keep a core busy: half the work then
takes as long as the whole, and splitting only costs time. The gain is measured by a short
calibration before the first launch. It is measured again while the launches run, at first often and
then less and less often.
"""

import hashlib
from collections import deque
from collections.abc import Callable
from statistics import geometric_mean, median
from time import perf_counter

from kernels.cores import CoreThreads, current_core

__all__ = ["LEAST_GAIN", "SplitChoice", "calibrate", "run_split"]

LEAST_GAIN = 1.1
"""Ratio of whole to split time above which a launch is split."""
ORDER = tuple(number.bit_count() % 2 == 1 for number in range(16))
"""Choice of the runs of a trial that are split.

Split runs are late as often as early, and follow no rhythm that the work of the runs may have.
"""
MOST_RATIO = 4.0
"""Largest time of a run in a trial, relative to the median; longer runs count as this.

One interruption therefore does not decide the trial, several do.
"""
KEPT = 4
"""Number of trials that count."""
FIRST_TRIAL, LAST_TRIAL = 32, 2048
"""Number of large runs before the first trial, and the largest number between trials.

The number doubles with each trial that confirms the choice.
"""
SAMPLES = 8
"""Number of pairs of whole and split work in the calibration."""
CALIBRATION_S = 1.5e-4
"""Time of one part of the calibration's work [s].

A launch that is just large enough to be split has two such parts.
"""
SAMPLE_BYTES = 1 << 16


class SplitChoice:
    """Decision whether one launch is split.

    The work of a launch changes from run to run. A trial therefore compares equal numbers of whole
    and split runs, in mixed order.

    Parameters
    ----------
    gain
        Ratio of whole to split time measured so far, such as the ratio from `calibrate`.
    """

    def __init__(self, gain: float = 1.0) -> None:
        self._gains = deque([gain], maxlen=KEPT)
        self._period = self._due = FIRST_TRIAL
        self._trial: list[float] = []

    @property
    def gain(self) -> float:
        """Geometric mean of the last measurements."""
        return geometric_mean(self._gains)

    @property
    def splits(self) -> bool:
        """Return whether splitting gains enough."""
        return self.gain >= LEAST_GAIN

    def next_run(self) -> bool:
        """Return whether to split the next large run."""
        return self.splits if self._due > 0 else ORDER[len(self._trial)]

    def add(self, seconds: float) -> None:
        """Record the time [s] of the run that was announced by `next_run`."""
        if self._due > 0:
            self._due -= 1
            return
        self._trial.append(seconds)
        if len(self._trial) == len(ORDER):
            self._judge()

    def _judge(self) -> None:
        """Compare the whole and the split runs of a trial, and set when the next one begins."""
        most, before = MOST_RATIO * median(self._trial), self.splits
        times = [min(each, most) for each in self._trial]
        split = sum(each for each, was_split in zip(times, ORDER, strict=True) if was_split)
        whole = sum(times) - split
        self._trial.clear()
        if whole > 0.0 and split > 0.0:
            self._gains.append(whole / split)
        self._period = min(2 * self._period, LAST_TRIAL) if self.splits == before else FIRST_TRIAL
        self._due = self._period


def run_split(pool: CoreThreads, parts: list[Callable[[], object]]) -> int:
    """Run the first part in this thread and the other parts in the threads of a pool.

    A part that no thread has begun is taken back.

    Returns
    -------
    Number of parts that ran at the same time.
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


def calibrate(pool: CoreThreads, parts: int, *, now: Callable[[], float] = perf_counter) -> float:
    """Measure the ratio of whole to split time of work that needs only a core.

    The measurement takes a few milliseconds.

    Parameters
    ----------
    pool
        Threads that take all parts but one.
    parts
        Parts to split into.
    now
        Clock [s].
    """
    one_s = min(_hash_time(bytes(SAMPLE_BYTES), now) for _ in range(3))
    work = bytes(
        SAMPLE_BYTES * max(1, round(CALIBRATION_S / one_s)) if one_s > 0.0 else SAMPLE_BYTES
    )
    # hashing releases the interpreter lock
    jobs: list[Callable[[], object]] = [lambda: hashlib.sha256(work)] * parts
    run_split(pool, jobs)  # threads start now
    ratios = []
    for _ in range(SAMPLES):
        start = now()
        for job in jobs:
            job()
        middle = now()
        run_split(pool, jobs)
        ratios.append((middle - start) / max(now() - middle, 1e-9))
    return median(ratios)


def _hash_time(work: bytes, now: Callable[[], float]) -> float:
    start = now()
    hashlib.sha256(work)
    return now() - start
