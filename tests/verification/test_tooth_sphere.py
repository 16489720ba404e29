"""Hollow sphere under inner pressure, cut from a grid (Lame, validation case 3).

It is compared with body-fitted tetrahedra.
"""

import numpy as np
import pytest
from tooth_bodies import block, lattice, on_boundary, particle_stress, slope

from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import HexGrid, NodeSupports, ParticleSet
from tissue.models.tooth.recovery import StressRecovery, ball_weight

INNER, OUTER, PRESSURE, MODULUS, RATIO = 1.0, 2.0, 1.0, 1000.0, 0.3


SCALE = PRESSURE * INNER**3 / (OUTER**3 - INNER**3)


ENERGY = 0.5 * PRESSURE * 8e-4 * 4.0 * np.pi * INNER**2 / 8.0
"""Strain energy of the octant: half the pressure's work over u(a) = 8e-4."""


def exact_stress(position):
    """Stress, shape (n, 3, 3): radial and hoop."""
    radius = np.linalg.norm(position, axis=1)
    out = position / radius[:, None]
    radial, hoop = (SCALE * (1.0 + k * OUTER**3 / radius**3) for k in (-1.0, 0.5))
    outward = np.einsum("ni,nj->nij", out, out)
    return radial[:, None, None] * outward + hoop[:, None, None] * (np.eye(3) - outward)


def sphere(cells, inner_strength=1.0, per_edge=4):
    """Octant with ``cells`` cells along the outer radius, of per_edge^3 particles."""
    edge = OUTER / cells
    step = edge / per_edge
    at = (np.arange(cells * per_edge) + 0.5) * step
    position = np.stack(np.meshgrid(at, at, at, indexing="ij"), axis=-1).reshape(-1, 3)
    near = np.abs(np.linalg.norm(position, axis=1) - 1.5) < 0.5 + step
    position = position[near]
    radius = np.linalg.norm(position[:, None] + (lattice(5) - 0.5) * step, axis=2)
    inside = ((radius > INNER) & (radius < OUTER)).mean(axis=1)
    position, inside = position[inside > 0], inside[inside > 0]
    particles = ParticleSet.uniform(
        position, volume_m3=step**3, modulus_Pa=MODULUS, poisson_ratio=RATIO
    )
    particles.remaining[:] = np.rint(65535 * inside)
    grid = HexGrid.around(position, edge_m=edge, origin_m=np.zeros(3))
    return ParticleBody(
        particles,
        grid,
        NodeSupports.of(grid.node_count, held=grid.node_place == 0),
        inner_strength=inner_strength,
    )


def pressure_load(body, count=60):
    """Return the load of an inner pressure.

    The pressure is spread from midpoints of a polar net of the octant to the cells that hold them.
    """
    theta, phi = np.meshgrid(*[(np.arange(count) + 0.5) * np.pi / 2.0 / count] * 2, indexing="ij")
    out = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    ).reshape(-1, 3)
    area = np.sin(theta).ravel()
    area *= 4.0 * np.pi / 8.0 / area.sum()
    return body.spread(INNER * out, PRESSURE * area[:, None] * out)


def energy_norm(stress, weights):
    """Square root of sum w s : C^-1 : s."""
    trace = np.trace(stress, axis1=1, axis2=2)
    density = ((1.0 + RATIO) * (stress**2).sum(axis=(1, 2)) - RATIO * trace**2) / MODULUS
    return float(np.sqrt((weights * density).sum()))


