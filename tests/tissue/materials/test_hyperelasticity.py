"""Hyperelastic laws.

They are compared with closed forms, differences, rotations, work along a path and the linear law.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.base.errors import InputError
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
STRETCHES = (0.4, 0.7, 1.0, 1.3, 1.6, 2.0)
SHEARS = (-1.0, 0.0, 0.3, 1.5)


def invariant_slopes(name: str, i1: float) -> tuple[float, float]:
    """dW/dI1 and dW/dI2 at constant volume [Pa], written out from each law's definition."""
    x = i1 - 3.0
    return {
        "neo-hookean": (1000.0, 0.0),
        "mooney-rivlin": (700.0, 250.0),
        "yeoh": (900.0 + 2.0 * 150.0 * x + 3.0 * 40.0 * x**2, 0.0),
        "exponential": (900.0 * np.exp(0.7 * x), 0.0),
    }[name]


def cauchy(law: Hyperelastic, gradient: np.ndarray) -> np.ndarray:
    return law.stress(gradient) @ gradient.T / np.linalg.det(gradient)


def random_gradients(seed: int, count: int = 20) -> np.ndarray:
    f = np.eye(3) + 0.25 * np.random.default_rng(seed).standard_normal((count, 3, 3))
    return f[np.linalg.det(f) > 0.2]


@LAW
@pytest.mark.parametrize("a", STRETCHES)
def test_uniaxial_and_equibiaxial_tension_are_the_closed_forms(name, a):
    """Uniaxial and equibiaxial tension follow the closed forms.

    The difference of two Cauchy stresses at constant volume has no pressure in it (Ogden 1984,
    chapter 7).
    """
    for first, third in ((a, a**-0.5), (a, a**-2.0)):
        stretch = (first, third, third) if third == a**-0.5 else (first, first, third)
        stress = cauchy(LAWS[name], np.diag(stretch))
        if name == "ogden":
            exact = sum(2.0 * mu / n * (first**n - third**n) for mu, n in OGDEN)
        else:
            w1, w2 = invariant_slopes(name, float(np.square(stretch).sum()))
            exact = 2.0 * (first**2 - third**2) * (w1 + w2 * stretch[1] ** 2)
        assert stress[0, 0] - stress[2, 2] == pytest.approx(exact, rel=1e-10, abs=1e-8)


@LAW
@pytest.mark.parametrize("shear", SHEARS)
def test_simple_shear_is_the_closed_form(name, shear):
    """Stress 2 (W1 + W2) g; Ogden's through the stretch a with a - 1/a = g."""
    gradient = np.eye(3)
    gradient[0, 1] = shear
    if name == "ogden":
        a = 0.5 * shear + np.sqrt(1.0 + 0.25 * shear**2)
        exact = sum(2.0 * mu / n * (a**n - a**-n) for mu, n in OGDEN) / (a + 1.0 / a)
    else:
        exact = 2.0 * sum(invariant_slopes(name, 3.0 + shear**2)) * shear
    assert cauchy(LAWS[name], gradient)[0, 1] == pytest.approx(exact, rel=1e-10, abs=1e-8)


@LAW
def test_a_change_of_volume_alone_has_the_pressure_of_the_volumetric_part(name):
    j = 1.2
    exact = 0.5 * BULK * (j - 1.0 / j) * np.eye(3)
    assert cauchy(LAWS[name], j ** (1 / 3) * np.eye(3)) == pytest.approx(exact, rel=1e-10, abs=1e-7)


def tangent_of(law: Hyperelastic, f: np.ndarray) -> np.ndarray:
    """dP_ij / dF_kl by central differences, shape (..., 3, 3, 3, 3)."""
    tangent, step = np.empty((*f.shape, 3, 3)), 1e-6
    for k, n in np.ndindex(3, 3):
        change = np.zeros((3, 3))
        change[k, n] = step
        tangent[..., k, n] = (law.stress(f + change) - law.stress(f - change)) / (2.0 * step)
    return tangent


@LAW
def test_the_law_turns_with_the_body_and_has_an_energy(name):
    """A tangent is symmetric where the stress is the derivative of an energy."""
    law, f = LAWS[name], random_gradients(5)
    turn = Rotation.random(len(f), random_state=2).as_matrix()
    assert law.stress(turn @ f) == pytest.approx(turn @ law.stress(f), abs=1e-10 * BULK)
    tangent = tangent_of(law, f).reshape(-1, 9, 9)
    assert np.abs(tangent - tangent.transpose(0, 2, 1)).max() < 1e-7 * np.abs(tangent).max()


@LAW
def test_small_strains_are_those_of_the_linear_law(name):
    law, unit = LAWS[name], np.eye(3)
    lam = BULK - 2.0 / 3.0 * law.shear_Pa
    linear = lam * np.einsum("ij,kl", unit, unit)
    linear = linear + law.shear_Pa * (
        np.einsum("ik,jl", unit, unit) + np.einsum("il,jk", unit, unit)
    )
    assert tangent_of(law, unit) == pytest.approx(linear, abs=1e-6 * BULK)
    assert law.stress(unit) == pytest.approx(np.zeros((3, 3)), abs=1e-10 * BULK)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: LAWS["yeoh"].stress(np.diag([1.0, 1.0, -1.0])), "gradient"),
        (lambda: Hyperelastic.neo_hookean(1.0, bulk_Pa=0.0), "bulk_Pa"),
        (lambda: Hyperelastic.neo_hookean(-1.0, bulk_Pa=1.0), "shear modulus"),
        (lambda: Hyperelastic(1.0, ((1.0, 0.0),)), "alpha"),
        (lambda: Hyperelastic.exponential(1.0, 0.0, bulk_Pa=1.0), "rate"),
        (lambda: Hyperelastic(1.0, ((np.nan, 2.0),)), "constants"),
    ],
)
def test_a_body_turned_over_and_unstable_constants_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
