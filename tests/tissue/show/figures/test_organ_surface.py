"""Drawn organ: no facets, kept edges, and a section with values."""

import numpy as np
import pytest
from fake_fields import pressed_series

from tissue.show.figures.organ_surface import SHOWN, drawn_surface, section_cap
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