def particle_errors(cells, **options):
    """Relative error of the energy, and of the stress in the energy norm."""
    body = sphere(cells, **options)
    load = pressure_load(body)
    found = body.solve(load, tolerance=1e-7)
    assert found.converged
    chosen = np.flatnonzero(body.cells.live[body.cells.particle_cell[body.cells.rank]])
    values = particle_stress(body.cells, found.displacement_m, particles=chosen)
    stress = values[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
    weights = (body.particles.volume_m3 * body.particles.remaining / 65535.0)[chosen]
    exact = exact_stress(body.particles.position_m[chosen])
    energy = 0.5 * (load * found.displacement_m).sum()
    return (
        abs(energy / ENERGY - 1.0),
        energy_norm(stress - exact, weights) / energy_norm(exact, weights),
        body,
    )


def tetrahedra_errors(cells):
    """Compute the same errors for body-fitted linear tetrahedra.

    Their mesh is a cube's shell, of max-norm 1 to 2, bent onto the sphere.
    """
    skfem = pytest.importorskip("skfem")
    from skfem.helpers import ddot, dot, sym_grad
    from skfem.models.elasticity import lame_parameters, linear_elasticity, linear_stress

    mesh = skfem.MeshTet.init_tensor(*([np.linspace(0.0, OUTER, cells + 1)] * 3))
    middle = mesh.p[:, mesh.t].mean(axis=1).max(axis=0)
    mesh = mesh.restrict(np.flatnonzero(middle > INNER))
    largest = mesh.p.max(axis=0)
    mesh = skfem.MeshTet(mesh.p * largest / np.linalg.norm(mesh.p, axis=0), mesh.t)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP1()), intorder=2)
    first, shear = lame_parameters(MODULUS, RATIO)
    matrix = linear_elasticity(first, shear).assemble(basis)
    inner = mesh.facets_satisfying(
        lambda x: np.linalg.norm(x, axis=0) < INNER, boundaries_only=True
    )
    load = skfem.LinearForm(
        lambda v, w: PRESSURE * dot(w.x / np.linalg.norm(w.x, axis=0), v)
    ).assemble(basis.boundary(inner))
    held = np.concatenate([basis.nodal_dofs[axis, mesh.p[axis] < 1e-9] for axis in range(3)])
    moved = skfem.solve(*skfem.condense(matrix, load, D=held))
    stress_of = linear_stress(first, shear)

    @skfem.Functional
    def squared(w):
        x = w.x.reshape(3, -1).T
        exact = np.moveaxis(exact_stress(x), 0, -1).reshape(3, 3, *w.x.shape[1:])
        wrong = stress_of(sym_grad(w["u"])) - exact
        trace = wrong[0, 0] + wrong[1, 1] + wrong[2, 2]
        return ((1.0 + RATIO) * ddot(wrong, wrong) - RATIO * trace**2) / MODULUS

    wrong = np.sqrt(squared.assemble(basis, u=basis.interpolate(moved)))
    return abs(0.5 * load @ moved / ENERGY - 1.0), float(wrong / np.sqrt(2.0 * ENERGY))


@pytest.mark.slow
def test_lame_sphere_converges():
    """Lame's sphere converges.

    Energy converges with order 1 or higher, and stress, in the energy norm, with order 1 (0.85:
    four cut grids scatter).
    """
    cells = np.array([8, 12, 16, 24])
    particle = np.array([particle_errors(int(n))[:2] for n in cells])
    print("\ncells  particles: energy, stress")
    for row in zip(cells, *particle.T, strict=True):
        print("{:5d}  {:17.4f}  {:.4f}".format(*row))
    orders = [slope(1.0 / cells, column) for column in particle.T]
    print("orders", np.round(orders, 2))
    assert orders[0] >= 1.0
    assert orders[1] >= 0.85
    assert particle[-1, 0] < 0.01  # the case's 1 %


@pytest.mark.slow
def test_particles_against_body_fitted_tetrahedra():
    """Particles have a smaller error than body-fitted tetrahedra.

    The cut cells are compared with linear tetrahedra that follow the surfaces, on grids of equal
    edge.
    """
    print("\ncells  particles: energy, stress   tetrahedra: energy, stress")
    for cells in (8, 16):
        ours, theirs = particle_errors(cells)[:2], tetrahedra_errors(cells)
        print("{:5d}  {:17.4f}  {:.4f}   {:18.4f}  {:.4f}".format(cells, *ours, *theirs))
        assert ours[0] < theirs[0] and ours[1] < theirs[1]


