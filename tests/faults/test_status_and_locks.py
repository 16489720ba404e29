"""Status and locks of runs.

The status is reported truly whatever ended the run, and two processes never write one output.
"""

import json
import os
import signal
import subprocess
import sys

import psutil
import pytest

from tissue import InputError, load_scene, simulate
from tissue.scene.anatomy import BoneSurface
from tissue.show.viewer.view import _about
from tissue.simulation.run_folder import RunFolder, SavedRun
from tissue.simulation.simulate import RunObserver
from tissue.system.owned_folder import OutputLock, identity, is_alive
from tissue.system.stopping import Terminated, terminated_as_exception

QUICK = {"voxels.spacing_mm": 0.8, "duration_s": 0.02}
HOLD = "import sys; from pathlib import Path; from tissue.system.owned_folder import OutputLock; \
held = OutputLock(Path(sys.argv[1]), folder=sys.argv[2] == 'folder'); print('held', flush=True); sys.stdin.read()"


@pytest.fixture
def holder():
    """Start a process that holds an output; it ends with the test."""
    started = []

    def begin(path, kind):
        pipe = subprocess.PIPE
        process = subprocess.Popen(
            [sys.executable, "-c", HOLD, str(path), kind], stdin=pipe, stdout=pipe, text=True
        )
        started.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield begin
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_a_second_process_is_kept_off_and_the_owner_is_named(tmp_path, holder, kind):
    out = tmp_path / "deep" / "out"
    if kind == "file":
        out.parent.mkdir()
    process = holder(out, kind)
    for _ in range(2):  # the first refusal must not take the number away
        with pytest.raises(
            InputError, match=f"which process {process.pid} is writing. Wait for that process"
        ):
            OutputLock(out, folder=kind == "folder")
    process.kill()
    process.wait()
    with OutputLock(out, folder=kind == "folder"):
        pass
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_run_is_kept_out_of_a_folder_that_another_writes(tmp_path, holder, refused, overwrite):
    out = tmp_path / "run"
    process = holder(out, "folder")
    message = refused("run", "milling", "--out", out, *(["--overwrite"] if overwrite else []))
    assert message == (
        f"out must have one writer at a time, got {out}, which process {process.pid} is "
        "writing. Wait for that process, end it, "
        "or choose another --out"
    )
    assert [each.name for each in out.iterdir()] == [".lock"]


def test_a_process_is_known_by_more_than_its_number():
    me = identity()
    assert is_alive(me)
    assert not is_alive(me | {"started_s": me["started_s"] - 60.0}), "a number that was given again"
    assert is_alive(me | {"machine": "elsewhere", "id": 2**30}), (
        "one of another machine cannot be looked for"
    )
    assert not is_alive(me | {"id": 2**30}) and not is_alive({}) and not is_alive(None)
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    other = me | {"id": child.pid, "started_s": psutil.Process(child.pid).create_time()}
    assert is_alive(other)
    child.kill()
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT) if hasattr(
        os, "waitid"
    ) else child.wait()
    assert not is_alive(other), "a zombie runs no longer"
    child.communicate()


def test_a_run_is_running_complete_failed_or_interrupted(tmp_path):
    out = tmp_path / "run"
    folder = RunFolder(out, overwrite=False)
    folder.begin(load_scene("milling"))
    saved = SavedRun(out)
    assert (saved.status, saved.complete) == ("running", False)
    assert (
        f"is running before its first tick was written, process {os.getpid()} writes it"
        in _about(saved)
    )
    held = json.loads((out / "summary.json").read_text())
    held["process"]["started_s"] -= 1000.0
    (out / "summary.json").write_text(json.dumps(held))
    assert SavedRun(out).status == "interrupted"
    with pytest.raises(ZeroDivisionError), folder.ending():
        raise ZeroDivisionError("over\nnothing")
    saved = SavedRun(out)
    assert (saved.status, saved.problem) == ("failed", "ZeroDivisionError: over nothing")
    about = _about(saved)
    assert about.startswith("run is incomplete: it failed before its first tick")
    assert "The tissue is not shown" not in about
    anatomy = BoneSurface(file="bone.ply")
    saved.scene = saved.scene.model_copy(update={"anatomy": anatomy})
    assert _about(saved).startswith(about) and "The tissue is not shown" in _about(saved)
    assert not (out / ".lock").exists()


