"""Bad tetrahedra: counted, located, repaired by the stated rule or refused."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.tets.quality import FLAT, SLIVER, describe, repair_tets
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh, flatness, mean_ratio, pinched_edges

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


def inner_node(mesh: TetMesh) -> int:
    """Node in the middle of the cube."""
    return int(np.argmin(np.linalg.norm(mesh.nodes_m - 0.05, axis=1)))


def lowered(mesh: TetMesh, share: float) -> np.ndarray:
    """Nodes with the middle one moved by a share of its distance to the face of a cell."""
    nodes = mesh.nodes_m.copy()
    inner = inner_node(mesh)
    cell = mesh.cells[(mesh.cells == inner).any(axis=1)][0]
    nodes[inner] += share * (nodes[cell[cell != inner]].mean(axis=0) - nodes[inner])
    return nodes


def at_mm(points_m: np.ndarray) -> str:
    return f"({', '.join(f'{x:.3g}' for x in 1e3 * points_m.mean(axis=0))}) mm"


def test_a_good_mesh_is_left_as_it_is(cube: TetMesh) -> None:
    mesh, repairs = repair_tets(cube.nodes_m, cube.cells)
    assert np.array_equal(mesh.nodes_m[mesh.cells], cube.nodes_m[cube.cells])
    assert repairs == ()
    (described,) = describe(mesh)
    assert "384 tetrahedra on 125 nodes, 1000 ml" in described


def test_inverted_cells_are_turned_counted_and_located(cube: TetMesh) -> None:
    cells = cube.cells.copy()
    cells[[17, 200, 301]] = cells[[17, 200, 301]][:, [1, 0, 2, 3]]
    mesh, (repair,) = repair_tets(cube.nodes_m, cells)
    assert "3 inverted" in repair and at_mm(cube.nodes_m[cells[17]]) in repair
    assert mesh.volumes_m3.sum() == pytest.approx(1e-3, rel=1e-12)


def test_a_flat_cell_on_the_surface_is_dropped(cube: TetMesh) -> None:
    # A cell laid over a square of the top face closes it without volume.
    corners = ([0.025, 0.025, 0.1], [0.05, 0.025, 0.1], [0.05, 0.05, 0.1], [0.025, 0.05, 0.1])
    square = [int(np.linalg.norm(cube.nodes_m - p, axis=1).argmin()) for p in corners]
    mesh, (repair,) = repair_tets(cube.nodes_m, np.vstack([cube.cells, [square]]))
    assert "Dropped 1 flat" in repair
    assert len(mesh.cells) == len(cube.cells)
    assert len(mesh.surface) == len(cube.surface)


@pytest.mark.parametrize("share", [1.0, 0.998], ids=["flat", "sliver"])
def test_a_bad_cell_inside_gets_volume_by_moving_its_nodes(cube: TetMesh, share: float) -> None:
    nodes = lowered(cube, share)
    quality = mean_ratio(nodes, cube.cells)
    flat = int((flatness(nodes, cube.cells) < FLAT).sum())
    mesh, repairs = repair_tets(nodes, cube.cells)
    text = " ".join(repairs)
    assert (f"{flat} flat tetrahedra inside" in text) == (share == 1.0) == (flat > 0)
    assert f"{int((quality < SLIVER).sum())} slivers" in text and "0 slivers remained" in text
    if not flat:
        assert at_mm(nodes[cube.cells[quality.argmin()]]) in text
    assert mean_ratio(mesh.nodes_m, mesh.cells).min() > SLIVER
    assert mesh.volumes_m3.sum() == pytest.approx(1e-3, rel=1e-12)
    assert np.array_equal(mesh.surface, cube.surface)


def test_debris_is_dropped_with_its_volume(cube: TetMesh) -> None:
    crumb = 1e-4 * REGULAR + 0.3
    nodes = np.vstack([cube.nodes_m, crumb])
    mesh, repairs = repair_tets(nodes, np.vstack([cube.cells, [[125, 126, 127, 128]]]))
    # A regular tetrahedron in a cube of side 0.2 mm has a third of its volume.
    assert f"largest {0.2**3 / 3.0:.3g} mm3" in repairs[-1]
    assert len(mesh.nodes_m) == 125


@pytest.mark.parametrize(("shift", "pinched"), [((0.2, 0.0, 0.0), 0), ((0.1, 0.1, 0.0), 1)])
def test_two_bodies_and_the_edge_they_share_are_kept_and_reported(shift, pinched) -> None:
    one = box((0.1, 0.1, 0.1), (1, 1, 1))
    nodes = np.vstack([one.nodes_m, np.array(shift) + one.nodes_m])
    mesh, _ = repair_tets(nodes, np.vstack([one.cells, one.cells + 8]))
    text = " ".join(describe(mesh))
    assert "2 bodies" in text
    assert len(pinched_edges(mesh.surface)) == pinched
    assert ("Kept 1 surface edges" in text and "(100, 100, 50) mm" in text) == (pinched == 1)


def test_coincident_nodes_are_joined_and_repeated_cells_dropped(cube: TetMesh) -> None:
    apart = cube.nodes_m[cube.cells].reshape(-1, 3)
    cells = np.arange(len(apart)).reshape(-1, 4)
    mesh, repairs = repair_tets(apart, np.vstack([cells, cells[:5]]))
    assert len(mesh.nodes_m) == 125
    assert "Dropped 5 tetrahedra" in repairs[1]
    assert len(mesh.surface) == len(cube.surface)


def folded(nodes: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cube whose middle node is pulled through its neighbours."""
    nodes = nodes.copy()
    nodes[np.argmin(np.linalg.norm(nodes - 0.05, axis=1))] += [0.04, 0.0, 0.0]
    return nodes, cells


def unmendable(nodes: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two solid cells about a flat one, without which the mesh falls apart."""
    nodes = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.2, 1], [0.5, 0.8, -1.0]]
    return 0.1 * np.array(nodes), np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 3, 5]])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda n, c: (np.where(np.arange(len(n))[:, None] == 3, np.nan, n), c),
            "nodes must be finite, got 1 of 125",
        ),
        (lambda n, c: (n, c + 1), "cells must refer to the nodes 0 to 124"),
        (lambda n, c: (n, c[:0]), "cells must be tetrahedra"),
        (
            lambda n, c: (
                np.vstack([n, [[0.05, 0.05, 0.5]]]),
                np.vstack([c, np.append(_middle(n, c)[:3], 125)]),
            ),
            "share each face with at most one other cell",
        ),
        (folded, r"both cells on the same side, the first at \(.*\) mm"),
        (unmendable, "got 1 of 3 cells that are flat"),
    ],
)
def test_what_is_no_mesh_is_refused(cube: TetMesh, spoil: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        repair_tets(*spoil(cube.nodes_m, cube.cells))  # type: ignore[operator]


def _middle(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Corners of the cell nearest the middle of the cube."""
    return cells[int(np.linalg.norm(nodes[cells].mean(axis=1) - 0.05, axis=1).argmin())]
