"""Runs against the wall clock.

They have no display, a window that is closed, fails or hangs, or are driven by the mouse.
"""

import signal
import time
import typing

import numpy as np
import pytest

from tissue import InputError, load_scene
from tissue.motion.quaternion import UPRIGHT
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.live.run import LiveObserver, LiveSettings
from tissue.simulation.live.run import live as run_live
from tissue.simulation.live.window import WindowProcess
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.simulate import TICK_S


@pytest.fixture
def no_display(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: "there is no display")


def test_the_command_runs_live_without_a_display(no_display, command, here):
    code, output, _ = command(
        "run", "wall", "--live", "--duration-s", "0.3", "--no-pictures", "--out", "run"
    )
    assert code == 0
    assert output.startswith(
        "live: no window, for there is no display: a simulated expert moves it; Ctrl-C ends it"
    )
    assert "delay of ticks, median / 99 % / max" in output and "wall clock skipped" in output
    saved = SavedRun(here / "run")
    assert saved.complete and len(saved.trace.rows) == 300
    timing = np.loadtxt(here / "run" / "timing.csv", delimiter=",", skiprows=1)
    assert timing.shape == (300, 8)
    assert saved.summary["missed_deadlines"] == (timing[:, 0] + timing[:, 6] > 1000.0).sum()


class FakeWindow:
    """A window whose pointer goes 8 mm down at once, and that is closed after 600 ticks."""

    paused = reset = False

    def __init__(self, scene, parts, columns):
        self.closed, self.shown = False, 0

    @property
    def frames(self):
        return self.shown

    def steer(self, mouse):
        mouse.push((0.0, 0.0, -2e-3), UPRIGHT)

    def show(self, index, row, times):
        self.shown += 1
        self.closed = index >= 599

    def failed(self):
        return None

    def end(self):
        pass


@pytest.mark.parametrize("device", ["touch", "none"])
def test_a_mouse_moves_the_tool_on_the_devices_spring_until_the_window_is_closed(
    monkeypatch, device
):
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: None)
    monkeypatch.setattr("tissue.simulation.live.run.WindowProcess", FakeWindow)
    run = run_live(load_scene("wall", {"device": device, "anatomy.stiffness_kN_m": 40.0}))
    assert len(run.trace.rows) == 600 and run.scene.held.kind == "touch"
    assert run.trace["device_z_mm"][-1] == pytest.approx(-2.0, abs=0.01)
    # 400 N/m at the device in series with the wall.
    scale = chosen_scale(run.scene).factor
    assert run.trace["model_force_z_N"][-1] == pytest.approx(
        2e-3 / (scale / 400.0 + 1.0 / 4e4), rel=0.01
    )
    assert run.trace["device_force_z_N"][-1] == pytest.approx(
        scale * run.trace["model_force_z_N"][-1], rel=0.02
    )
    assert run.parts.notes["live"].startswith("the mouse moves the tool in a window")


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
    assert run.timing["skipped_us"][paused : paused + 2].max() < waited_us, (
        "a pause of the run is no lateness"
    )


def test_a_pause_is_no_lateness_and_is_reported(monkeypatch):
    until = []

    def paused(self):
        if self.shown == 300 and not until:
            until.append(time.monotonic() + 0.4)
        return bool(until) and time.monotonic() < until[0]

    monkeypatch.setattr("tissue.simulation.live.run.await_display", lambda: None)
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: None)
    monkeypatch.setattr("tissue.simulation.live.run.WindowProcess", FakeWindow)
    monkeypatch.setattr(FakeWindow, "paused", property(paused))
    run = run_live(load_scene("wall"))
    assert len(run.trace.rows) == 600
    ((time_s, what),) = [event for event in run.events if "paused" in event[1]]
    assert (
        time_s == 0.3
        and float(what.removeprefix("the run was paused for ").removesuffix(" s")) >= 0.4
    )
    assert run.timing["skipped_us"][300:302].max() < 4e5


class FakePage:
    """A page on which a person begins again after 200 ticks of the first run, as `Page`."""

    made: typing.ClassVar = []

    def __init__(self, opened):
        self.windows, self.closed = [], False
        self.made.append(self)
        opened("http://127.0.0.1:1/?token=x")

    def show(self, scene, parts, columns):
        window = FakeWindow(scene, parts, columns)
        if not self.windows:
            show = window.show

            def shown(index, row, clock):
                show(index, row, clock)
                window.reset = index >= 199

            window.show = shown
        self.windows.append(window)
        return window

    def close(self):
        self.closed = True


@pytest.fixture
def paged(monkeypatch):
    monkeypatch.setattr("tissue.simulation.live.run.Page", FakePage)
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: "there is no display")
    monkeypatch.setattr(FakePage, "made", [])


def test_a_page_needs_no_display_and_a_reset_begins_the_scene_again_in_the_same_folder(
    paged, tmp_path
):
    pytest.importorskip("aiohttp")
    addresses, out = [], tmp_path / "run"
    run = run_live(load_scene("wall"), LiveSettings(opened=addresses.append), out=out)
    (page,) = FakePage.made
    assert addresses == ["http://127.0.0.1:1/?token=x"] and page.closed
    assert [window.shown for window in page.windows] == [200, 600]
    assert len(run.trace.rows) == 600 and run.trace["time_s"][0] == 0.0
    run.save(out, pictures=False)
    saved = SavedRun(out)
    assert saved.complete and len(saved.trace.rows) == 600
    assert (
        saved.summary["notes"]["live"]
        == "the mouse moves the tool in a browser; the force is shown but cannot be felt"
    )


def test_ctrl_c_is_given_back(monkeypatch):
    before = signal.getsignal(signal.SIGINT)
    observer = LiveObserver(load_scene("wall"), None)
    observer.on_begin(None, ())
    assert signal.getsignal(signal.SIGINT) != before
    signal.raise_signal(signal.SIGINT)
    assert not observer.on_tick(0, np.zeros(3), np.zeros(8))
    observer.on_end()
    assert signal.getsignal(signal.SIGINT) == before


def test_a_missing_process_is_refused_before_the_run_and_leaves_no_folder(monkeypatch):
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: None)
    monkeypatch.setattr("tissue.simulation.live.run.await_display", lambda: None)
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: ())
    with pytest.raises(InputError, match="tissue-sim must have the process window"):
        LiveSettings().check(load_scene("wall"))
    monkeypatch.setattr("tissue.simulation.live.window._new_folder", None)
    with pytest.raises(InputError, match="tissue-sim must have the process window"):
        WindowProcess(None, None, ())
