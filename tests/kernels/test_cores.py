"""Cores for threads: counted, limited, and kept free for the thread that splits its work."""

import os

import pytest

import kernels.cores as cores
from kernels.cores import (
    CoreThreads,
    allowed_cores,
    core_count,
    cores_without,
    limit_cores,
)

linux = pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity"), reason="the system reports no cores"
)


@pytest.mark.parametrize(
    ("core", "allowed", "left"),
    [
        (1, {0, 1}, {0}),
        (0, {0}, {0}),
        (None, {0, 1}, {0, 1}),
        (7, {0, 1}, {0, 1}),
        (0, set(), set()),
    ],
)
def test_one_core_is_left_out_where_another_one_remains(core, allowed, left):
    assert cores_without(core, allowed) == left


def test_a_process_may_be_limited_to_fewer_cores(monkeypatch):
    monkeypatch.setattr(cores, "_most_cores", [])
    monkeypatch.setattr(cores, "allowed_cores", lambda: {0, 1, 2})
    assert core_count() == 3
    limit_cores(2)
    assert core_count() == 2
    limit_cores(5)
    assert core_count() == 3


@linux
@pytest.mark.parametrize("allowed", [1, None])
def test_threads_keep_off_a_core(allowed, monkeypatch):
    """Running and later threads keep off a reserved core; on a single core they share it."""
    mine = set(sorted(allowed_cores())[:allowed])
    monkeypatch.setattr(cores, "allowed_cores", lambda: mine)
    core = min(mine)
    with CoreThreads(1) as threads:
        threads.submit(int).result()
        threads.keep_off(core)
        assert threads.submit(os.sched_getaffinity, 0).result() == cores_without(core, mine)
    with CoreThreads(1) as threads:
        threads.keep_off(core)
        assert threads.submit(os.sched_getaffinity, 0).result() == cores_without(core, mine)
