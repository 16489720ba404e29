"""What a run leaves on disk: its files, that it can be made again from them, and what a killed run leaves."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from tissue import InputError, SavedRun, load_scene, simulate
from tissue.run_folder import RunFolder
from tissue.trace import FLUSH_EVERY_S, read_table

COARSE = ("--set", "voxels.spacing_mm=0.4", "--no-pictures")
MAIN = [sys.executable, "-c", "from tissue.cli import main; main()"]
LOST_S = 0.2
"""Most of a killed run's wall time that may be missing from its trace."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder of a coarse glenoid run by the command."""
    out = tmp_path_factory.mktemp("runs") / "glenoid"
    arguments = ["run", "glenoid", *COARSE, "--set", "motion.feed_mm_s=5", "--duration-s", "0.6", "--out", str(out)]
    subprocess.run([*MAIN, *arguments, "--cores", "1"], check=True, capture_output=True)
    return out


def test_the_folder_holds_every_file(made):
    assert {entry.name for entry in made.iterdir()} == {
        "trace.csv",
        "timing.csv",
        "scene.toml",
        "summary.json",
        "bone.vti",
        "bone.nrrd",
        "bone.stl",
        "bone.vtp",
    }
    summary = json.loads((made / "summary.json").read_text())
    assert summary["status"] == "complete" and summary["scene"] == "glenoid"
    assert summary["simulated_s"] == pytest.approx(0.6)
    assert sum(summary["removed_mm3"].values()) > 100.0
    assert (made / "trace.csv").read_text().count("\n") == (made / "timing.csv").read_text().count("\n") == 601


@pytest.mark.parametrize("cores", [1, 2])
def test_a_run_is_made_again_bit_for_bit_on_any_number_of_cores(made, tmp_path, cores):
    """Threads are made to share every launch: of the coarse scene's, few are long enough by themselves."""
    split = "import kernels.launcher as l; l.SPLIT_ABOVE_S = 0.0; " if cores > 1 else ""
    again = [sys.executable, "-c", f"{split}from tissue.cli import main; main()"]
    arguments = ["run", str(made / "scene.toml"), "--no-pictures", "--out", str(tmp_path / "again")]
    subprocess.run([*again, *arguments, "--cores", str(cores)], check=True, capture_output=True)
    assert (tmp_path / "again" / "trace.csv").read_bytes() == (made / "trace.csv").read_bytes()
    assert (tmp_path / "again" / "scene.toml").read_bytes() == (made / "scene.toml").read_bytes()


def test_a_saved_run_reads_back(made):
    saved = SavedRun(made)
    assert saved.complete
    assert saved.trace.rows.shape[0] == 600
    assert saved.trace.layer_names == tuple(saved.summary["layers"])
    assert saved.summary["force_N"]["peak"] == pytest.approx(
        np.linalg.norm(saved.trace.vectors("model_force", "N"), axis=1).max(), rel=1e-12
    )


def test_a_folder_without_a_run_is_no_run(tmp_path):
    with pytest.raises(InputError, match="run must be a folder that `tissue run` wrote"):
        SavedRun(tmp_path)
    for text in ("", "[]", "{}", "nonsense"):
        (tmp_path / "summary.json").write_text(text)
        with pytest.raises(InputError, match="run must be a folder that `tissue run` wrote"):
            SavedRun(tmp_path)


def test_a_runs_own_trace_replays_it(tmp_path):
    scene = load_scene("milling", {"voxels.spacing_mm": 0.4, "motion.feed_mm_s": 50.0, "duration_s": 0.809})
    first = simulate(scene, out=tmp_path / "first")
    first.save(tmp_path / "first", pictures=False)
    table = str(tmp_path / "first" / "trace.csv")
    again = simulate(load_scene(tmp_path / "first" / "scene.toml", {"motion.kind": "replay", "motion.file": table}))
    assert again.parts.volume.shape == first.parts.volume.shape
    # Poses go through mm and back: a few roundings of 5 mm. Velocities are differences of poses, 1e-18 m in steps of
    # 5e-5 m. No element of this cutter lies so close to a voxel's face that such a rounding takes it across.
    for name in ("tool_x_mm", "tool_y_mm", "tool_z_mm"):
        np.testing.assert_allclose(again.trace[name], first.trace[name], atol=1e-14)
    total = sum(first.summary()["removed_mm3"].values())
    assert total > 5.0
    assert sum(again.summary()["removed_mm3"].values()) == pytest.approx(total, rel=1e-9)
    peak = first.summary()["force_N"]["peak"]
    for kind in ("model_force", "force"):
        moved = again.trace.vectors(kind, "N") - first.trace.vectors(kind, "N")
        assert np.abs(moved).max() < 1e-9 * peak


