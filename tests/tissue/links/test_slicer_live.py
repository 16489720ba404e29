"""Live runs that are published for 3D Slicer.

A client reads them, and a pose drives the tool.
"""

import numpy as np
import pytest
from igtl_client import IgtlClient

from tissue import load_scene, simulate
from tissue.links import igtl_messages as igtl
from tissue.links.slicer_process import scene_to_ras
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.live.publisher import SlicerLink
from tissue.simulation.live.run import LiveSettings, live

pytest.importorskip("pyvista")

LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


@pytest.fixture(autouse=True)
def no_display(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: "there is no display")


class Greeted:
    """A client that connects before the first tick, and what it is to send then."""

    def __init__(self, *messages):
        self.messages, self.client = messages, None

    def __call__(self, address):
        self.client = IgtlClient(address)
        self.client.until(lambda: self.client.of("tissue"))
        for message in self.messages:
            self.client.send(message)

    def all(self):
        """All messages, once the run has ended."""
        self.client.until(lambda: self.client.ended)
        self.client.close()
        return self.client.messages


@pytest.mark.slow
def test_a_client_sees_a_run_from_its_first_row_to_its_end_and_the_rows_are_those_without_it():
    greeted = Greeted()
    scene = load_scene("wall", {"duration_s": 0.4})
    run = live(scene, LiveSettings(slicer=SlicerLink(port=0, opened=greeted)))
    messages = greeted.all()
    np.testing.assert_array_equal(run.trace.rows, simulate(scene).trace.rows)
    poses = [each.held["matrix"] for each in messages if each.name == "tissue-tool"]
    assert poses
    rows = (
        run.trace.rows[:, [run.trace.columns.index(f"tool_{c}_mm") for c in "xyz"]]
        @ LPS_TO_RAS[:3, :3]
    )
    away = [np.abs(rows - pose[:3, 3]).max(axis=1).min() for pose in poses]
    assert max(away) < 1e-4, "each pose is that of a tick"
    assert messages[-1].held["code"] == 19
    assert {each.name for each in messages} >= {
        "tissue-tool-shape",
        "tissue-wall",
        "tissue-force-text",
    }
    note = run.summary["notes"]["slicer"]
    assert note == (
        f"published at {greeted_address(run)} by OpenIGTLink: {len(messages)} messages to 1 clients"
    )


def greeted_address(run):
    """The address in a run's note."""
    return run.summary["notes"]["slicer"].split(" at ")[1].split(" ")[0]


def target(tip_mm, turn=None):
    """A transform that asks for a tip in a scene without a file [mm], turned from the identity."""
    pose = np.eye(4)
    pose[:3, 3] = tip_mm
    pose[:3, :3] = np.eye(3) if turn is None else turn
    body = igtl.transform_body(scene_to_ras({}) @ pose)
    return igtl.packed("TRANSFORM", "tissue-target", body, time_s=0.0)


def test_a_pose_of_a_client_moves_the_tool_on_the_devices_spring():
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
    first = load_scene("wall", {"anatomy.stiffness_kN_m": 40.0})
    greeted = Greeted(target((0.0, 0.0, -2.0), turn))
    run = live(
        first, LiveSettings(slicer=SlicerLink(port=0, drives=True, opened=greeted), duration_s=0.4)
    )
    greeted.all()
    assert run.scene.held.kind == "touch" and len(run.trace.rows) == 400
    assert run.trace["device_z_mm"][-1] == pytest.approx(-2.0, abs=0.01)
    # 400 N/m at the device in series with the wall; turned about its tip a ball of 5 mm radius is 5
    # mm x (1 - 0.8) deeper than that.
    scale = chosen_scale(run.scene).factor
    deep_m = 2e-3 + 5e-3 * (1.0 - 0.8)
    assert run.trace["model_force_z_N"][-1] == pytest.approx(
        deep_m / (scale / 400.0 + 1.0 / 4e4), rel=0.01
    )
    quaternion = [run.trace[f"tool_q{c}"][-1] for c in "xyzw"]
    np.testing.assert_allclose(quaternion, [np.sqrt(0.1), 0.0, 0.0, np.sqrt(0.9)], atol=1e-3)
    assert run.parts.notes["live"].startswith(
        "the transform tissue-target of 3D Slicer moves the tool"
    )
    assert run.parts.notes["coupling"].startswith(
        "a pose from 3D Slicer in place of the touch and its hand"
    )


class Fake:
    """A process that fails after its first ticks."""

    address = "127.0.0.1:1"

    def __init__(self, *_, **__):
        self.shown, self.reported, self.ended = 0, [], 0

    def show(self, index, row, times):
        self.shown += 1

    def report(self, what):
        self.reported.append(what)

    def failed(self):
        return "MemoryError" if self.shown > 300 else None

    def steer(self, mouse):
        pass

    def note(self):
        return "published"

    def end(self):
        self.ended += 1


@pytest.mark.parametrize("drives", [False, True])
def test_a_run_goes_on_without_a_link_that_failed_unless_it_moves_the_tool(monkeypatch, drives):
    made = []
    monkeypatch.setattr(
        "tissue.simulation.live.publisher.SlicerProcess",
        lambda *a, **k: made.append(Fake(*a, **k)) or made[-1],
    )
    scene = load_scene("wall", {} if drives else {"duration_s": 0.45})
    run = live(
        scene,
        LiveSettings(slicer=SlicerLink(port=0, drives=drives), duration_s=0.45 if drives else None),
    )
    assert len(run.trace.rows) == (401 if drives else 450)
    (what,) = [what for _, what in run.events if "3D Slicer" in what]
    assert what == (
        f"the link to 3D Slicer ended by itself{', and the run ended with it' if drives else ''}: "
        "MemoryError"
    )
    assert made[0].ended == 1
