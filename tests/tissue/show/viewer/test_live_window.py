"""The window of a live run: what it draws, and how mouse and keys move the tool."""

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.show.figures.force_depth import draw_wall
from tissue.show.figures.tool_mesh import faces_of
from tissue.show.viewer.live.live_scene import KEY_MM, NOTCH_MM, LiveBone, LiveOrgan, Pointer
from tissue.simulation.live.shared import (
    FADES_MM,
    BoneShared,
    BoneSurface,
    OrganShared,
    OrganSurface,
    SharedArrays,
)

UP = np.array([0.0, 0.0, 1.0])


class Plotter:
    """A plotter that only remembers what it was given, so that no OpenGL is needed."""

    def __init__(self):
        self.meshes = {}

    def add_mesh(self, mesh, name="mesh", **look):
        self.meshes[name] = mesh

    def remove_actor(self, name, **options):
        del self.meshes[name]


class Interactor:
    """Events as VTK sends them: observers by name, and what they ask for."""

    def __init__(self):
        self.observers, self.place, self.key, self.state = {}, (0, 0), "", 0

    def AddObserver(self, name, call):
        self.observers[name] = call

    def GetInteractorStyle(self):
        return self

    def GetEventPosition(self):
        return self.place

    def GetKeySym(self):
        return self.key

    def GetState(self):
        return self.state


@pytest.fixture
def pointed():
    """A pointer at the origin of a view from the front, 100 mm away, and its interactor."""
    from types import SimpleNamespace

    from vtkmodules.vtkRenderingCore import vtkCamera

    camera, interactor = vtkCamera(), Interactor()
    camera.SetPosition(0.0, -100.0, 0.0)
    camera.SetFocalPoint(0.0, 0.0, 0.0)
    camera.SetViewUp(0.0, 0.0, 1.0)
    camera.SetViewAngle(30.0)
    window = SimpleNamespace(
        camera=camera, window_size=(1000, 500), iren=SimpleNamespace(interactor=interactor)
    )
    box = {"low_mm": np.array([-20.0, -20.0, -10.0]), "high_mm": np.array([20.0, 20.0, 30.0])}
    return Pointer(window, np.zeros(3), UP, **box), interactor


def test_the_mouse_moves_the_target_by_what_is_under_the_pixels(pointed):
    pointer, events = pointed
    pixel = 2.0 * 100.0 * np.tan(np.radians(15.0)) / 500.0
    events.place = (500, 250)
    events.observers["MouseMoveEvent"]()
    # where it comes in is where it counts from
    np.testing.assert_array_equal(pointer.target_mm, 0.0)
    events.place = (530, 270)
    events.observers["MouseMoveEvent"]()
    np.testing.assert_allclose(pointer.target_mm, [30 * pixel, 0.0, 20 * pixel], atol=1e-12)
    events.state = 1  # a button is down: the mouse turns the view
    events.place = (700, 100)
    events.observers["MouseMoveEvent"]()
    events.state = 0
    events.observers["LeaveEvent"]()
    events.place = (10, 10)
    events.observers["MouseMoveEvent"]()
    np.testing.assert_allclose(pointer.target_mm, [30 * pixel, 0.0, 20 * pixel], atol=1e-12)


def test_wheel_and_keys_move_it_along_the_axis_and_in_the_view_within_the_box(pointed):
    pointer, events = pointed
    events.observers["MouseWheelForwardEvent"]()
    np.testing.assert_allclose(pointer.target_mm, -NOTCH_MM * UP)
    events.observers["MouseWheelBackwardEvent"]()
    for keys, target in (
        (("Next", "s"), -2 * KEY_MM * UP),
        (("Prior", "w"), 0.0 * UP),
        (("Right", "Up"), KEY_MM * np.array([1.0, 0.0, 1.0])),
        (("Left", "Down"), 0.0 * UP),
    ):
        for events.key in keys:
            events.observers["KeyPressEvent"]()
        np.testing.assert_allclose(pointer.target_mm, target, atol=1e-12)
    events.key = "s"
    for _ in range(100):
        events.observers["KeyPressEvent"]()
    assert pointer.target_mm[2] == -10.0 and not pointer.ended
    events.key = "q"
    events.observers["KeyPressEvent"]()
    assert pointer.ended


