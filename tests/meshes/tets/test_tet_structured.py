"""Structured tetrahedral meshes against the volumes and areas of the bodies they fill."""

import numpy as np
import pytest
from round_bodies import sphere_shell

from meshes.tets.structured import box, graded
from meshes.tets.tetrahedra import TetMesh, cell_faces, pieces, pinched_edges


def area(mesh: TetMesh) -> float:
    """Area of the surface [m2]."""
    a, b, c = (mesh.nodes_m[mesh.surface[:, k]] for k in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def closed_and_conforming(mesh: TetMesh) -> None:
    """Check that a mesh is closed and conforming.

    Every face has one cell, or two on opposite sides; the surface encloses the volume and has no
    odd edge.
    """
    _, _, shared = cell_faces(mesh.cells)
    assert shared.max() == 2
    assert len(pinched_edges(mesh.surface)) == 0
    assert pieces(mesh.cells).max() == 0
    a, b, c = (mesh.nodes_m[mesh.surface[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0 == pytest.approx(
        mesh.volumes_m3.sum(), rel=1e-12
    )


def test_a_box_is_filled_exactly_by_six_tetrahedra_a_brick() -> None:
    mesh = box((0.1, 0.2, 0.3), (2, 3, 4))
    assert len(mesh.cells) == 6 * 24
    assert len(mesh.nodes_m) == 3 * 4 * 5
    assert mesh.volumes_m3.sum() == pytest.approx(0.006, rel=1e-13)
    # Kuhn's six simplices of a brick have one volume.
    assert np.ptp(mesh.volumes_m3) < 1e-12 * mesh.volumes_m3[0]
    assert area(mesh) == pytest.approx(2.0 * (0.02 + 0.03 + 0.06), rel=1e-13)
    closed_and_conforming(mesh)


def test_a_hollow_sphere_comes_to_its_volume_with_the_square_of_the_cell_size() -> None:
    exact = 0.125 * 4.0 / 3.0 * np.pi * (2.0**3 - 1.0)
    error = []
    for n in (4, 8):
        mesh = sphere_shell(1.0, 2.0, (n, n), octants=1)
        closed_and_conforming(mesh)
        error.append(abs(mesh.volumes_m3.sum() / exact - 1.0))
    whole = sphere_shell(1.0, 2.0, (4, 4), octants=8)
    closed_and_conforming(whole)
    assert abs(whole.volumes_m3.sum() / (8.0 * exact) - 1.0) == pytest.approx(error[0], rel=1e-9)
    # Nothing but the two spheres bounds a whole shell: patches and images conform.
    radius = np.linalg.norm(whole.nodes_m[whole.surface_nodes], axis=1)
    assert np.minimum(np.abs(radius - 1.0), np.abs(radius - 2.0)).max() < 1e-12
    # Chords of angle h miss the sphere by h^2 / 8: order 2, with 0.1 for what is not asymptotic
    # yet.
    assert np.log2(error[0] / error[1]) == pytest.approx(2.0, abs=0.1)
    assert error[1] < 0.005


def test_graded_positions_start_small_grow_and_meet_the_end() -> None:
    at = graded(0.0, -0.04, 0.0025, 1.2)
    steps = -np.diff(at)
    assert at[0] == 0.0
    assert at[-1] == -0.04
    assert np.allclose(steps[1:] / steps[:-1], 1.2)
    assert 0.5 * 0.0025 < steps[0] <= 0.0025
