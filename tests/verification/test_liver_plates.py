"""Plates (cases 4, 7, 8, 9).

They are Kirsch's hole, Cook's membrane in plane stress and in plane strain, and NAFEMS LE10.
"""

import numpy as np
import pytest
from round_bodies import mapped, sphere_shell
from tet_bodies import faces_where, planes, slab, solve, solve_iteratively, wedge
from tet_fields import node_stress, pressure

from meshes.tets.structured import box, graded
from tissue.fem.assembly import assemble, capsule_stiffness, traction
from tissue.fem.space import Space
from tissue.materials.elasticity import lame


def test_hole_in_a_plate():
    """A hole in a plate has the stress of Kirsch (1898).

    It is 3 sigma at the sides of the hole and -sigma ahead of it; 2 % of sigma's peak, hole 1/20 of
    the width. In a plane problem with given tractions the stress in the plane does not depend on
    the material; here u_z = 0. A width of 20 holes alone adds 0.4 % to the peak.
    """
    half, n = 20.0, (16, 32)

    def into(unit):
        angle = unit[:, 0] * np.pi / 2.0
        ray = np.column_stack([np.cos(angle), np.sin(angle)])
        return ray * ((half / np.abs(ray).max(axis=1)) ** unit[:, 1])[:, None]

    thickness = np.pi / 2.0 / n[0]
    space, material = Space(slab(n, into, thickness), 2), lame(1000.0, 0.3)
    held = planes(space, x=0.0, y=0.0, z=0.0) | planes(space, z=thickness)
    load = traction(
        space, (1.0, 0.0, 0.0), faces=faces_where(space, lambda x: x[:, 0] > half - 1e-6)
    )
    stress = node_stress(space, solve(assemble(space, material), load, held), material).stress_Pa

    def at(x, y):
        return (np.abs(space.nodes_m[:, :2] - [x, y]) < 1e-6).all(axis=1)

    across, along = stress[at(0.0, 1.0), 0].mean(), stress[at(1.0, 0.0), 1].mean()
    print(f"\nbeside the hole {across:.4f} against 3, ahead of it {along:.4f} against -1")
    assert across == pytest.approx(3.0, rel=0.02)
    assert along == pytest.approx(-1.0, rel=0.02)


def cook(order, n, material, force):
    """Return the rise of the middle of the end and of the top of Cook's membrane.

    It has unit thickness, is one brick deep and is held in z.
    """

    def into(unit):
        return np.column_stack(
            [
                48.0 * unit[:, 0],
                44.0 * unit[:, 0] * (1.0 - unit[:, 1]) + unit[:, 1] * (44.0 + 16.0 * unit[:, 0]),
            ]
        )

    space = Space(slab((n, n), into, 48.0 / n), order)
    end = faces_where(space, lambda x: x[:, 0] > 48.0 - 1e-9)
    held = np.zeros((space.node_count, 3), dtype=bool)
    held[:, 2] = True
    held[space.nodes_m[:, 0] < 1e-9] = True
    moved = solve(
        assemble(space, material), traction(space, (0.0, force / 16.0, 0.0), faces=end), held
    )
    return [
        moved[(np.abs(space.nodes_m[:, :2] - at) < 1e-6).all(axis=1), 1].mean()
        for at in ([48, 52], [48, 60])
    ]


def test_cook_in_plane_stress():
    """23.96 in the middle of the end, 25.16 at the top corner; 0.5 %.

    Plane stress is plane strain (u_z = 0) with lambda replaced by 2 lambda mu / (lambda + 2 mu):
    free faces in z would need many cells, this is exact.
    """
    first, shear = lame(1.0, 1.0 / 3.0)
    material = (2.0 * first * shear / (first + 2.0 * shear), shear)
    linear, coarse, fine = (
        cook(order, n, material, 1.0) for order, n in ((1, 16), (2, 8), (2, 24))
    )
    print(f"\nP1 {linear}, P2 {coarse}, {fine} against 23.96 and 25.16")
    assert linear[0] < 0.93 * 23.96
    assert fine[0] == pytest.approx(23.96, rel=0.005)
    assert fine[1] == pytest.approx(25.16, rel=0.005)
    assert abs(coarse[0] - 23.96) < 0.005 * 23.96 + abs(cook(2, 4, material, 1.0)[0] - 23.96)


def test_cook_in_plane_strain():
    """Nearly incompressible: 7.386 and 7.74. Linear cells lock and do not let go, quadratic ones
    come within 1.5 %.
    """
    material, sizes = lame(250.0, 0.4999), (8, 16, 32)
    linear, quadratic = (
        np.array([cook(order, n, material, 100.0) for n in sizes]) for order in (1, 2)
    )
    print(
        "\ncells an edge, P1 and P2, middle and top:\n",
        np.column_stack([sizes, linear, quadratic]).round(3),
    )
    assert (linear[:, 0] < 0.35 * 7.386).all()
    assert quadratic[-1] == pytest.approx([7.386, 7.74], rel=0.015)
    assert (np.diff(quadratic, axis=0) > 0.0).all()


