"""Ball pressed into a layer by the axisymmetric solver of probe fits.

It is compared with Hertz, with derivatives by differences, with an independent solution from
geometry and energy alone, and with the tetrahedra of an organ.
"""

import numpy as np
import pytest
from newton_press import NewtonSolver, RigidSphere
from spline_press import spline_press_N

from meshes.base.errors import InputError
from meshes.tets.structured import graded, grid
from tissue.fem import axisymmetric
from tissue.fem.axisymmetric import LinearLaw, layer_mesh, press_forces
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.space import Space
from tissue.fitting.probe_laws import layer_scene, probe_curves
from tissue.materials.constants import constants
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

POISSON = 0.49
BULK = 2.0 * (1.0 + POISSON) / (3.0 * (1.0 - 2.0 * POISSON))
"""Bulk modulus over the shear modulus."""
LINEAR = LinearLaw(BULK - 2.0 / 3.0, 1.0)
NEO_HOOKEAN = Hyperelastic.neo_hookean(1.0, bulk_Pa=BULK)
EXPONENTIAL = Hyperelastic.exponential(1.0, 4.0, bulk_Pa=BULK)
LAWS = {"linear": LINEAR, "neo-hookean": NEO_HOOKEAN, "exponential": EXPONENTIAL}
LAW = pytest.mark.parametrize("name", LAWS)
DEPTHS = np.array([0.15, 0.45, 0.75])
"""Depths over the ball's radius."""


@pytest.mark.slow
def test_a_shallow_press_of_a_thick_layer_is_hertz():
    """Within 1.5 %: at depths of 0.02 and 0.05 radii the contact is 0.14 and 0.22 radii wide."""
    depths = np.array([0.02, 0.05])
    found = press_forces(layer_mesh(1.0, 20.0, first=0.025), LINEAR, depths)
    young = 2.0 * (1.0 + POISSON)
    exact = 4.0 / 3.0 * young / (1.0 - POISSON**2) * depths**1.5
    assert found == pytest.approx(exact, rel=0.015)


@LAW
def test_stress_and_tangent_are_derivatives_of_the_energy(name):
    """By central differences, for random gradients and for equal stretches."""
    random = np.random.default_rng(3)
    gradients = np.array([1.0, 0.0, 0.0, 1.0, 1.0]) + 0.2 * random.standard_normal((12, 5))
    gradients[0] = [1.1, 0.0, 0.0, 1.1, 1.1]

    def state(gradient, order=2):
        if name == "linear":
            return axisymmetric._linear(LINEAR, gradient - [1.0, 0.0, 0.0, 1.0, 1.0])
        return axisymmetric._stretched(LAWS[name], gradient, order)

    _, stress, tangent = state(gradients)
    for each, step in enumerate(1e-6 * np.eye(5)):
        energies = [state(gradients + sign * step)[0] for sign in (1.0, -1.0)]
        stresses = [state(gradients + sign * step)[1] for sign in (1.0, -1.0)]
        assert (energies[0] - energies[1]) / 2e-6 == pytest.approx(stress[:, each], abs=1e-6)
        slope = (stresses[0] - stresses[1]) / 2e-6
        assert slope == pytest.approx(tangent[..., each], abs=1e-5 * np.abs(tangent).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["linear", "exponential"])
def test_the_mesh_of_a_fit_is_fine_enough(name):
    """Against a mesh of a third of the edges: 0.7 % at 0.15 radii, 0.4 % deeper."""
    mesh, finer = (layer_mesh(1.0, 2.5, first=axisymmetric.FIRST / each) for each in (1.0, 3.0))
    off = press_forces(mesh, LAWS[name], DEPTHS) / press_forces(finer, LAWS[name], DEPTHS) - 1.0
    print(name, np.round(100.0 * off, 2))
    assert np.abs(off) == pytest.approx(0.0, abs=0.007)
    assert np.abs(off[1:]) == pytest.approx(0.0, abs=0.004)


@pytest.mark.slow
def test_a_law_without_an_equilibrium_ends_in_not_a_number():
    """A press through 90 % of a layer gives no force instead of a wrong one."""
    depths = np.array([0.1, 1.8])
    found = press_forces(layer_mesh(2.0, 2.0, first=0.3), NEO_HOOKEAN, depths)
    assert np.isfinite(found[0])
    assert np.isnan(found[1])


def test_lengths_are_checked():
    with pytest.raises(InputError, match="thickness_m must be positive"):
        layer_mesh(1.0, 0.0)


SPLINE_N = {
    "neo-hookean": np.array([0.352658, 1.998387, 4.400193]),
    "exponential": np.array([0.384829, 2.937942, 11.161052]),
}
"""Forces of `independent_N` at `DEPTHS`, recorded because a law takes about a minute."""


def independent_N(name, depths):
    """Return the forces of an independent solution on a layer of 2.5 radii, for a law."""
    import jax.numpy as jnp

    def density(first, ratio):
        x = first * ratio ** (-2.0 / 3.0) - 3.0
        shape = 0.5 * x if name == "neo-hookean" else (jnp.exp(4.0 * x) - 1.0) / 8.0
        return shape + 0.25 * BULK * (ratio**2 - 1.0 - 2.0 * jnp.log(ratio))

    width = float(layer_mesh(1.0, 2.5).nodes_m[:, 0].max())
    return spline_press_N(density, radius=1.0, thickness=2.5, width=width, depths=depths, cells=12)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", SPLINE_N)
