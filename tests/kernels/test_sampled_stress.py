"""Energy, stress and moduli at points of a body: against NumPy's laws, with the volume and the factor of each point."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from kernels.sampled_stress import sampled_moduli, sampled_stress
from tissue.materials.hyperelasticity import Hyperelastic

LAWS = {
    "neo-hookean": Hyperelastic.neo_hookean(2000.0, bulk_Pa=97e3),
    "mooney-rivlin": Hyperelastic.mooney_rivlin(700.0, 250.0, bulk_Pa=97e3),
    "yeoh": Hyperelastic.yeoh(900.0, 150.0, 40.0, bulk_Pa=97e3),
    "ogden": Hyperelastic(97e3, ((1200.0, 1.3), (300.0, 5.0), (-80.0, -2.0))),
}
LAW = pytest.mark.parametrize("name", LAWS)


def at_points(law, volumes_m3, factors, gradients):
    """Energy (p,), stress (p, 3, 3) and moduli (p, 3, 3, 3, 3) of the kernels."""
    count = len(volumes_m3)
    values = [volumes_m3, np.outer(factors, [law.bulk_Pa, law.shear_Pa]), np.array(law.terms) / [law.shear_Pa, 1.0],
              np.array(law.powers_Pa) / law.shear_Pa, (gradients - np.eye(3)).reshape(-1, 9)]  # fmt: skip
    inputs = [wp.array(each, dtype=wp.float64, device="cpu") for each in values]
    energy, stress, moduli = (
        wp.zeros(shape, dtype=wp.float64, device="cpu") for shape in (count, (count, 9), (count, 9, 9))
    )
    wp.launch(sampled_stress, dim=count, inputs=inputs, outputs=[energy, stress], device="cpu")
    wp.launch(sampled_moduli, dim=count, inputs=inputs, outputs=[moduli], device="cpu")
    return energy.numpy(), stress.numpy().reshape(-1, 3, 3), moduli.numpy().reshape(-1, 3, 3, 3, 3)


@LAW
def test_points_are_those_of_numpy(name):
    """Random, turned, equal and far apart stretches, to 1e-10 of the greatest."""
    law, random = LAWS[name], np.random.default_rng(3)
    turn = Rotation.random(rng=random).as_matrix()
    gradients = [turn @ (np.eye(3) + random.uniform(-0.3, 0.3, (3, 3))) for _ in range(8)]
    gradients += [np.eye(3), turn, turn @ np.diag([1.2, 1.2, 0.8]), np.diag([2.0, 0.5, 1.0]) @ turn]
    gradients = np.array(gradients)
    volumes, factors = random.uniform(1e-9, 2e-9, len(gradients)), random.uniform(0.5, 2.0, len(gradients))
    energy, stress, moduli = at_points(law, volumes, factors, gradients)
    scale = volumes * factors
    expected = scale[:, None, None] * law.stress(gradients), scale[:, None, None, None, None] * law.tangent(gradients)
    np.testing.assert_allclose(energy, scale * law.energy(gradients), rtol=1e-10, atol=1e-10 * np.abs(energy).max())
    np.testing.assert_allclose(stress, expected[0], atol=1e-10 * np.abs(expected[0]).max())
    np.testing.assert_allclose(moduli, expected[1], atol=1e-10 * np.abs(expected[1]).max())


def test_a_point_that_is_turned_over_has_infinite_energy_and_no_stress():
    energy, stress, _ = at_points(
        LAWS["ogden"], np.ones(2), np.ones(2), np.array([np.diag([1.0, 1.0, -0.1]), np.eye(3)])
    )
    assert energy[0] == np.inf and not stress[0].any()
    assert energy[1] == pytest.approx(0.0, abs=1e-9)