@pytest.fixture
def start():
    """Start a run in a process of its own, which does not outlive the test; it heeds SIGINT wherever this one runs."""
    started = []
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "

    def begin(*arguments):
        command = [sys.executable, "-c", heeding + MAIN[2], *arguments]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield begin
    for process in started:
        process.kill()
        process.communicate()


def wait_for_rows(path, process, least):
    """Wait until the trace has grown past its ``least`` rows."""
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        if path.is_file() and path.read_bytes().count(b"\n") > least:
            return
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.005)
    raise AssertionError(f"{path} did not grow")


@pytest.fixture
def killed(tmp_path, start):
    """Folder of a milling run killed in its middle, and the wall time from its last growth to its end [s]."""
    out = tmp_path / "milling"
    process = start("run", "milling", "--no-pictures", "--duration-s", "600", "--out", str(out), "--cores", "1")
    wait_for_rows(out / "trace.csv", process, 500)
    time.sleep(0.35)
    os.kill(process.pid, signal.SIGKILL)
    ended = time.time()
    process.wait()
    return out, ended - (out / "trace.csv").stat().st_mtime


def test_a_killed_run_loses_less_than_a_fifth_of_a_second(killed):
    """The rest of the time since its last flush is what it lost: it ran without pause."""
    folder, lost_s = killed
    assert FLUSH_EVERY_S < LOST_S
    assert -0.05 < lost_s < LOST_S  # clocks of the file system tick every 10 ms or less
    saved = SavedRun(folder)
    assert not saved.complete and saved.summary["status"] == "running"
    ticks = len(saved.trace.rows)
    assert ticks > 500
    np.testing.assert_allclose(saved.trace["time_s"], 1e-3 * np.arange(ticks), rtol=1e-12)
    timing = read_table(folder / "timing.csv", ())
    assert abs(len(timing.rows) - ticks) <= FLUSH_EVERY_S / np.median(timing["tick_us"]) * 2e6
    assert load_scene(folder / "scene.toml").name == "milling"


def test_a_killed_run_is_still_a_run(killed, refused, command):
    folder, _ = killed
    before = {entry.name: entry.read_bytes() for entry in folder.iterdir()}
    assert refused("run", "milling", *COARSE, "--out", folder) == (
        f"out must not hold another run, got {folder}: pass --overwrite to replace it or choose another --out"
    )
    assert {entry.name: entry.read_bytes() for entry in folder.iterdir()} == before
    from tissue.view import _about

    assert _about(SavedRun(folder)).startswith("run is incomplete: it stopped at ")
    code, _, error = command("run", "milling", *COARSE, "--duration-s", 0.01, "--out", folder, "--overwrite")
    assert (code, error) == (0, "")
    assert SavedRun(folder).complete


def test_an_interrupted_run_keeps_its_trace_and_says_one_line(tmp_path, start):
    out = tmp_path / "milling"
    process = start("run", "milling", *COARSE, "--duration-s", "600", "--out", str(out))
    wait_for_rows(out / "trace.csv", process, 100)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert said == "stopped: what was written so far is kept, see `tissue view`\n"
    saved = SavedRun(out)
    assert not saved.complete
    assert len(saved.trace.rows) > 100


def test_a_run_killed_before_its_first_row_reads_back(tmp_path):
    folder = RunFolder.begin(tmp_path / "run", load_scene("milling"), overwrite=False)
    assert SavedRun(folder.path).trace is None
    (folder.path / "trace.csv").touch()
    assert len(SavedRun(folder.path).trace.rows) == 0


def test_saving_twice_or_elsewhere_writes_the_same_files(tmp_path):
    run = simulate(load_scene("milling", {"voxels.spacing_mm": 0.4, "duration_s": 0.05}))
    for name in ("one", "two"):
        run.save(tmp_path / name, pictures=False, formats=["npz"])
    run.save(tmp_path / "two", pictures=False, overwrite=True)
    with pytest.raises(InputError, match="out must not hold another run"):
        run.save(tmp_path / "one", pictures=False)
    for name in ("trace.csv", "timing.csv", "scene.toml", "bone.stl"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert (tmp_path / "one" / "trace.npz").is_file() and not (tmp_path / "two" / "trace.npz").exists()
