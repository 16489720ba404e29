"""Launches split over threads.

The result is unchanged, also where no thread is free, and only large launches are split.
"""

from itertools import cycle
from threading import Event
from time import sleep

import numpy as np
import pytest
import warp as wp

import kernels.launcher as launcher
from kernels.launcher import (
    LEAST_GAIN,
    LONGEST_PERIOD,
    ORDER,
    RECENT_GAINS,
    SplitChoice,
    SplitLaunch,
)

COUNT = 1000


@wp.kernel
def squares(
    # in
    offset: int,
    # out
    squares_out: wp.array(dtype=wp.int32),
):
    """The square of every thread's index."""
    i = wp.tid() + offset
    squares_out[i] = squares_out[i] + i * i


@pytest.fixture
def split() -> tuple[SplitLaunch, np.ndarray]:
    """A launch on a machine where splitting saves time, and the array that it writes."""
    out = wp.zeros(COUNT, dtype=wp.int32, device="cpu")
    launch = SplitLaunch(squares, COUNT, [], [out], device="cpu", cores=2)
    launch._choice = settled(TWO_CORES)
    return launch, out.numpy()


def test_a_part_that_no_thread_begins_is_taken_back(split, monkeypatch):
    """A part that no thread begins is taken back.

    If its thread is held up, the launch neither waits nor omits anything, and no part runs twice
    afterwards.
    """
    launch, out = split
    monkeypatch.setattr(launcher, "SPLIT_ABOVE_S", 0.0)
    begun, release = Event(), Event()
    pool = launcher._pool(1)
    held = pool.submit(lambda: (begun.set(), release.wait(10.0)))
    assert begun.wait(5.0)
    launch()
    assert not held.done()
    release.set()
    held.result()
    pool.submit(sleep, 0.0).result()  # whatever was queued before has run or was cancelled
    assert np.array_equal(out, np.arange(COUNT) ** 2)
    launch()
    assert np.array_equal(out, 2 * np.arange(COUNT) ** 2)


def test_one_slow_run_does_not_split_a_small_launch(split, monkeypatch):
    """One slow run does not split a small launch.

    Only work that stays large is split: work is assumed to grow by a factor of two from run to run.
    """
    launch, _ = split
    clock = iter(np.cumsum([0.0, 1e-5, 0.0, 5e-3, 0.0, 1e-5, 0.0, *[5e-3, 0.0] * 6]))
    monkeypatch.setattr(launcher, "perf_counter", lambda: next(clock))
    handed = []
    submit = launch._pool.submit
    monkeypatch.setattr(launch._pool, "submit", lambda *task: handed.append(task) or submit(*task))
    for _ in range(3):
        launch()
    assert not handed, "an interrupted run counted as a large launch"
    for _ in range(6):
        launch()
    assert handed, "a launch that stays large is not split"


TWO_CORES, ONE_CORE = 1.8, 0.6
"""Gain from splitting on two cores, and on two processors that share one core."""


WHOLE_S, SLICE_S = 4e-4, 8e-3
"""Time of a whole run, and of a time slice that another process takes."""


def run(choice, gain):
    """One large run on a machine where splitting gains so much; whether it was split."""
    was_split = choice.next_run()
    choice.add(WHOLE_S / gain if was_split else WHOLE_S)
    return was_split


def run_to_trial(choice, gain):
    """Run until a trial begins; how many runs that took."""
    for count in range(2 * LONGEST_PERIOD):
        if choice._due == 0:
            return count
        assert run(choice, gain) == choice.splits
    raise AssertionError("no trial begins")


def trial(choice, times):
    """One trial with the given times of whole and split runs."""
    for was_split in ORDER:
        assert choice.next_run() == was_split
        choice.add(next(times[was_split]))


def even(gain):
    """Times of whole and split runs of the same work."""
    return {False: cycle([WHOLE_S]), True: cycle([WHOLE_S / gain])}


def settled(gain):
    """A choice after its first trial."""
    choice = SplitChoice()
    trial(choice, even(gain))
    return choice


@pytest.mark.parametrize(("gain", "splits"), [(TWO_CORES, True), (ONE_CORE, False), (1.0, False)])
def test_a_choice_begins_with_a_trial(gain, splits):
    assert not SplitChoice().splits
    choice = settled(gain)
    assert choice.gain == pytest.approx(gain)
    assert choice.next_run() == choice.splits == splits


@pytest.mark.parametrize(("before", "after"), [(TWO_CORES, ONE_CORE), (ONE_CORE, TWO_CORES)])
def test_a_choice_follows_the_machine_while_it_runs(before, after):
    """A core that others take, or give back, turns the choice within as many trials as count."""
    choice = settled(before)
    for _ in range(RECENT_GAINS):
        run_to_trial(choice, after)
        trial(choice, even(after))
    assert choice.splits == (after >= LEAST_GAIN)
    assert choice.gain == pytest.approx(after)


@pytest.mark.parametrize("gain", [TWO_CORES, ONE_CORE])
def test_one_interruption_decides_nothing(gain):
    """Neither a split run that lost a time slice, nor a whole one."""
    for interrupted in (False, True):
        choice = settled(gain)
        run_to_trial(choice, gain)
        times = even(gain)
        usual = next(times[interrupted])
        times[interrupted] = iter([SLICE_S] + [usual] * 7)
        trial(choice, times)
        assert choice.splits == (gain >= LEAST_GAIN)


def test_interruptions_that_come_again_end_the_splitting():
    """The mean counts, not the median: threads that often lose their core make late ticks."""
    choice = settled(TWO_CORES)
    for _ in range(RECENT_GAINS):
        run_to_trial(choice, TWO_CORES)
        times = even(TWO_CORES)
        times[True] = iter([SLICE_S] * 3 + [WHOLE_S / TWO_CORES] * 5)
        trial(choice, times)
    assert not choice.splits
