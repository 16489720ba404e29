"""Runs against the wall clock: the laws of the clock, shared arrays, runs without a display, and the mouse."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tissue import InputError, load_scene, simulate
from tissue.haptics.device.recorded import MouseDevice
from tissue.simulation.live.clock import WallClock
from tissue.simulation.live.run import LiveObserver, moved_by
from tissue.simulation.live.run import live as run_live
from tissue.simulation.live.shared import SharedArrays
from tissue.simulation.live.tissues import TURN_TICKS, BoneShared
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.simulate import TICK_S
from tissue.system.offscreen import await_display, display_problem

ROOT = Path(__file__).parents[3]
STEP_S = 1e-3
HALF = {"duration_s": 0.5}


class FakeTime:
    """A clock that goes on by a microsecond a look, and a sleep that ends late."""

    def __init__(self, oversleeps_s=6e-5):
        self.s, self._over = 100.0, oversleeps_s

    def now(self):
        self.s += 1e-6
        return self.s

    def rest(self, seconds):
        self.s += seconds + self._over


def paced(costs_s, **options):
    """Starts of ticks after the first [s], lateness and skips [s], for ticks that take so long."""
    fake = FakeTime(**{k: v for k, v in options.items() if k == "oversleeps_s"})
    clock = WallClock(STEP_S, now=fake.now, rest=fake.rest)
    rows = []
    for index, cost in enumerate(costs_s):
        clock.wait(index)
        rows.append((fake.s, clock.late_s, clock.skipped_s))
        fake.s += cost
    starts, late, skipped = np.array(rows).T
    return starts - starts[0], late, skipped


def test_a_paced_run_does_not_drift():
    rng = np.random.default_rng(1)
    starts, late, skipped = paced(rng.uniform(1e-4, 8e-4, 3000))
    # The last tick begins when it is due: a schedule that added up sleeps would be 3000 times their 60 us late.
    np.testing.assert_allclose(starts, STEP_S * np.arange(3000), atol=3e-6)  # looks at the clock take 1 us
    assert late.max() < 3e-6 and not skipped.any()


def test_a_sleep_that_ends_too_late_is_lateness_and_is_made_up():
    starts, late, _ = paced(np.full(100, 1e-4), oversleeps_s=4e-4)
    assert np.median(late) == pytest.approx(2.5e-4, abs=5e-6)  # 0.4 ms over, less the 0.15 ms before it is due
    assert starts[-1] == pytest.approx(99 * STEP_S, abs=5e-4)


def test_one_long_tick_makes_the_next_ones_late_and_then_it_is_on_time_again():
    costs = np.full(60, 2e-4)
    costs[10] = 5e-3
    starts, late, skipped = paced(costs)
    assert late[11] == pytest.approx(4e-3, abs=1e-5) and late[12] == pytest.approx(3.2e-3, abs=1e-5)
    assert (late[11:16] > 1e-4).all() and (late[17:] < 5e-6).all()
    assert not skipped.any() and starts[-1] == pytest.approx(59 * STEP_S, abs=5e-6)


@pytest.mark.parametrize("cost_s", [1.3e-3, 2.5e-3, 0.05])
def test_a_run_that_cannot_keep_up_skips_on_the_wall_and_counts_it(cost_s):
    starts, late, skipped = paced(np.full(400, cost_s))
    # No tick is left out and none is stretched: what the wall has more than the schedule is what was skipped.
    assert starts[-1] == pytest.approx(399 * cost_s, rel=1e-3)
    assert starts[-1] - 399 * STEP_S == pytest.approx(skipped.sum() + late[-1] * (skipped[-1] == 0.0), abs=1e-4)
    assert late.max() < 0.01 + cost_s and (late[skipped > 0.0] > 0.01).all()


def test_an_unfinished_write_is_never_read(tmp_path):
    """Another process writes rows of one number each; whoever reads a mixed one has read a torn one."""
    layout = {"row": ("float64", (2000,)), "row_turn": ("int64", (1,)), "end": ("int64", (1,))}
    ours = SharedArrays(tmp_path, layout)
    writer = (
        "import sys, time, numpy as np; from pathlib import Path; from tissue.simulation.live.shared import SharedArrays\n"
        "arrays = SharedArrays(Path(sys.argv[1]))\n"
        "number = 0.0\n"
        "while not arrays['end'][0]:\n    number += 1.0; arrays.write('row', np.full(2000, number)); time.sleep(1e-4)\n"
    )
    with subprocess.Popen([sys.executable, "-c", writer, str(tmp_path)], env=os.environ | {"PYTHONPATH": str(ROOT)}):
        seen = set()
        limit = time.perf_counter() + 60.0
        while len(seen) < 50 and time.perf_counter() < limit:
            if (message := ours.read("row")) is not None:
                assert (message[1] == message[1][0]).all()
                seen.add(message[1][0])
            if not seen:
                time.sleep(1e-3)  # it has not begun
        ours["end"][0] = 1
    assert len(seen) == 50


def test_a_writer_that_died_in_the_middle_stops_nobody(tmp_path):
    arrays = SharedArrays(tmp_path, {"row": ("float64", (3,)), "row_turn": ("int64", (1,))})
    arrays.write("row", np.ones(3))
    assert arrays.read("row")[0] == 1
    arrays["row_turn"][0] += 1
    assert arrays.read("row") is None


def test_every_brick_is_copied_once_a_turn(tmp_path):
    run = simulate(load_scene("milling", {"voxels.spacing_mm": 0.4, "duration_s": 0.05}))
    milling = run.parts.tissue
    shared = BoneShared(milling, run.volume)
    arrays = SharedArrays(tmp_path, shared.layout)
    shared.publish(arrays, 0)
    left = milling.store.remaining.numpy()
    np.testing.assert_array_equal(arrays["remaining"], left)
    left //= 2
    for index in range(1, TURN_TICKS):
        shared.publish(arrays, index)
    assert (arrays["remaining"] != left).any()
    shared.publish(arrays, TURN_TICKS)
    np.testing.assert_array_equal(arrays["remaining"], left)


@pytest.fixture
def no_display(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: "there is no display")


@pytest.mark.parametrize("device", ["touch", "none"])
def test_without_a_display_the_script_runs_and_gives_the_same_rows(no_display, device):
    scene = load_scene("wall", HALF | {"device": device})
    begun = time.perf_counter()
    run = run_live(scene)
    assert time.perf_counter() - begun > 0.5
    np.testing.assert_array_equal(run.trace.rows, simulate(scene).trace.rows)
    summary = run.summary()
    late, took = run.timing["late_us"], run.timing["tick_us"]
    assert summary["missed_deadlines"] == (late + took > 1000.0).sum()
    assert summary["late_us"]["max"] == late.max() >= 0.0
    assert summary["skipped_ms"] == pytest.approx(1e-3 * run.timing["skipped_us"].sum())
    mover = "a simulated expert moves it" if device == "touch" else "the scripted motion moves the tool"
    assert summary["notes"]["live"] == f"no window, for there is no display: {mover}"
    reported = any("the clock skips from here" in what for _, what in run.events)
    assert reported == (summary["skipped_ms"] > 0.0)


def test_the_command_runs_live_without_a_display(no_display, command, here):
    code, output, _ = command("run", "wall", "--live", "--duration-s", "0.3", "--no-pictures", "--out", "run")
    assert code == 0
    assert output.startswith("live: no window, for there is no display: a simulated expert moves it; Ctrl-C ends it")
    assert "delay of ticks, median / 99 % / max" in output and "wall clock skipped" in output
    saved = SavedRun(here / "run")
    assert saved.complete and len(saved.trace.rows) == 300
    timing = np.loadtxt(here / "run" / "timing.csv", delimiter=",", skiprows=1)
    assert timing.shape == (300, 8)
    assert saved.summary["missed_deadlines"] == (timing[:, 0] + timing[:, 6] > 1000.0).sum()


def test_ctrl_c_ends_a_live_run_that_is_whole(tmp_path):
    """The run ends after its tick, is saved like any other, and exits well."""
    code = "from tissue.cli.main import main; main()"
    arguments = ["run", "wall", "--live", "--duration-s", "600", "--no-pictures", "--out", str(tmp_path / "run")]
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"PYTHONPATH": str(ROOT)}
    trace = tmp_path / "run" / "trace.csv"
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments], env=environment, stdout=subprocess.PIPE, text=True
    ) as process:
        limit = time.perf_counter() + 100.0
        while time.perf_counter() < limit and not (trace.is_file() and trace.stat().st_size > 20_000):
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=100.0)
    assert process.returncode == 0, output
    saved = SavedRun(tmp_path / "run")
    assert saved.complete and 10 < len(saved.trace.rows) < 600_000
    assert saved.summary["simulated_s"] == pytest.approx(1e-3 * len(saved.trace.rows))
    whole = simulate(load_scene("wall", {"duration_s": 1e-3 * len(saved.trace.rows)}))
    np.testing.assert_array_equal(saved.trace.rows, whole.trace.rows)


class FakeWindow:
    """A window whose pointer goes 8 mm down at once, and that is closed after 600 ticks."""

    def __init__(self, scene, parts, columns, *, low_m, high_m):
        self.closed, self.box, self.shown, self._announced = False, (low_m, high_m), 0, False

    @property
    def frames(self):
        return self.shown

    def pointed_m(self):
        if self._announced:
            return None
        self._announced = True
        return (0.0, 0.0, -2e-3)

    def show(self, index, row, clock):
        self.shown += 1
        self.closed = index >= 599

    def failed(self):
        return None

    def end(self):
        pass


@pytest.mark.parametrize("device", ["touch", "none"])
def test_a_mouse_moves_the_tool_on_the_devices_spring_until_the_window_is_closed(monkeypatch, device):
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: None)
    monkeypatch.setattr("tissue.simulation.live.run.WindowProcess", FakeWindow)
    run = run_live(load_scene("wall", {"device": device, "anatomy.stiffness_kN_m": 40.0}))
    assert len(run.trace.rows) == 600 and run.scene.device == "touch"
    assert run.trace["device_z_mm"][-1] == pytest.approx(-2.0, abs=0.01)
    # 400 N/m in series with the wall: 2 mm x (1/400 + 1/40000)^-1.
    assert run.trace["model_force_z_N"][-1] == pytest.approx(2e-3 / (1.0 / 400.0 + 1.0 / 4e4), rel=0.01)
    assert run.trace["device_force_z_N"][-1] == pytest.approx(run.trace["model_force_z_N"][-1], rel=0.02)
    assert run.parts.notes["live"].startswith("the mouse moves the tool in a window")


def test_a_window_that_fails_ends_the_run_and_is_reported(monkeypatch):
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: None)
    monkeypatch.setattr(FakeWindow, "failed", lambda self: "X Error")
    monkeypatch.setattr("tissue.simulation.live.run.WindowProcess", FakeWindow)
    run = run_live(load_scene("wall"))
    assert len(run.trace.rows) < 600
    assert run.events[-1][1] == "the window ended by itself, and the run with it: X Error"


def test_what_moves_the_tool_is_reported_before_it_runs(monkeypatch):
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: "libGL is missing (install libgl1)")
    assert moved_by(load_scene("wall", {"hand": "novice"})) == (
        False,
        "no window, for libGL is missing (install libgl1): a simulated novice moves it",
    )


@pytest.fixture
def stalled(monkeypatch):
    """A window that draws nothing after its first 200 ticks, until a time on the clock."""
    until = []

    def frames(self):
        if self.shown > 200 and not until:
            until.append(time.monotonic() + 0.4)
        return self.shown if not until or time.monotonic() > until[0] else 200

    monkeypatch.setattr("tissue.simulation.live.run.await_display", lambda: None)
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: None)
    monkeypatch.setattr("tissue.simulation.live.run.WindowProcess", FakeWindow)
    monkeypatch.setattr(FakeWindow, "frames", property(frames))
    monkeypatch.setattr("tissue.simulation.live.run.STALLED_S", 0.1)


def test_a_run_waits_for_a_window_that_hangs_and_reports_it(stalled):
    run = run_live(load_scene("wall"))
    assert len(run.trace.rows) == 600
    (time_s, what), *more = [event for event in run.events if "drew nothing" in event[1]]
    assert what.startswith("the window drew nothing: the run waited ") and not more
    waited_us = 1e6 * float(what.split("waited ")[1].split(" s")[0])
    paused = round(time_s / TICK_S)
    assert run.timing["skipped_us"][paused : paused + 2].max() < waited_us, "a pause of the run is no lateness"


def test_a_run_ends_when_its_window_hangs_for_ever(stalled, monkeypatch):
    monkeypatch.setattr("tissue.simulation.live.run.HELD_S", 0.2)
    run = run_live(load_scene("wall"))
    assert len(run.trace.rows) < 600
    assert [what for _, what in run.events if "drew nothing" in what] == [
        "the window drew nothing for 0 s: the run ended"
    ]


def test_a_display_that_comes_late_is_waited_for(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":9")
    problems = ["the display :9 does not answer"] * 3 + [None]
    monkeypatch.setattr("tissue.system.offscreen.display_problem", lambda: problems.pop(0))
    assert await_display(longest_s=60.0) is None and not problems
    monkeypatch.setattr("tissue.system.offscreen.display_problem", lambda: "the display :9 does not answer")
    with pytest.raises(
        InputError, match=r"got :9, which did not within 0\.3 s: start it, or unset DISPLAY to go without"
    ):
        await_display(longest_s=0.3)
    monkeypatch.setattr("tissue.system.offscreen.display_problem", lambda: "there is no display (DISPLAY is not set)")
    assert await_display() == "there is no display (DISPLAY is not set)"


@pytest.mark.skipif(not Path("/tmp/.X11-unix").is_dir(), reason="no X server keeps its sockets here")
def test_a_display_that_takes_the_call_and_never_answers_is_no_display(monkeypatch):
    number = 7000 + os.getpid() % 1000
    place = f"/tmp/.X11-unix/X{number}"
    monkeypatch.setenv("DISPLAY", f":{number}")
    monkeypatch.setattr("tissue.system.offscreen.ANSWERS_S", 0.3)
    with socket.socket(socket.AF_UNIX) as deaf:
        deaf.bind(place)
        try:
            deaf.listen()
            assert display_problem() in (
                f"the display :{number} does not answer",
                "libX11 is missing (install libx11-6, libgl1 and libxcursor1)",
            )
        finally:
            os.unlink(place)


def test_ctrl_c_is_given_back(monkeypatch):
    before = signal.getsignal(signal.SIGINT)
    observer = LiveObserver(load_scene("wall"), None, WallClock(TICK_S))
    observer.on_begin(None, ())
    assert signal.getsignal(signal.SIGINT) != before
    signal.raise_signal(signal.SIGINT)
    assert not observer.on_tick(0, np.zeros(3), np.zeros(8))
    observer.on_end()
    assert signal.getsignal(signal.SIGINT) == before


def test_a_mouse_that_is_pushed_far_never_moves_faster_than_a_hand():
    mouse = MouseDevice((0.0, 0.0, 0.0))
    mouse.push((0.3, 0.0, 0.0))
    speeds = [mouse.read(1e-3 * tick).velocity_m_s[0] for tick in range(300)]
    assert 3.0 < max(speeds) < 5.0  # 0.3 m / (e x 30 ms) = 3.7 m/s
