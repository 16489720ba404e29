"""Drawn organ: kept edges and normals, and values of nodes and of layers in a section."""

import numpy as np
import pytest
from fake_fields import pressed_series

from tissue.fem.fields import FieldSeries, Frame
from tissue.show.figures.organ_surface import SHOWN, drawn_surface
from tissue.show.figures.section import STRESS, Section, _section_stress
from tissue.simulation.vtk_files import frame_mesh

pyvista = pytest.importorskip("pyvista")


def test_a_block_keeps_its_flat_faces_and_edges():
    series = pressed_series((4, 4, 4), 2)
    mesh = frame_mesh(series, series.frames[0])
    drawn = drawn_surface(mesh, np.zeros(mesh.n_points, dtype=np.float32))
    np.testing.assert_allclose(drawn.bounds, mesh.bounds, atol=1e-5)
    assert drawn.area == pytest.approx(
        mesh.extract_surface(algorithm="dataset_surface").area, rel=1e-5
    )
    height = np.asarray(mesh.points, dtype=np.float32)[:, 2]
    drawn = drawn_surface(mesh, height)
    np.testing.assert_allclose(drawn.point_data[SHOWN], drawn.points[:, 2], atol=1e-5)


def test_the_stress_of_a_section_is_that_of_the_nearest_cell_of_the_layer():
    """A removed cell has no stress, and a layer without cells takes the nearest of any layer."""
    cells = np.arange(8 * 4).reshape(4, 8)
    corner = np.array(list(np.ndindex(2, 2, 2)), dtype=float)
    nodes_m = 1e-3 * np.vstack([corner + np.array([x, 0.0, 0.0]) for x in range(4)])
    series = FieldSeries(nodes_m, cells, np.array([0, 0, 1, 1], np.uint8), ("a", "b", "c"))
    frame = Frame(0.0, {}, {STRESS: np.array([1.0, np.nan, 3.0, 4.0])})
    layer = np.array([0, 0, 0, 0, 1, 1, 1, 1, 2, 2], np.uint8)[:, None]
    full = np.ones(layer.shape)
    section = Section(
        np.eye(3)[[0, 2, 1]], np.array([0.0, 0.5, 0.0]), 0, (0.0, 5.0, 0.0, 1.0), full, full, layer
    )
    found = _section_stress(series, frame, section)[:, 0]
    np.testing.assert_array_equal(found[:8], [1.0] * 4 + [3.0] * 2 + [4.0] * 2)
    assert np.isfinite(found[8:]).all()
