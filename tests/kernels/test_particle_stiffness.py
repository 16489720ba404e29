"""Cell stiffness, its product, its assembly and its projection to a coarser grid.

The reference is plain NumPy and SciPy.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tooth_bodies import GAUSS, block, particle_stress

from tissue.fem.fields import principal_stresses, von_mises
from tissue.fem.solvers.held_body import rigid_modes
from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import (
    NO_SPRINGS,
    HexGrid,
    NodeSupports,
    ParticleSet,
    PointSprings,
    shape_values,
)
from tissue.models.tooth.stiffness import CellStiffness, full_cell_stiffness, strain_matrix

ROUNDING = 1e-13  # relative to the largest entry: sums of a few hundred terms in double precision


def random_body(seed=0, count=400, edge_m=1e-3):
    """Particles of random place, size, modulus and remaining fraction in a few cells."""
    random = np.random.default_rng(seed)
    particles = ParticleSet(
        random.uniform(0.0, 4.0, (count, 3)) * edge_m,
        random.uniform(0.2, 2.0, count) * edge_m**3 / 8.0,
        10.0 ** random.uniform(6.0, 11.0, count),
        random.uniform(0.0, 0.49, count),
        np.zeros(count, dtype=np.uint8),
        random.integers(0, 65536, count).astype(np.uint16),
    )
    return particles, HexGrid.around(particles.position_m, edge_m=edge_m)


def numpy_cells(particles, grid):
    """Every cell's sum of ``w B^T D B``, particle by particle."""
    cell, place = grid.locate(particles.position_m)
    total = np.zeros((grid.cell_count, 24, 24))
    weight = particles.volume_m3 * particles.remaining / 65535.0
    for p, (c, at) in enumerate(zip(cell, place, strict=True)):
        first, shear = particles.lame_Pa[p]
        total[c] += full_cell_stiffness(
            grid.edge_m, at[None], weight[p : p + 1], first_Pa=first, shear_Pa=shear
        )
    return total


def scattered(cells):
    """Dense assembled matrix from the cells' full matrices."""
    grid = cells.grid
    total = np.zeros((3 * grid.node_count,) * 2)
    for nodes, matrix in zip(grid.cell_nodes, cells.cell_matrices(), strict=True):
        rows = (3 * nodes[:, None] + np.arange(3)).ravel()
        total[np.ix_(rows, rows)] += matrix
    return total


def random_springs(position_m, count=30):
    """Springs in any direction at some of these points, as stiff as the softer particles."""
    random = np.random.default_rng(5)
    half = 300.0 * random.normal(size=(count, 3, 3))
    return PointSprings(position_m[:count], half @ half.transpose(0, 2, 1))


def test_cells_against_numpy():
    particles, grid = random_body()
    found = CellStiffness(particles, grid, inner_strength=0.0).cell_matrices()
    wanted = numpy_cells(particles, grid)
    assert np.abs(found - wanted).max() <= ROUNDING * np.abs(wanted).max()


def test_full_cell_is_symmetric_to_the_bit_with_six_rigid_modes():
    particles, grid = block((2, 2, 2), 1e-3, modulus_Pa=84e9)
    matrices = CellStiffness(particles, grid, inner_strength=1.0).cell_matrices()
    assert np.array_equal(matrices, matrices.transpose(0, 2, 1))
    bare = CellStiffness(particles, grid, inner_strength=0.0).cell_matrices()
    assert np.abs(matrices - bare).max() <= ROUNDING * np.abs(matrices).max()
    values = np.linalg.eigvalsh(matrices[0])
    assert np.abs(values[:6]).max() < 1e-13 * values[-1] and values[6] > 1e-3 * values[-1]
    rigid = rigid_modes(grid.node_position_m[grid.cell_nodes[0]], np.zeros(3)).reshape(24, 6)
    assert np.abs(matrices[0] @ rigid).max() <= ROUNDING * np.abs(matrices[0]).max()


def test_a_single_particle_leaves_twelve_more_modes_that_the_inner_stiffness_closes():
    particles = ParticleSet.uniform(np.full((1, 3), 0.3e-3), volume_m3=1e-10, modulus_Pa=18.6e9)
    grid = HexGrid.around(particles.position_m, edge_m=1e-3, origin_m=np.zeros(3))
    for strength, rank in ((0.0, 6), (1.0, 18)):
        values = np.linalg.eigvalsh(
            CellStiffness(particles, grid, inner_strength=strength).cell_matrices()[0]
        )
        assert int((values > 1e-10 * values[-1]).sum()) == rank


def test_inner_stiffness_vanishes_on_linear_fields():
    """Energy of a random linear field: that of the particles alone."""
    particles, grid = random_body(seed=2)
    field = np.random.default_rng(1).normal(size=(3, 3))
    moved = grid.node_position_m @ field.T
    plain = CellStiffness(particles, grid, inner_strength=0.0).product(moved)
    closed = CellStiffness(particles, grid, inner_strength=1.0).product(moved)
    assert np.abs(plain - closed).max() <= 1e-12 * np.abs(plain).max()


def test_product_and_rows_against_the_scattered_matrix():
    particles, grid = random_body(seed=1)
    supports = NodeSupports.of(grid.node_count, held=grid.node_place[:, 2] == 0)
    body = ParticleBody(particles, grid, supports)
    body.cells.set_live(np.ones(grid.cell_count, dtype=bool))
    wanted = scattered(body.cells)
    vector = np.random.default_rng(0).normal(size=(grid.node_count, 3))
    product = body.cells.product(vector).ravel()
    assert np.abs(product - wanted @ vector.ravel()).max() <= 1e-12 * np.abs(product).max()

    body._hierarchy.update(np.arange(grid.cell_count, dtype=np.int32))
    free = ~supports.fixed.ravel()
    wanted = wanted * np.outer(free, free)
    rows = body.matrix()
    assert np.abs(rows.toarray() - wanted).max() <= ROUNDING * np.abs(wanted).max()


