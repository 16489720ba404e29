"""Workers and drawing processes that are killed or stopped, and a Ctrl-C during drawing."""

import multiprocessing
import os
import signal
import sys
import threading
import time
from concurrent.futures import BrokenExecutor

import psutil
import pytest

from tissue.system import child, offscreen
from tissue.system.offscreen import draw_apart, end_drawing
from tissue.system.workers import first_done, worker_pool

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="this system has no SIGSTOP")


def stop_oneself(how):
    os.kill(os.getpid(), how)
    return "it went on"


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
    monkeypatch.setattr("tissue.system.offscreen._windows", lambda: iter([""]))
    return tmp_path / "number"


def number_in(path):
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        if path.exists() and (text := path.read_text()):
            return int(text)
        time.sleep(0.02)
    raise AssertionError("it did not start")


def test_a_drawing_that_hangs_is_given_up_in_a_sentence(drawing):
    message = draw_apart("drawing", str(drawing))
    assert message.startswith("drawing in 3D hangs and has done nothing for 1 s: ")
    assert not psutil.pid_exists(number_in(drawing))


def test_a_drawing_in_another_thread_ends_on_request(drawing, monkeypatch):
    monkeypatch.setattr("tissue.system.child.IDLE_S", 600.0)
    message = []
    thread = threading.Thread(target=lambda: message.append(draw_apart("drawing", str(drawing))))
    thread.start()
    number = number_in(drawing)
    end_drawing()
    thread.join(20.0)
    assert message == ["drawing was stopped"] and not psutil.pid_exists(number)
    assert not offscreen._drawing


def test_an_exception_during_a_drawing_does_not_wait_for_it(drawing, monkeypatch):
    from tissue.show.figures import _background

    monkeypatch.setattr("tissue.system.child.IDLE_S", 600.0)
    with pytest.raises(KeyboardInterrupt), _background() as thread:
        thread.submit(draw_apart, "drawing", str(drawing))
        number_in(drawing)
        raise KeyboardInterrupt
    assert not psutil.pid_exists(number_in(drawing)) or sys.platform == "win32"
