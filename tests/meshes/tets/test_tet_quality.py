"""Bad tetrahedra: counted, located, repaired by the stated rule or refused."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.tets.quality import FLAT, SLIVER, repair_tets
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh, flatness, mean_ratio, pinched_edges
from meshes.tets.tetrahedralise import crossing_triangles

REGULAR = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])


@pytest.fixture
def cube() -> TetMesh:
    return box((0.1, 0.1, 0.1), (4, 4, 4))


def test_mean_ratio_of_known_tetrahedra() -> None:
    cell = np.array([[0, 1, 3, 2]])
    sign = np.sign(mean_ratio(REGULAR, cell)[0])
    assert sign * mean_ratio(REGULAR, cell)[0] == pytest.approx(1.0, rel=1e-14)
    # Corner of a cube: volume 1/6, squared edges 1, 1, 1, 2, 2, 2.
    corner = np.vstack([np.zeros(3), np.eye(3)])
    assert mean_ratio(corner, np.array([[0, 1, 2, 3]]))[0] == pytest.approx(
        12.0 * 0.5 ** (2 / 3) / 9.0, rel=1e-14
    )
    assert mean_ratio(corner, np.array([[0, 2, 1, 3]]))[0] < 0.0
    assert flatness(REGULAR, cell)[0] == pytest.approx(np.sqrt(0.5), rel=1e-14)


def test_a_good_mesh_is_left_as_it_is(cube: TetMesh) -> None:
    mesh, report = repair_tets(cube.nodes_m, cube.cells)
    assert np.array_equal(mesh.nodes_m[mesh.cells], cube.nodes_m[cube.cells])
    assert len(report.sentences()) == 1
    assert "384 tetrahedra on 125 nodes, 1000 ml" in report.sentences()[0]


def test_inverted_cells_are_turned_counted_and_located(cube: TetMesh) -> None:
    cells = cube.cells.copy()
    cells[[17, 200, 301]] = cells[[17, 200, 301]][:, [1, 0, 2, 3]]
    mesh, report = repair_tets(cube.nodes_m, cells)
    assert report.inverted == 3
    assert report.inverted_at_mm == pytest.approx(1e3 * cube.nodes_m[cells[17]].mean(axis=0))
    assert mesh.volumes_m3.sum() == pytest.approx(1e-3, rel=1e-12)
    assert any("Turned 3 inverted" in sentence for sentence in report.sentences())


def test_a_mesh_that_folds_over_itself_is_refused_with_the_place(cube: TetMesh) -> None:
    nodes = cube.nodes_m.copy()
    inner = int(np.argmin(np.linalg.norm(nodes - 0.05, axis=1)))
    nodes[inner] += [0.04, 0.0, 0.0]
    with pytest.raises(InputError, match=r"both cells on one side, the first at \(.*\) mm"):
        repair_tets(nodes, cube.cells)


def test_a_flat_cell_on_the_surface_is_dropped(cube: TetMesh) -> None:
    # A cell laid over a square of the top face closes it without volume.
    top = np.flatnonzero(np.isclose(cube.nodes_m[:, 2], 0.1))
    at = cube.nodes_m[top]
    square = [
        int(top[np.argmin(np.linalg.norm(at - p, axis=1))])
        for p in ([0.025, 0.025, 0.1], [0.05, 0.025, 0.1], [0.05, 0.05, 0.1], [0.025, 0.05, 0.1])
    ]
    mesh, report = repair_tets(cube.nodes_m, np.vstack([cube.cells, [square]]))
    assert report.flat_dropped == 1
    assert len(mesh.cells) == len(cube.cells)
    assert len(mesh.surface) == len(cube.surface)


def test_a_flat_cell_inside_gets_volume_by_moving_its_nodes() -> None:
    good = box((0.1, 0.1, 0.1), (4, 4, 4))
    nodes = good.nodes_m.copy()
    inner = int(np.argmin(np.linalg.norm(nodes - 0.05, axis=1)))
    others = good.cells[(good.cells == inner).any(axis=1)]
    face = others[0][others[0] != inner]
    nodes[inner] = nodes[face].mean(axis=0)
    mesh, report = repair_tets(nodes, good.cells)
    assert report.flat_moved == int((flatness(nodes, good.cells) < FLAT).sum()) > 0
    assert report.slivers_left == 0
    assert mesh.volumes_m3.sum() == pytest.approx(1e-3, rel=1e-12)
    assert np.array_equal(mesh.surface, good.surface)


def test_a_flat_cell_that_nothing_mends_is_refused() -> None:
    # Two solid cells about a flat one whose nodes all lie on the surface: without it the mesh falls
    # apart.
    nodes = (
        np.array(
            [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.2, 1], [0.5, 0.8, -1.0]],
            dtype=float,
        )
        * 0.1
    )
    cells = np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 3, 5]])
    with pytest.raises(
        InputError, match=r"got 1 flat tetrahedra of 3 that neither dropping nor moving"
    ):
        repair_tets(nodes, cells)


def test_a_sliver_inside_is_counted_located_and_mended() -> None:
    good = box((0.1, 0.1, 0.1), (4, 4, 4))
    nodes = good.nodes_m.copy()
    inner = int(np.argmin(np.linalg.norm(nodes - 0.05, axis=1)))
    around = good.cells[(good.cells == inner).any(axis=1)]
    face = around[0][around[0] != inner]
    nodes[inner] += 0.998 * (nodes[face].mean(axis=0) - nodes[inner])
    worst = good.cells[int(mean_ratio(nodes, good.cells).argmin())]
    mesh, report = repair_tets(nodes, good.cells)
    assert report.slivers == int((mean_ratio(nodes, good.cells) < SLIVER).sum()) > 0
    assert report.sliver_at_mm == pytest.approx(1e3 * nodes[worst].mean(axis=0))
    assert report.slivers_left == 0
    assert mean_ratio(mesh.nodes_m, mesh.cells).min() > SLIVER


def test_a_sliver_on_the_surface_is_kept_and_reported() -> None:
    corner = np.vstack([np.zeros(3), 0.05 * np.eye(3)])
    corner[3] *= 0.01
    _, report = repair_tets(corner, np.array([[0, 1, 2, 3]]))
    assert (report.slivers, report.slivers_left, report.nodes_moved) == (1, 1, 0)
    assert any(
        "Found 1 slivers" in sentence and "left 1" in sentence for sentence in report.sentences()
    )


def test_debris_is_dropped_with_its_volume(cube: TetMesh) -> None:
    crumb = 1e-4 * REGULAR + 0.3
    nodes = np.vstack([cube.nodes_m, crumb])
    mesh, report = repair_tets(nodes, np.vstack([cube.cells, [[125, 126, 127, 128]]]))
    # A regular tetrahedron in a cube of side 0.2 mm has a third of its volume.
    assert report.debris_mm3 == pytest.approx((0.2**3 / 3.0,), rel=1e-9)
    assert not any("bodies" in sentence for sentence in report.sentences())
    assert len(mesh.nodes_m) == 125


def test_two_bodies_are_kept_and_reported(cube: TetMesh) -> None:
    nodes = np.vstack([cube.nodes_m, np.array([0.2, 0.0, 0.0]) + cube.nodes_m])
    _, report = repair_tets(nodes, np.vstack([cube.cells, cube.cells + 125]))
    assert any("2 bodies" in sentence for sentence in report.sentences())


def test_coincident_nodes_are_joined_and_repeated_cells_dropped(cube: TetMesh) -> None:
    apart = cube.nodes_m[cube.cells].reshape(-1, 3)
    cells = np.arange(len(apart)).reshape(-1, 4)
    mesh, report = repair_tets(apart, np.vstack([cells, cells[:5]]))
    assert len(mesh.nodes_m) == 125
    assert report.repeated_cells == 5
    assert len(mesh.surface) == len(cube.surface)


def test_a_pinched_edge_is_reported() -> None:
    # Two boxes that share an edge and no face.
    one = box((0.1, 0.1, 0.1), (1, 1, 1))
    nodes = np.vstack([one.nodes_m, np.array([0.1, 0.1, 0.0]) + one.nodes_m])
    mesh, report = repair_tets(nodes, np.vstack([one.cells, one.cells + 8]))
    assert len(pinched_edges(mesh.surface)) == 1
    assert any(
        "Kept 1 surface edges" in sentence and "(100, 100, 50) mm" in sentence
        for sentence in report.sentences()
    )
    assert any("2 bodies" in sentence for sentence in report.sentences())


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda n, c: (np.where(np.arange(len(n))[:, None] == 3, np.nan, n), c),
            "nodes must be finite, got 1 of 125",
        ),
        (lambda n, c: (n, c + 1), "cells must name nodes 0 to 124"),
        (lambda n, c: (n, c[:0]), "cells must be tetrahedra"),
        (
            lambda n, c: (
                np.vstack([n, [[0.05, 0.05, 0.5]]]),
                np.vstack([c, np.append(_middle(n, c)[:3], 125)]),
            ),
            "two at a face",
        ),
    ],
)
def test_what_is_no_mesh_is_refused(cube: TetMesh, spoil: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        repair_tets(*spoil(cube.nodes_m, cube.cells))  # type: ignore[operator]


def test_triangles_that_cross_are_found_and_others_are_not() -> None:
    one = box((0.1, 0.1, 0.1), (2, 2, 2))
    assert len(crossing_triangles(one.nodes_m, one.surface)) == 0
    shift = [0.053, 0.061, 0.047]
    both = np.vstack([one.nodes_m, one.nodes_m + shift])
    faces = np.vstack([one.surface, one.surface + len(one.nodes_m)])
    found = crossing_triangles(both, faces)
    brute = [
        k
        for k, face in enumerate(faces)
        if any(
            _crosses(both[face], both[[f[i], f[i - 1]]])
            for f in faces
            for i in range(3)
            if not set(f) & set(face)
        )
    ]
    assert len(found) > 0
    assert found.tolist() == brute


def _middle(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Corners of the cell nearest the middle of the cube."""
    return cells[int(np.linalg.norm(nodes[cells].mean(axis=1) - 0.05, axis=1).argmin())]


def _crosses(triangle: np.ndarray, edge: np.ndarray) -> bool:
    """Return True if a segment crosses a triangle, by Cramer's rule for the crossing point."""
    a, b, c = triangle
    matrix = np.column_stack([b - a, c - a, edge[0] - edge[1]])
    if abs(np.linalg.det(matrix)) < 1e-18:
        return False
    u, v, t = np.linalg.solve(matrix, edge[0] - a)
    return bool(u > 0.0 and v > 0.0 and u + v < 1.0 and 0.0 < t < 1.0)
