"""Loads on tetrahedra: sums, moments, work on known displacements, and what is refused."""

import numpy as np
import pytest
from tet_bodies import distorted, faces_where
from tet_fields import isotropic, pressure

from meshes.base.errors import InputError
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.assembly import assemble, capsule_stiffness, gravity, traction
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

ORDERS = pytest.mark.parametrize("order", [1, 2])
FIELD = np.array([[0.3, -0.2, 0.5], [0.1, 0.7, -0.4], [-0.6, 0.2, 0.9]])


def moment(space, force):
    return np.cross(space.nodes_m, force).sum(axis=0)


@ORDERS
def test_pressure_all_around_has_neither_force_nor_moment(order):
    space = Space(distorted(3), order)
    load = pressure(space, 7.0)
    assert np.abs(load.sum(axis=0)).max() < 1e-13 and np.abs(moment(space, load)).max() < 1e-13


@ORDERS
def test_loads_do_the_work_of_a_linear_field(order):
    """Pressure: -p times the change of volume. Gravity and traction: what they do at the middle
    of a block.
    """
    space = Space(distorted(3), order)
    moved = space.nodes_m @ FIELD.T
    assert (pressure(space, 7.0) * moved).sum() == pytest.approx(-7.0 * np.trace(FIELD))
    pull = np.array([1.0, 2.0, -3.0])
    middle = np.full(3, 0.5)
    assert (gravity(space, density_kg_m3=1060.0) * moved).sum() == pytest.approx(
        -9.80665 * 1060.0 * (FIELD @ middle)[2]
    )
    top = faces_where(space, lambda x: x[:, 2] > 1.0 - 1e-9)
    found = (traction(space, pull, faces=top) * moved).sum()
    assert found == pytest.approx(pull @ FIELD @ [0.5, 0.5, 1.0])


def test_quadratic_loads_do_the_work_of_a_quadratic_field():
    """Quadratic loads do the work of a quadratic field.

    Traction (0, 0, 1) on the top of the unit cube times u_z = x^2, and weight times the same field,
    are 1/3 each.
    """
    space = Space(distorted(3), 2)
    moved = np.column_stack([0 * space.nodes_m[:, 0]] * 2 + [space.nodes_m[:, 0] ** 2])
    top = faces_where(space, lambda x: x[:, 2] > 1.0 - 1e-9)
    assert (traction(space, (0.0, 0.0, 1.0), faces=top) * moved).sum() == pytest.approx(
        1.0 / 3.0, rel=1e-12
    )
    assert (gravity(space, density_kg_m3=1.0) * moved).sum() == pytest.approx(
        -9.80665 / 3.0, rel=1e-12
    )


@ORDERS
def test_density_by_cell(order):
    space = Space(distorted(2), order)
    density = np.random.default_rng(0).uniform(500.0, 2000.0, space.cell_count)
    force = gravity(space, density_kg_m3=density).sum(axis=0)
    assert force == pytest.approx([0.0, 0.0, -9.80665 * density @ space.mesh.volumes_m3])


def test_what_cannot_be_used_is_refused():
    space = Space(distorted(2))
    for argument, bad in {
        "order": lambda: Space(space.mesh, 3),
        "poisson_ratio": lambda: capsule_stiffness(
            space, thickness_m=1e-4, young_Pa=1e6, poisson_ratio=0.5
        ),
        "elasticity": lambda: assemble(space, np.stack([isotropic(5e3, 0.4)] * 2)),
    }.items():
        with pytest.raises(InputError, match=argument):
            bad()


def test_a_body_far_from_the_origin_has_the_same_matrix():
    """A body far from the origin has the same matrix.

    Gradients come from differences of positions: 1 m away from a body of 1 m costs rounding alone.
    """
    mesh = distorted(3)
    near, far = (
        assemble(Space(TetMesh(mesh.nodes_m + shift, mesh.cells), 2), lame(5e3, 0.45)).data
        for shift in (0.0, 1.0)
    )
    assert np.abs(near - far).max() <= 1e-13 * np.abs(near).max()
