"""Process that runs next to the ticks.

It lowers its priority, raises it when its result is awaited, and does not fail where it cannot.
"""

import os
import subprocess
import sys

import pytest

from kernels.cores import allowed_cores, cores_without, current_core
from tissue.system import priorities
from tissue.system.child import Helper
from tissue.system.priorities import LOWEST, BackgroundPriority, may_return_from_idle

pytestmark = pytest.mark.skipif(
    not hasattr(os, "SCHED_IDLE"), reason="the system has no idle priority"
)


@pytest.fixture
def child():
    """Another process, which waits."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        yield process
        process.kill()


def test_it_steps_back_and_hurries(child, monkeypatch):
    if not may_return_from_idle():
        pytest.skip("no thread may leave the idle priority here")
    allowed = allowed_cores()
    core = current_core()
    monkeypatch.setattr(priorities, "current_core", lambda: core)
    priority = BackgroundPriority(child.pid)
    for _ in range(2):
        priority.step_back()
        assert os.sched_getscheduler(child.pid) == os.SCHED_IDLE
        assert os.sched_getaffinity(child.pid) == cores_without(core, allowed)
        priority.hurry()
        assert os.sched_getscheduler(child.pid) == os.SCHED_OTHER
        assert os.sched_getaffinity(child.pid) == allowed
    assert "idle priority" in priority.described


def test_where_it_could_not_hurry_again_it_has_the_lowest_ordinary_priority(child):
    priority = BackgroundPriority(child.pid, returns=False)
    for _ in range(2):
        priority.step_back()
        assert os.sched_getscheduler(child.pid) == os.SCHED_OTHER
        assert os.getpriority(os.PRIO_PROCESS, child.pid) == LOWEST
        priority.hurry()
    assert str(LOWEST) in priority.described


def test_a_helper_has_one_thread_for_linear_algebra_and_a_group_of_its_own(tmp_path, monkeypatch):
    """Ctrl-C does not reach its group; in this session its priority counts against this process."""
    code = (
        "import os, pickle, sys; names = ['OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', "
        "'MKL_NUM_THREADS']\n"
    )
    code += (
        "pickle.dump([[os.environ[name] for name in names], os.getpgid(0), os.getsid(0)], "
        "sys.stdout.buffer)\n"
    )
    (tmp_path / "answering.py").write_text(code + "sys.stdout.flush(); input()\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    helper = Helper("answering", does="answers")
    try:
        threads, group, session = helper.receive(longest_s=60.0)
        assert threads == ["1", "1", "1"]
        assert group == helper.number != os.getpgid(0) and session == os.getsid(0)
    finally:
        helper.kill()


def test_a_helper_whose_priority_cannot_be_imported_starts_no_process(monkeypatch):
    started = []
    monkeypatch.setitem(sys.modules, "tissue.system.priorities", None)
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: started.append(True))
    with pytest.raises(ImportError):
        Helper("tissue.nowhere", does="waits")
    assert not started
