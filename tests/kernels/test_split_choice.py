"""Choice to split a launch, which follows the measured gain, at the start and while it runs."""

from itertools import cycle

import pytest

from kernels.cores import CoreThreads
from kernels.split_choice import (
    KEPT,
    LAST_TRIAL,
    LEAST_GAIN,
    ORDER,
    SAMPLES,
    SplitChoice,
    calibrate,
)

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
    for count in range(2 * LAST_TRIAL):
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


@pytest.mark.parametrize(("gain", "splits"), [(TWO_CORES, True), (ONE_CORE, False), (1.0, False)])
def test_a_choice_begins_with_the_machine(gain, splits):
    choice = SplitChoice(gain)
    assert choice.gain == pytest.approx(gain)
    assert choice.next_run() == choice.splits == splits


@pytest.mark.parametrize(("before", "after"), [(TWO_CORES, ONE_CORE), (ONE_CORE, TWO_CORES)])
def test_a_choice_follows_the_machine_while_it_runs(before, after):
    """A core that others take, or give back, turns the choice within as many trials as count."""
    choice = SplitChoice(before)
    for _ in range(KEPT):
        run_to_trial(choice, after)
        trial(choice, even(after))
    assert choice.splits == (after >= LEAST_GAIN)
    assert choice.gain == pytest.approx(after)


@pytest.mark.parametrize("gain", [TWO_CORES, ONE_CORE])
def test_one_interruption_decides_nothing(gain):
    """Neither a split run that lost a time slice, nor a whole one."""
    for interrupted in (False, True):
        choice = SplitChoice(gain)
        run_to_trial(choice, gain)
        times = even(gain)
        usual = next(times[interrupted])
        times[interrupted] = iter([SLICE_S] + [usual] * 7)
        trial(choice, times)
        assert choice.splits == (gain >= LEAST_GAIN)


def test_interruptions_that_come_again_end_the_splitting():
    """The mean counts, not the median: threads that often lose their core make late ticks."""
    choice = SplitChoice(TWO_CORES)
    for _ in range(KEPT):
        run_to_trial(choice, TWO_CORES)
        times = even(TWO_CORES)
        times[True] = iter([SLICE_S] * 3 + [WHOLE_S / TWO_CORES] * 5)
        trial(choice, times)
    assert not choice.splits


@pytest.mark.parametrize(
    ("whole_s", "split_s", "gain"), [(3e-4, 2e-4, 1.5), (3e-4, 3.6e-4, 1 / 1.2)]
)
def test_the_calibration_compares_whole_with_split_work(whole_s, split_s, gain):
    """The calibration compares whole with split work.

    A clock shows the given times: three looks at the duration of hashing, then whole and split in
    turn.
    """
    steps = [1e-4] * 3
    times, shown = cycle([whole_s, split_s]), [0.0]
    for step in steps:
        shown += [shown[-1] + step, shown[-1] + step]
    for _ in range(SAMPLES):
        start = shown.pop()
        shown += [start, start + next(times)]
        shown.append(shown[-1] + next(times))
        shown.append(shown[-1])
    clock = iter(shown)
    with CoreThreads(1) as pool:
        found = calibrate(pool, 2, now=lambda: next(clock))
    assert found == pytest.approx(gain)
