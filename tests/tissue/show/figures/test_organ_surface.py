"""Drawn organ: no facets, kept edges, a section with values, and the displayed moment."""

from dataclasses import replace

import numpy as np
import pytest
from fake_fields import pressed_series

from tissue.show.figures.organ_pictures import moment_of_press
from tissue.show.figures.organ_surface import SHOWN, drawn_surface, inclusions, section_cap
from tissue.simulation.vtk_files import frame_mesh

pyvista = pytest.importorskip("pyvista")


def test_a_coarse_ball_is_drawn_rounder_through_its_nodes():
    shell = pyvista.Icosphere(radius=10.0, nsub=2)
    points = np.vstack([shell.points, np.zeros((1, 3))])
    faces = np.column_stack([shell.regular_faces, np.full(shell.n_cells, shell.n_points)])
    ball = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: faces}, points)
    drawn = drawn_surface(ball, np.zeros(ball.n_points, dtype=np.float32))
    flat = ball.extract_surface(algorithm="dataset_surface").subdivide(2, "linear")
    missing = [
        np.abs(10.0 - np.linalg.norm(np.asarray(each.points), axis=1)).max()
        for each in (drawn, flat)
    ]
    assert missing[0] < 0.1 * missing[1]
    nearest = drawn.points[drawn.find_closest_point(ball.points[5])]
    np.testing.assert_allclose(nearest, ball.points[5], atol=1e-5)


def test_a_block_keeps_its_flat_faces_and_edges():
    series = pressed_series((4, 4, 4), 2)
    mesh = frame_mesh(series, series.frames[0])
    drawn = drawn_surface(mesh, np.zeros(mesh.n_points, dtype=np.float32))
    np.testing.assert_allclose(drawn.bounds, mesh.bounds, atol=1e-5)
    assert drawn.area == pytest.approx(
        mesh.extract_surface(algorithm="dataset_surface").area, rel=1e-5
    )


def test_a_section_fills_the_boundary_and_keeps_a_linear_field():
    series = pressed_series((4, 4, 4), 2)
    mesh = frame_mesh(series, series.frames[0])
    mesh.point_data["height_mm"] = np.asarray(mesh.points)[:, 2]
    whole = drawn_surface(mesh, np.zeros(mesh.n_points, dtype=np.float32))
    place = np.array([0.0, 0.3, 0.0])
    cap = section_cap(mesh, whole, "height_mm", place_mm=place, normal=np.array([0.0, -1.0, 0.0]))
    x0, x1, _, _, z0, z1 = mesh.bounds
    assert cap.area == pytest.approx((x1 - x0) * (z1 - z0), rel=1e-4)
    np.testing.assert_allclose(cap.point_data[SHOWN], cap.points[:, 2], atol=0.01)  # of 20 mm


def test_a_press_is_shown_where_the_tool_is_nearest_to_an_inclusion():
    series = pressed_series((8, 8, 8), 11)
    corners = series.nodes_m[series.cells]
    inside = (
        np.abs(corners.mean(axis=1) - [0.0, 0.0, 0.5 * series.nodes_m[:, 2].min()]) < 4e-3
    ).all(axis=1)
    assert not len(inclusions(corners, series.layer))  # the capsule lies around, not inside
    nodule = replace(
        series, layer=np.where(inside, 2, 0).astype(np.uint8), layer_names=("body", "", "nodule")
    )
    np.testing.assert_array_equal(inclusions(corners, nodule.layer), np.flatnonzero(inside))
    trace = _Trace(np.linspace(0.0, 1.0, 101))
    frame, why = moment_of_press(nodule, trace)
    assert frame.time_s == pytest.approx(0.3) and why == "the tool nearest to the nodule"
    most, why = moment_of_press(series, trace)
    moved = [np.linalg.norm(each.points["displacement_mm"], axis=1).max() for each in series.frames]
    assert most is series.frames[int(np.argmax(moved))] and "moved most" in why


class _Trace:
    """A tool that slides over x = 0 at 0.3 s."""

    def __init__(self, times):
        self.rows, self._times = times, times

    def __getitem__(self, name):
        assert name == "time_s"
        return self._times

    def vectors(self, name, unit):
        assert (name, unit) == ("tool", "mm")
        return np.column_stack(
            [60.0 * (self._times - 0.3), np.zeros_like(self._times), np.zeros_like(self._times)]
        )