def test_a_wall_is_a_face_under_all_of_the_path():
    pytest.importorskip("pyvista")
    scene = load_scene("wall")
    coupling = scene.held.coupling.model_copy(update={"roam_mm": 40.0})
    roaming = scene.held.model_copy(update={"coupling": coupling})  # as a live run gives the mouse
    for each, beyond in ((scene, 15.0), (scene.model_copy(update={"device": roaming}), 40.0)):
        (face,) = faces_of(each).values()
        expected = (-beyond, 50.0 + beyond, -beyond, beyond, 0.0, 0.0)
        assert tuple(face.bounds) == pytest.approx(expected, abs=1e-3)


@pytest.mark.slow
def test_a_pressed_wall_is_drawn_for_the_report(tmp_path):
    from PIL import Image

    run = simulate(load_scene("wall", {"duration_s": 1.2}))
    draw_wall(run, tmp_path / "wall.png")
    with Image.open(tmp_path / "wall.png") as picture:
        red, green, blue = np.moveaxis(np.asarray(picture.convert("RGB"), dtype=int), 2, 0)
    pale = (abs(red - 236) < 12) & (abs(green - 208) < 12) & (abs(blue - 224) < 12)
    dashes = (red > 180) & (abs(green - 94) < 40) & (blue < 60)
    assert pale.mean() > 0.01
    assert dashes.sum() > 500


@pytest.mark.slow
def test_the_drawn_bone_loses_what_the_tool_removes(tmp_path, monkeypatch):
    pytest.importorskip("pyvista")
    # bricks of 4 voxels, as for many voxels
    monkeypatch.setattr("tissue.simulation.live.shared.MOST_SHOWN", 0)
    run = simulate(load_scene("milling", {"voxels.spacing_mm": 0.2, "duration_s": 0.001}))
    milling = run.parts.tissue
    shared = BoneShared(milling, run.volume)
    arrays = SharedArrays(tmp_path, shared.layout)
    shared.publish(arrays, 0)
    plotter = Plotter()
    bone = LiveBone(plotter, BoneSurface(shared.start, arrays))
    names = run.volume.layer_names
    assert list(bone.colours) == [
        n for i, n in enumerate(names) if (run.volume.fraction[run.volume.layer == i] > 0).any()
    ]
    before = plotter.meshes["bone"].volume
    # A closed surface at half full holds the bone but for its rounded edges.
    assert before == pytest.approx(1e9 * milling.start_m3.sum(), rel=0.03)
    assert not bone.update()
    left = milling.store.remaining.numpy()
    hollow = np.flatnonzero(
        (milling.store.places == milling.store.places.max(axis=0) // 2).all(axis=1)
    )
    assert hollow.size == 1
    lost_mm3 = 1e9 * milling.step_m3 * left[hollow].sum(dtype=float)
    left[hollow] = 0
    shared.publish(arrays, 0)
    assert bone.update()
    assert before - plotter.meshes["bone"].volume == pytest.approx(
        lost_mm3, rel=0.35
    )  # a cube, rounded
    left[:] = 0
    shared.publish(arrays, 0)
    assert bone.update() and "bone" not in plotter.meshes


def test_the_drawn_organ_moves_where_it_is_known_and_fades_beyond(tmp_path):
    pytest.importorskip("pyvista")
    from fake_fields import pressed_series

    series = pressed_series()
    surface = np.flatnonzero(series.nodes_m[:, 2] == 0.0)
    near = surface[np.linalg.norm(series.nodes_m[surface, :2], axis=1) < 8e-3]

    class Organ:
        fields = series
        # nodes in the middle of edges come last and are not drawn
        moved = np.zeros((len(near) + 3, 3))

        def displacement_m(self):
            return self.moved

    series.node_sets["touchable"] = near
    organ = Organ()
    shared = OrganShared(organ)
    arrays = SharedArrays(tmp_path, shared.layout)
    plotter = Plotter()
    drawn = LiveOrgan(plotter, OrganSurface(shared.start, arrays))
    rest = np.array(plotter.meshes["mesh"].points)
    assert not drawn.update()
    organ.moved[:] = (0.0, 0.0, -2e-3)
    organ.moved[0] = np.nan
    shared.publish(arrays, 0)
    assert drawn.update()
    moved = np.array(plotter.meshes["mesh"].points) - rest
    known = 1e3 * series.nodes_m[near[1:]]
    away = np.linalg.norm(rest[:, None] - known[None], axis=2).min(axis=1)
    np.testing.assert_allclose(moved[:, 2], -2.0 * np.exp(-away / FADES_MM), atol=1e-5)
    assert np.isclose(moved[:, 2], -2.0).sum() >= len(near) - 1
