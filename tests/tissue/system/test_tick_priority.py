"""Priority of ticks against the wall clock.

The tests cover the request to each system, the granted priority, and its restoration.
"""

import os
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest

from tissue.system.priorities import REALTIME, TickPriority

linux = pytest.mark.skipif(
    not hasattr(os, "sched_setscheduler"), reason="Linux alone has these calls"
)


class FakeScheduler:
    """Calls of Linux that record their arguments, and that grant what a test wants."""

    def __init__(self, monkeypatch, *, realtime, nice, clear=True):
        self.policy, self.niceness, self.calls, self._clear = (0, 0), 0, [], clear
        self._realtime, self._nice = realtime, nice
        for name in (
            "sched_setscheduler",
            "sched_getscheduler",
            "sched_getparam",
            "setpriority",
            "getpriority",
        ):
            monkeypatch.setattr(os, name, getattr(self, name))
        monkeypatch.setattr(
            os, "sched_param", lambda priority: SimpleNamespace(sched_priority=priority)
        )

    def sched_getscheduler(self, thread):
        return self.policy[0]

    def sched_getparam(self, thread):
        return SimpleNamespace(sched_priority=self.policy[1])

    def sched_setscheduler(self, thread, policy, param):
        self.calls.append((thread, policy, param.sched_priority))
        if not self._realtime or (policy == 0 and not self._clear):
            raise PermissionError(1, "Operation not permitted")
        self.policy = (policy, param.sched_priority)

    def getpriority(self, which, thread):
        return self.niceness

    def setpriority(self, which, thread, value):
        if value < self.niceness and not self._nice:
            raise PermissionError(13, "Permission denied")
        self.niceness = value


@linux
def test_real_time_priority_is_the_threads_own_and_put_back_from_another_thread(monkeypatch):
    fake, priority = FakeScheduler(monkeypatch, realtime=True, nice=True), TickPriority()
    ticks = threading.Thread(target=priority.begin)
    ticks.start()
    number = ticks.native_id
    ticks.join()
    assert fake.policy == (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, REALTIME)
    assert priority.granted == f"real-time priority {REALTIME} (SCHED_FIFO)"
    priority.begin()  # a second call changes nothing
    priority.end()
    priority.end()
    assert (
        fake.policy == (0, 0)
        and {call[0] for call in fake.calls} == {number}
        and len(fake.calls) == 2
    )


@linux
def test_nothing_granted_is_noted_and_ends_nothing(monkeypatch):
    fake, priority = FakeScheduler(monkeypatch, realtime=False, nice=False), TickPriority()
    priority.begin()
    assert priority.granted.startswith(
        "ordinary priority: the system grants no other priority, see rtprio and nice"
    )
    priority.end()
    assert fake.policy == (0, 0) and fake.niceness == 0


@linux
def test_the_system_itself_grants_it_or_not_and_a_child_does_not_inherit_it():
    """Whatever this person may: after it all is as it was."""
    before = os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
    priority = TickPriority()
    priority.begin()
    try:
        policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        assert (policy == os.SCHED_FIFO) == priority.granted.startswith("real-time")
        code = "import os; print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK)"
        child = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        assert int(child.stdout) == os.SCHED_OTHER
    finally:
        priority.end()
    assert (
        os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK,
        os.getpriority(os.PRIO_PROCESS, 0),
    ) == before


def test_a_system_without_such_calls_is_left_as_it_is(monkeypatch):
    monkeypatch.setattr(sys, "platform", "freebsd14")
    monkeypatch.delattr(os, "sched_setscheduler", raising=False)
    priority = TickPriority()
    priority.begin()
    priority.end()
    assert priority.granted == "ordinary priority: this system offers no other priority"
