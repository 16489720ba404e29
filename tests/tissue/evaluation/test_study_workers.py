"""A study on real workers: interrupted, with a killed worker, and on Dask."""

import os
import signal
import socket
import subprocess
import sys
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
PLAN = Plan(
    trials=3,
    tasks=("T2",),
    groups=("novice",),
    methods=("penalty",),
)
"""Three trials, on two workers."""
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}


def tables(out):
    return (out / "trials.csv").read_bytes()


def kept(out):
    return sorted((out / "trials").glob("*.json"))


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The study on one worker."""
    out = tmp_path_factory.mktemp("alone") / "study"
    assert run_study(PLAN, out, workers=1).table("T2").failed == 0
    return out


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
    """Dask gives the same table, although one of three workers is killed in mid-study."""
    pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install distributed"
    )
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    out = tmp_path / "study"
    with cluster(port, tmp_path / "cluster") as workers:

        def report(doing, share):
            if len(kept(out)) == 1:
                workers[0].kill()

        run_study(PLAN, out, workers=2, scheduler=f"dask://127.0.0.1:{port}", report=report)
    assert tables(out) == tables(alone)
    assert len(StudyFolder(out).table("T2")) == 3


@contextmanager
def cluster(port, folder):
    """Start a Dask scheduler and three workers; yield the processes of the workers."""
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
        yield workers
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