REACH = 0.35


FULL = [[0, 5, 4], [5, 1, 3], [4, 3, 2]]
"""Places of a tensor's entries in xx, yy, zz, yz, xz, xy."""


def relative(found, exact):
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def ball(reach, count=41):
    """Points of a lattice in a ball and their weights."""
    at = np.linspace(-reach, reach, count)
    points = np.stack(np.meshgrid(at, at, at), axis=-1).reshape(-1, 3)
    weights = ball_weight(np.linalg.norm(points, axis=1), reach)
    return points[weights > 0.0], weights[weights > 0.0]


def places_by_the_hole(count=30):
    """Return random places of the octant up to 0.25 from the hole.

    No plane of symmetry cuts their balls.
    """
    random = np.random.default_rng(0)
    out = np.abs(random.normal(size=(40 * count, 3)))
    places = out / np.linalg.norm(out, axis=1)[:, None] * random.uniform(INNER, 1.25, (len(out), 1))
    return places[(places > REACH).all(axis=1)][:count]


def mean_by_the_hole(places):
    """Mean of the exact stress over what each ball holds of the shell."""
    points, weights = ball(REACH)
    means = []
    for place in places:
        radius = np.linalg.norm(place + points, axis=1)
        inside = (radius > INNER) & (radius < OUTER)
        means.append(
            np.average(exact_stress((place + points)[inside]), axis=0, weights=weights[inside])
        )
    return np.array(means)


def errors_by_the_hole(cells):
    """Relative errors of the recovered stress, and of that at the particle next to each place."""
    body, places = sphere(cells), places_by_the_hole()
    found = body.solve(pressure_load(body), tolerance=1e-7)
    assert found.converged
    stress, particles = particle_stress(body.cells, found.displacement_m), body.particles
    recovery = StressRecovery(
        particles, body.cells, places, np.zeros(len(places), dtype=int), reach_m=REACH
    )
    mean = recovery(found.displacement_m)
    near = [
        int(np.argmin(np.linalg.norm(particles.position_m - place, axis=1))) for place in places
    ]
    return relative(mean[:, FULL], mean_by_the_hole(places)), relative(
        stress[near][:, FULL], exact_stress(places)
    )


@pytest.mark.parametrize(
    ("cells", "finest"),
    [((8, 12), 0.03), pytest.param((8, 12, 16, 24, 32), 0.0035, marks=pytest.mark.slow)],
)
def test_stress_beside_a_hole(cells, finest):
    """Stress next to a hole converges with order 1.8 or more in the edge.

    The stress at single particles converges with order 1 at best.
    """
    recovered, single = np.array([errors_by_the_hole(n) for n in cells]).T
    print(
        "\ncells, error recovered and at particles",
        *zip(cells, recovered.round(4), single.round(3), strict=True),
    )
    assert slope(1.0 / np.array(cells), recovered) >= 1.8
    assert (np.diff(recovered) < 0.0).all() and recovered[-1] < finest
    assert (recovered < 0.2 * single).all()


SHEAR, RADIUS, HALF = 1.0, 0.4, 1.6


FORCE = np.array([0.3, -0.5, 0.8])


def kelvin(position, moment):
    """Return displacements by Kelvin's force in a ball of this second moment per mass.

    It is averaged over another ball: U + moment times U's Laplacian over 6, exact outside, because
    U is biharmonic.
    """
    r = np.linalg.norm(position, axis=1)[:, None]
    along = (position @ FORCE)[:, None] * position
    plain = (3.0 - 4.0 * RATIO) * FORCE / r + along / r**3
    laplacian = 2.0 * FORCE / r**3 - 6.0 * along / r**5
    return (plain + moment / 6.0 * laplacian) / (16.0 * np.pi * SHEAR * (1.0 - RATIO))


