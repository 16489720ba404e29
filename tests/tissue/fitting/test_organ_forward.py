"""Loads of an organ by its constants, against closed forms and runs.

They are proportional to all moduli together.
"""

import numpy as np
import pytest

from tissue.fitting.organ_problem import OrganForward
from tissue.fitting.organ_runs import OrganRuns, Poses
from tissue.fitting.problem import Parameter
from tissue.materials.constants import Prior
from tissue.scene.load import load_scene

FIRST = 5.0
SECOND = 50.0
FRICTION = 0.3
SLAB = {
    "anatomy.size_mm": [40, 30, 15],
    "anatomy.nodule_diameter_mm": None,
    "anatomy.edge_mm": 10.0,
    "anatomy.touch_edge_mm": 6.0,
    "organ.parts": None,
    "organ.interval_ms": 0.0,
    "motion.points_mm": [[0, 0, 1], [0, 0, -1]],
}
POSES = Poses(
    np.array([0.0, 0.1, 0.3]),
    1e-3 * np.array([[-4, 0, 0.5], [-4, 0, -2], [4, 0, -2]]),
    np.tile([0.0, 0, 0, 1], (3, 1)),
)


def closed(x):
    """Return loads of springs in parallel.

    Friction multiplies them, and so does the logarithm of a time, also together.
    """
    base = np.arange(1.0, 7.0).reshape(3, 2)
    friction = x[2]
    late = np.log(x[3])
    others = 3.0 * friction - friction**2 + 0.5 * late**2 + 0.4 * friction * late
    return base * x[0] + base**2 * x[1] + x[0] * base * others


def forward(moduli):
    """Coefficients of the closed form, written down."""
    names = ("organ.young_kPa", "organ.young_end_kPa", "organ.friction", "soft.liver.prony_tau1_s")
    at = np.array([FIRST, SECOND, FRICTION, 0.5])
    parameters = tuple(
        Parameter(name, Prior(value, 0.5 * value, 2.0 * value))
        for name, value in zip(names, at, strict=True)
    )
    base = np.arange(1.0, 7.0).reshape(3, 2)
    of_first = np.zeros_like(base) if moduli else (closed(at) - base**2 * SECOND) / FIRST
    late = np.log(0.5)
    of_friction = 3.0 - 2.0 * FRICTION + 0.4 * late
    of_time = late + 0.4 * FRICTION
    slopes = [of_first, base**2, FIRST * base * of_friction, FIRST * base * of_time]
    curved = np.zeros((*base.shape, 4, 4))
    curved[..., 2, 2] = -FIRST * base
    curved[..., 3, 3] = 0.5 * FIRST * base
    curved[..., 2, 3] = curved[..., 3, 2] = 0.2 * FIRST * base
    runs = (at, closed(at), np.stack(slopes, -1), curved)
    return OrganForward(parameters, ("force_x_N", "force_z_N"), np.arange(3.0), moduli, *runs)


def test_loads_that_are_proportional_to_all_moduli_need_no_slope_by_the_first():
    x = np.array([11.0, 20.0, 0.7, 0.2])
    np.testing.assert_allclose(forward((0, 1)).loads(x), closed(x), rtol=1e-12)
    assert np.abs(forward(()).loads(x) - closed(x)).max() > 10.0, (
        "friction times modulus is not linear"
    )


def test_jacobian_against_differences():
    x = np.array([11.0, 20.0, 0.7, 0.2])
    model = forward((0, 1))
    for at, step in enumerate(1e-4 * np.eye(4)):
        expected = (model.loads(x + step) - model.loads(x - step)) / 2e-4
        np.testing.assert_allclose(model.jacobian(x)[..., at], expected, rtol=1e-6)


def test_another_run_corrects_slopes_along_its_step_alone():
    model = forward((0, 1))
    wrong = OrganForward(**{**vars(model), "slopes": 0.5 * model.slopes})
    at = np.array([FIRST, 80.0, FRICTION, 0.5])
    learnt = wrong.moved(at, closed(at), learnt=0.1)
    np.testing.assert_allclose(learnt.slopes[..., 1], model.slopes[..., 1], rtol=1e-12)
    np.testing.assert_allclose(learnt.slopes[..., 2], 0.5 * model.slopes[..., 2], rtol=1e-12)
    near = np.array([FIRST, 50.1, FRICTION, 0.5])
    np.testing.assert_array_equal(wrong.moved(near, closed(near), learnt=0.1).slopes, wrong.slopes)


@pytest.mark.parametrize("viscous", [False, True])
def test_the_force_is_proportional_to_all_moduli_of_a_run(viscous):
    scene = load_scene("palpation", SLAB | {"organ.viscous": viscous})
    runs = OrganRuns(scene, POSES, ("force_x_N", "force_z_N"), every=2)
    once, thrice = runs(
        [{"organ.young_kPa": k * 5.0, "organ.young_end_kPa": k * 50.0} for k in (1.0, 3.0)]
    )
    assert once.shape == (150, 2) and once[-1, 1] > 0.05 and runs.count == 2
    np.testing.assert_allclose(thrice, 3.0 * once, atol=1e-9 * thrice.max())
