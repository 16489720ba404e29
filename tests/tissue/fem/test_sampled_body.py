"""A body in a few modes and at a few points: against the whole body, by differences, round a closed path, turned."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.tets.structured import box
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.sampled_body import SampledBody
from tissue.fem.space import Space
from tissue.materials.hyperelasticity import Hyperelastic

LAW = Hyperelastic.yeoh(900.0, 150.0, 40.0, bulk_Pa=97e3)


def parts(order: int, modes: int | None = None, seed: int = 0):
    """A block, factors of its cells, random smooth modes, and amounts that strain by about 0.1."""
    random = np.random.default_rng(seed)
    space = Space(box((0.02, 0.01, 0.01), (2, 1, 1)), order)
    factors = random.uniform(0.5, 2.0, space.cell_count)
    if modes is None:
        vectors = np.eye(space.unknown_count)
        return space, factors, vectors, 2e-4 * random.uniform(-1.0, 1.0, space.unknown_count)
    scaled = space.nodes_m / 0.01
    shapes = np.stack([np.sin(scaled @ random.uniform(0.0, 1.5, (3, 3))) for _ in range(modes)], axis=-1)
    return space, factors, shapes.reshape(-1, modes), 4e-4 * random.uniform(-1.0, 1.0, modes)


@pytest.mark.parametrize("order", [1, 2])
def test_all_unknowns_at_all_points_are_the_whole_body(order):
    space, factors, modes, amounts = parts(order)
    whole = NonlinearBody(space, None, law=LAW, cell_factors=factors)
    body = SampledBody(space, LAW, factors, modes)
    energy, force = whole.energy_and_force(amounts.reshape(-1, 3))
    found = body.energy_and_force(amounts)
    assert found[0] == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(found[1], force.ravel(), atol=1e-11 * np.abs(force).max())
    stiffness = whole.stiffness(amounts.reshape(-1, 3)).toarray()
    np.testing.assert_allclose(body.tangent(amounts), stiffness, atol=1e-11 * np.abs(stiffness).max())


def test_force_and_tangent_are_derivatives_of_the_energy_whatever_the_points():
    space, factors, modes, amounts = parts(2, 5)
    body = SampledBody(space, LAW, factors, modes, points=np.array([0, 7, 8, 21]), volumes_m3=np.array([1, 4, 2, 3.0]))
    step = 1e-7
    moved = [[body.energy_and_force(amounts + sign * step * each) for sign in (1, -1)] for each in np.eye(5)]
    force = [(up[0] - down[0]) / (2.0 * step) for up, down in moved]
    tangent = [(up[1] - down[1]) / (2.0 * step) for up, down in moved]
    exact = body.energy_and_force(amounts)[1]
    np.testing.assert_allclose(exact, force, atol=1e-6 * np.abs(exact).max())
    np.testing.assert_allclose(body.tangent(amounts), tangent, atol=1e-6 * np.abs(tangent).max())


def test_a_closed_path_does_no_work():
    space, factors, modes, amounts = parts(2, 3)
    body = SampledBody(space, LAW, factors, modes, points=np.array([2, 11]), volumes_m3=np.array([3e-7, 5e-7]))
    angle = np.linspace(0.0, 2.0 * np.pi, 401)
    path = np.abs(amounts[:, None]) * np.array([np.cos(angle), np.sin(angle), np.sin(2.0 * angle)])
    forces = np.array([body.energy_and_force(place)[1].copy() for place in path.T])
    work = 0.5 * (forces[1:] + forces[:-1]) * np.diff(path.T, axis=0)
    assert abs(work.sum()) < 1e-4 * np.abs(work).sum()


def test_a_rotation_that_a_mode_holds_costs_nothing_and_half_of_it_does():
    """Objective on what the modes span: a rotation is not linear in an amount, so half of the amount is a strain."""
    space, factors, _, _ = parts(2, 3)
    turn = Rotation.from_rotvec([0.3, -0.5, 0.4]).as_matrix()
    body = SampledBody(space, LAW, factors, (space.nodes_m @ (turn - np.eye(3)).T).reshape(-1, 1))
    half = body.energy_and_force(np.array([0.5]))[0]
    assert half > 1e-7
    assert body.energy_and_force(np.array([1.0]))[0] == pytest.approx(0.0, abs=1e-9 * half)


def test_a_point_turned_over_has_infinite_energy():
    space, factors, _, _ = parts(1, 3)
    body = SampledBody(space, LAW, factors, (space.nodes_m * [0.0, 0.0, -1.0]).reshape(-1, 1))
    assert body.energy_and_force(np.array([1.1]))[0] == np.inf
