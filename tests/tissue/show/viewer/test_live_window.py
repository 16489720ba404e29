"""The window of a live run: what it draws, and how mouse and keys move the tool."""

import numpy as np
import pytest

from tissue.show.viewer.live.live_scene import KEY_MM, NOTCH_MM, Pointer, add_organ
from tissue.simulation.live.shared import (
    FADES_MM,
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
    return Pointer(window, start_mm=np.zeros(3), axis=UP, **box), interactor


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
    drawn = OrganSurface(shared.start, arrays)
    add_organ(plotter, drawn)
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
