"""Contact of a sphere and a drag on a half-space, against closed forms.

The forms are Hertz, Sneddon, Cattaneo and Mindlin. The half-spaces have their own Green's
functions, which leaves only the contact's error. `test_liver_punches` compares these and other
closed forms with tetrahedra.
"""

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu
from tet_bodies import wedge

from tissue.fem.assembly import assemble
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.models.organ.contact import ContactOutcome, SurfaceContact
from tissue.models.organ.probe import CylinderProbe, ShellProbe, SphereProbe


def pressed(body, probe, depths, *, times):
    """Return `times` times the force [N] on a part at each of the rising depths [m].

    The body consists of nodes, triangles and compliance of the part.
    """
    contact = SurfaceContact(
        *body, probe, friction=0.0, spacing_m=1.0, tolerance=1e-6, sweeps=20000
    )
    forces = []
    for depth in depths:
        result = contact.solve(np.array([0.0, 0.0, -depth]), np.eye(3))
        assert result.outcome is ContactOutcome.CONVERGED
        forces.append(times * result.force_N[2])
    return np.array(forces)


YOUNG_PA = 5e3
TILE_M = 1e-4


def plane_modulus(poisson_ratio):
    return YOUNG_PA / (1.0 - poisson_ratio**2)


def hertz_N(radius, depth, poisson_ratio):
    """Hertz 1882: a paraboloid of curvature 1/R."""
    return 4.0 / 3.0 * plane_modulus(poisson_ratio) * radius**0.5 * depth**1.5


def triangles(count):
    """Triangles between the centres of a square of tiles."""
    number = np.arange(count**2).reshape(count, count)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])


def over_tile(antiderivative, x, y, tile):
    """Integral over a square of tile whose centre lies at (-x, -y)."""
    h = 0.5 * tile
    return sum(
        sign * antiderivative(x + p, y + q)
        for p, q, sign in ((h, h, 1), (-h, -h, 1), (h, -h, -1), (-h, h, -1))
    )


