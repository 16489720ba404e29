"""Effects of a page's messages on a live run: reset and figures."""

from types import SimpleNamespace

import numpy as np
import pytest

from tissue.show.viewer.live.live_scene import NOTCH_MM, Readings
from tissue.show.viewer.web import live_page
from tissue.show.viewer.web.live_page import LivePage
from tissue.simulation.live.shared import SharedArrays
from tissue.simulation.live.window import LOADS

pytest.importorskip("aiohttp")
LAYOUT = {
    **dict.fromkeys(
        ("pointer_turn", "ended", "closed", "frames", "loads_count", "paused", "resets", "runs"),
        ("int64", (1,)),
    ),
    "pointer": ("float64", (3,)),
    "loads": ("float64", (LOADS, 4)),
}
READ = Readings(
    tip_mm=np.zeros(3),
    turn=np.array([0.0, 0.0, 0.0, 1.0]),
    force_N=np.array([0.0, 0.3, 0.4]),
    torque_Nm=np.array([0.0, 3e-3, 4e-3]),
    device_N=0.1,
    layer="wall",
    numbers={
        "time_s": 1.5,
        "removed_mm3": 2.0,
        "tick_us": 300.0,
        "late_us": 5.0,
        "missed": 2.0,
        "skipped_ms": 0.0,
    },
)


class Scene:
    """Scene of a page without OpenGL: a camera 100 mm in front of the origin."""

    def __init__(self, folder, **look):
        from vtkmodules.vtkRenderingCore import vtkCamera

        self.arrays = SharedArrays(folder, LAYOUT)
        camera = vtkCamera()
        camera.SetPosition(0.0, -100.0, 0.0)
        camera.SetFocalPoint(0.0, 0.0, 0.0)
        camera.SetViewUp(0.0, 0.0, 1.0)
        camera.SetViewAngle(30.0)
        self.plotter = SimpleNamespace(camera=camera, window_size=(1000, 500))
        self.points_mm, self.colours, self.scene = (
            np.eye(3),
            {"wall": (1.0, 0.0, 0.5)},
            SimpleNamespace(name="wall"),
        )
        self.is_cut_open = self.is_bone = False
        self.target_options = {
            "start_mm": np.zeros(3),
            "axis": np.array([0.0, 0.0, 1.0]),
            "low_mm": np.full(3, -20.0),
            "high_mm": np.full(3, 20.0),
        }

    def show(self, target_mm):
        return READ

    def cut_open(self, is_open):
        self.is_cut_open = is_open

    def update_tissue(self):
        return False


class Stage:
    """A stage that draws nothing."""

    tall_px = 500

    def __init__(self, plotter, aim):
        self.changed = True

    def take(self, do, values):
        return False

    def picture(self):
        changed, self.changed = self.changed, False
        return b"picture" if changed else None


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setattr(live_page, "LiveScene", Scene)
    monkeypatch.setattr(live_page, "Stage", Stage)
    made = LivePage(tmp_path)
    assert made.arrays["paused"][0] == 1, "the ticks wait until a page is open"
    made.attend(True)
    return made


def pointer(page):
    page.frame(True)
    return page.arrays["pointer"]


def test_a_reset_is_asked_for_once_and_the_tool_begins_where_it_did(page):
    page.take("depth", {"notches": -3})
    page.take("pause", {"on": True})
    page.take("reset", {})
    page.take("reset", {})
    assert page.arrays["resets"][0] == 1 and page.arrays["paused"][0] == 0
    page.take("depth", {"notches": -9})
    assert page.frame(True)[0]["figures"]["state"] == "resetting"
    page.arrays["runs"][0] += 1
    figures, _ = page.frame(True)
    assert figures["figures"]["state"] == "running" and figures["figures"]["run"] == 1
    np.testing.assert_array_equal(page.target.target_mm, 0.0)
    turn = page.arrays["pointer_turn"][0]
    page.take("depth", {"notches": 2})
    assert pointer(page)[2] == 2 * NOTCH_MM and page.arrays["pointer_turn"][0] == turn + 2


def test_figures_hold_every_row_since_the_last_frame_that_could_be_sent(page):
    rows = np.arange(40.0).reshape(10, 4)
    page.arrays["loads"][:10], page.arrays["loads_count"][0] = rows, 10
    assert page.frame(False) == (None, None), "nothing is drawn while the last picture is not seen"
    figures, picture = page.frame(True)
    assert figures["loads"] == rows.tolist() and picture == b"picture"
    assert (
        figures["figures"]["force_N"] == [0.0, 0.3, 0.4]
        and figures["figures"]["torque_Nm"] == 0.005
    )
    assert {"removed_mm3", "late_us", "missed", "device_N", "tick_us", "skipped_ms"} <= set(
        figures["figures"]
    )
    assert page.frame(True) == (None, None), "nothing is new"
    page.arrays["loads"][:4], page.arrays["loads_count"][0] = rows[:4], LOADS + 4
    assert len(page.frame(True)[0]["loads"]) == LOADS // 2, "what is too old is left out"
