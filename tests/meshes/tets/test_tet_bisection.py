"""Bisection: conforming, the same body, as fine as asked, bounded shapes."""

import numpy as np
import pytest

from meshes.shapes.sdf import sphere
from meshes.tets.structured import box
from meshes.tets.stuffing import bisected, stuffed
from meshes.tets.tetrahedra import FACES, TetMesh


def longest_over_height(mesh: TetMesh) -> float:
    """Longest edge of a cell over its smallest height, the worst of all cells."""
    corners = mesh.nodes_m[mesh.cells]
    edge = np.max(
        [np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i in range(4) for j in range(i)],
        axis=0,
    )
    faces = corners[:, FACES]
    area = 0.5 * np.linalg.norm(
        np.cross(faces[:, :, 1] - faces[:, :, 0], faces[:, :, 2] - faces[:, :, 0]), axis=2
    )
    return float((edge * area.max(axis=1) / (3.0 * mesh.volumes_m3)).max())


@pytest.mark.parametrize("seed", range(2))
def test_a_shaken_box_refined_about_a_point(seed):
    """A shaken box refined about a point stays valid.

    Volume and surface area stay to rounding, every face is shared by two cells or lies outside, and
    edges obey their length.
    """
    random = np.random.default_rng(seed)
    coarse = box((1.0, 1.0, 0.5), (4, 4, 2))
    inside = (coarse.nodes_m > 0.01).all(axis=1) & (coarse.nodes_m < [0.99, 0.99, 0.49]).all(axis=1)
    nodes = (
        coarse.nodes_m + 0.05 * random.uniform(-1.0, 1.0, coarse.nodes_m.shape) * inside[:, None]
    )
    coarse = TetMesh(nodes, coarse.cells, (coarse.cells[:, 0] % 2).astype(np.uint8), ("one", "two"))
    centre = random.uniform(0.2, 0.8, 3) * [1.0, 1.0, 0.5]

    def size(at):
        return 0.05 + 0.4 * np.linalg.norm(at - centre, axis=1)

    fine = bisected(coarse, size)
    assert fine.volumes_m3.sum() == pytest.approx(0.5, rel=1e-12)
    for part in (0, 1):
        old, new = (
            coarse.volumes_m3[coarse.part == part].sum(),
            fine.volumes_m3[fine.part == part].sum(),
        )
        assert new == pytest.approx(old, rel=1e-12)
    faces = np.sort(fine.cells[:, FACES].reshape(-1, 3), axis=1)
    _, count = np.unique(faces, axis=0, return_counts=True)
    assert count.max() == 2
    a, b, c = (fine.nodes_m[fine.surface[:, i]] for i in range(3))
    assert 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() == pytest.approx(
        4.0, rel=1e-12
    )
    np.testing.assert_array_equal(fine.nodes_m[: len(coarse.nodes_m)], coarse.nodes_m)
    pairs = np.unique(
        np.sort(
            fine.cells[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2), axis=1
        ),
        axis=0,
    )
    length = np.linalg.norm(fine.nodes_m[pairs[:, 0]] - fine.nodes_m[pairs[:, 1]], axis=1)
    assert (length <= size(fine.nodes_m[pairs].mean(axis=1))).all()
    # Longest-edge halving creates few shapes; cells grow at most some times flatter than the first
    # ones.
    assert longest_over_height(fine) < 4.0 * longest_over_height(coarse)


def test_surface_nodes_go_onto_the_surface_that_the_mesh_stands_for():
    """Surface nodes move onto the surface that the mesh stands for.

    A divided ball of flat triangles keeps its missing volume; moved onto its sphere, it misses a
    volume that falls with the square of edges.
    """

    def onto(points):
        return points / np.linalg.norm(points, axis=1)[:, None]

    edges = (0.5, 0.25)
    coarse = stuffed(sphere(1.0), 0.6)
    whole, missing = 4.0 / 3.0 * np.pi, []
    for edge in edges:
        flat = bisected(coarse, lambda at, edge=edge: np.full(len(at), edge))
        assert flat.volumes_m3.sum() == pytest.approx(coarse.volumes_m3.sum(), rel=1e-9)
        round_ = bisected(coarse, lambda at, edge=edge: np.full(len(at), edge), onto=onto)
        assert np.linalg.norm(round_.nodes_m[round_.surface_nodes], axis=1) == pytest.approx(
            1.0, abs=1e-9
        )
        assert (round_.volumes_m3 > 0.0).all()
        missing.append(1.0 - round_.volumes_m3.sum() / whole)
    assert missing[-1] < edges[-1] * (1.0 - coarse.volumes_m3.sum() / whole)
    assert 2.5 < missing[0] / missing[1] < 6.0


def test_a_move_that_would_flatten_a_tetrahedron_is_not_made():
    """The top is to go through the bottom: it stays, and so does the box."""
    mesh = box((1.0, 1.0, 1.0), (2, 2, 2))
    found = bisected(mesh, lambda at: np.full(len(at), 0.6), onto=lambda at: at * [1.0, 1.0, -1.0])
    assert (found.volumes_m3 > 0.0).all() and found.volumes_m3.sum() == pytest.approx(1.0)
