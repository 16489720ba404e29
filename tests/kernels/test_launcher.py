"""Launches split over threads: the same result, also where no thread is free, and only where work is large."""

from threading import Event
from time import sleep

import numpy as np
import pytest
import warp as wp

import kernels.launcher as launcher
from kernels.launcher import SplitLaunch

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


@pytest.fixture
def split() -> tuple[SplitLaunch, np.ndarray]:
    out = wp.zeros(COUNT, dtype=wp.int32, device="cpu")
    launch = SplitLaunch(squares, dim=COUNT, inputs=[0], outputs=[out], offset_index=0, device="cpu", cores=2)
    return launch, out.numpy()


def test_a_part_that_no_thread_begins_is_taken_back(split, monkeypatch):
    """With its thread held up the launch neither waits nor leaves anything out, nor is a part run twice afterwards."""
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
    """Only what stays large is split: work is assumed to grow by a factor of two from run to run."""
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
