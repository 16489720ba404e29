"""Whether a launch is split over threads, decided by what splitting gains on this machine at this time.

Two processors may share one core, and other processes may keep a core busy: then half the work takes as long as all of
it, and splitting only costs. The gain is measured by a short calibration before the first launch, and again while the
launches run, at first often and then ever more seldom.
"""

import hashlib
from collections import deque
from collections.abc import Callable, Iterable
from math import exp, log
from time import perf_counter

from kernels.cores import CoreThreads, current_core

__all__ = ["LEAST_GAIN", "SplitChoice", "calibrate", "run_split"]

LEAST_GAIN = 1.1
"""Time of whole runs over that of split ones from which a launch is split."""
KEPT = 8
"""Measurements of the gain that count."""
MOST_RATIO = 4.0
"""A single measurement counts as at most this gain or loss: one interruption decides nothing, several do."""
FIRST_TRIAL, LAST_TRIAL = 8, 512
"""Large runs before the first trial; the number doubles with each trial that confirms the choice, up to the second."""
CALIBRATION_S = 1.5e-4
"""Time of one part of the calibration's work [s]: a launch just large enough to be split has two of them."""
SAMPLE_BYTES = 1 << 16


class SplitChoice:
    """Whether one launch is split.

    Parameters
    ----------
    gains
        Ratios of whole to split time measured so far, such as those of `calibrate`; without any it is not split.
    """

    def __init__(self, gains: Iterable[float] = ()) -> None:
        self._logs = deque((_clipped_log(gain) for gain in gains), maxlen=KEPT)
        self._period = self._due = FIRST_TRIAL

    @property
    def gain(self) -> float:
        """Geometric mean of the last measurements; 1 without any."""
        return exp(sum(self._logs) / len(self._logs)) if self._logs else 1.0

    @property
    def splits(self) -> bool:
        """Whether splitting gains enough."""
        return self.gain >= LEAST_GAIN

    def trial_is_due(self) -> bool:
        """Count a large run; whether this one is to measure the gain."""
        self._due -= 1
        return self._due < 0

    def add(self, whole_s: float, split_s: float) -> None:
        """Take a trial's measurement: time of the same amount of work as a whole, and split [s]."""
        before = self.splits
        self._logs.append(_clipped_log(whole_s / split_s if split_s > 0.0 else 1.0))
        self._period = min(2 * self._period, LAST_TRIAL) if self.splits == before else FIRST_TRIAL
        self._due = self._period


def run_split(pool: CoreThreads, parts: list[Callable[[], object]]) -> int:
    """Run parts, the first in this thread and the others in a pool's; a part that no thread has begun is taken back.

    Returns
    -------
    How many parts ran at the same time.
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


def calibrate(pool: CoreThreads, parts: int, *, now: Callable[[], float] = perf_counter) -> list[float]:
    """Ratios of whole to split time of work that needs only a core, in a few milliseconds.

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
    work = bytes(SAMPLE_BYTES * max(1, round(CALIBRATION_S / one_s)) if one_s > 0.0 else SAMPLE_BYTES)
    jobs: list[Callable[[], object]] = [lambda: hashlib.sha256(work)] * parts  # hashing releases the interpreter lock
    run_split(pool, jobs)  # threads start now
    gains = []
    for _ in range(KEPT):
        start = now()
        for job in jobs:
            job()
        middle = now()
        run_split(pool, jobs)
        gains.append((middle - start) / max(now() - middle, 1e-9))
    return gains


def _hash_time(work: bytes, now: Callable[[], float]) -> float:
    start = now()
    hashlib.sha256(work)
    return now() - start


def _clipped_log(gain: float) -> float:
    return log(min(max(gain, 1.0 / MOST_RATIO), MOST_RATIO))
