"""Contact against closed forms: Hertz, flat punch, Boussinesq, Hayes, and a tangential drag.

Quick: half-spaces by their own Green's functions, which leaves only the contact's error. Slow: quadratic tetrahedra, a
quarter of a round body graded towards the contact.
"""

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from meshes.tet_structured import joined, mapped
from tissue.liver.assembly import assemble
from tissue.liver.contact import SurfaceContact
from tissue.liver.contact_result import ContactOutcome
from tissue.liver.probe import CylinderProbe, SphereProbe
from tissue.liver.space import Space
from tissue.materials.elasticity import lame

YOUNG_PA = 5e3
TILE_M = 1e-4


def plane_modulus(poisson_ratio):
    return YOUNG_PA / (1.0 - poisson_ratio**2)


def hertz_N(radius, depth, poisson_ratio):
    """Hertz 1882: a paraboloid of curvature 1/R."""
    return 4.0 / 3.0 * plane_modulus(poisson_ratio) * radius**0.5 * depth**1.5


def tiles(count, tile):
    """A square of tiles: their centres as nodes, triangles between them, deflection under unit force on one tile.

    Love 1929 (Johnson 1985, eq. 3.25): a uniform pressure on a rectangle of a half-space.
    """
    axis = tile * (np.arange(count) - 0.5 * (count - 1))
    nodes = np.stack(np.meshgrid(axis, axis, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(count**2).reshape(count, count)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    x, y = (nodes[:, None, k] - nodes[None, :, k] for k in (0, 1))
    h = 0.5 * tile
    near, far, low, high = x - h, x + h, y - h, y + h

    def term(p, q, r):
        return p * np.log((q + np.hypot(q, p)) / (r + np.hypot(r, p)))

    deflection = term(far, high, low) + term(high, far, near) - term(near, high, low) - term(low, far, near)
    return nodes, faces, deflection / (np.pi * tile**2)


def half_space(count, tile, poisson_ratio, tangential):
    """Compliance that moves each tile along z, and by `tangential` times as much along x, without coupling."""
    nodes, faces, deflection = tiles(count, tile)
    full = np.zeros((len(nodes), 3, len(nodes), 3))
    full[:, 2, :, 2] = deflection / plane_modulus(poisson_ratio)
    full[:, 0, :, 0] = full[:, 1, :, 1] = tangential * full[:, 2, :, 2]
    return nodes, faces, full.reshape(3 * len(nodes), -1)


def test_a_sphere_on_tiles_follows_hertz_and_converges():
    """Shallow enough, a/R = 0.02, that sphere and paraboloid agree to 1e-4; at least 3 tiles to the radius."""
    errors = []
    for count in (9, 17, 31):
        tile = 31 * TILE_M / count
        nodes, faces, compliance = half_space(count, tile, 0.49, 0.0)
        radius = 0.0012 / 0.02
        contact = SurfaceContact(
            nodes, faces, compliance, SphereProbe(radius), friction=0.0, spacing_m=1.0, tolerance=1e-8, sweeps=2000
        )
        depths = 0.02**2 * radius * np.linspace(0.4, 1.0, 7)
        found = [contact.solve(np.array([0.0, 0.0, -d]), np.eye(3)).force_N[2] for d in depths]
        exact = hertz_N(radius, depths, 0.49)
        errors.append(np.abs(np.array(found) / exact - 1.0).mean())
    slope = np.polyfit(np.log(depths), np.log(found), 1)[0]
    assert abs(slope - 1.5) < 0.03
    # The edge of the contact is found to a tile, where the pressure is zero: order above one.
    assert errors[-1] < 0.005
    assert -np.polyfit(np.log([9, 17, 31]), np.log(errors), 1)[0] > 1.0


def test_a_drag_follows_its_own_normal_curve():
    """Without coupling, Q(U) = mu (P(d) - P(d - U / (mu k))) exactly, also after discretisation.

    Ciavarella 1998 and Jäger 1998, after Cattaneo 1938 and Mindlin 1949; k is tangential over normal compliance. The
    sphere is shallow, so that its normals lean by at most a/R = 0.01 out of the vertical, and the drag is one-way.
    """
    nodes, faces, compliance = half_space(21, TILE_M, 0.3, 1.21)
    radius, depth, friction = 0.08, 1e-5, 0.4
    options = {"spacing_m": 1.0, "tolerance": 1e-10, "sweeps": 5000}
    press = SurfaceContact(nodes, faces, compliance, SphereProbe(radius), friction=0.0, **options)

    def normal_N(d):
        press.forget()
        return press.solve(np.array([0.0, 0.0, -d]), np.eye(3)).force_N[2] if d > 0.0 else 0.0

    drag = SurfaceContact(nodes, faces, compliance, SphereProbe(radius), friction=friction, **options)
    drag.place(np.array([0.0, 0.0, 1e-6]), np.eye(3))
    drag.solve(np.array([0.0, 0.0, -depth]), np.eye(3))
    whole = normal_N(depth)
    for way in np.linspace(0.0, 1.3 * friction * 1.21 * depth, 9)[1:]:
        result = drag.solve(np.array([way, 0.0, -depth]), np.eye(3))
        assert result.outcome is ContactOutcome.CONVERGED
        expected = friction * (whole - normal_N(depth - way / (friction * 1.21)))
        assert abs(-result.force_N[0] - expected) < 0.01 * friction * whole


CORE = 3
"""Rings that are squares on the way to circles; farther out as many cells lie along each eighth of a ring."""


def quarter(radii, depths):
    """A quarter of a round body under z = 0 with rings and layers at given places, shapes (n,) and (m,), from 0."""
    outer, layers = len(radii) - 1 - CORE, len(depths) - 1

    def patch(counts, first):
        def into(unit):
            place = np.rint(unit[:, :2] * counts).astype(int) + first
            ring = place.max(axis=1)
            share = np.minimum(place / np.clip(ring, 1, CORE)[:, None], 1.0)
            angle = np.tan(0.25 * np.pi * share)
            length = np.maximum(np.linalg.norm(angle, axis=1), 1e-30)
            down = depths[np.rint((1.0 - unit[:, 2]) * layers).astype(int)]
            return np.column_stack([angle * (radii[ring] / length)[:, None], -down])

        return mapped((*counts, layers), into)

    return joined([patch((CORE, CORE), (0, 0)), patch((outer, CORE), (CORE, 0)), patch((CORE, outer), (0, CORE))])


def condensed(radii, depths, poisson_ratio, *, touch_m, rim_held):
    """Nodes, triangles and compliance of the top of a quarter body of quadratic cells, bonded at its base."""
    space = Space(quarter(radii, depths), 2)
    nodes = space.nodes_m
    tiny = 1e-9 * radii[-1]
    round_m = np.hypot(nodes[:, 0], nodes[:, 1])
    held = nodes < [tiny, tiny, -np.inf]
    held[nodes[:, 2] < -depths[-1] * (1.0 - 1e-9)] = True
    held[rim_held & (round_m > 0.999 * radii[-1])] = True
    free = np.flatnonzero(~held)
    top = np.flatnonzero((nodes[:, 2] > -tiny) & (round_m < touch_m))
    number = np.full(len(nodes), -1)
    number[top] = np.arange(len(top))
    faces = number[space.faces[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]].reshape(-1, 3)]
    place = np.full(held.size, -1)
    place[free] = np.arange(len(free))
    rows = place[(3 * top[:, None] + np.arange(3)).ravel()]
    moving = np.flatnonzero(rows >= 0)
    stiffness = assemble(space, lame(YOUNG_PA, poisson_ratio)).tocsc()[free][:, free]
    factor = splu(stiffness, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    compliance = np.zeros((len(rows), len(rows)))
    for column in moving:
        load = np.zeros(len(free))
        load[rows[column]] = 1.0
        compliance[moving, column] = factor.solve(load)[rows[moving]]
    return nodes[top], faces[(faces >= 0).all(axis=1)], 0.5 * (compliance + compliance.T)


def pressed(body, probe, depths):
    """Four times the force on a quarter at each of the rising depths."""
    contact = SurfaceContact(*body, probe, friction=0.0, spacing_m=1.0, tolerance=1e-6, sweeps=2000)
    forces = []
    for depth in depths:
        result = contact.solve(np.array([0.0, 0.0, -depth]), np.eye(3))
        assert result.outcome is ContactOutcome.CONVERGED
        forces.append(4.0 * result.force_N[2])
    return np.array(forces)


def growing(start, first, growth, count):
    return start + first * np.cumsum(growth ** np.arange(count))


@pytest.mark.slow
def test_sphere_and_point_load_on_a_graded_half_space():
    """Case 13: E = 5 kPa, nu = 0.49; 3 %, at a/R up to 0.05: deeper, normals lean and Hertz' paraboloid is another body.

    The far end lies at 70 contact radii, which is worth less than 1 %."""
    a = 0.00316
    radii = np.concatenate([a * np.linspace(0.0, 1.2, 9), growing(1.2 * a, 0.25 * a, 1.7, 10)])
    depths = np.concatenate([[0.0], growing(0.0, 0.1 * a, 1.7, 12)])
    body = condensed(radii, depths, 0.49, touch_m=1.3 * a, rim_held=True)
    shallow = 0.05
    radius = a / shallow
    at = shallow**2 * radius * np.linspace(0.3, 1.0, 15)
    found = pressed(body, SphereProbe(radius), at)
    assert abs(found / hertz_N(radius, at, 0.49) - 1.0).mean() < 0.03
    assert abs(found[-1] / hertz_N(radius, at[-1], 0.49) - 1.0) < 0.03
    assert abs(np.polyfit(np.log(at), np.log(found), 1)[0] - 1.5) < 0.05
    nodes, _, compliance = body
    centre = int(np.argmin(np.linalg.norm(nodes, axis=1)))
    distance = np.linalg.norm(nodes, axis=1)
    beside = np.flatnonzero((distance > 0.75 * a) & (distance < 1.3 * a))
    # A quarter of the load acts on the quarter's node; Boussinesq 1885 beyond a few cells from it.
    deflection = 0.25 * compliance[3 * beside + 2, 3 * centre + 2]
    # The far end is held, which takes its own deflection off everywhere.
    exact = (1.0 / distance[beside] - 1.0 / radii[-1]) / (np.pi * plane_modulus(0.49))
    assert abs(deflection / exact - 1.0).mean() < 0.03


EDGE = np.array([0.0, 0.3, 0.55, 0.75, 0.88, 0.96, 1.0])
"""Rings that close in on the edge of a punch, where the pressure is singular."""


@pytest.mark.slow
def test_flat_punch_on_a_graded_half_space():
    """Case 13: a = 5 mm, 2 mm deep, 0.1316 N; 3 %."""
    a = 0.005
    radii = np.concatenate([a * EDGE, growing(a, 0.05 * a, 1.7, 13)])
    depths = np.concatenate([[0.0], growing(0.0, 0.05 * a, 1.7, 13)])
    body = condensed(radii, depths, 0.49, touch_m=1.01 * a, rim_held=True)
    found = pressed(body, CylinderProbe(a, 1e-6 * a), np.linspace(2e-4, 2e-3, 10))[-1]
    assert abs(found / (2.0 * plane_modulus(0.49) * a * 0.002) - 1.0) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    ("poisson_ratio", "share", "kappa"),
    [(0.3, 0.4, 1.473), (0.45, 0.6, 2.033), (0.45, 2.0, 6.421), (0.49, 1.0, 3.484)],
)
def test_flat_punch_on_a_bonded_layer(poisson_ratio, share, kappa):
    """Case 14, Hayes 1972: P = 2 E* a kappa d; 2 %.

    Linear theory leaves the rim's material under the edge, while a squeezed layer flows out: the press is shallow, and
    the punch wider by as much as that.
    """
    a = 0.005
    height = a / share
    radii = np.concatenate([a * EDGE, growing(a, 0.05 * a, 1.6, 9)])
    depths = np.concatenate([[0.0], growing(0.0, 0.05 * a, 1.5, 7)])
    depths *= height / depths[-1]
    body = condensed(radii, depths, poisson_ratio, touch_m=1.01 * a, rim_held=False)
    found = pressed(body, CylinderProbe(1.001 * a, 1e-6 * a), height * np.linspace(2e-4, 1e-3, 5))[-1]
    assert abs(found / (2.0 * plane_modulus(poisson_ratio) * a * 1e-3 * height) / kappa - 1.0) < 0.02
