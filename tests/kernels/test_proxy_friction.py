"""Forces on a point in two tangential directions.

They are compared with NumPy's solve and SciPy's root of the cone's equation.
"""

import numpy as np
import pytest
import warp as wp
from scipy.optimize import brentq

from kernels.proxy_friction import holding_force, slipping_force

EXACT = 1e-9
"""Relative tolerance.

Compliances have a condition of up to a hundred, softened by 1e-11, and Newton steps end at 1e-13.
"""
COUNT = 200


@wp.kernel
def evaluate(
    compliance: wp.array(dtype=wp.vec3d),  # w00, w01, w11
    slip: wp.array(dtype=wp.vec2d),
    bound: wp.array(dtype=wp.float64),
    force_out: wp.array2d(dtype=wp.vec2d),
):
    i = wp.tid()
    w = compliance[i]
    v = slip[i]
    f0, f1 = holding_force(w[0], w[1], w[2], v[0], v[1], wp.float64(0.0))
    force_out[i, 0] = wp.vec2d(f0, f1)
    f0, f1 = slipping_force(w[0], w[1], w[2], v[0], v[1], bound[i])
    force_out[i, 1] = wp.vec2d(f0, f1)


def test_holding_and_slipping_forces():
    """Holding and slipping forces solve their equations.

    W f = -v where the bound allows it; else (W + s I) f = -v with the s >= 0 for which |f| is the
    bound.
    """
    random = np.random.default_rng(0)
    half = random.normal(size=(COUNT, 2, 2))
    compliance = half @ half.transpose(0, 2, 1) + 0.1 * np.eye(2)
    slip = random.normal(size=(COUNT, 2))
    hold = -np.linalg.solve(compliance, slip[..., None])[..., 0]
    bound = np.linalg.norm(hold, axis=1) * random.uniform(0.05, 1.5, COUNT)
    bound[0] = 0.0
    out = wp.zeros((COUNT, 2), dtype=wp.vec2d, device="cpu")
    inputs = [
        wp.array(compliance.reshape(COUNT, 4)[:, [0, 1, 3]], dtype=wp.vec3d, device="cpu"),
        wp.array(slip, dtype=wp.vec2d, device="cpu"),
        wp.array(bound, dtype=wp.float64, device="cpu"),
    ]
    wp.launch(evaluate, dim=COUNT, inputs=inputs, outputs=[out], device="cpu")
    found = out.numpy()
    assert found[:, 0] == pytest.approx(hold, rel=EXACT, abs=EXACT)
    assert not found[0, 1].any()
    for i in range(1, COUNT):

        def force(softer, i=i):
            return -np.linalg.solve(compliance[i] + softer * np.eye(2), slip[i])

        right = hold[i]
        if np.linalg.norm(right) > bound[i]:
            most = np.linalg.norm(slip[i]) / bound[i]
            right = force(
                brentq(
                    lambda s, i=i: np.linalg.norm(force(s)) - bound[i],
                    0.0,
                    most,
                    xtol=1e-14,
                    rtol=1e-14,
                )
            )
        assert found[i, 1] == pytest.approx(right, abs=EXACT * np.linalg.norm(hold[i]))
    assert 50 < (np.linalg.norm(hold, axis=1) > bound).sum() < COUNT - 20
