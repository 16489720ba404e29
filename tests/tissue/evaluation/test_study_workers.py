"""A study on real workers: the same table whatever runs it, killed and interrupted as it may be."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest

from tissue.evaluation.study.folder import StudyFolder, run_study
from tissue.evaluation.study.plan import Plan

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL"),
]
ROOT = Path(__file__).resolve().parents[3]
PLAN = Plan(trials=3, tasks=("drilling", "T2"), methods=("penalty",), sensitivity=False)
COMMAND = (
    *(
        sys.executable,
        "-c",
        "from tissue.cli.main import main; main()",
        "study",
        "run",
        "--trials",
        "3",
        "--tasks",
    ),
    *("drilling,T2", "--methods", "penalty", "--no-sensitivity", "--workers", "2", "--out"),
)
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}


def tables(out):
    return [(out / name).read_bytes() for name in ("trials.csv", "drilling.csv")]


def kept(out):
    return sorted((out / "trials").glob("*.json"))


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The study on one worker."""
    out = tmp_path_factory.mktemp("alone") / "study"
    assert run_study(PLAN, out, workers=1).table("T2").failed == 0
    return out


@pytest.mark.parametrize("workers", [2, 4])
def test_the_table_does_not_depend_on_the_workers(tmp_path, alone, workers):
    run_study(PLAN, tmp_path / "study", workers=workers)
    assert tables(tmp_path / "study") == tables(alone)


@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_killed_study_goes_on(tmp_path, alone, name):
    """A killed study continues.

    Killed at its third trial, its workers end with it, its results are kept, and nothing is done
    twice.
    """
    out, blow = tmp_path / "study", getattr(signal, name)
    with subprocess.Popen(
        (*COMMAND, str(out)), env=ENVIRONMENT, stderr=subprocess.PIPE, text=True
    ) as study:
        wait_for(lambda: len(kept(out)) >= 3)
        workers = children(study.pid)
        study.send_signal(blow)
        message = study.stderr.read()
    assert workers and study.returncode == (130 if name == "SIGINT" else -blow), message
    assert "Traceback" not in message
    wait_for(lambda: not any(psutil.pid_exists(each) for each in workers))
    had = {each.name: each.stat().st_mtime_ns for each in kept(out)}
    assert 3 <= len(had) < len(list(PLAN.all_trials()))
    assert (
        subprocess.run(
            (*COMMAND, str(out)), env=ENVIRONMENT, capture_output=True, check=False
        ).returncode
        == 0
    )
    assert {name: (out / "trials" / name).stat().st_mtime_ns for name in had} == had
    assert tables(out) == tables(alone)


def test_a_killed_worker_is_replaced(tmp_path, alone):
    reported = []

    def report(doing, share):
        reported.append(doing)
        if len(reported) == 2:
            os.kill(children(os.getpid(), "spawn_main")[0], signal.SIGKILL)

    run_study(PLAN, tmp_path / "study", workers=2, report=report)
    assert any("workers were lost" in each for each in reported)
    assert tables(tmp_path / "study") == tables(alone)


def test_dask_gives_the_same_table(tmp_path, alone):
    """Dask gives the same table.

    One of three workers is killed in mid-study, then the scheduler, which comes back with new
    workers.
    """
    pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install 'tissue-sim[cluster]'"
    )
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    out, reported, failed = tmp_path / "study", [], []

    def study():
        try:
            run_study(
                PLAN,
                out,
                workers=2,
                scheduler=f"dask://127.0.0.1:{port}",
                report=lambda *given: reported.append(given),
            )
        except BaseException as error:
            failed.append(error)

    with cluster(port, tmp_path / "first") as (scheduler, workers):
        thread = threading.Thread(target=study, daemon=True)
        thread.start()
        wait_for(lambda: len(kept(out)) >= 3 or failed)
        workers[0].kill()
        wait_for(lambda: len(kept(out)) >= 6 or failed)
        scheduler.kill()
        had = len(kept(out))
    with cluster(port, tmp_path / "second"):
        while thread.is_alive():  # as long as trials come: how fast they do is the machine's affair
            at = len(kept(out))
            wait_for(lambda at=at: len(kept(out)) > at or not thread.is_alive())
    assert not failed, failed
    assert had < len(list(PLAN.all_trials()))
    assert any("workers were lost" in doing for doing, _ in reported)
    assert tables(out) == tables(alone)
    assert len(StudyFolder(out).table("T2")) == 9


@contextmanager
def cluster(port, folder):
    """A Dask scheduler and three workers, each a process of its own."""
    folder.mkdir()
    common = {
        "env": ENVIRONMENT,
        "cwd": folder,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
    }
    dask = (sys.executable, "-m", "dask")
    options = ("--no-dashboard", "--host", "127.0.0.1")
    scheduler = subprocess.Popen((*dask, "scheduler", *options, "--port", str(port)), **common)
    worker = (*dask, "worker", f"tcp://127.0.0.1:{port}", "--nthreads", "1", "--no-nanny", *options)
    workers = [subprocess.Popen(worker, **common) for _ in range(3)]
    try:
        yield scheduler, workers
    finally:
        for each in (scheduler, *workers):
            each.kill()
            each.wait()


def children(parent, named=""):
    """Numbers of the worker processes of a process."""
    found = []
    for process in psutil.Process(parent).children():
        with suppress(psutil.Error):
            line = " ".join(process.cmdline())
            if "spawn_main" in line and named in line:
                found.append(process.pid)
    return sorted(found)


def wait_for(condition, seconds=120.0):
    """Wait until something is so."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
