"""Tetrahedra pressed by spheres and punches, against closed forms.

The forms are Hertz, Boussinesq, the flat punch, and Hayes' layer. The mesh is a wedge of 5 degrees
about the tool's axis, one brick wide, of quadratic cells graded towards the contact. Its sides may
slide but not leave their planes. Its chords lie at most 0.1 % of the radius inside the circle.
"""

import numpy as np
import pytest
from pressed_part import pressed
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu
from tet_bodies import wedge

from meshes.tets.structured import box
from meshes.tets.stuffing import bisected
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.assembly import assemble
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.models.organ.probe import CylinderProbe, ShellProbe, SphereProbe

YOUNG_PA, TIMES = 5e3, 72
ANGLE = 2.0 * np.pi / TIMES


def plane_modulus(poisson_ratio):
    return YOUNG_PA / (1.0 - poisson_ratio**2)


def hertz_N(radius, depth, poisson_ratio):
    """Hertz 1882: a paraboloid of curvature 1/R."""
    return 4.0 / 3.0 * plane_modulus(poisson_ratio) * radius**0.5 * depth**1.5


def growing(first, growth, end):
    """Places behind steps that grow from the first until they pass the end."""
    count = int(np.ceil(np.log(1.0 + end * (growth - 1.0) / first) / np.log(growth)))
    return first * np.cumsum(growth ** np.arange(count))


def touchable(space, within_m):
    """Nodes of the top near the axis, and the triangles between them, four to a quadratic face."""
    near = np.hypot(space.nodes_m[:, 0], space.nodes_m[:, 1]) < within_m
    top = np.flatnonzero((space.nodes_m[:, 2] > -1e-9) & near)
    number = np.full(space.node_count, -1)
    number[top] = np.arange(len(top))
    faces = number[space.faces[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]].reshape(-1, 3)]
    return top, faces[(faces >= 0).all(axis=1)]


