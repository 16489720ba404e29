"""Energy, force and tangent of the three laws.

They are compared with NumPy and finite differences, and under rotation.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.assembly import assemble
from tissue.fem.hyperelastic import Law, NonlinearBody
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

LAWS = list(Law)
YOUNG, POISSON = 5e3, 0.4


def space_of(order: int, seed: int) -> Space:
    """A shaken box of 12 tetrahedra, linear or quadratic."""
    mesh = box((0.02, 0.01, 0.01), (2, 1, 1))
    nodes = mesh.nodes_m + np.random.default_rng(seed).uniform(-1e-3, 1e-3, mesh.nodes_m.shape)
    return Space(TetMesh(nodes, mesh.cells), order)


def body_of(law, order=1, seed=0):
    return NonlinearBody(space_of(order, seed), lame(YOUNG, POISSON), law=law)


def shaken(body, seed, size=0.15):
    """Return a displacement of strains about ``size``.

    It is turned by a large rotation unless the law is linear.
    """
    random = np.random.default_rng(seed)
    turn = np.eye(3) if body.law is Law.LINEAR else Rotation.random(rng=random).as_matrix()
    bent = body.nodes_m @ (turn @ (np.eye(3) + size * random.uniform(-1.0, 1.0, (3, 3)))).T
    return bent + 2e-4 * random.uniform(-1.0, 1.0, bent.shape) - body.nodes_m


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(4))
def test_energy_force_and_stiffness_agree(law, order, seed):
    """Energy, force and stiffness agree by central differences over random directions.

    Truncation is h^2, rounding 1e-16/h; at h = 1e-6 both are below 1e-8.
    """
    body = body_of(law, order, seed)
    at = shaken(body, 100 + seed)
    random = np.random.default_rng(200 + seed)
    _, force = body.energy_and_force(at)
    stiffness = body.stiffness(at)
    for _ in range(3):
        direction = random.normal(size=at.shape)
        h = 1e-6 * np.abs(body.nodes_m).max()
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


@pytest.mark.parametrize("law", LAWS)
def test_stiffness_is_symmetric_to_the_bit(law):
    """K equals its transpose, no tolerance, far from rest too."""
    for order in (1, 2):
        body = body_of(law, order, 3)
        dense = body.stiffness(shaken(body, 7)).toarray()
        assert np.array_equal(dense, dense.T)


def test_stiffness_at_rest_is_one_and_has_six_zero_modes():
    """All laws share it with the linear assembly; its zero modes are the rigid motions."""
    for order in (1, 2):
        space = space_of(order, 0)
        zero = np.zeros(space.nodes_m.shape)
        rest = [
            NonlinearBody(space, lame(YOUNG, POISSON), law=law).stiffness(zero).toarray()
            for law in LAWS
        ]
        for other in (*rest[1:], assemble(space, lame(YOUNG, POISSON)).toarray()):
            np.testing.assert_allclose(other, rest[0], atol=1e-12 * np.abs(rest[0]).max())
        values = np.linalg.eigvalsh(rest[0])
        assert np.abs(values[:6]).max() < 1e-12 * values[-1] < values[6]


@pytest.mark.parametrize("law", LAWS)
def test_against_numpy(law):
    """One linear tetrahedron under a known gradient agrees with NumPy.

    The formulas are written out with an SVD and dense algebra.
    """
    random = np.random.default_rng(5)
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.01
    body = NonlinearBody(
        Space(TetMesh(nodes, np.array([[0, 1, 2, 3]]))), lame(YOUNG, POISSON), law=law
    )
    mu, lam = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    volume, gradient = (
        1e-6 / 6.0,
        np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) / 0.01,
    )
    for _ in range(20):
        f = Rotation.random(rng=random).as_matrix() @ (
            np.eye(3) + random.uniform(-0.3, 0.3, (3, 3))
        )
        j = np.linalg.det(f)
        if law is Law.LINEAR:
            e = (f + f.T) / 2 - np.eye(3)
            psi, p = (
                mu * np.sum(e * e) + lam / 2 * np.trace(e) ** 2,
                2 * mu * e + lam * np.trace(e) * np.eye(3),
            )
        elif law is Law.COROTATIONAL:
            u, s, vt = np.linalg.svd(f)
            psi, p = (
                mu * np.sum((s - 1) ** 2) + lam / 2 * (s.sum() - 3) ** 2,
                2 * mu * (f - u @ vt) + lam * (s.sum() - 3) * u @ vt,
            )
        else:
            psi = mu / 2 * (np.sum(f * f) - 3) - mu * np.log(j) + lam / 2 * np.log(j) ** 2
            p = mu * f + (lam * np.log(j) - mu) * np.linalg.inv(f).T
        energy, force = body.energy_and_force(nodes @ (f - np.eye(3)).T)
        assert energy == pytest.approx(volume * psi, rel=1e-12)
        np.testing.assert_allclose(
            force, volume * gradient @ p.T, atol=1e-12 * np.abs(volume * gradient @ p.T).max()
        )


@pytest.mark.parametrize("law", LAWS)
def test_turned_over_cells_have_infinite_energy(law):
    """Mirrored through a plane: refused by the nonlinear laws, not seen by the linear one."""
    body = body_of(law)
    energy, _ = body.energy_and_force(body.nodes_m * [-2.0, 0.0, 0.0])
    assert np.isfinite(energy) == (law is Law.LINEAR)


def test_small_strain_limit():
    """All laws agree to first order.

    The difference to linear shrinks with the square of the strain.
    """
    linear = body_of(Law.LINEAR, 2)
    direction = np.random.default_rng(0).normal(size=linear.nodes_m.shape) * 1e-3
    for law in (Law.COROTATIONAL, Law.NEO_HOOKEAN):
        body, sizes = body_of(law, 2), np.array([1e-2, 1e-3, 1e-4])
        errors = [
            np.abs(
                body.energy_and_force(s * direction)[1] - linear.energy_and_force(s * direction)[1]
            ).max()
            for s in sizes
        ]
        assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.05)