def kelvin_stress(position, moment, step=1e-4):
    """Its stress by central differences, shape (n, 3, 3)."""
    gradient = np.stack(
        [
            (kelvin(position + step * e, moment) - kelvin(position - step * e, moment)) / (2 * step)
            for e in np.eye(3)
        ],
        axis=2,
    )
    strain = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    first = 2.0 * SHEAR * RATIO / (1.0 - 2.0 * RATIO)
    return 2.0 * SHEAR * strain + first * np.trace(strain, axis1=1, axis2=2)[
        :, None, None
    ] * np.eye(3)


def errors_by_the_load(cells):
    """Return the relative error of the recovered stress under a spread force and a point force.

    The first is spread over a ball.
    """
    particles, grid = block(
        (cells,) * 3, 2.0 * HALF / cells, modulus_Pa=2.0 * SHEAR * (1.0 + RATIO), places=lattice(2)
    )
    centre, moment = np.full(3, HALF), 3.0 / 7.0 * RADIUS**2
    held = on_boundary(grid)
    moved = kelvin(np.where(held[:, None], grid.node_position_m - centre, HALF), moment)
    body = ParticleBody(
        particles, grid, NodeSupports.of(grid.node_count, held=held, displacement_m=moved)
    )
    out = np.random.default_rng(1).normal(size=(40, 3))
    places = out / np.linalg.norm(out, axis=1)[:, None] * np.linspace(0.82, 1.0, 40)[:, None]
    recovery = StressRecovery(
        particles, body.cells, centre + places, np.zeros(len(places), dtype=int), reach_m=RADIUS
    )
    wanted, errors = kelvin_stress(places, 2.0 * moment), []
    for load in (body.spread_over(centre, FORCE, radius_m=RADIUS), body.spread(centre, FORCE)):
        found = body.solve(load, tolerance=1e-8)
        assert found.converged
        assert load.sum(axis=0) == pytest.approx(FORCE, rel=1e-12)
        errors.append(relative(recovery(found.displacement_m)[:, FULL], wanted))
    return errors


@pytest.mark.slow
def test_stress_beside_a_load():
    """Order 1.8 or more in the edge under a force spread over a ball."""
    cells = np.array([8, 12, 16, 24])
    spread, point = np.array([errors_by_the_load(int(n)) for n in cells]).T
    print(
        "\ncells, error under a ball and a point",
        *zip(cells, spread.round(4), point.round(4), strict=True),
    )
    assert slope(1.0 / cells, spread) >= 1.8
    assert (np.diff(spread) < 0.0).all() and spread[-1] < 0.02


@pytest.mark.parametrize("cells", [4, 8])
def test_layers_are_not_mixed_and_removed_particles_do_not_count(cells):
    """Layers are not mixed and removed particles do not count.

    Two layers of unlike modulus are under one strain: each place has its own layer's stress,
    whether particles count singly or by cells. Where nothing of the layer is left, or no cell
    carries load, the stress is not a number.
    """
    particles, grid = block(
        (cells,) * 3, 1.0 / cells, modulus_Pa=lambda x: np.where(x[:, 0] > 0.5, 9.0, 1.0)
    )
    particles.layer[:] = particles.position_m[:, 0] > 0.5
    body = ParticleBody(
        particles, grid, NodeSupports.of(grid.node_count, held=grid.node_place[:, 0] == 0)
    )
    recovery = StressRecovery(
        particles, body.cells, np.full((2, 3), 0.5), np.array([0, 1]), reach_m=0.3
    )
    moved = 1e-3 * grid.node_position_m
    wanted = (
        np.array([1.0, 9.0])[:, None] * 1e-3 / (1.0 - 2.0 * RATIO) * np.array([1, 1, 1, 0, 0, 0])
    )
    assert recovery(moved) == pytest.approx(wanted, rel=1e-6, abs=1e-8)
    right = np.flatnonzero(particles.layer == 1)
    body.set_remaining(right, np.zeros(len(right), dtype=int))
    body.update()
    found = recovery(moved)
    assert found[0] == pytest.approx(wanted[0], rel=1e-6, abs=1e-8) and np.isnan(found[1]).all()