def test_springs_at_points_add_their_stiffness():
    """Springs at points add their stiffness.

    It is sum N^T S N over the points, with N the shape functions at each; their reaction is that
    product.
    """
    particles, grid = random_body(seed=4)
    springs = random_springs(particles.position_m)
    bare, sprung = (
        CellStiffness(particles, grid, inner_strength=0.1, springs=s) for s in (NO_SPRINGS, springs)
    )
    cell, place = grid.locate(springs.position_m)
    shape = np.zeros((len(cell), grid.node_count))
    np.put_along_axis(shape, grid.cell_nodes[cell], shape_values(place), axis=1)
    added = np.einsum("kp,kij,kq->piqj", shape, springs.stiffness_N_m, shape).reshape(
        (3 * grid.node_count,) * 2
    )
    found = scattered(sprung) - scattered(bare)
    assert np.abs(found - added).max() <= 1e-12 * np.abs(scattered(sprung)).max()


def test_coarse_grid_is_the_galerkin_projection():
    """Coarse cells summed from their children against P^T A P of the assembled matrix."""
    particles, grid = block(
        (6, 5, 7), 1e-3, modulus_Pa=lambda x: np.where(x[:, 0] < 2.5e-3, 2e6, 84e9)
    )
    supports = NodeSupports.of(grid.node_count, held=grid.node_place[:, 2] == 0)
    body = ParticleBody(particles, grid, supports, springs=random_springs(particles.position_m))
    coarse = body._hierarchy.coarser[0]
    places = grid.node_place / 2.0
    cell = np.minimum(np.floor(places), coarse.grid.cell_place.max(axis=0)).astype(int)
    weights = shape_values(places - cell)
    nodes = coarse.grid.cell_nodes[coarse.grid.find_cells(cell)]
    interpolation = np.zeros((grid.node_count, coarse.grid.node_count))
    np.put_along_axis(interpolation, nodes, weights, axis=1)
    dense = np.kron(interpolation, np.eye(3)) * ~supports.fixed.reshape(-1, 1)
    wanted = dense.T @ body.matrix().toarray() @ dense
    assert np.abs(coarse.matrix().toarray() - wanted).max() <= 1e-12 * np.abs(wanted).max()


def test_strain_matrix_of_gauss_points_sums_to_the_volume():
    """A uniform stretch has energy modulus x volume / 2 (Poisson's ratio 0)."""
    edge = 2e-3
    stretch = np.zeros((8, 3))
    stretch[4:, 0] = edge
    total = full_cell_stiffness(edge, GAUSS, np.full(8, edge**3 / 8), first_Pa=0.0, shear_Pa=0.5e9)
    assert stretch.ravel() @ total @ stretch.ravel() == pytest.approx(1e9 * edge**3, rel=1e-12)
    assert np.allclose(
        strain_matrix(np.full(3, 0.5), edge) @ stretch.ravel(), [1, 0, 0, 0, 0, 0], atol=1e-12
    )


def deformed():
    random = np.random.default_rng(0)
    particles, grid = block(
        (3, 2, 2), 1e-3, modulus_Pa=lambda x: 10.0 ** random.uniform(6, 11, len(x))
    )
    body = ParticleBody(
        particles, grid, NodeSupports.of(grid.node_count, held=grid.node_place[:, 2] == 0)
    )
    return body, 1e-6 * random.normal(size=(grid.node_count, 3))


def test_particle_stress_against_numpy():
    body, moved = deformed()
    grid, edge = body.grid, body.grid.edge_m
    found = particle_stress(body.cells, moved)
    cell, place = grid.locate(body.particles.position_m)
    nodes = moved[grid.cell_nodes[cell]]
    step = 1e-7
    from tissue.models.tooth.grid import shape_values

    gradient = np.stack(
        [
            np.einsum(
                "pa,pai->pi",
                shape_values(place + step * axis) - shape_values(place - step * axis),
                nodes,
            )
            / (2.0 * step * edge)
            for axis in np.eye(3)
        ],
        axis=2,
    )
    strain = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    first, shear = body.particles.lame_Pa.T[:, :, None, None]
    stress = 2.0 * shear * strain + first * np.trace(strain, axis1=1, axis2=2)[
        :, None, None
    ] * np.eye(3)
    order = ([0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1])
    # 1e-7 of it: the central difference of a cubic, and rounding
    scale = np.abs(stress).max(axis=(1, 2))[:, None]
    assert (np.abs(found - stress[:, *order]) <= 1e-7 * scale).all()
    assert (
        np.abs(principal_stresses(found) - np.linalg.eigvalsh(stress)[:, ::-1]) <= 1e-6 * scale
    ).all()
    deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    assert np.allclose(von_mises(found), np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))), rtol=1e-6)


@pytest.mark.parametrize(
    "wanted",
    [(2.0, -1.0, -1.0), (1.0, 1.0, -2.0), (3.0, 0.0, 0.0), (5.0, 2.0, -4.0), (0.0, 0.0, 0.0)],
)
def test_principal_stresses_of_turned_tensors(wanted):
    """The principal stresses of 2,000 turned tensors are those of the tensor before."""
    turns = Rotation.random(2000, random_state=0).as_matrix()
    stress = np.einsum("nij,j,nkj->nik", turns, wanted, turns)
    found = principal_stresses(stress[:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]])
    # rounding of eigvalsh for entries up to 5
    assert found == pytest.approx(np.broadcast_to(wanted, (2000, 3)), abs=1e-13)
