"""Signed distances filled with tetrahedra: volumes, surfaces and qualities against closed forms."""

import numpy as np
import pytest

from meshes.shapes.sdf import half_space, sphere
from meshes.tets.stuffing import cut_by, stuffed, with_part
from meshes.tets.tetrahedra import TetMesh, cell_faces, mean_ratio, pieces, pinched_edges

LEAST_QUALITY = 0.15
"""Moved nodes keep cells above it; cut cells of these shapes stay above it as well."""


def closed(mesh: TetMesh) -> None:
    """Faces conform, the surface is manifold and of one piece."""
    _, where, shared = cell_faces(mesh.cells)
    triangles, _, _ = cell_faces(mesh.cells)
    assert shared.max() == 2
    a, b, c = triangles.T
    winding = np.sign(b - a) * np.sign(c - b) * np.sign(a - c)
    assert (np.abs(np.bincount(where, weights=winding))[where[shared == 2]] == 0).all()
    assert len(pinched_edges(mesh.surface)) == 0
    assert pieces(mesh.cells).max() == 0


def test_a_ball_comes_to_its_volume_with_the_square_of_the_spacing() -> None:
    exact, error = 4.0 / 3.0 * np.pi * 0.05**3, []
    for spacing in (0.016, 0.008):
        mesh = stuffed(sphere(0.05), spacing)
        closed(mesh)
        # A manifold surface of genus 0 has twice as many triangles as nodes, less four (Euler).
        assert len(mesh.surface) == 2 * len(mesh.surface_nodes) - 4
        away = np.abs(np.linalg.norm(mesh.nodes_m[mesh.surface_nodes], axis=1) - 0.05)
        # Six steps of regula falsi on a function this smooth.
        assert away.max() < 1e-4 * spacing
        assert mean_ratio(mesh.nodes_m, mesh.cells).min() > LEAST_QUALITY
        error.append(1.0 - mesh.volumes_m3.sum() / exact)
    assert np.log2(error[0] / error[1]) == pytest.approx(2.0, abs=0.3)
    assert 0.0 < error[1] < 0.01


def test_a_cut_keeps_both_sides_and_every_bit_of_volume() -> None:
    mesh = stuffed(sphere(0.05), 0.012)
    nodes, cells, within, came = cut_by(
        mesh.nodes_m, mesh.cells, half_space((0.3, -0.2, 1.0), (0.0, 0.0, 0.007)).distance
    )
    both = TetMesh(nodes, cells)
    closed(both)
    # Nodes at the rim slide along the surface's edges, which only a little of the volume notices.
    assert both.volumes_m3.sum() == pytest.approx(mesh.volumes_m3.sum(), rel=0.01)
    signed = half_space((0.3, -0.2, 1.0), (0.0, 0.0, 0.007)).distance(nodes)
    assert signed[np.unique(cells[within])].max() < 1e-9
    assert signed[np.unique(cells[~within])].min() > -1e-9
    assert set(came.tolist()) == set(range(len(mesh.cells)))


def test_a_part_inside_has_a_separate_surface() -> None:
    mesh = with_part(stuffed(sphere(0.05), 0.008), sphere(0.018, (0.01, 0.0, 0.005)), "nodule")
    closed(mesh)
    assert mesh.part_names == ("body", "nodule")
    inside = TetMesh(mesh.nodes_m, mesh.cells[mesh.part == 1])
    away = np.linalg.norm(mesh.nodes_m[inside.surface_nodes] - [0.01, 0.0, 0.005], axis=1) - 0.018
    assert np.abs(away).max() < 1e-6
    assert inside.volumes_m3.sum() == pytest.approx(4.0 / 3.0 * np.pi * 0.018**3, rel=0.07)
    assert mean_ratio(mesh.nodes_m, mesh.cells).min() > LEAST_QUALITY