@pytest.mark.slow
def test_thick_elliptic_plate():
    """The thick elliptic plate follows NAFEMS LE10.

    sigma_yy at D (2, 0, 0.6) is -5.38 MPa under 1 MPa; 2 %, quadratic cells with straight edges.
    """

    def into(unit):
        angle = unit[:, 0] * np.pi / 2.0
        inner, outer = (
            np.column_stack([a * np.cos(angle), b * np.sin(angle)])
            for a, b in ((2.0, 1.0), (3.25, 2.75))
        )
        return np.column_stack([inner + (outer - inner) * unit[:, 1:2] ** 1.3, 0.6 * unit[:, 2]])

    space, material = Space(mapped((12, 8, 4), into), 2), lame(210e9, 0.3)
    at = space.nodes_m
    rim = np.zeros(space.node_count, dtype=bool)
    rim[
        np.unique(
            faces_where(
                space, lambda x: np.abs((x[:, 0] / 3.25) ** 2 + (x[:, 1] / 2.75) ** 2 - 1.0) < 1e-9
            )
        )
    ] = True
    held = planes(space, x=0.0, y=0.0)
    held[rim, :2] = True
    held[rim & (np.abs(at[:, 2] - 0.3) < 1e-9), 2] = True
    load = pressure(space, 1e6, faces=faces_where(space, lambda x: x[:, 2] > 0.6 - 1e-9))
    moved = solve(assemble(space, material), load, held)
    found = node_stress(space, moved, material).stress_Pa[
        (np.abs(at - [2.0, 0.0, 0.6]) < 1e-9).all(axis=1), 1
    ]
    print(f"\nsigma_yy(D) {found[0] / 1e6:.3f} MPa against -5.38")
    assert found == pytest.approx(-5.38e6, rel=0.02)


LENGTH, YOUNG = 10.0, 1000.0


def clamped(order, cells, ratio=0.3):
    """Return the tip deflection of a clamped bar under 1 N and its largest bending stress.

    The bar is 10 x 1 x 1, clamped at its root; the stress is taken one height off it.
    """
    space, material = Space(box((LENGTH, 1.0, 1.0), cells), order), lame(YOUNG, ratio)
    held = np.repeat(space.nodes_m[:, :1] < 1e-9, 3, axis=1)
    end = faces_where(space, lambda x: x[:, 0] > LENGTH - 1e-9)
    moved = solve(assemble(space, material), traction(space, (0.0, 0.0, 1.0), faces=end), held)
    stress = node_stress(space, moved, material).stress_Pa[:, 0]
    skin = (np.abs(space.nodes_m[:, 2]) < 1e-9) & (
        np.abs(space.nodes_m[:, 0] - 0.2 * LENGTH) < 0.26
    )
    return moved[space.nodes_m[:, 0] > LENGTH - 1e-9, 2].mean(), stress[skin].max()


def test_cantilever():
    """Timoshenko 4.0312, plane-stress elasticity 4.0275; 0.5 %.

    The root moves as that of the plane-stress solution (Timoshenko and Goodier 1970): it may warp
    and bulge. A clamp that stops both takes 0.8 % off (3.996), which is no error of the cells.
    """
    space = Space(box((LENGTH, 1.0, 1.0), (20, 2, 4)), 2)
    x, y, z = space.nodes_m.T - [[0.0], [0.5], [0.5]]
    root, inertia, ratio = x < 1e-9, 1.0 / 12.0, 0.3
    held, moved = np.zeros((space.node_count, 3), dtype=bool), np.zeros((space.node_count, 3))
    held[root] = [True, False, True]
    held[root & (np.abs(y) < 1e-9), 1] = True
    moved[:, 0] = -(2.0 + ratio) * z * (z * z - 0.25) / (6.0 * YOUNG * inertia)
    moved[:, 2] = 3.0 * ratio * z * z * LENGTH / (6.0 * YOUNG * inertia)
    end = faces_where(space, lambda x: x[:, 0] > LENGTH - 1e-9)
    height = space.nodes_m[end[:, :3], 2].mean(axis=1) - 0.5
    load = traction(
        space, np.column_stack([0 * height, 0 * height, 1.5 * (1.0 - 4.0 * height**2)]), faces=end
    )
    found = solve(assemble(space, lame(YOUNG, ratio)), load / load.sum(), held, moved)[
        x > LENGTH - 1e-9, 2
    ].mean()
    print(f"\ntip {found:.4f} against 4.0312 and 4.0275; clamped {clamped(2, (20, 2, 4))[0]:.4f}")
    assert found == pytest.approx(4.0312, rel=0.005)
    assert found == pytest.approx(4.0275, rel=0.005)


