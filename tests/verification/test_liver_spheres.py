"""Spheres under pressure: Lame's (validation case 3), and one with a capsule around it."""

import numpy as np
import pytest
from round_bodies import sphere_shell
from tet_bodies import faces_where, planes, solve_iteratively
from tet_fields import node_stress, pressure

from tissue.fem.assembly import assemble
from tissue.fem.capsule import capsule_stiffness
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

YOUNG, RATIO = 1000.0, 0.3


def pressed_octant(cells, order, *, capsule=None):
    """Return the octant of a hollow sphere of radii 1 and 2, pressed from inside by 1 Pa.

    The result is space and displacement.
    """
    space = Space(sphere_shell(1.0, 2.0, cells), order)
    matrix = assemble(space, lame(YOUNG, RATIO))
    if capsule is not None:
        matrix = matrix + capsule_stiffness(space, faces=wall(space, 2.0), **capsule)
    held = planes(space, x=0.0, y=0.0, z=0.0)
    return space, solve_iteratively(
        matrix, pressure(space, 1.0, faces=wall(space, 1.0)), held, tolerance=1e-7
    )


def wall(space, radius):
    return faces_where(space, lambda x: np.abs(np.linalg.norm(x, axis=1) - radius) < 1e-6)


def motion_outwards(space, moved, radius):
    """Mean over a wall, weighted by its area, of the displacement along its normal."""
    corners = space.nodes_m[wall(space, radius)[:, :3]]
    area = (
        0.5
        * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        ).sum()
    )
    return abs((pressure(space, 1.0, faces=wall(space, radius)) * moved).sum()) / area


def at_corners(space, moved):
    """Radius, displacement along it, and hoop stress of the corners of cells."""
    count = len(space.mesh.nodes_m)
    radius = np.linalg.norm(space.mesh.nodes_m, axis=1)
    normal = space.mesh.nodes_m / radius[:, None]
    stress = node_stress(space, moved, lame(YOUNG, RATIO)).stress_Pa[:count][
        :, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]
    ]
    across = np.einsum("ni,nij,nj->n", normal, stress, normal)
    hoop = 0.5 * (np.trace(stress, axis1=1, axis2=2) - across)
    return radius, (moved[:count] * normal).sum(axis=1), hoop


@pytest.mark.parametrize("cells", [(5, 6), pytest.param((8, 8), marks=pytest.mark.slow)])
def test_lame_sphere(cells):
    """Lame's sphere has the stresses and displacements of 1852.

    sigma_theta(1) = 5/7, sigma_theta(2) = 3/14, u(1) = 8e-4, u(2) = 3e-4; 1 %, means over the
    surface. Cells have straight edges: of the 0.9 % left in u(1) most is the polyhedron, which has
    less surface than the sphere. Single nodes scatter by 1 % in the hoop stress, because the cells
    around them lie differently.
    """
    radius, moved, hoop = at_corners(*pressed_octant(cells, 2))
    for at, stress, displacement in ((1.0, 5.0 / 7.0, 8e-4), (2.0, 3.0 / 14.0, 3e-4)):
        here = np.abs(radius - at) < 1e-6
        print(
            f"\nr = {at:g}: hoop stress {hoop[here].mean():.5f} "
            f"({hoop[here].mean() / stress - 1:+.2%}, scatter "
            f"{hoop[here].std() / stress:.1%}), displacement {moved[here].mean():.4e} "
            f"({moved[here].mean() / displacement - 1:+.2%})"
        )
        assert abs(hoop[here].mean() / stress - 1.0) < 0.01
        assert np.abs(moved[here] / displacement - 1.0).max() < 0.01
        assert hoop[here].std() < 0.03 * stress


def inflated(young, thickness, ratio):
    """Return the motion at r = 1 and 2 inside a thin sphere that resists.

    The resisting pressure is 2 E t u / ((1 - nu) r^2). u = A r + B / r^2 and sigma_r = E (A / (1 -
    2 nu) - 2 B / ((1 + nu) r^3)).
    """
    bulk, shear, hold = (
        YOUNG / (1 - 2 * RATIO),
        2 * YOUNG / (1 + RATIO),
        2.0 * young * thickness / ((1 - ratio) * 4.0),
    )
    a, b = np.linalg.solve(
        [[bulk, -shear], [bulk + 2.0 * hold, -shear / 8.0 + 0.25 * hold]], [-1.0, 0.0]
    )
    return a + b, 2.0 * a + 0.25 * b


@pytest.mark.parametrize(
    ("order", "cells", "within"),
    [(1, (10, 10), 0.012), pytest.param(2, (5, 5), 0.03, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("young", [1e4, pytest.param(1e5, marks=pytest.mark.slow)])
def test_sphere_in_a_capsule(order, cells, within, young):
    """A sphere in a capsule follows the closed form.

    Lame's sphere lies in a membrane, up to one as stiff as itself, which halves the motion of its
    surface. Linear cells are off by 1.2 %, most of it the polyhedron. Quadratic cells with straight
    edges have nodes in the middle of flat pieces of the membrane, which carry no pressure. The
    stiff membrane pulls in the corners instead, 8 % too far, and the mean is kept to 3 %.
    """
    space, moved = pressed_octant(
        cells, order, capsule={"thickness_m": 0.01, "young_Pa": young, "poisson_ratio": 0.4}
    )
    found = np.array([motion_outwards(space, moved, at) for at in (1.0, 2.0)])
    wanted = inflated(young, 0.01, 0.4)
    print(
        f"\nP{order}, capsule of {young * 0.01:g} N/m: {found / wanted - 1.0} off {wanted}; "
        "bare 8e-4, 3e-4"
    )
    assert wanted[1] < 0.95 * 3e-4
    assert np.allclose(found, wanted, rtol=within)
