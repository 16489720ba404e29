"""Springs of a tooth to the ground: their forces and their stiffness.

They are compared with a rigid motion, written out.
"""

import numpy as np
import pytest
from tooth_bodies import block

from tissue.models.tooth.grid import PointSprings


def springs(count=7):
    rng = np.random.default_rng(0)
    half = rng.normal(size=(count, 3, 3))
    stiffness = 1e4 * half @ half.transpose(0, 2, 1)
    return PointSprings(
        rng.uniform(0.1, 2.9, (count, 3)) * 1e-3, 0.5 * (stiffness + stiffness.transpose(0, 2, 1))
    )


def test_the_restraint_is_the_energy_of_rigid_motions():
    """The restraint is the energy of rigid motions.

    u = t + w x (x - c) at each spring: twice the energy is sum u S u; rotations are in units of 1 /
    length.
    """
    given = springs()
    centre = np.array([2e-3, -1e-3, 4e-3])
    length = 5e-3
    restraint = given.restraint(centre, length)
    assert restraint == pytest.approx(restraint.T)
    for motion in np.random.default_rng(1).normal(size=(10, 6)):
        shift = motion[:3]
        turn = motion[3:] / length
        moved = [shift + np.cross(turn, at - centre) for at in given.position_m]
        twice = sum(u @ each @ u for u, each in zip(moved, given.stiffness_N_m, strict=True))
        assert motion @ restraint @ motion == pytest.approx(twice, rel=1e-10)


def test_blocks_by_cell_add_up_to_the_same_forces():
    """Blocks by cell add up to equal forces.

    The springs of a cell act on its eight nodes: sum over b of N_a N_b S u_b, upper blocks and
    their transposes.
    """
    _, grid = block((3, 3, 3), 1e-3)
    given = springs(40)
    nodes = np.random.default_rng(3).normal(size=(4**3, 3))
    cells, blocks = given.by_cell(grid)
    assert cells.tolist() == sorted(set(cells.tolist())) and 5 < len(cells) < 27
    moved = np.array(moved_at(given, grid, nodes))
    energy = np.einsum("ki,kij,kj->", moved, given.stiffness_N_m, moved)
    total = 0.0
    row = 0
    for a in range(8):
        for b in range(a, 8):
            ends = nodes[grid.cell_nodes[cells][:, a]], nodes[grid.cell_nodes[cells][:, b]]
            part = np.einsum("ki,kij,kj->", ends[0], blocks[:, row], ends[1])
            total = total + part * (1.0 if a == b else 2.0)
            row = row + 1
    assert row == blocks.shape[1]
    assert total == pytest.approx(energy, rel=1e-10)


def moved_at(given, grid, nodes):
    """Displacement at the springs by trilinear weights that are written out."""
    found = []
    for at in given.position_m / 1e-3:
        low = np.floor(at).astype(int)
        part = at - low
        value = np.zeros(3)
        for corner in np.ndindex(2, 2, 2):
            node = np.flatnonzero(
                (np.rint(grid.node_position_m / 1e-3).astype(int) == low + corner).all(axis=1)
            )[0]
            value += np.prod(np.where(corner, part, 1.0 - part)) * nodes[node]
        found.append(value)
    return np.array(found)


def test_nodes_of_the_coarse_grid_are_nodes_of_the_fine_one():
    _, grid = block((4, 6, 2), 1e-3)
    coarse, of_cell = grid.coarse()
    fine = {tuple(each) for each in np.rint(grid.node_position_m * 1e6).astype(int).tolist()}
    assert {
        tuple(each) for each in np.rint(coarse.node_position_m * 1e6).astype(int).tolist()
    } <= fine
    assert coarse.edge_m == 2e-3 and np.array_equal(np.bincount(of_cell), np.full(6, 8))
