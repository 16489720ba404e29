"""Messages that a publisher sends, their receivers and times.

The test client decodes messages without the package's code.
"""

import json

import numpy as np
import pytest
from igtl_client import IgtlClient

from meshes.base.placement import Placement
from tissue import load_scene, simulate
from tissue.links import igtl_messages as igtl
from tissue.links import slicer_process
from tissue.links.slicer_process import Publisher, scene_to_ras
from tissue.show.figures.tool_mesh import pose
from tissue.simulation.live.shared import BoneShared, SharedArrays, SharedTissue
from tissue.simulation.live.window import CLOCK

pytest.importorskip("pyvista")

PLACEMENT = Placement(
    np.array([10.0, -20.0, 30.0]), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
)
LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


class Stage:
    """A publisher in this process, and what the ticks would share with it."""

    def __init__(self, folder, run, shared, *, drives=True, placement=None):
        self.columns, self.shared = run.trace.columns, shared
        layout = {
            "row": ("float64", (len(self.columns) + len(CLOCK),)),
            "row_turn": ("int64", (1,)),
            "ended": ("int64", (1,)),
            "frames": ("int64", (1,)),
            "target": ("float64", (7,)),
            "target_turn": ("int64", (1,)),
            "events": ("uint8", (4, 64)),
            "events_count": ("int64", (1,)),
            "counts": ("int64", (4,)),
        }
        self.arrays = SharedArrays(folder, layout | shared.layout)
        names = np.array(run.parts.tissue.layer_names)
        start = {"port": 0, "start_turn": np.eye(3), "drives": drives, "layer_names": names}
        start |= shared.start
        start |= {"low_m": np.array([-9e-3, -9e-3, -4e-3]), "high_m": np.array([9e-3, 9e-3, 20e-3])}
        if run.parts.volume is not None:
            start["density_kg_m3"] = run.volume.density_kg_m3
        if placement is not None:
            start["file_to_scene_mm"] = placement.file_to_scene_mm
        np.savez(folder / "start.npz", **start)
        (folder / "scene.json").write_text(run.scene.model_dump_json(exclude_unset=True), "utf-8")
        (folder / "columns.json").write_text(json.dumps([*self.columns, *CLOCK]), "utf-8")
        shared.publish(self.arrays, 0)
        self.row = np.concatenate([run.trace.rows[-1], [200.0, 10.0, 3.0, 0.0]])
        self.publisher = Publisher(folder)
        self.clients = []

    def client(self):
        """A client that has been greeted."""
        made = IgtlClient(self.publisher.server.address)
        self.clients.append(made)
        made.until(lambda: made.of("tissue", "STATUS"), poll=self.publisher.step)
        return made

    def show(self, **changes):
        """Write a row of the ticks, with some values changed."""
        for name, value in changes.items():
            self.row[self.columns.index(name)] = value
        self.arrays.write("row", self.row)

    def report(self, *sentences):
        """Write events."""
        for what in sentences:
            text = what.encode()
            slot = self.arrays["events"][self.arrays["events_count"][0] % 4]
            slot[:] = 0
            slot[: len(text)] = np.frombuffer(text, np.uint8)
            self.arrays["events_count"][0] += 1


@pytest.fixture(scope="module")
def milled():
    return simulate(load_scene("milling", {"voxels.spacing_mm": 0.4, "duration_s": 0.05}))


@pytest.fixture(scope="module")
def pressed():
    return simulate(load_scene("wall", {"duration_s": 0.05}))


@pytest.fixture
def stage(tmp_path):
    """Function that returns stages and closes them at the end."""
    made = []

    def make(run, shared=None, **options):
        if shared is None:
            shared = (
                SharedTissue()
                if run.parts.volume is None
                else BoneShared(run.parts.tissue, run.volume)
            )
        made.append(Stage(tmp_path, run, shared, **options))
        return made[-1]

    yield make
    for each in made:
        for client in each.clients:
            client.close()
        each.publisher.server.close()


