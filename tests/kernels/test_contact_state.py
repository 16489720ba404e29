"""Readings of poses, compliance blocks and shell planes against NumPy."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from kernels.contact_state import (
    SHELL,
    Body,
    Points,
    axis_distance,
    block,
    coulomb_force,
    distance_to,
    pose_of,
    safe_inverse,
)
from tissue.models.organ.probe import CylinderProbe, ShellProbe, SphereProbe

ROUNDING = 1e-14
"""Sums of three products of numbers of size one."""
NODES = 4


@wp.kernel
def read(
    body: Body,
    points: Points,
    rows: wp.array(dtype=wp.vec3d),
    place: wp.array(dtype=wp.vec3d),
    block_out: wp.array2d(dtype=wp.mat33d),
    moved_out: wp.array2d(dtype=wp.vec3d),
    distance_out: wp.array(dtype=wp.float64),
    direction_out: wp.array(dtype=wp.vec3d),
):
    i = wp.tid()
    pose = pose_of(rows, SHELL, wp.vec2d())
    moved_out[i, 0] = pose.tip + pose.turn * place[i]
    moved_out[i, 1] = pose.last_tip + pose.last_turn * place[i]
    for j in range(place.shape[0]):
        block_out[i, j] = block(body, i, j)
    distance, direction = distance_to(pose, points, i, place[i])
    distance_out[i] = distance
    direction_out[i] = direction


def test_readings():
    """Rows are tip, rotation, last tip and last rotation.

    A shell's point stands for the plane through it.
    """
    random = np.random.default_rng(0)
    compliance, rows = random.normal(size=(3 * NODES, 3 * NODES)), random.normal(size=(8, 3))
    place, at, normal = random.normal(size=(3, NODES, 3))
    body, points = Body(), Points()
    body.scale = wp.float64(0.4)
    body.compliance = wp.array(compliance, dtype=wp.float64, device="cpu")
    points.tool_point = wp.array(at, dtype=wp.vec3d, device="cpu")
    points.tool_normal = wp.array(normal, dtype=wp.vec3d, device="cpu")
    out = [
        wp.zeros((NODES, NODES), dtype=wp.mat33d, device="cpu"),
        wp.zeros((NODES, 2), dtype=wp.vec3d, device="cpu"),
        wp.zeros(NODES, dtype=wp.float64, device="cpu"),
        wp.zeros(NODES, dtype=wp.vec3d, device="cpu"),
    ]
    inputs = [
        body,
        points,
        wp.array(rows, dtype=wp.vec3d, device="cpu"),
        wp.array(place, dtype=wp.vec3d, device="cpu"),
    ]
    wp.launch(read, dim=NODES, inputs=inputs, outputs=out, device="cpu")
    blocks, moved, distance, direction = (each.numpy() for each in out)
    assert blocks == pytest.approx(
        0.4 * compliance.reshape(NODES, 3, NODES, 3).transpose(0, 2, 1, 3), abs=ROUNDING
    )
    assert moved[:, 0] == pytest.approx(rows[0] + place @ rows[1:4].T, abs=ROUNDING)
    assert moved[:, 1] == pytest.approx(rows[4] + place @ rows[5:8].T, abs=ROUNDING)
    assert distance == pytest.approx(((place - at) * normal).sum(axis=1), abs=ROUNDING)
    np.testing.assert_array_equal(direction, normal)


CONE_ROUNDING = 1e-9
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
    assert press.min() >= -CONE_ROUNDING
    assert (left / scale).min() >= -CONE_ROUNDING
    assert np.abs(press * left / (scale * (1.0 + press))).max() < CONE_ROUNDING
    assert ((size - friction * press) / (1.0 + press)).max() <= CONE_ROUNDING
    sticking = (press > 0.0) & (size < friction * press * (1.0 - 1e-9))
    slipping = (press > 0.0) & ~sticking
    assert (direction[sticking] / scale[sticking] < CONE_ROUNDING).all()
    opposed = np.einsum("ni,ni->n", tangential, sideways)[slipping]
    assert (
        np.abs(opposed + size[slipping] * direction[slipping]).max()
        < CONE_ROUNDING * ((1.0 + size) * scale).max()
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


@wp.kernel
def distance_each(
    kind: int,
    size: wp.vec2d,
    rows: wp.array(dtype=wp.vec3d),
    point: wp.array(dtype=wp.vec3d),
    distance_out: wp.array(dtype=wp.float64),
    direction_out: wp.array(dtype=wp.vec3d),
):
    i = wp.tid()
    distance, direction = axis_distance(pose_of(rows, kind, size), point[i])
    distance_out[i] = distance
    direction_out[i] = direction


@pytest.mark.parametrize(
    "probe", [SphereProbe(0.004), CylinderProbe(0.004, 0.0005)], ids=["sphere", "cylinder"]
)
def test_distances_agree_with_numpy_and_their_gradients_with_differences(probe):
    rng = np.random.default_rng(3)
    rotation, tip = Rotation.random(random_state=1).as_matrix(), np.array([0.01, -0.02, 0.03])
    local = rng.uniform([-0.006, -0.006, -0.003], [0.006, 0.006, 0.009], (3000, 3))
    rows = np.vstack([tip, rotation, tip, rotation])

    def kernel(points):
        out = (
            wp.zeros(len(points), dtype=wp.float64, device="cpu"),
            wp.zeros(len(points), dtype=wp.vec3d, device="cpu"),
        )
        inputs = [
            probe.kind,
            wp.vec2d(*probe.size_m),
            wp.array(rows, dtype=wp.vec3d, device="cpu"),
            wp.array(tip + points @ rotation.T, dtype=wp.vec3d, device="cpu"),
        ]
        wp.launch(distance_each, dim=len(points), inputs=inputs, outputs=list(out), device="cpu")
        return out[0].numpy(), out[1].numpy() @ rotation

    distance, direction = kernel(local)
    np.testing.assert_allclose(distance, probe.distance(local), atol=1e-15)
    step = 1e-7
    slopes = np.column_stack(
        [(kernel(local + e)[0] - kernel(local - e)[0]) / (2 * step) for e in step * np.eye(3)]
    )
    # Within a step of an edge between face and side the difference straddles both.
    smooth = np.abs(np.linalg.norm(slopes, axis=1) - 1.0) < 1e-3
    assert smooth.mean() > 0.99
    np.testing.assert_allclose(direction[smooth], slopes[smooth], atol=2e-3)


def test_the_ball_around_a_shell_lies_halfway_between_its_ends():
    """Rings of 3 mm radius at heights of 1 mm and 9 mm: a ball of 5 mm around (0, 0, 5) mm."""
    turn = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = 3e-3 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(16)])
    points = np.vstack([ring, ring]) + np.repeat([[0.0, 0.0, 1e-3], [0.0, 0.0, 9e-3]], 16, axis=0)
    shell = ShellProbe(points, np.vstack([ring, ring]) / 3e-3, np.full(32, 1e-6))
    assert shell.size_m == pytest.approx((5e-3, 5e-3))


def test_the_centre_of_a_ball_is_its_radius_deep():
    distance = SphereProbe(4e-3).distance(np.array([[0.0, 0.0, 4e-3], [0.0, 3e-3, 8e-3]]))
    assert distance == pytest.approx([-4e-3, 1e-3])