def test_a_deep_press_is_that_of_an_independent_solution(name):
    """Within 0.5 % from 0.15 to 0.75 radii, on a layer of 2.5 radii.

    The solutions are recorded. `test_a_recorded_solution_is_found_again` computes a force of each
    law again.
    """
    mesh = layer_mesh(1.0, 2.5)
    exact = SPLINE_N[name]
    off = press_forces(mesh, LAWS[name], DEPTHS) / exact - 1.0
    print(name, np.round(exact, 4), np.round(100.0 * off, 2))
    assert off == pytest.approx(np.zeros(3), abs=0.005)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", SPLINE_N)
def test_a_recorded_solution_is_found_again(name):
    """The independent solution gives the recorded force at the first depth again."""
    pytest.importorskip("jax")
    found = independent_N(name, DEPTHS[:1])
    assert found == pytest.approx(SPLINE_N[name][:1], rel=1e-5)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_tetrahedra_of_an_organ_approach_the_same_force():
    """Quadratic tetrahedra of 1.5 and 1 mm, extrapolated to zero edges: within 3 %.

    The nodes alone touch the ball, so the error is of first order in the edges: the two meshes are
    6 and 5 % too stiff at 0.75 radii.
    """
    radius, thickness, depths = 4e-3, 10e-3, np.array([1.5e-3, 3e-3])
    law = Hyperelastic.exponential(5e3, 4.0, bulk_Pa=5e3 * BULK)
    exact = press_forces(layer_mesh(radius, thickness), law, depths)
    forces = {}
    for edge in (1.5e-3, 1e-3):
        aside = graded(0.0, 28e-3, edge, 1.45)
        space = Space(grid(aside, aside, graded(0.0, -thickness, edge, 1.45)[::-1]), 2)
        held = (np.abs(space.nodes_m) < 1e-12) & np.array([True, True, False])
        held[space.nodes_m[:, 2] < -thickness + 1e-9] = True
        near = np.linalg.norm(space.nodes_m, axis=1) < 2.0 * radius
        top = np.flatnonzero((space.nodes_m[:, 2] > -1e-12) & near)
        solver = NewtonSolver(NonlinearBody(space, law=law), held, tolerance=1e-5)
        penalty = 10.0 * solver.rest_diagonal.reshape(-1, 3)[top].mean(axis=1)
        ball = RigidSphere(top, penalty, radius_m=radius, centre_m=np.zeros(3), tolerance=1e-4)
        now, found = None, []
        for depth in depths:
            ball.centre_m = np.array([0.0, 0.0, radius - depth])
            solution = solver.solve(sphere=ball, start_m=now)
            assert solution.converged
            now = solution.displacement_m
            found.append(4.0 * solution.tool_force_N[2])
        forces[edge] = np.array(found)
    limit = forces[1e-3] - 2.0 * (forces[1.5e-3] - forces[1e-3])
    print({edge: np.round(force / exact - 1.0, 4) for edge, force in forces.items()}, limit / exact)
    assert limit[-1] == pytest.approx(exact[-1], rel=0.03)
    assert (forces[1e-3] > exact).all()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_pressed_liver_pushes_back_as_measured():
    """A ball of 8 mm on 10 mm of cited liver, at rest 2.93 mm deep: four measured regions.

    Their medians are 0.74 to 1.89 N. The scene's own mesh is within 4 % of the axisymmetric force,
    and the exponent of force over depth rises from 1.5 (Hertz) to more than 2.5.
    """
    scene = load_scene(
        "palpation",
        {
            "anatomy.size_mm": [60, 60, 10],
            "anatomy.edge_mm": 5.0,
            "anatomy.touch_edge_mm": None,
            "anatomy.nodule_diameter_mm": 0.0,
            "tool.diameter_mm": 8.0,
            "organ.material": "pressed_liver",
            "organ.law": "exponential",
            "organ.young_kPa": None,
            "organ.young_end_kPa": None,
            "organ.parts": None,
            "organ.friction": 0.0,
            "organ.interval_ms": 0.0,
            "motion.points_mm": [[0, 0, 0.3], [0, 0, -2.93], [0, 0, -2.94]],
            "motion.feed_mm_s": 8.0,
            "duration_s": 0.6,
        },
    )
    depths = np.array([0.3e-3, 0.9e-3, 2.2e-3, 2.93e-3])
    young = 1e3 * constants("soft", "pressed_liver")["modulus_kPa"].value
    exact = young * probe_curves(layer_scene(scene), depths, ()).unit_N_Pa[0]
    slopes = np.diff(np.log(exact))[::2] / np.diff(np.log(depths))[::2]
    force = simulate(scene, cores=1).trace["force_z_N"][-1]
    print(np.round(exact, 3), force, slopes)
    assert 0.74 < force < 1.89
    assert force == pytest.approx(exact[-1], rel=0.04)
    assert slopes[0] < 1.8
    assert slopes[1] > 2.5