def test_a_bone_its_voxels_and_the_tool_are_sent_once_and_lie_in_ras(stage, milled):
    shown = stage(milled, placement=PLACEMENT)
    client = shown.client()
    client.until(lambda: client.of("tissue-anatomy"), poll=shown.publisher.step)
    (image,), (shape,), (bone,) = (
        client.of(name) for name in ("tissue-image", "tissue-tool-shape", "tissue-anatomy")
    )
    volume, to_file = milled.volume, np.linalg.inv(PLACEMENT.file_to_scene_mm)
    assert image["coordinates"] == 1
    np.testing.assert_array_equal(image["values"], volume.density_kg_m3)
    np.testing.assert_allclose(
        image["axes"], 1e3 * volume.spacing_m * (LPS_TO_RAS @ to_file)[:3, :3], atol=1e-6
    )
    middle = 1e3 * (volume.origin_m + 0.5 * volume.spacing_m * np.array(volume.shape))
    np.testing.assert_allclose(
        image["middle"], (LPS_TO_RAS @ to_file @ [*middle, 1.0])[:3], atol=1e-4
    )
    # The bone's surface fills the voxels' box up to its blocks of 0.8 mm, in RAS.
    corners = (
        np.array([(*corner, 1.0) for corner in 1e3 * np.array(volume.bounds_m)])
        @ (LPS_TO_RAS @ to_file).T
    )
    low, high = corners.min(axis=0)[:3], corners.max(axis=0)[:3]
    assert (bone["points"] > low - 0.8).all() and (bone["points"] < high + 0.8).all()
    assert np.ptp(bone["points"], axis=0).min() > 0.5 * (high - low).min()
    assert set(np.unique(bone["values"]["layer"])) <= set(range(len(volume.layer_names)))
    # The tool's shape is in its own frame: its tip is the lowest point, at the origin.
    assert shape["points"][:, 2].min() == pytest.approx(0.0, abs=1e-3)
    shown.show()
    client.until(lambda: len(client.of("tissue-tool")) >= 1, poll=shown.publisher.step)
    assert len(client.of("tissue-image")) == 1


def test_a_pose_is_that_of_the_row_in_ras_and_an_old_row_is_not_sent_again(stage, pressed):
    shown = stage(pressed, placement=PLACEMENT)
    client = shown.client()
    shown.show(
        tool_x_mm=1.0,
        tool_y_mm=2.0,
        tool_z_mm=3.0,
        tool_qx=0.0,
        tool_qy=0.0,
        tool_qz=np.sin(0.2),
        tool_qw=np.cos(0.2),
    )
    client.until(lambda: client.of("tissue-force-text"), poll=shown.publisher.step)
    for _ in range(20):
        shown.publisher.step()
    (pose,) = client.of("tissue-tool")
    turn = np.array(
        [
            [np.cos(0.4), -np.sin(0.4), 0, 1.0],
            [np.sin(0.4), np.cos(0.4), 0, 2.0],
            [0, 0, 1, 3.0],
            [0, 0, 0, 1],
        ]
    )
    expected = LPS_TO_RAS @ np.linalg.inv(PLACEMENT.file_to_scene_mm) @ turn
    np.testing.assert_allclose(pose["matrix"], expected, atol=1e-5)
    assert np.linalg.det(pose["matrix"]) == pytest.approx(1.0, rel=1e-6)


def test_force_and_torque_are_sent_to_who_asks_for_them(stage, pressed, monkeypatch):
    monkeypatch.setattr(slicer_process, "FRAME_S", 0.0)
    shown = stage(pressed, placement=PLACEMENT)
    asks, looks = shown.client(), shown.client()
    shown.show(
        time_s=1.25,
        model_force_x_N=1.0,
        model_force_y_N=2.0,
        model_force_z_N=3.0,
        model_torque_x_Nm=0.1,
    )
    asks.until(lambda: asks.of("tissue-tool"), poll=shown.publisher.step)
    asks.send(igtl.packed("GET_SENSOR", "", b"", time_s=0.0))
    asks.until(lambda: asks.of("tissue-torque"), poll=shown.publisher.step)
    turn = LPS_TO_RAS[:3, :3] @ PLACEMENT.rotation
    loads = np.concatenate([turn @ [1.0, 2.0, 3.0], turn @ [0.1, 0.0, 0.0]])
    (force,), (torque,) = asks.of("tissue-force", "SENSOR"), asks.of("tissue-torque", "SENSOR")
    assert force["unit"] == 0x0B << 54 | 1 << 50
    assert torque["unit"] == force["unit"] | 0x01 << 44 | 1 << 40
    np.testing.assert_allclose([*force["values"], *torque["values"]], loads)
    asks.send(igtl.packed("STT_NDARRAY", "", b"", time_s=0.0))
    asks.until(lambda: asks.of("", "RTS_NDARRAY"), poll=shown.publisher.step)
    shown.show()
    asks.until(lambda: asks.of("tissue-wrench"), poll=shown.publisher.step)
    np.testing.assert_allclose(asks.of("tissue-wrench")[0]["values"], loads)
    asks.send(igtl.packed("STP_NDARRAY", "", b"", time_s=0.0))
    asks.until(lambda: len(asks.of("", "RTS_NDARRAY")) == 2, poll=shown.publisher.step)
    before = len(asks.of("tissue-wrench"))
    shown.show(time_s=1.5)
    looks.until(lambda: len(looks.of("tissue-tool")) >= 3, poll=shown.publisher.step)
    assert len(asks.of("tissue-wrench")) == before
    assert not [each for each in looks.messages if each.kind in ("SENSOR", "NDARRAY")]
    words = looks.of("tissue-force-text")[0]["text"]
    assert words.startswith("1.25 s: force 3.74 N") and words.endswith("torque 100.0 mN m")


