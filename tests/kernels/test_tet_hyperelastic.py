"""Tetrahedra under laws of principal stretches.

They are compared with NumPy, closed forms, differences, turns, work and a mirror.
"""

import numpy as np
import pytest
from hyperelastic_law import energy as energy_of
from hyperelastic_law import tangent as tangent_of
from newton_press import NewtonSolver
from scipy.spatial.transform import Rotation

from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.space import Space
from tissue.materials.hyperelasticity import Hyperelastic

BULK = 97e3
OGDEN = ((1200.0, 1.3), (300.0, 5.0), (-80.0, -2.0))
LAWS = {
    "neo-hookean": Hyperelastic.neo_hookean(2000.0, bulk_Pa=BULK),
    "mooney-rivlin": Hyperelastic.mooney_rivlin(700.0, 250.0, bulk_Pa=BULK),
    "yeoh": Hyperelastic.yeoh(900.0, 150.0, 40.0, bulk_Pa=BULK),
    "ogden": Hyperelastic(BULK, OGDEN),
    "exponential": Hyperelastic.exponential(1800.0, 0.7, bulk_Pa=BULK),
}
LAW = pytest.mark.parametrize("name", LAWS)
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.01
SLOPES = np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) / 0.01
VOLUME = 1e-6 / 6.0


def shaken_body(name: str, order: int, seed: int = 0) -> NonlinearBody:
    mesh = box((0.02, 0.01, 0.01), (2, 1, 1))
    nodes = mesh.nodes_m + np.random.default_rng(seed).uniform(-1e-3, 1e-3, mesh.nodes_m.shape)
    return NonlinearBody(Space(TetMesh(nodes, mesh.cells), order), law=LAWS[name])


def bent(body: NonlinearBody, seed: int) -> np.ndarray:
    """A displacement of strains about 0.15."""
    random = np.random.default_rng(seed)
    affine = body.nodes_m @ (0.15 * random.uniform(-1.0, 1.0, (3, 3))).T
    return affine + 2e-4 * random.uniform(-1.0, 1.0, body.nodes_m.shape)


@LAW
def test_one_tetrahedron_is_that_of_numpy(name):
    """One tetrahedron agrees with NumPy.

    Energy, force and tangent agree to 1e-10 for random, turned, equal, nearly equal and far apart
    stretches.
    """
    law, random = LAWS[name], np.random.default_rng(5)
    gradients = [
        Rotation.random(rng=random).as_matrix() @ (np.eye(3) + random.uniform(-0.3, 0.3, (3, 3)))
        for _ in range(12)
    ]
    turn = Rotation.random(rng=random).as_matrix()
    for stretch in (
        (1, 1, 1),
        (1.2, 1.2, 0.8),
        (1.1, 1.1 + 1e-9, 1.1),
        (2.0, 0.5, 1.0),
        (0.3, 1.9, 1.7),
    ):
        gradients += [np.diag(stretch), turn @ np.diag(stretch), np.diag(stretch) @ turn]
    body = NonlinearBody(Space(TetMesh(CORNERS, np.array([[0, 1, 2, 3]]))), law=law)
    for f in gradients:
        moved = CORNERS @ (f - np.eye(3)).T
        energy, force = body.energy_and_force(moved)
        tangent = (
            np.einsum("aj,ijkl,bl->aibk", SLOPES, tangent_of(law, f), SLOPES).reshape(12, 12)
            * VOLUME
        )
        assert energy == pytest.approx(
            VOLUME * energy_of(law, f), rel=1e-10, abs=1e-15 * VOLUME * BULK
        )
        np.testing.assert_allclose(
            force, VOLUME * SLOPES @ law.stress(f).T, atol=1e-10 * VOLUME * BULK / 0.01
        )
        np.testing.assert_allclose(
            body.stiffness(moved).toarray(), tangent, atol=1e-10 * np.abs(tangent).max()
        )


@LAW
def test_the_definite_tangent_has_the_magnitudes_of_the_eigenvalues(name):
    """The definite tangent has the magnitudes of the eigenvalues of NumPy's tangent.

    Pressed flat, sheared and pulled cells have negative eigenvalues; unit and pulled ones have
    equal stretches.
    """
    law, random = LAWS[name], np.random.default_rng(7)
    turn = Rotation.random(rng=random).as_matrix()
    body = NonlinearBody(Space(TetMesh(CORNERS, np.array([[0, 1, 2, 3]]))), law=law)
    negative = 0
    for stretch in ((1.0, 1, 1), (0.4, 1.1, 0.9), (0.5, 0.5, 0.5), (3.0, 0.6, 0.6), (2.0, 0.5, 1)):
        f = turn @ np.diag(stretch) @ Rotation.random(rng=random).as_matrix()
        values, frame = np.linalg.eigh(tangent_of(law, f).reshape(9, 9))
        negative += (values < 0.0).sum()
        raised = np.maximum(np.abs(values), 1e-3 * law.shear_Pa)
        expected = ((frame * raised) @ frame.T).reshape(3, 3, 3, 3)
        expected = np.einsum("aj,ijkl,bl->aibk", SLOPES, expected, SLOPES).reshape(12, 12) * VOLUME
        found = body.stiffness(CORNERS @ (f - np.eye(3)).T, definite=True).toarray()
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    assert negative > 5


