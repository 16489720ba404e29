"""One step of conduction against finite volumes in NumPy, face by face."""

import numpy as np
import pytest
import warp as wp

from kernels.conduction import conduct

ROUNDING = 2e-6
"""Of the largest rise: a few tens of float32 operations of relative error 6e-8."""
STEP_S, SPACING_M = 0.02, 2e-4


def fields(seed, shape=(9, 7, 8)):
    """Rise, conductivity with holes, heat capacity and power, in the sizes of tooth and bone."""
    random = np.random.default_rng(seed)
    conductivity = random.uniform(0.3, 1.0, shape) * (random.uniform(size=shape) > 0.3)
    rise = random.uniform(0.0, 20.0, shape) * (conductivity > 0.0)
    capacity = random.uniform(2e6, 4e6, shape)
    return [values.astype(np.float32) for values in (rise, conductivity, capacity, random.uniform(0.0, 1e-4, shape))]


def stepped(values, *, first_plane=0):
    """The kernel's rise after a step, of the planes from ``first_plane`` on."""
    arrays = [wp.array(each, dtype=wp.float32, device="cpu") for each in values]
    out = wp.zeros(values[0].shape, dtype=wp.float32, device="cpu")
    dim = (values[0].shape[0] - first_plane, *values[0].shape[1:])
    wp.launch(conduct, dim=dim, inputs=[*arrays, STEP_S, SPACING_M, first_plane], outputs=[out], device="cpu")
    return out.numpy()


def expected(rise, conductivity, capacity, power):
    """T + dt (sum over faces of k_mean dT / h^2 + q / h^3) / (rho c), k_mean harmonic and 0 beside nothing."""
    rise, conductivity, capacity, power = (each.astype(float) for each in (rise, conductivity, capacity, power))
    gain = power / SPACING_M**3
    for axis in range(3):
        low, high = (np.moveaxis(gain, axis, 0)[part] for part in (np.s_[:-1], np.s_[1:]))
        t, k = np.moveaxis(rise, axis, 0), np.moveaxis(conductivity, axis, 0)
        both = k[:-1] * k[1:] > 0.0
        mean = np.where(both, 2.0 / (1.0 / np.where(both, k[:-1], 1.0) + 1.0 / np.where(both, k[1:], 1.0)), 0.0)
        flux = mean * np.diff(t, axis=0) / SPACING_M**2
        low += flux
        high -= flux
    return np.where(conductivity > 0.0, rise + STEP_S * gain / capacity, 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_step_against_numpy(seed):
    values = fields(seed)
    right = expected(*values)
    assert np.abs(stepped(values) - right).max() < ROUNDING * right.max()


def test_a_part_steps_only_its_planes():
    values = fields(4)
    part = stepped(values, first_plane=5)
    assert not part[:5].any()
    np.testing.assert_array_equal(part[5:], stepped(values)[5:])
