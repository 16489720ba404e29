"""Elements of a cutter that advance and chunks that may cut, compared with NumPy."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from kernels.bricks import Bricks
from kernels.elements import (
    CHUNK,
    LANES,
    Elements,
    advance_of,
    may_cut,
    meets_bone,
    place_of,
    travel_of,
)
from kernels.mirror import filled
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, pear_bur
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

SPACING_M = 1e-4
SINGLE = 1e-6
"""Of unit velocities, in single precision."""


@wp.kernel
def ask(
    elements: Elements,
    motion: wp.array(dtype=wp.vec3d),
    spacing: float,
    everywhere: bool,
    bricks: Bricks,
    advance_out: wp.array(dtype=float),
    place_out: wp.array2d(dtype=float),
    may_out: wp.array(dtype=int),
):
    e = wp.tid()
    travel = travel_of(motion, spacing)
    advances = advance_of(elements, e / LANES, travel)
    advance_out[e] = advances[e % LANES]
    for axis in range(3):
        place_out[e, axis] = place_of(elements, e / LANES, travel, axis)[e % LANES]
    may = may_cut(elements, e / CHUNK, travel, spacing, everywhere, bricks)
    may_out[e] = wp.where(may, 1, 0)


def launch_ask(model, arrays, *, everywhere):
    store = model.store
    inputs = [model.elements, model.motion_rows, SPACING_M, everywhere, store.on_device]
    wp.launch(ask, dim=len(arrays[0]), inputs=inputs, outputs=arrays, device="cpu")


def layer_of_bone():
    """Bone from 0.8 to 1.6 mm below the middle of a block of 4.8 mm, and air around it."""
    filled = np.zeros((48,) * 3, np.uint8)
    filled[:, :, 8:16] = 255
    density = np.full(filled.shape, 1800, np.uint16)
    return VoxelVolume(
        np.full(3, -24 * SPACING_M), SPACING_M, filled, np.zeros_like(filled), density, ("bone",)
    )


@wp.kernel
def ask_box(
    bricks: Bricks,
    middle: wp.array(dtype=wp.vec3),
    radius: float,
    meets_out: wp.array(dtype=int),
):
    i = wp.tid()
    meets_out[i] = wp.where(meets_bone(bricks, middle[i], radius), 1, 0)


@pytest.mark.parametrize("radius", [0.4, 5.0, 13.0])
def test_a_box_meets_the_bricks_that_it_overlaps(radius):
    """A box finds the bricks that it overlaps.

    Boxes lie around points in and around a grid of 5 x 4 x 6 bricks, some missing and some empty,
    and are compared with all bricks.
    """
    random = np.random.default_rng(0)
    shape = np.array([5, 4, 6])
    brick_of = np.where(
        random.random(shape) < 0.4, np.arange(shape.prod()).reshape(shape), -1
    ).astype(np.int32)
    alive = np.where(random.random(shape.prod()) < 0.5, 1 << 17, 0).astype(np.uint64)
    middles = random.uniform(-20.0, 8.0 * shape + 20.0, (3000, 3)).astype(np.float32)
    out = wp.zeros(len(middles), dtype=int, device="cpu")
    bricks = filled(Bricks, "cpu", brick_of=brick_of, alive=alive)
    inputs = [bricks, wp.array(middles, dtype=wp.vec3, device="cpu"), radius]
    wp.launch(ask_box, dim=len(middles), inputs=inputs, outputs=[out], device="cpu")
    low = 8.0 * np.argwhere((brick_of >= 0) & (alive[np.maximum(brick_of, 0)] > 0))
    overlaps = (middles[:, None] + radius >= low) & (middles[:, None] - radius < low + 8.0)
    wanted = overlaps.all(axis=2).any(axis=1)
    assert (out.numpy() == wanted).all() and 40 < wanted.sum() < 2900


def test_an_element_s_advance_and_place_are_those_of_numpy():
    """One tool, turning about its tip, tilted: the first hundred elements."""
    model = BoneModel(
        layer_of_bone(),
        Cutter(ball_burr(diameter_m=3e-3), 4, 500.0),
        (cutting_coefficients("bone"),),
    )
    motion, shell, count = ToolMotion(speed_m_s=1e-3), model.shell, 100
    motion.tip_m[:] = (2e-4, -3e-4, 1e-4)
    motion.rotation[:] = Rotation.from_euler("xyz", [0.5, -0.3, 0.8]).as_matrix()
    motion.heading[:] = [[0.6, 0.0, -0.8], [200.0, -100.0, 50.0]]
    model.respond(motion)
    arrays = [
        wp.zeros(count, dtype=float),
        wp.zeros((count, 3), dtype=float),
        wp.zeros(count, dtype=int),
    ]
    launch_ask(model, arrays, everywhere=False)
    normal, arm = (
        shell.normals[:count] @ motion.rotation.T,
        shell.points_m[:count] @ motion.rotation.T,
    )
    expected = ((motion.heading[0] + np.cross(motion.heading[1], arm)) * normal).sum(axis=1)
    assert arrays[0].numpy() == pytest.approx(expected, abs=2 * SINGLE)
    assert arrays[1].numpy() == pytest.approx(
        (motion.tip_m + arm) / SPACING_M + 24, abs=SINGLE * 48
    )


@pytest.mark.parametrize("everywhere", [False, True])
def test_a_chunk_may_cut_where_an_element_advances_or_lies_close_to_bone(everywhere):
    """A chunk may cut if it lies close to bone and, unless all sides count, one element advances.

    The check is compared with all elements of the chunk. It may only be wrong on the safe side: by
    the ball and the cone around the chunk, and by bricks of 0.8 mm and 2 voxels.
    """
    model = BoneModel(
        layer_of_bone(),
        Cutter(ball_burr(diameter_m=3e-3), 4, 500.0),
        (cutting_coefficients("bone"),),
    )
    motion, shell = ToolMotion(speed_m_s=1e-3), model.shell
    motion.tip_m[:] = (1e-4, -1e-4, -1.2e-3)
    motion.heading[0] = (0.8, 0.0, -0.6)
    model.send_pose(motion)
    count = len(shell.areas_m2)
    arrays = [
        wp.zeros(count, dtype=float),
        wp.zeros((count, 3), dtype=float),
        wp.zeros(count, dtype=int),
    ]
    launch_ask(model, arrays, everywhere=everywhere)
    height = motion.tip_m[2] + shell.points_m[:, 2]
    advances = (shell.normals @ motion.heading[0] > 0.0) | everywhere
    in_bone = (height > -1.6e-3) & (height < -0.8e-3) & advances
    beyond = 2.0 * model.shell_spacing_m + 0.8e-3 + 2.0 * SPACING_M
    starts = np.arange(0, count, CHUNK)
    may = np.maximum.reduceat(arrays[2].numpy(), starts)
    assert (may == np.minimum.reduceat(arrays[2].numpy(), starts)).all()
    assert (may >= np.maximum.reduceat(in_bone, starts)).all() and 3 < may.sum() < len(starts)
    balls, cones = model.elements.chunk_ball.numpy(), model.elements.chunk_cone.numpy()
    middle = motion.tip_m[2] + balls[:, 2]
    far = np.abs(middle + 1.2e-3) > 0.4e-3 + balls[:, 3] + beyond
    backward = cones[:, :3] @ motion.heading[0] + cones[:, 3] < 0.0
    assert not may[far].any() and far.any() and backward.any()
    assert not may[backward].any() or everywhere


@pytest.mark.parametrize(
    "profile", [ball_burr(diameter_m=3e-3), pear_bur(diameter_m=2e-3, length_m=3e-3)]
)
def test_the_ball_and_the_cone_of_a_chunk_hold_all_its_elements(profile):
    """The ball and the cone of a chunk hold all its elements.

    Each chunk is 128 elements in order; its ball touches one of them, and its cone one of their
    normals.
    """
    model = BoneModel(layer_of_bone(), Cutter(profile, 4, 500.0), (cutting_coefficients("bone"),))
    shell, elements = model.shell, model.elements
    balls, cones = elements.chunk_ball.numpy(), elements.chunk_cone.numpy()
    assert len(balls) == len(cones) == -(-len(shell.areas_m2) // 128)
    for at, (ball, cone) in enumerate(zip(balls, cones, strict=True)):
        part = slice(128 * at, 128 * at + 128)
        away = np.linalg.norm(shell.points_m[part] - ball[:3], axis=1)
        assert away.max() == pytest.approx(ball[3], rel=1e-5)
        cosines = shell.normals[part] @ cone[:3]
        if cone[3] <= 1.0:
            assert cosines.min() == pytest.approx(np.sqrt(1.0 - cone[3] ** 2), abs=1e-5)
        else:
            assert cosines.min() <= 0.0
    assert (cones[:, 3] <= 1.0).any()
