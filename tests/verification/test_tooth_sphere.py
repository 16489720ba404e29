"""Hollow sphere under inner pressure, cut from a grid (Lame, validation case 3).

It is compared with body-fitted tetrahedra.
"""

import numpy as np
import pytest
from hollow_sphere import (
    ENERGY,
    INNER,
    MODULUS,
    OUTER,
    PRESSURE,
    RATIO,
    exact_stress,
    pressure_load,
    sphere,
)
from tooth_bodies import particle_stress, slope


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


@pytest.mark.slow
def test_error_and_condition_of_stabilisation():
    """Error and condition depend on the stabilisation.

    The condition number of the diagonally scaled stiffness and the errors are given over particles
    a cell and inner stiffness. One particle a cell without inner stiffness is singular. A tenth
    closes it and costs less than a tenth of the errors.
    """
    print("\nparticles a cell  strength  condition  energy error  stress error")
    rows = {}
    for per_edge in (1, 2, 4):
        for strength in (1e-3, 0.1, 1.0):
            energy, stress, body = particle_errors(8, inner_strength=strength, per_edge=per_edge)
            matrix = body.matrix().toarray()
            kept = np.flatnonzero(np.diag(matrix) > 0.0)
            scale = 1.0 / np.sqrt(np.diag(matrix)[kept])
            values = np.linalg.eigvalsh(scale[:, None] * matrix[np.ix_(kept, kept)] * scale)
            rows[per_edge, strength] = values[-1] / values[0], energy, stress
            row = rows[per_edge, strength]
            print(
                f"{per_edge**3:16d}  {strength:8.0e}  {row[0]:9.2e}  {row[1]:12.4f}  {row[2]:12.4f}"
            )
    bare = sphere(8, inner_strength=0.0, per_edge=1)
    assert not bare.solve(pressure_load(bare)).converged
    assert rows[1, 0.1][0] < 0.1 * rows[1, 1e-3][0]
    for per_edge in (2, 4):
        assert rows[per_edge, 0.1][0] <= rows[per_edge, 1e-3][0]
        for error in (1, 2):
            assert rows[per_edge, 0.1][error] < 1.1 * rows[per_edge, 1e-3][error]