@LAW
@pytest.mark.parametrize("order", [1, 2])
def test_force_and_stiffness_are_differences_and_symmetric_to_the_bit(name, order):
    body = shaken_body(name, order)
    at, h = bent(body, 1), 1e-6 * 0.02
    _, force = body.energy_and_force(at)
    stiffness = body.stiffness(at)
    direction = np.random.default_rng(2).normal(size=at.shape)
    plus, minus = (
        body.energy_and_force(at + h * direction),
        body.energy_and_force(at - h * direction),
    )
    scale = np.linalg.norm(force) * np.linalg.norm(direction)
    assert abs((plus[0] - minus[0]) / (2.0 * h) - np.sum(force * direction)) < 1e-7 * scale
    product = (stiffness @ direction.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(
        (plus[1] - minus[1]) / (2.0 * h), product, atol=1e-7 * np.abs(product).max()
    )
    assert np.array_equal(stiffness.toarray(), stiffness.toarray().T)


def cauchy_difference(name: str, first: float, third: float, second: float) -> float:
    """Return s_1 - s_3 of principal stretches at constant volume [Pa].

    It is written out from each law's definition.
    """
    if name == "ogden":
        return sum(2.0 * mu / n * (first**n - third**n) for mu, n in OGDEN)
    x = first**2 + second**2 + third**2 - 3.0
    w1, w2 = {
        "neo-hookean": (1000.0, 0.0),
        "mooney-rivlin": (700.0, 250.0),
        "yeoh": (900.0 + 300.0 * x + 120.0 * x**2, 0.0),
        "exponential": (900.0 * np.exp(0.7 * x), 0.0),
    }[name]
    return 2.0 * (first**2 - third**2) * (w1 + w2 * second**2)


@LAW
@pytest.mark.parametrize("kind", ["uniaxial", "equibiaxial"])
@pytest.mark.parametrize("stretch", [0.7, 1.4])
def test_a_pulled_block_is_the_closed_form(name, kind, stretch):
    """A pulled block follows the closed form.

    With free sides J follows from kappa (J - 1/J) / 2 = -(s_1 - s_3) / 3 per free direction, and
    the force agrees to 1e-6.
    """
    space = Space(box((0.02, 0.02, 0.02), (2, 2, 2)))
    body = NonlinearBody(space, law=LAWS[name])
    driven = [0] if kind == "uniaxial" else [0, 1]
    held, goal = np.abs(space.nodes_m) < 1e-9, np.zeros(space.nodes_m.shape)
    for axis in driven:
        end = space.nodes_m[:, axis] > 0.02 - 1e-9
        held[end, axis] = True
    solver, found = NewtonSolver(body, held, tolerance=1e-10), None
    for now in np.linspace(1.0, stretch, 4)[1:]:
        for axis in driven:
            goal[space.nodes_m[:, axis] > 0.02 - 1e-9, axis] = (now - 1.0) * 0.02
        solution = solver.solve(goal, start_m=found)
        assert solution.converged
        found = solution.displacement_m
    pull = solution.force_N[space.nodes_m[:, 0] > 0.02 - 1e-9, 0].sum()
    volume = 1.0
    # s_3 = 0 on the free sides: pressure of the change of volume against the mean stress
    for _ in range(60):
        free = (volume / stretch) ** 0.5 if kind == "uniaxial" else volume / stretch**2
        unit = volume ** (1 / 3)
        other = free if kind == "uniaxial" else stretch
        difference = cauchy_difference(name, stretch / unit, free / unit, other / unit) / volume
        mean = difference / 3.0 if kind == "uniaxial" else 2.0 * difference / 3.0
        volume = mean / BULK + np.sqrt((mean / BULK) ** 2 + 1.0)
    assert pull == pytest.approx(difference * (volume / stretch) * 0.02**2, rel=1e-6)


@LAW
def test_a_sheared_block_is_the_closed_form(name):
    """A sheared block follows the closed form.

    The surface is moved by simple shear 0.6: the inside follows (patch test), and the shear force
    on a face agrees to 1e-6.
    """
    g = 0.6
    mesh = box((0.03, 0.03, 0.03), (3, 3, 3))
    inner = ((mesh.nodes_m > 1e-9) & (mesh.nodes_m < 0.03 - 1e-9)).all(axis=1)
    shift = np.random.default_rng(0).uniform(-1.6e-3, 1.6e-3, mesh.nodes_m.shape)
    space = Space(TetMesh(mesh.nodes_m + inner[:, None] * shift, mesh.cells))
    held = np.zeros(space.nodes_m.shape, dtype=bool)
    held[np.unique(space.faces)] = True
    solver, found = (
        NewtonSolver(NonlinearBody(space, law=LAWS[name]), held, tolerance=1e-11),
        None,
    )
    for share in (0.5, 1.0):
        goal = share * g * space.nodes_m[:, [1]] * [1.0, 0.0, 0.0]
        solution = solver.solve(goal, start_m=found)
        assert solution.converged
        found = solution.displacement_m
    np.testing.assert_allclose(found, goal, atol=1e-9 * np.abs(goal).max())
    a = 0.5 * g + np.sqrt(1.0 + 0.25 * g**2)
    shear = cauchy_difference(name, a, 1.0 / a, 1.0) / (a + 1.0 / a)
    body_energy = solver.body.energy_and_force(found)[0] / 0.03**3
    nodes, weight = np.polynomial.legendre.leggauss(12)
    work = 0.0
    for t, w in zip(0.5 * g * (nodes + 1.0), 0.5 * g * weight, strict=True):
        b = 0.5 * t + np.sqrt(1.0 + 0.25 * t**2)
        work += w * cauchy_difference(name, b, 1.0 / b, 1.0) / (b + 1.0 / b)
    assert body_energy == pytest.approx(work, rel=1e-6)
    # by virtual work of a uniform further shear, which moves every node by its height
    virtual = float(np.sum(solution.force_N[:, 0] * space.nodes_m[:, 1])) / 0.03**3
    assert virtual == pytest.approx(shear, rel=1e-6)
