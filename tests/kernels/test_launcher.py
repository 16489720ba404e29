"""Launches split over threads.

The result is unchanged, also where no thread is free, and only large launches are split.
"""

from threading import Event
from time import sleep

import numpy as np
import pytest
import warp as wp

import kernels.launcher as launcher
from kernels.launcher import SplitLaunch
from kernels.split_choice import FIRST_TRIAL, KEPT, ORDER

wp.set_module_options({"enable_backward": False})
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


def launch_of(gain, monkeypatch) -> tuple[SplitLaunch, np.ndarray]:
    """A launch on a machine where splitting gains so much, and what it writes."""
    monkeypatch.setattr(launcher, "_gain", lambda threads: gain)
    out = wp.zeros(COUNT, dtype=wp.int32, device="cpu")
    launch = SplitLaunch(
        squares, dim=COUNT, inputs=[0], outputs=[out], offset_index=0, device="cpu", cores=2
    )
    return launch, out.numpy()


@pytest.fixture
def split(monkeypatch) -> tuple[SplitLaunch, np.ndarray]:
    return launch_of(1.8, monkeypatch)


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


@pytest.mark.parametrize(("before", "after"), [(0.6, 1.8), (1.8, 0.6)])
def test_trials_while_it_runs_turn_the_choice_and_change_no_result(before, after, monkeypatch):
    """A clock makes splitting gain nothing at first and then much, or the opposite."""
    launch, out = launch_of(before, monkeypatch)
    monkeypatch.setattr(launcher, "SPLIT_ABOVE_S", 0.0)
    choice = launch._choice
    add = choice.add

    def timed(seconds):
        add(1e-3 / after if choice.next_run() else 1e-3)

    monkeypatch.setattr(choice, "add", timed)
    runs = 0
    most = sum(FIRST_TRIAL * 2**trial + len(ORDER) for trial in range(KEPT))
    while choice.splits == (before > 1.0) and runs <= most:
        launch()
        runs += 1
    assert FIRST_TRIAL + len(ORDER) <= runs <= most
    assert np.array_equal(out, runs * np.arange(COUNT) ** 2)
