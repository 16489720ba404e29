"""One step of conduction against finite volumes in NumPy, face by face."""

import numpy as np
import pytest
import warp as wp

from kernels.conduction import conduct

ROUNDING = 2e-6
"""Of the largest rise: a few tens of float32 operations of relative error 6e-8."""
STEP_S = 0.02


def fields(seed, shape=(9, 7, 8)):
    """Return random fields like those in a tooth.

    They are temperature rise, filled fraction with holes, conductances along three axes, heat
    capacity and power.
    """
    random = np.random.default_rng(seed)
    filled = random.uniform(0.1, 1.0, shape) * (random.uniform(size=shape) > 0.3)
    rise = random.uniform(0.0, 20.0, shape) * (filled > 0.0)
    along = [random.uniform(5e-5, 2e-4, shape) for _ in range(3)]
    capacity, power = random.uniform(1e-5, 4e-5, shape), random.uniform(0.0, 1e-4, shape)
    return [values.astype(np.float32) for values in (rise, filled, *along, capacity, power)]


def stepped(values, *, first_plane=0):
    """The kernel's rise after a step, of the planes from ``first_plane`` on."""
    arrays = [wp.array(each, dtype=wp.float32, device="cpu") for each in values]
    out = wp.zeros(values[0].shape, dtype=wp.float32, device="cpu")
    dim = (values[0].shape[0] - first_plane, *values[0].shape[1:])
    wp.launch(conduct, dim=dim, inputs=[*arrays, STEP_S, first_plane], outputs=[out], device="cpu")
    return out.numpy()


def expected(rise, filled, along_x, along_y, along_z, capacity, power):
    """Return the temperature rise after a step in closed form.

    It is T + dt (sum over faces of G a dT + P) / (f C) with a = min(max(f, g), 2 min(f, g)), which
    is 0 next to an empty cell.
    """
    rise, filled, capacity, power = (each.astype(float) for each in (rise, filled, capacity, power))
    gain = power.copy()
    for axis, along in enumerate((along_x, along_y, along_z)):
        low, high = (np.moveaxis(gain, axis, 0)[part] for part in (np.s_[:-1], np.s_[1:]))
        t, f, g = (np.moveaxis(each, axis, 0) for each in (rise, filled, along.astype(float)))
        least, most = np.minimum(f[:-1], f[1:]), np.maximum(f[:-1], f[1:])
        flux = g[:-1] * np.where(least > 0.5 * most, most, 2.0 * least) * np.diff(t, axis=0)
        low += flux
        high -= flux
    return np.where(
        filled > 0.0, rise + STEP_S * gain / np.where(filled > 0.0, filled * capacity, 1.0), 0.0
    )


@pytest.mark.parametrize("seed", range(3))
def test_step_against_numpy(seed):
    values = fields(seed)
    right = expected(*values)
    assert np.abs(stepped(values) - right).max() < ROUNDING * np.abs(right).max()


def test_a_part_steps_only_its_planes():
    values = fields(4)
    part = stepped(values, first_plane=5)
    assert not part[:5].any()
    np.testing.assert_array_equal(part[5:], stepped(values)[5:])