@pytest.mark.parametrize("stopped", [True, False])
def test_an_error_after_a_stop_signal_is_an_interruption(stopped, tmp_path):
    """Native code converts the exception of a signal, as VTK does during its import."""
    out = tmp_path / "run"
    folder = RunFolder(out, overwrite=False)
    folder.begin(load_scene("milling"))
    with (
        pytest.raises(Terminated if stopped else ImportError),
        terminated_as_exception(),
        folder.ending(),
    ):
        try:
            if stopped:
                signal.raise_signal(signal.SIGTERM)
        finally:
            raise ImportError("no module vtk")
    expected = ("interrupted", "SIGTERM") if stopped else ("failed", "ImportError: no module vtk")
    saved = SavedRun(out)
    assert (saved.status, saved.problem) == expected


@pytest.mark.parametrize(
    ("error", "status", "problem"),
    [
        (KeyboardInterrupt(), "interrupted", "Ctrl-C"),
        (Terminated(), "interrupted", "SIGTERM"),
        (InputError("device must answer"), "failed", "device must answer"),
        (MemoryError("no more"), "failed", "MemoryError: no more"),
    ],
)
@pytest.mark.parametrize("when", ["ticks", "saving"])
def test_what_ends_a_run_is_in_its_summary_and_its_trace_is_kept(
    tmp_path, monkeypatch, error, status, problem, when
):
    class Ends(RunObserver):
        def before_tick(self, index):
            if index == 7 and when == "ticks":
                raise error

    def fail(*_):
        raise error

    out = tmp_path / "run"
    scene = load_scene("milling", QUICK)
    monkeypatch.setattr("tissue.simulation.bone_files.write_bone", fail)
    with pytest.raises(type(error)):
        simulate(scene, out=out, on_tick=Ends()).save(out, pictures=False)
    saved = SavedRun(out)
    assert (saved.status, saved.problem) == (status, problem)
    assert len(saved.trace.rows) == (7 if when == "ticks" else 20)
    assert not (out / ".lock").exists()
    if not isinstance(error, Terminated):
        return
    monkeypatch.undo()
    simulate(scene, out=out, overwrite=True).save(out, pictures=False)
    assert SavedRun(out).status == "complete" and "process" not in SavedRun(out).summary


@pytest.mark.parametrize(
    ("kind", "command_line"),
    [
        ("folder", ["study", "run", "--trials", "1", "--tasks", "T2"]),
        ("folder", ["chart", "milling", "--quick", "--overwrite"]),
        ("folder", ["chart", "prediction", "wall", "--overwrite"]),
        ("folder", ["stability", "--only", "locking", "--overwrite"]),
        ("file.json", ["calibrate", "--observer", "simulated:1", "--overwrite"]),
        ("file.npz", ["train", "wall", "--overwrite"]),
    ],
    ids=lambda value: "-".join(value[:2]) if isinstance(value, list) else value,
)
def test_no_command_writes_what_another_process_writes(tmp_path, refused, kind, command_line):
    out = tmp_path / kind
    with OutputLock(out, folder=kind == "folder"):
        before = sorted(each.relative_to(tmp_path) for each in tmp_path.rglob("*"))
        message = refused(*command_line, "--out", out)
        assert message.startswith(
            f"out must have one writer at a time, got {out}, which process {os.getpid()} is writing"
        )
        assert sorted(each.relative_to(tmp_path) for each in tmp_path.rglob("*")) == before
