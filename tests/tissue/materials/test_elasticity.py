"""Elastic matrices: published constants, invariance, and what is refused."""

import numpy as np
import pytest
from tet_fields import isotropic

from meshes.base.errors import InputError
from tissue.materials.elasticity import (
    checked_stiffness,
    elasticity_rows,
    fibre_ratio_range,
    lame,
    orthotropic,
    rotated,
    stiffness_of_lame,
    transversely_isotropic,
    volume_preserving_ratio,
)

FEMUR = {
    "young_Pa": (12.0e9, 13.4e9, 20.0e9),
    "shear_Pa": (4.53e9, 5.61e9, 6.23e9),
    "poisson_ratio": (0.376, 0.222, 0.235),
}
"""Cortical bone of the femur (Ashman et al. 1984): E1, E2, E3; G12, G13, G23; nu12, nu13, nu23."""

FIBROUS = {
    "young_fibre_Pa": 2e6,
    "young_across_Pa": 1e5,
    "shear_fibre_Pa": 8e4,
    "poisson_fibre": 0.4,
    "poisson_across": 0.3,
}


def turn(seed):
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return matrix * np.linalg.det(matrix)


def tensor_of(strain):
    """Tensor of engineering strains in the order xx, yy, zz, yz, xz, xy."""
    return np.array(
        [
            [strain[0], strain[5] / 2, strain[4] / 2],
            [strain[5] / 2, strain[1], strain[3] / 2],
            [strain[4] / 2, strain[3] / 2, strain[2]],
        ]
    )


def test_isotropic_constants_by_their_meaning():
    """A pull of 1 Pa along x stretches by 1/E and narrows by nu/E; shear needs E / (2 (1 + nu))."""
    compliance = np.linalg.inv(isotropic(5e3, 0.45))
    assert np.allclose(compliance[:3, 0] * 5e3, [1.0, -0.45, -0.45])
    assert np.allclose(np.diag(compliance)[3:] * 5e3, 2.9)
    assert np.allclose(stiffness_of_lame(lame(5e3, 0.45)), isotropic(5e3, 0.45), rtol=1e-15)


def test_orthotropic_constants_by_their_meaning():
    compliance = np.linalg.inv(orthotropic(**FEMUR))
    assert np.allclose(1.0 / np.diag(compliance), [12e9, 13.4e9, 20e9, 6.23e9, 5.61e9, 4.53e9])
    assert -compliance[1, 0] * 12e9 == pytest.approx(0.376)
    # the ratios printed inverted, nu31 = nu13 E3 / E1 and so on, which agree within 1 % (Ashman
    # 1984)
    assert [
        -compliance[0, 1] * 13.4e9,
        -compliance[0, 2] * 20e9,
        -compliance[1, 2] * 20e9,
    ] == pytest.approx([0.422, 0.371, 0.350], rel=0.01)


