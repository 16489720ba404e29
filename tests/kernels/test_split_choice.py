"""Whether a launch is split follows what splitting gains, at the start and while it runs."""

from itertools import count, cycle

import pytest

from kernels.cores import CoreThreads
from kernels.split_choice import FIRST_TRIAL, KEPT, LAST_TRIAL, LEAST_GAIN, MOST_RATIO, SplitChoice, calibrate

TWO_CORES, ONE_CORE = 1.8, 0.6
"""What splitting gains on two cores, and on two processors that share one."""


def runs_to_trial(choice):
    """Large runs until a trial is due, that one included."""
    return next(number for number in count(1) if choice.trial_is_due())


@pytest.mark.parametrize(("gain", "splits"), [(TWO_CORES, True), (ONE_CORE, False), (1.0, False)])
def test_a_choice_begins_with_the_machine(gain, splits):
    choice = SplitChoice([gain] * KEPT)
    assert choice.gain == pytest.approx(gain)
    assert choice.splits == splits


def test_a_choice_without_measurements_does_not_split():
    assert not SplitChoice().splits


@pytest.mark.parametrize(("before", "after"), [(TWO_CORES, ONE_CORE), (ONE_CORE, TWO_CORES)])
def test_a_choice_follows_the_machine_while_it_runs(before, after):
    """A core that others take, or give back, turns the choice within as many trials as count."""
    choice = SplitChoice([before] * KEPT)
    for _ in range(KEPT):
        choice.add(after * 1e-3, 1e-3)
    assert choice.splits == (after >= LEAST_GAIN)
    assert choice.gain == pytest.approx(after)


def test_one_interruption_decides_nothing():
    """A split run that lost a time slice of 8 ms does not end the splitting, and a whole one does not begin it."""
    choice = SplitChoice([TWO_CORES] * KEPT)
    choice.add(2e-4, 8e-3)
    assert choice.splits
    choice = SplitChoice([ONE_CORE] * KEPT)
    choice.add(8e-3, 2e-4)
    assert not choice.splits


def test_interruptions_that_come_again_end_the_splitting():
    """The mean counts, not the median: threads that often lose their core make late ticks."""
    choice = SplitChoice([1.0 + 0.5 * (TWO_CORES - 1.0)] * KEPT)
    for _ in range(3):
        choice.add(1e-4, 1e-4 * 2.0 * MOST_RATIO)
    assert not choice.splits


def test_trials_become_seldom_and_often_again_when_the_choice_turns():
    choice = SplitChoice([TWO_CORES] * KEPT)
    waited = []
    for _ in range(10):
        waited.append(runs_to_trial(choice))
        choice.add(TWO_CORES * 1e-3, 1e-3)
    assert waited == [min(FIRST_TRIAL * 2**power, LAST_TRIAL) + 1 for power in range(10)]
    while choice.splits:
        choice.add(ONE_CORE * 1e-3, 1e-3)
    assert runs_to_trial(choice) == FIRST_TRIAL + 1


def test_times_too_short_for_the_clock_are_no_gain():
    choice = SplitChoice()
    choice.add(0.0, 0.0)
    choice.add(0.0, 1e-3)
    assert not choice.splits


@pytest.mark.parametrize(("whole_s", "split_s", "gain"), [(3e-4, 2e-4, 1.5), (3e-4, 3.6e-4, 1 / 1.2)])
def test_the_calibration_compares_whole_with_split_work(whole_s, split_s, gain):
    """By a clock that shows those times: three looks at how long hashing takes, then whole and split in turn."""
    steps = [1e-4] * 3
    times, shown = cycle([whole_s, split_s]), [0.0]
    for step in steps:
        shown += [shown[-1] + step, shown[-1] + step]
    for _ in range(KEPT):
        start = shown.pop()
        shown += [start, start + next(times)]
        shown.append(shown[-1] + next(times))
        shown.append(shown[-1])
    clock = iter(shown)
    with CoreThreads(1) as pool:
        gains = calibrate(pool, 2, now=lambda: next(clock))
    assert gains == pytest.approx([gain] * KEPT)
