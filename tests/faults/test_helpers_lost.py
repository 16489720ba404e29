"""Helper processes that are killed, stopped, or left behind by a killed run."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor

import numpy as np
import psutil
import pytest

from tissue import load_scene, simulate
from tissue.models.tooth import stress_process
from tissue.simulation.run_folder import SavedRun
from tissue.system import child
from tissue.system.child import Helper, HelperLostError
from tissue.system.offscreen import draw_apart
from tissue.system.workers import first_done, worker_pool

TOOTH = {
    "voxels.spacing_mm": 0.2,
    "stress.cell_mm": 0.8,
    "stress.interval_ms": 10.0,
    "motion.points_mm": [[0, 0, 0.0], [0, 0, -2]],
    "motion.feed_mm_s": 3.0,
    "duration_s": 0.1,
}
STOPS = pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="this system has no SIGSTOP")
ECHO = """
import pickle, sys, time
def main():
    while True:
        sent = pickle.load(sys.stdin.buffer)
        if isinstance(sent, str):
            if sent == "raise":
                sent = ValueError("no")
            while sent == "busy": pass
            if sent == "sleep":
                time.sleep(1000)
        pickle.dump(sent, sys.stdout.buffer); sys.stdout.buffer.flush()
main()
"""


def start_in(folder):
    """Return the start code of a child process that also finds the modules of a folder."""
    return f"import sys; sys.path.insert(0, {str(folder)!r}); {child.START}"


@pytest.fixture
def echo(tmp_path, monkeypatch):
    """A helper that answers what it is sent, or does not."""
    (tmp_path / "echoing.py").write_text(ECHO)
    monkeypatch.setattr("tissue.system.child.IDLE_S", 1.5)
    monkeypatch.setattr("tissue.system.child.CHECK_S", 0.25)
    monkeypatch.setattr("tissue.system.child.CHECK_S", 0.25)
    monkeypatch.setattr("tissue.system.child.START", start_in(tmp_path))
    helper = Helper("echoing", does="echoes")
    yield helper
    helper.kill()


def gone(number, within_s=20.0):
    """Return True if a process ends within the given time."""
    until = time.monotonic() + within_s
    while time.monotonic() < until:
        try:
            if psutil.Process(number).status() == psutil.STATUS_ZOMBIE:
                return True
        except psutil.NoSuchProcess:
            return True
        time.sleep(0.05)
    return False


@STOPS
def test_a_helper_that_is_stopped_is_given_up_and_sending_to_it_does_not_block(echo):
    echo.send(1)
    assert echo.receive(longest_s=60.0) == 1
    os.kill(echo.number, signal.SIGSTOP)
    echo.send(np.zeros(1_000_000))
    with pytest.raises(
        HelperLostError,
        match=r"the process that echoes was stopped and has done nothing for 1\.5 s",
    ):
        echo.receive(longest_s=60.0)
    assert gone(echo.number)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("does", "message"),
    [("sleep", "hangs and has done nothing for 1.5 s"), ("busy", "took longer than 2.5 s")],
)
def test_a_helper_that_hangs_or_works_for_ever_is_given_up(echo, does, message):
    echo.send(does)
    with pytest.raises(HelperLostError, match=f"the process that echoes {message}"):
        echo.receive(longest_s=2.5)
    assert gone(echo.number)


@pytest.mark.skipif(sys.platform == "win32", reason="no signals end a process on Windows")
def test_a_helper_that_is_killed_is_named_by_its_signal(echo):
    os.kill(echo.number, signal.SIGKILL)
    echo.send(1)
    with pytest.raises(
        HelperLostError,
        match=r"the process that echoes was ended by SIGKILL \(memory may have run out\)",
    ):
        echo.receive(longest_s=60.0)


@pytest.fixture(scope="module")
def plain():
    """The run that nothing disturbs."""
    return simulate(load_scene("molar", TOOTH))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "when"), [("SIGKILL", "begun"), ("SIGSTOP", "last")])
def test_a_run_that_loses_its_stress_keeps_all_else(plain, tmp_path, monkeypatch, name, when):
    """A run that loses its stress process keeps bone, trace and pictures unchanged.

    One sentence names the missing part.
    """
    if not hasattr(signal, name):
        pytest.skip(f"this system has no {name}")
    monkeypatch.setattr("tissue.system.child.IDLE_S", 2.0)
    begin, hit = stress_process.StressProcess.begin, []

    def hitting(self, state):
        begin(self, state)
        if not hit and state.time_s > (0.085 if when == "last" else 0.035):
            hit.append(self._helper.number)
            os.kill(self._helper.number, getattr(signal, name))

    monkeypatch.setattr(stress_process.StressProcess, "begin", hitting)
    out = tmp_path / "run"
    run = simulate(load_scene("molar", TOOTH), out=out)
    run.save(out, pictures=when == "begun" and name == "SIGKILL")
    assert gone(hit[0])
    saved = SavedRun(out)
    assert saved.complete and (out / "bone.stl").is_file()
    np.testing.assert_array_equal(saved.trace.rows, plain.trace.rows)
    np.testing.assert_array_equal(run.remaining, plain.remaining)
    message = [
        each["what"] for each in saved.summary["events"] if "solves the stress" in each["what"]
    ]
    how = (
        "was ended by SIGKILL" if name == "SIGKILL" else "was stopped and has done nothing for 2 s"
    )
    assert (
        len(message) == 1
        and how in message[0]
        and message[0].endswith("no stress and no frames. Everything else continues")
    )
    if (out / "pictures").is_dir():
        assert {"force_torque.png"} <= {each.name for each in (out / "pictures").iterdir()}


PARENT = """
import subprocess, sys, time
from tissue.system.child import child_command
pipe = subprocess.PIPE
child = subprocess.Popen(child_command("waiting"), stdin=pipe, start_new_session=True)
print(child.pid, flush=True)
time.sleep(1000)
"""
WAITING = "import subprocess, sys, time\nfrom tissue.system.child import child_command\n\
print(subprocess.Popen(child_command('sleeping')).pid, flush=True)\ntime.sleep(1000)\n"


@pytest.mark.parametrize("stopped", [False, True])
def test_a_killed_process_leaves_neither_helper_nor_its_helper(tmp_path, monkeypatch, stopped):
    if stopped and sys.platform != "linux":
        pytest.skip("only Linux ends a stopped process with the one that started it")
    (tmp_path / "sleeping.py").write_text("import time\ntime.sleep(1000)\n")
    code = f"import tissue.system.child; tissue.system.child.START = {start_in(tmp_path)!r}\n"
    (tmp_path / "waiting.py").write_text(code + WAITING)
    with subprocess.Popen(
        [sys.executable, "-c", code + PARENT], stdout=subprocess.PIPE, text=True
    ) as parent:
        numbers = [int(parent.stdout.readline()), int(parent.stdout.readline())]
        if stopped:
            os.kill(numbers[0], signal.SIGSTOP)
        parent.kill()
    assert all(gone(number) for number in numbers)


def stop_oneself(how):
    os.kill(os.getpid(), how)
    return "it went on"


@STOPS
@pytest.mark.parametrize("how", ["SIGSTOP", "SIGKILL"])
def test_a_worker_that_does_not_work_is_ended_and_reported(monkeypatch, how):
    monkeypatch.setattr("tissue.system.child.IDLE_S", 1.0)
    monkeypatch.setattr("tissue.system.workers.CHECK_S", 0.25)
    monkeypatch.setattr("tissue.system.child.CHECK_S", 0.25)
    message = []
    with pytest.raises(BrokenExecutor), worker_pool(1) as pool:
        assert first_done(pool, [pool.submit(abs, -3)], lambda *_: None).pop().result() == 3
        futures = [pool.submit(stop_oneself, getattr(signal, how)), pool.submit(abs, -4)]
        first_done(pool, futures, lambda doing, _: message.append(doing)).pop().result()
    assert message == (
        ["a worker was stopped and has done nothing for 1 s: it is ended"]
        if how == "SIGSTOP"
        else []
    )
    assert not multiprocessing.active_children()


@pytest.fixture
def drawing(tmp_path, monkeypatch):
    """Return a module that draws endlessly in one kind of window, and its process id's path."""
    (tmp_path / "drawing.py").write_text(
        "import os, sys, time\nfrom pathlib import "
        "Path\nPath(sys.argv[1]).write_text(str(os.getpid()))\n"
        "time.sleep(1000)\n"
    )
    start = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {child.START}"
    monkeypatch.setattr("tissue.system.child.START", start)
    monkeypatch.setattr("tissue.system.child.IDLE_S", 1.0)
    monkeypatch.setattr("tissue.system.child.CHECK_S", 0.25)
    monkeypatch.setattr("tissue.system.offscreen.CHECK_S", 0.25)
    monkeypatch.setattr("tissue.system.offscreen.drawing_environments", lambda: iter([{}]))
    return tmp_path / "number"


def number_in(path):
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        if path.exists() and (text := path.read_text()):
            return int(text)
        time.sleep(0.02)
    raise AssertionError("it did not start")


@STOPS
def test_a_drawing_that_hangs_is_given_up_in_a_sentence(drawing):
    message = draw_apart("drawing", str(drawing))
    assert message.startswith("drawing in 3D hangs and has done nothing for 1 s: ")
    assert not psutil.pid_exists(number_in(drawing))