def half_space(count, tile, poisson_ratio, tangential):
    """Return a compliance that moves each tile along z, and along x by `tangential` times as much.

    There is no coupling. Love 1929 (Johnson 1985, eq. 3.25): a uniform pressure on a rectangle of a
    half-space.
    """
    axis = tile * (np.arange(count) - 0.5 * (count - 1))
    nodes = np.stack(np.meshgrid(axis, axis, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    x, y = (nodes[:, None, k] - nodes[None, :, k] for k in (0, 1))
    deflection = over_tile(
        lambda x, y: x * np.arcsinh(y / np.abs(x)) + y * np.arcsinh(x / np.abs(y)), x, y, tile
    )
    full = np.zeros((len(nodes), 3, len(nodes), 3))
    full[:, 2, :, 2] = deflection / (np.pi * tile**2 * plane_modulus(poisson_ratio))
    full[:, 0, :, 0] = full[:, 1, :, 1] = tangential * full[:, 2, :, 2]
    return nodes, triangles(count), full.reshape(3 * len(nodes), -1)


def quarter_half_space(count, tile, poisson_ratio):
    """A quarter of a half-space with its images: nodes, triangles and compliance in all directions.

    Boussinesq 1885 and Cerruti 1882 (Johnson 1985, eqs. 3.18 and 3.77) integrated over square
    tiles.
    """
    axis = tile * (np.arange(count) + 0.5)
    nodes = np.stack(np.meshgrid(axis, axis, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    full = np.zeros((len(nodes), 3, len(nodes), 3))
    unit = (1.0 + poisson_ratio) / (np.pi * YOUNG_PA * tile**2)
    aside = 0.5 * (1.0 - 2.0 * poisson_ratio)
    for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        x = nodes[:, None, 0] - sx * nodes[None, :, 0]
        y = nodes[:, None, 1] - sy * nodes[None, :, 1]
        terms = (
            lambda x, y: y * np.arcsinh(x / np.abs(y)),  # x^2 / r^3
            lambda x, y: x * np.arcsinh(y / np.abs(x)),  # y^2 / r^3
            lambda x, y: -np.hypot(x, y),  # x y / r^3
            lambda x, y: y * np.log(np.hypot(x, y)) + x * np.arctan(y / x),  # x / r^2
            lambda x, y: x * np.log(np.hypot(x, y)) + y * np.arctan(x / y),  # y / r^2
        )
        xx, yy, xy, to_x, to_y = (over_tile(term, x, y, tile) for term in terms)
        one = (1.0 - poisson_ratio) * (xx + yy)
        block = [
            [sx * (one + poisson_ratio * xx), sy * poisson_ratio * xy, aside * to_x],
            [sx * poisson_ratio * xy, sy * (one + poisson_ratio * yy), aside * to_y],
            [-sx * aside * to_x, -sy * aside * to_y, one],
        ]
        for i in range(3):
            for j in range(3):
                full[:, i, :, j] += unit * block[i][j]
    compliance = full.reshape(3 * len(nodes), -1)
    assert np.abs(compliance - compliance.T).max() < 1e-12 * compliance.max()
    return nodes, triangles(count), 0.5 * (compliance + compliance.T)


def upright(nodes, height):
    """Return a tool whose normals all point down, with a point over each node.

    These are the boundary conditions of Hertz and Sneddon.
    """
    return ShellProbe(
        np.column_stack([nodes[:, :2], height]),
        np.tile([0.0, 0.0, -1.0], (len(nodes), 1)),
        np.ones(len(nodes)),
    )


def sneddon_N(radius, contact, poisson_ratio):
    """Return force and depth of a sphere on a half-space at a radius of contact (Sneddon 1965).

    The normals are upright.
    """
    log = np.log((radius + contact) / (radius - contact))
    force = plane_modulus(poisson_ratio) * (0.5 * (contact**2 + radius**2) * log - contact * radius)
    return force, 0.5 * contact * log


RADIUS_M, DEPTH_M = 5e-3, 2e-3
DEEP_N = 0.0487
"""Force on a true sphere at which tiles converge [N].

The sphere has R = 5 mm and is 2 mm deep, with E = 5 kPa and nu = 0.49. The force is 8.6 % below
Sneddon's 0.0533 N and 12 % below Hertz' 0.0555 N. Both press with upright normals and count the
downward motion at the place where a point lay. A frictionless sphere 2 mm deep leans its normals by
up to 37 degrees and so spreads the surface. A point that lay at r touches the sphere farther out,
where the sphere is higher. Elasticity is linear, and contact is taken where the surface has moved
to. The error at 12 tiles to 3.3 mm is 1 %.
"""


def test_a_deep_sphere_at_its_literal_numbers():
    """A deep sphere has its literal numbers.

    Case 13, R = 5 mm, 2 mm deep, E = 5 kPa, nu = 0.49: Hertz' problem 0.0555 N, Sneddon's 0.0533 N,
    1 %.
    """
    body = quarter_half_space(12, 3.3e-3 / 12, 0.49)
    depths = np.linspace(DEPTH_M / 40.0, DEPTH_M, 40)
    square = (body[0][:, :2] ** 2).sum(axis=1)
    assert hertz_N(RADIUS_M, DEPTH_M, 0.49) == pytest.approx(0.0555, abs=5e-5)
    found = pressed(body, upright(body[0], 0.5 * square / RADIUS_M), depths, times=4.0)
    assert found[-1] == pytest.approx(0.0555, rel=0.01)
    # Shallower, there are few tiles in contact.
    assert abs(np.polyfit(np.log(depths[20:]), np.log(found[20:]), 1)[0] - 1.5) < 0.05
    exact, depth = sneddon_N(RADIUS_M, 2.95056e-3, 0.49)
    assert depth == pytest.approx(DEPTH_M, rel=1e-5)
    found = pressed(
        body, upright(body[0], RADIUS_M - np.sqrt(RADIUS_M**2 - square)), depths, times=4.0
    )
    assert found[-1] == pytest.approx(exact, rel=0.01)
    found = pressed(body, SphereProbe(RADIUS_M), depths, times=4.0)
    assert found[-1] == pytest.approx(DEEP_N, rel=0.01)


def test_a_drag_follows_its_own_normal_curve():
    """Without coupling, Q(U) = mu (P(d) - P(d - U / (mu k))) exactly, also after discretisation.

    Ciavarella 1998 and Jäger 1998, after Cattaneo 1938 and Mindlin 1949; k is tangential over
    normal compliance. The sphere is shallow, so that its normals lean by at most a/R = 0.01 out of
    the vertical, and the drag does not reverse.
    """
    nodes, faces, compliance = half_space(21, TILE_M, 0.3, 1.21)
    radius, depth, friction = 0.08, 1e-5, 0.4
    options = {"spacing_m": 1.0, "tolerance": 1e-10, "sweeps": 5000}
    press = SurfaceContact(nodes, faces, compliance, SphereProbe(radius), friction=0.0, **options)

    def normal_N(d):
        press.forget()
        return press.solve(np.array([0.0, 0.0, -d]), np.eye(3)).force_N[2] if d > 0.0 else 0.0

    drag = SurfaceContact(
        nodes, faces, compliance, SphereProbe(radius), friction=friction, **options
    )
    drag.place(np.array([0.0, 0.0, 1e-6]), np.eye(3))
    drag.solve(np.array([0.0, 0.0, -depth]), np.eye(3))
    whole = normal_N(depth)
    for travel in np.linspace(0.0, 1.3 * friction * 1.21 * depth, 9)[1:]:
        result = drag.solve(np.array([travel, 0.0, -depth]), np.eye(3))
        assert result.outcome is ContactOutcome.CONVERGED
        expected = friction * (whole - normal_N(depth - travel / (friction * 1.21)))
        assert abs(-result.force_N[0] - expected) < 0.01 * friction * whole


TIMES = 72


ANGLE = 2.0 * np.pi / TIMES


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


CELLS = [(0.3, 0.2), (0.49, 2.0)]
SLOW = [(0.3, 2.0), (0.45, 0.6), (0.49, 0.2), (0.49, 1.0)]


@pytest.mark.parametrize(
    ("poisson_ratio", "share"),
    [*CELLS, *(pytest.param(*cell, marks=pytest.mark.slow) for cell in SLOW)],
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
