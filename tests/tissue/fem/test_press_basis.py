"""The basis of a pressed body: orthonormal in its stiffness, linear answers in it, as large as asked."""

import numpy as np
from scipy.sparse import bsr_array

from tissue.fem.press_basis import press_basis


def presses(count: int):
    """A stiffness, linear answers and others to as many forces."""
    random = np.random.default_rng(4)
    root = random.normal(size=(30, 30))
    stiffness = root @ root.T + 30.0 * np.eye(30)
    linear = np.linalg.solve(stiffness, random.normal(size=(30, count)))
    return (
        bsr_array(stiffness, blocksize=(3, 3)),
        stiffness,
        linear,
        linear + 0.3 * random.normal(size=(30, count)) / 60,
    )


def test_modes_are_orthonormal_and_hold_what_was_seen():
    stiffness, dense, linear, moved = presses(6)
    modes = press_basis(stiffness, linear, moved, 20)
    assert modes.shape == (30, 12)
    np.testing.assert_allclose(modes.T @ dense @ modes, np.eye(12), atol=1e-9)
    for seen in (linear, moved):
        np.testing.assert_allclose(modes @ (modes.T @ dense @ seen), seen, atol=1e-9 * np.abs(seen).max())


def test_half_of_a_small_basis_is_of_the_linear_body():
    stiffness, dense, linear, moved = presses(12)
    modes = press_basis(stiffness, linear, moved, 9)
    assert modes.shape == (30, 9)
    first = modes[:, :5]
    span = np.linalg.lstsq(linear, first, rcond=None)[0]
    np.testing.assert_allclose(linear @ span, first, atol=1e-9)
    np.testing.assert_allclose(modes.T @ dense @ modes, np.eye(9), atol=1e-9)