def test_transversely_isotropic_is_alike_across_its_fibre_and_holds_isotropy():
    matrix = transversely_isotropic(**FIBROUS)
    compliance = np.linalg.inv(matrix)
    assert np.allclose(compliance[:3, 2] * 2e6, [-0.4, -0.4, 1.0])
    c, s = np.cos(0.7), np.sin(0.7)
    assert np.allclose(
        rotated(matrix, [[[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]])[0],
        matrix,
        rtol=1e-12,
        atol=1.0,
    )
    alike = transversely_isotropic(
        young_fibre_Pa=5e3,
        young_across_Pa=5e3,
        shear_fibre_Pa=5e3 / 2.8,
        poisson_fibre=0.4,
        poisson_across=0.4,
    )
    assert np.allclose(alike, isotropic(5e3, 0.4), rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_turned_material_has_the_energy_of_the_strain_turned_back(seed):
    """e : D' e = (R^T e R) : D (R^T e R), for any strain."""
    random, rotation, matrix = np.random.default_rng(seed), turn(seed), orthotropic(**FEMUR)
    strain = random.normal(size=6)
    back = rotation.T @ tensor_of(strain) @ rotation
    seen = np.array(
        [back[0, 0], back[1, 1], back[2, 2], 2 * back[1, 2], 2 * back[0, 2], 2 * back[0, 1]]
    )
    turned = rotated(matrix, rotation[None])[0]
    assert strain @ turned @ strain == pytest.approx(seen @ matrix @ seen, rel=1e-12)
    assert np.array_equal(turned, turned.T)
    assert np.allclose(rotated(turned, rotation.T[None])[0], matrix, rtol=1e-12, atol=1.0)


def fibrous_compliance(poisson, ratio):
    """Return the compliance of tissue of 1 Pa across fibres along z, shape (3, 3).

    It covers normal strains alone and is written out by hand.
    """
    across = volume_preserving_ratio(poisson_ratio=poisson, modulus_ratio=ratio)
    along = -poisson / ratio
    return np.array([[1.0, -across, along], [-across, 1.0, along], [along, along, 1.0 / ratio]])


@pytest.mark.parametrize("poisson", [-0.5, 0.0, 0.3, 0.45, 0.49, 0.499])
def test_fibres_leave_the_bulk_modulus_as_it_is(poisson):
    """Fibres leave the bulk modulus unchanged.

    Over the whole range the volume under a pressure is that of the isotropic tissue, in any frame.
    """
    low, high = fibre_ratio_range(poisson)
    isotropic_bulk = 1.0 / (3.0 * (1.0 - 2.0 * poisson))
    for ratio in np.geomspace(1.01 * low, min(0.99 * high, 10.0), 9):
        unit = transversely_isotropic(
            young_fibre_Pa=ratio,
            young_across_Pa=1.0,
            shear_fibre_Pa=0.3,
            poisson_fibre=poisson,
            poisson_across=volume_preserving_ratio(poisson_ratio=poisson, modulus_ratio=ratio),
        )
        assert np.linalg.eigvalsh(unit)[0] > 0.0
        turned = rotated(unit, np.random.default_rng(3).normal(size=(1, 3)))[0]
        shrinks = np.linalg.solve(turned, -np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))[:3].sum()
        assert -1.0 / shrinks == pytest.approx(isotropic_bulk, rel=1e-8)


@pytest.mark.parametrize("poisson", [-0.5, 0.0, 0.3, 0.49])
def test_the_range_of_fibres_is_that_of_stable_tissue(poisson):
    low, high = fibre_ratio_range(poisson)
    for inside, outside in ((1.001 * low, 0.999 * low), (0.999 * high, 1.001 * high)):
        if np.isfinite(inside):
            assert np.linalg.eigvalsh(fibrous_compliance(poisson, inside))[0] > 0.0
            assert np.linalg.eigvalsh(fibrous_compliance(poisson, outside))[0] < 0.0


@pytest.mark.parametrize(
    ("make", "argument"),
    [
        (lambda: lame(5e3, [0.3, 0.5]), "poisson_ratio"),
        (lambda: lame(5e3, [0.3, np.nan]), "poisson_ratio"),
        (lambda: lame([5e3, np.nan], 0.3), "young_Pa"),
        (lambda: orthotropic(**{**FEMUR, "poisson_ratio": (0.9, 0.9, 0.9)}), "poisson_ratio"),
        (lambda: orthotropic(**{**FEMUR, "shear_Pa": (1e9, 0.0, 1e9)}), "shear_Pa"),
        (lambda: transversely_isotropic(**{**FIBROUS, "poisson_across": 1.0}), "poisson_across"),
        (lambda: checked_stiffness(np.triu(isotropic(1e3, 0.3))), "stiffness_Pa"),
        (lambda: checked_stiffness(np.full((6, 6), np.nan)), "stiffness_Pa"),
        (lambda: checked_stiffness(-isotropic(1e3, 0.3)), "stiffness_Pa"),
        (lambda: checked_stiffness(np.eye(3)), "stiffness_Pa"),
        (lambda: rotated(isotropic(1e3, 0.3), [[0.0, 0.0, 0.0]]), "axes"),
        (lambda: elasticity_rows([-1.0, 1.0], 4), "elasticity"),
        (lambda: elasticity_rows(np.tile(lame(1e3, 0.3), (3, 1)), 4), "elasticity"),
    ],
)
def test_what_is_no_elastic_material_is_refused(make, argument):
    with pytest.raises(InputError, match=argument):
        make()