def condensed(radii, depths, poisson_ratio, *, touch_m, rim_held):
    """Nodes, triangles and compliance of the top of a wedge under z = 0, bonded at its base."""
    space = Space(wedge(radii, -depths[::-1], ANGLE), 2)
    nodes, tiny = space.nodes_m, 1e-7 * radii[1]
    round_m = np.hypot(nodes[:, 0], nodes[:, 1])
    axis = round_m < tiny
    turn = np.array(
        [[np.cos(ANGLE), np.sin(ANGLE), 0.0], [-np.sin(ANGLE), np.cos(ANGLE), 0.0], [0.0, 0.0, 1.0]]
    )
    second = (np.abs(nodes @ turn[1]) < tiny) & ~axis
    held = np.zeros(nodes.shape, dtype=bool)
    held[second | (nodes[:, 1] < tiny), 1] = True
    held[axis, :2] = True
    held[nodes[:, 2] < -depths[-1] * (1.0 - 1e-9)] = True
    held[rim_held & (round_m > 0.999 * radii[-1])] = True
    frame = np.tile(np.eye(3), (len(nodes), 1, 1))
    frame[second] = turn
    rows, columns = (np.broadcast_to(i, frame.shape).ravel() for i in np.indices((3, 3)))
    start = np.repeat(3 * np.arange(len(nodes)), 9)
    turned = csr_array((frame.ravel(), (start + rows, start + columns)))
    free = np.flatnonzero(~held.ravel())
    stiffness = (turned @ assemble(space, lame(YOUNG_PA, poisson_ratio)).tocsr() @ turned.T)[free][
        :, free
    ].tocsc()
    factor = splu(
        stiffness,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    top, faces = touchable(space, touch_m)
    place = np.full(held.size, -1)
    place[free] = np.arange(len(free))
    rows = place[(3 * top[:, None] + np.arange(3)).ravel()]
    compliance = np.zeros((len(rows), len(rows)))
    moving = np.flatnonzero(rows >= 0)
    for column in moving:
        load = np.zeros(len(free))
        load[rows[column]] = 1.0
        compliance[moving, column] = factor.solve(load)[rows[moving]]
    axes, count = frame[top], len(top)
    compliance = np.einsum(
        "aji,ajbk,bkl->aibl", axes, compliance.reshape(count, 3, count, 3), axes, optimize=True
    )
    compliance = compliance.reshape(3 * count, -1)
    return nodes[top], faces, 0.5 * (compliance + compliance.T)


def graded_half_space(contact, poisson_ratio, cells=10):
    """Return a half space with `cells` cells to 1.2 radii of the contact.

    The far end lies at 300, where 0.2 % of the depth is lost.
    """
    first = 1.2 * contact / cells
    radii = np.concatenate(
        [np.arange(cells + 1) * first, 1.2 * contact + growing(1.3 * first, 1.7, 300.0 * contact)]
    )
    depths = np.concatenate([[0.0], growing(0.5 * first, 1.5, 300.0 * contact)])
    return condensed(radii, depths, poisson_ratio, touch_m=1.4 * contact, rim_held=True), radii[-1]


def test_shallow_sphere_and_point_load():
    """A shallow sphere and a point load follow their closed forms.

    Case 13: E = 5 kPa, nu = 0.49; 2 %, at a/R up to 0.05, where a sphere is Hertz' paraboloid;
    Boussinesq 1885.
    """
    a = 0.00316
    body, far = graded_half_space(a, 0.49)
    shallow = 0.05
    radius = a / shallow
    at = shallow**2 * radius * np.linspace(0.3, 1.0, 15)
    found = pressed(body, SphereProbe(radius), at, times=TIMES)
    assert abs(found / hertz_N(radius, at, 0.49) - 1.0).mean() < 0.02
    assert abs(found[-1] / hertz_N(radius, at[-1], 0.49) - 1.0) < 0.02
    assert abs(np.polyfit(np.log(at), np.log(found), 1)[0] - 1.5) < 0.05
    nodes, _, compliance = body
    distance = np.linalg.norm(nodes, axis=1)
    centre = int(np.argmin(distance))
    ring = np.flatnonzero((distance > 0.75 * a) & (distance < 1.3 * a))
    # The wedge's share of a newton acts on its own axis; the far end is held, which takes its
    # deflection off everywhere.
    deflection = compliance[3 * ring + 2, 3 * centre + 2] / TIMES
    exact = (1.0 / distance[ring] - 1.0 / far) / (np.pi * plane_modulus(0.49))
    assert abs(deflection / exact - 1.0).max() < 0.03


RADIUS_M = 5e-3


def upright(nodes):
    """Hertz' paraboloid with normals that all point down, a point over each node."""
    height = 0.5 * (nodes[:, :2] ** 2).sum(axis=1) / RADIUS_M
    down = np.tile([0.0, 0.0, -1.0], (len(nodes), 1))
    return ShellProbe(np.column_stack([nodes[:, :2], height]), down, np.ones(len(nodes)))


@pytest.mark.slow
def test_deep_sphere_at_its_literal_numbers():
    """A deep sphere has its literal numbers.

    Case 13, R = 5 mm, 2 mm deep: Hertz' problem gives 0.0555 N with upright normals. A true sphere
    agrees with the exact half-space, for which `test_liver_contact` finds 0.0487 N and explains why
    it is less. The error is 2 % and falls with every refinement. Cells that grow by 1.7 and 1.5 a
    ring and layer leave 1 % whatever the first cell is.
    """
    at = np.linspace(5e-5, 2e-3, 40)
    off = []
    for cells in (5, 10, 20):
        body, _ = graded_half_space(3.2e-3, 0.49, cells)
        found = (
            pressed(body, upright(body[0]), at, times=TIMES)[-1],
            pressed(body, SphereProbe(RADIUS_M), at, times=TIMES)[-1],
        )
        off.append([found[0] / 0.0555 - 1.0, found[1] / 0.0487 - 1.0])
        print(f"\n{cells} cells: upright paraboloid {found[0]:.5f} N, sphere {found[1]:.5f} N")
    assert np.abs(off[1:]).max() < 0.02
    assert (np.diff(np.abs(off), axis=0) < 0.0).all()


EDGE = np.array([0.0, 0.25, 0.45, 0.62, 0.75, 0.84, 0.9, 0.94, 0.97, 0.985, 1.0])
"""Rings that close in on the edge of a punch, where the pressure is singular."""


@pytest.mark.parametrize("poisson_ratio", [pytest.param(0.3, marks=pytest.mark.slow), 0.49])
def test_flat_punch(poisson_ratio):
    """Case 13, Boussinesq 1885: a = 5 mm, 2 mm deep, 0.1316 N at nu = 0.49; 3 %."""
    a, fine = 0.005, 0.005 * (1.0 - EDGE[-2])
    radii = np.concatenate([a * EDGE, a + growing(1.3 * fine, 1.6, 300.0 * a)])
    depths = np.concatenate([[0.0], growing(fine, 1.5, 300.0 * a)])
    body = condensed(radii, depths, poisson_ratio, touch_m=1.01 * a, rim_held=True)
    found = pressed(
        body, CylinderProbe(1.001 * a, 1e-6 * a), np.linspace(1e-4, 2e-3, 20), times=TIMES
    )[-1]
    exact = 2.0 * plane_modulus(poisson_ratio) * a * 0.002
    assert poisson_ratio != 0.49 or exact == pytest.approx(0.1316, abs=5e-5)
    assert abs(found / exact - 1.0) < 0.03


KAPPA = {
    0.3: {0.2: 1.207, 0.4: 1.473, 0.6: 1.785, 0.8: 2.126, 1.0: 2.484, 1.5: 3.409, 2.0: 4.353},
    0.45: {0.2: 1.252, 0.4: 1.599, 0.6: 2.033, 0.8: 2.535, 1.0: 3.091, 1.5: 4.658, 2.0: 6.421},
    0.49: {0.2: 1.274, 0.4: 1.664, 0.6: 2.169, 0.8: 2.780, 1.0: 3.484, 1.5: 5.632, 2.0: 8.337},
}
"""Stiffening by a bonded base, by Poisson's ratio and a/h."""
CELLS = [(ratio, share) for ratio, row in KAPPA.items() for share in row]
QUICK = {(0.3, 0.2), (0.45, 0.6), (0.49, 1.0), (0.49, 2.0)}


@pytest.mark.parametrize(
    ("poisson_ratio", "share"),
    [pytest.param(*c, marks=() if c in QUICK else pytest.mark.slow) for c in CELLS],
)
def test_flat_punch_on_a_bonded_layer(poisson_ratio, share):
    """A flat punch on a bonded layer follows case 14.

    Hayes 1972: P = 2 E* a kappa d; 1 %. Linear theory leaves the rim's material under the edge,
    while a squeezed layer flows out. Therefore the press is shallow, and the punch is wider by its
    depth.
    """
    a, fine = 0.005, 0.005 * (1.0 - EDGE[-2])
    height = a / share
    radii = np.concatenate([a * EDGE, a + growing(1.3 * fine, 1.4, 12.0 * max(a, height))])
    depths = np.concatenate([[0.0], growing(fine, 1.4, height)])
    depths *= height / depths[-1]
    body = condensed(radii, depths, poisson_ratio, touch_m=1.01 * a, rim_held=False)
    found = pressed(
        body, CylinderProbe(1.001 * a, 1e-6 * a), height * np.linspace(2e-4, 1e-3, 5), times=TIMES
    )[-1]
    kappa = found / (2.0 * plane_modulus(poisson_ratio) * a * 1e-3 * height)
    assert abs(kappa / KAPPA[poisson_ratio][share] - 1.0) < 0.01


@pytest.mark.slow
def test_bisected_cells_at_the_literal_numbers():
    """Bisected cells have the literal numbers of case 13.

    The mesh is made as for an organ: a cube's quarter, halved towards the tool, quadratic cells of
    2 mm there; 3 %. Of this the sides and base, 0.2 m away, make about 1 %. The forms are Hertz,
    the true sphere as above, and the flat punch.
    """
    size = 0.2

    def wanted(at):
        return 2e-3 + 0.45 * np.maximum(np.linalg.norm(at - [0.0, 0.0, size], axis=1) - 5.2e-3, 0.0)

    mesh = bisected(box((size, size, size), (2, 2, 2)), wanted)
    space = Space(TetMesh(mesh.nodes_m - [0.0, 0.0, size], mesh.cells), 2)
    nodes = space.nodes_m
    held = nodes < [1e-9, 1e-9, 1e-9 - size]
    held[nodes[:, 2] < 1e-9 - size] = True
    factor = DirectSolver(HeldBody(assemble(space, lame(YOUNG_PA, 0.49)), nodes, held))
    top, faces = touchable(space, 6e-3)
    rows = (3 * top[:, None] + np.arange(3)).ravel()
    compliance = factor.columns(rows)[rows]
    body = nodes[top], faces, 0.5 * (compliance + compliance.T)
    at = np.linspace(5e-5, 2e-3, 40)
    for probe, exact in (
        (upright(nodes[top]), 0.0555),
        (SphereProbe(RADIUS_M), 0.0487),
        (CylinderProbe(5e-3, 1e-6), 0.1316),
    ):
        found = pressed(body, probe, at, times=4)[-1]
        print(
            f"\n{type(probe).__name__} {found:.5f} N against {exact} N ({found / exact - 1.0:+.1%})"
        )
        assert abs(found / exact - 1.0) < 0.03