RATIO = 0.3


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


LAYER_RATIO, ANGLE, FAR = 0.499, np.radians(6.0), 4000.0
"""Poisson's ratio, angle of the wedge and radius of the domain.

0.499 for the table's 0.5 adds 0.1 % to a displacement; beyond 4000 radii lie 0.0003 of F2 (at 1000
it was 0.001).
"""


TABLE = {
    2: {0.25: 0.990, 0.5: 0.926, 1.0: 0.790, 2.0: 0.662},
    10: {0.25: 0.942, 0.5: 0.738, 1.0: 0.486, 2.0: 0.306},
    100: {0.25: 0.704, 0.5: 0.429, 1.0: 0.235, 2.0: 0.125},
}
"""F2 = w0 E2 / (1.5 p a) by E1/E2 and h/a.

It belongs to a bonded layer with Poisson's ratio 0.5 and a uniform pressure on a disc of radius a.
"""


def settlement(radius, layer, young, *, below, capsule=None):
    """Return the settlement of a pressed disc's middle over a bare half-space's, 1.5 p a / E2.

    The mesh is a wedge of 6 degrees about the axis, one brick wide, of quadratic cells. Its sides
    may slide but not leave their planes. Steps grow away from the rim of the disc and from the
    layer.
    """
    inside = radius - graded(0.0, radius, 0.15 * radius, 1.25)[::-1]
    radii = np.concatenate([inside, graded(radius, FAR * radius, 0.15 * radius, 1.35)[1:]])
    above = graded(0.0, -layer, min(layer / 3.0, 0.2 * radius), 1.0)
    step = abs(above[-1] - above[-2])
    depths = np.concatenate([above, graded(-layer, -FAR * radius, step, 1.35)[1:]])[::-1]
    mesh = wedge(radii, depths, ANGLE)
    space, small = Space(mesh, 2), 1e-9 * radius
    middle = mesh.nodes_m[mesh.cells].mean(axis=1)[:, 2]
    matrix = assemble(
        space,
        np.where(
            (middle > -layer)[:, None],
            lame(young, LAYER_RATIO),
            lame(below, LAYER_RATIO),
        ),
    )
    top = faces_where(space, lambda x: np.abs(x[:, 2]) < small)
    if capsule is not None:
        matrix = matrix + capsule_stiffness(space, faces=top, poisson_ratio=LAYER_RATIO, **capsule)
    disc = (np.linalg.norm(space.nodes_m[top[:, :3], :2], axis=2) < radius * (1.0 + 1e-9)).all(
        axis=1
    )
    x, y, z = space.nodes_m.T
    frame, held = (
        np.tile(np.eye(3), (space.node_count, 1, 1)),
        np.zeros((space.node_count, 3), dtype=bool),
    )
    axis = np.hypot(x, y) < small
    second = (np.abs(x * np.sin(ANGLE) - y * np.cos(ANGLE)) < small) & ~axis
    frame[second] = [
        [np.cos(ANGLE), np.sin(ANGLE), 0.0],
        [-np.sin(ANGLE), np.cos(ANGLE), 0.0],
        [0.0, 0.0, 1.0],
    ]
    held[second | (y < small), 1] = True
    held[axis, :2] = True
    held[z < depths[0] + small] = True
    held[(second | (y < small)) & (np.hypot(x, y) > radii[-1] * (1.0 - 1e-9)), 0] = True
    moved = solve(matrix, pressure(space, 1.0, faces=top[disc]), held, frame=frame)
    return -moved[axis & (np.abs(z) < small), 2][0] / (1.5 * radius / below)


ENTRIES = ((2, 0.25), (2, 2.0), (10, 0.5), (100, 0.25), (100, 2.0))
"""Corners of the table and an entry in its middle."""


@pytest.mark.slow
@pytest.mark.parametrize(("contrast", "depth"), ENTRIES)
def test_two_layer_half_space(contrast, depth):
    """The two-layer half-space agrees with the table.

    The error of each entry is below 2 %. The meshes are up to 1 % too stiff at the largest
    contrast.
    """
    found, wanted = settlement(1.0, depth, contrast, below=1.0), TABLE[contrast][depth]
    print(
        f"\nE1/E2 {contrast}, h/a {depth}: {found:.4f} against {wanted} "
        f"({found / wanted - 1.0:+.2%})"
    )
    assert found == pytest.approx(wanted, rel=0.02)
