"""One contact's force against the laws of Signorini and Coulomb."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from kernels.friction_cone import coulomb_force, safe_inverse

ROUNDING = 1e-9
"""Tolerance of forces on the cone.

Newton on the cone stops at 1e-13; systems of condition up to 1e3 add the rest.
"""


@wp.kernel
def solve_each(
    compliance: wp.array(dtype=wp.mat33d),
    old: wp.array(dtype=wp.vec3d),
    gap: wp.array(dtype=wp.float64),
    normal: wp.array(dtype=wp.vec3d),
    slip: wp.array(dtype=wp.vec3d),
    friction: wp.float64,
    force_out: wp.array(dtype=wp.vec3d),
):
    i = wp.tid()
    force_out[i] = coulomb_force(
        compliance[i], safe_inverse(compliance[i]), old[i], gap[i], normal[i], slip[i], friction
    )


def random_contacts(seed, count=4000):
    """Compliances of condition up to about 1e3, forces, gaps, normals and slips of one size."""
    rng = np.random.default_rng(seed)
    turns = Rotation.random(count, random_state=seed).as_matrix()
    spread = rng.uniform(-1.5, 1.5, (count, 3)) * rng.uniform(size=(count, 1))
    compliance = np.einsum("nij,nj,nkj->nik", turns, 10.0**spread, turns)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    small = 10.0 ** rng.uniform(-3.0, 0.0, (2, count, 1))
    old, slip = small * rng.normal(size=(2, count, 3))
    return compliance, old, rng.normal(size=count), normal, slip


def forces(compliance, old, gap, normal, slip, friction):
    given = [
        wp.array(value, dtype=dtype, device="cpu")
        for value, dtype in zip(
            (compliance, old, gap, normal, slip),
            (wp.mat33d, wp.vec3d, wp.float64, wp.vec3d, wp.vec3d),
            strict=True,
        )
    ]
    out = wp.zeros(len(gap), dtype=wp.vec3d, device="cpu")
    wp.launch(solve_each, dim=len(gap), inputs=[*given, friction], outputs=[out], device="cpu")
    return out.numpy()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("friction", [0.0, 0.05, 0.3, 1.0])
def test_a_contact_obeys_signorini_and_coulomb(seed, friction):
    compliance, old, gap, normal, slip = random_contacts(seed)
    force = forces(compliance, old, gap, normal, slip, friction)
    change = np.einsum("nij,nj->ni", compliance, force - old)
    left = gap + np.einsum("ni,ni->n", normal, change)
    moved = slip + change
    sideways = moved - np.einsum("ni,ni->n", moved, normal)[:, None] * normal
    press = np.einsum("ni,ni->n", force, normal)
    tangential = force - press[:, None] * normal
    size, direction = np.linalg.norm(tangential, axis=1), np.linalg.norm(sideways, axis=1)
    scale = 1.0 + np.abs(change).max(axis=1) + np.abs(slip).max(axis=1)
    assert press.min() >= -ROUNDING
    assert (left / scale).min() >= -ROUNDING
    assert np.abs(press * left / (scale * (1.0 + press))).max() < ROUNDING
    assert ((size - friction * press) / (1.0 + press)).max() <= ROUNDING
    sticking = (press > 0.0) & (size < friction * press * (1.0 - 1e-9))
    slipping = (press > 0.0) & ~sticking
    assert (direction[sticking] / scale[sticking] < ROUNDING).all()
    opposed = np.einsum("ni,ni->n", tangential, sideways)[slipping]
    assert (
        np.abs(opposed + size[slipping] * direction[slipping]).max()
        < ROUNDING * ((1.0 + size) * scale).max()
    )
    assert (press == 0.0).sum() > 100 and slipping.sum() > 100
    assert friction == 0.0 or sticking.sum() > 10


def test_a_point_that_cannot_move_sideways_is_still_pushed():
    """On a plane of symmetry one direction has no compliance: the limit of a small one."""
    compliance = np.diag([0.0, 2.0, 1.0])[None]
    almost = compliance + np.diag([1e-7, 0.0, 0.0])
    given = (
        np.zeros((1, 3)),
        np.array([-1.0]),
        np.array([[0.0, 0.0, 1.0]]),
        np.array([[0.0, 0.3, 0.0]]),
        0.2,
    )
    np.testing.assert_allclose(forces(compliance, *given), forces(almost, *given), atol=1e-6)


@pytest.mark.parametrize("friction", [0.1, 0.5])
def test_a_contact_along_any_axis_is_that_along_z_turned(friction):
    """The force turns with the contact if its normal lies along x, y or z, with either sign."""
    compliance, old, gap, _, slip = random_contacts(9, count=50)
    gap = -np.abs(gap)
    upright = forces(compliance, old, gap, np.tile([0.0, 0.0, 1.0], (50, 1)), slip, friction)
    tangential = np.linalg.norm(upright[:, :2], axis=1)
    assert (tangential > 0.9 * friction * upright[:, 2]).sum() > 10
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        turn = Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])[0].as_matrix().round(15)
        turned = np.einsum("ij,njk,lk->nil", turn, compliance, turn)
        normal = np.tile(turn @ [0.0, 0.0, 1.0], (50, 1))
        found = forces(turned, old @ turn.T, gap, normal, slip @ turn.T, friction)
        np.testing.assert_allclose(found, upright @ turn.T, atol=1e-8 * np.abs(upright).max())