def test_events_are_sent_in_order_and_the_last_ones_kept(stage, pressed):
    shown = stage(pressed)
    client = shown.client()
    shown.report("one", "two µ")
    client.until(lambda: len(client.of("tissue-events")) == 2, poll=shown.publisher.step)
    shown.report(*map(str, range(6)))
    client.until(lambda: len(client.of("tissue-events")) == 6, poll=shown.publisher.step)
    texts = [each["text"] for each in client.of("tissue-events")]
    assert texts == ["one", "two µ", "2", "3", "4", "5"]


def test_a_surface_is_sent_when_it_has_changed_and_to_late_clients(stage, milled, monkeypatch):
    monkeypatch.setattr(slicer_process, "SURFACE_S", 0.02)
    shown = stage(milled)
    client = shown.client()
    client.until(lambda: client.of("tissue-anatomy"), poll=shown.publisher.step)
    for _ in range(20):
        shown.publisher.step()
    assert len(client.of("tissue-anatomy")) == 1
    left = shown.arrays["remaining"]
    left[len(left) // 2 :] = 0
    client.until(lambda: len(client.of("tissue-anatomy")) == 2, poll=shown.publisher.step)
    late = shown.client()
    late.until(lambda: late.of("tissue-anatomy"), poll=shown.publisher.step)
    np.testing.assert_array_equal(
        late.of("tissue-anatomy")[0]["points"], client.of("tissue-anatomy")[1]["points"]
    )
    assert len(late.of("tissue-anatomy")[0]["points"]) < len(
        client.of("tissue-anatomy")[0]["points"]
    )
    left[:] = 0
    client.until(lambda: len(client.of("tissue-anatomy")) == 3, poll=shown.publisher.step)
    assert not len(client.of("tissue-anatomy")[2]["triangles"])


AT_ORIGIN = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""Tip and quaternion for the identity matrix. Its RAS axes are LPS axes after half a turn about z.
"""


def target(matrix):
    """A transform that is to move the tool."""
    return igtl.packed("TRANSFORM", "tissue-target", igtl.transform_body(matrix), time_s=0.0)


def asked(shown, *, taken, ignored=0):
    """Work until so many poses were taken and ignored, and return the last one taken."""
    for _ in range(2000):
        shown.publisher.step()
        turn, pose = shown.arrays.read("target")
        if turn == taken and shown.arrays["counts"][3] == ignored:
            return pose
    raise AssertionError(f"{turn} taken, {shown.arrays['counts']}")


def test_a_pose_of_a_client_comes_to_the_ticks_in_their_frame_and_within_the_box(stage, pressed):
    shown = stage(pressed, placement=PLACEMENT)
    client = shown.client()
    to_ras = scene_to_ras({"file_to_scene_mm": PLACEMENT.file_to_scene_mm})
    turn = [np.sin(0.15), 0.0, 0.0, np.cos(0.15)]
    client.send(target(to_ras @ pose([1.0, -2.0, 3.0], turn)))
    expected = [1.0, -2.0, 3.0, np.sin(0.15), 0.0, 0.0, np.cos(0.15)]
    np.testing.assert_allclose(asked(shown, taken=1), expected, atol=1e-5)
    client.send(target(to_ras @ pose([100.0, -2.0, -100.0], turn)))
    np.testing.assert_allclose(asked(shown, taken=2)[:3], [9.0, -2.0, -4.0], atol=1e-5)


@pytest.mark.parametrize(
    "matrix",
    [
        np.full((4, 4), np.nan),
        np.diag([2.0, 1.0, 1.0, 1.0]),
        np.diag([-1.0, 1.0, 1.0, 1.0]),
        np.zeros((4, 4)),
    ],
    ids=["nan", "scaled", "mirrored", "zero"],
)
def test_a_transform_that_is_no_pose_is_ignored_and_counted(stage, pressed, matrix):
    shown = stage(pressed)
    client = shown.client()
    other = igtl.packed("TRANSFORM", "another", igtl.transform_body(np.eye(4)), time_s=0.0)
    client.send(target(matrix) + other + target(np.eye(4)))
    np.testing.assert_allclose(asked(shown, taken=1, ignored=1), AT_ORIGIN, atol=1e-6)


def test_only_one_client_at_a_time_moves_the_tool(stage, pressed):
    shown = stage(pressed)
    first, second = shown.client(), shown.client()
    first.send(target(np.eye(4)))
    asked(shown, taken=1)
    second.send(target(np.eye(4)))
    asked(shown, taken=1, ignored=1)
    first.close()
    second.until(lambda: len(shown.publisher.server.clients) == 1, poll=shown.publisher.step)
    second.send(target(np.eye(4)))
    asked(shown, taken=2, ignored=1)
    assert shown.arrays["counts"][3] == 1


def test_a_run_that_nobody_may_move_ignores_poses(stage, pressed):
    shown = stage(pressed, drives=False)
    shown.client().send(target(np.eye(4)))
    asked(shown, taken=0, ignored=1)
    assert not shown.arrays.read("target")[0]
