"""Volumes that a ball removes from a block, against the exact volume of a spherical cap."""

from math import pi

import numpy as np
import pytest

from meshes.shapes.anatomy import cortical_block
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, cylinder
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

RADIUS_M, DEPTH_M = 3e-3, 1e-3
CAP_M3 = pi * DEPTH_M**2 * (3.0 * RADIUS_M - DEPTH_M) / 3.0
SPACINGS_M = (0.4e-3, 0.2e-3, 0.1e-3, 0.05e-3)
BONE = (cutting_coefficients("bone"),)


def block(spacing_m, size_mm=(6.4, 6.4, 1.6)):
    return voxelise(cortical_block(size_mm=size_mm), spacing_m=spacing_m)


def ball(volume, removal="subvoxel"):
    return BoneModel(
        volume, Cutter(ball_burr(diameter_m=2 * RADIUS_M), 6, 1000.0), BONE, removal=removal
    )


def sweep(model, start_m, end_m, *, step_m=2e-6):
    """Move the ball along a line, tick by tick."""
    start, end = np.asarray(start_m, float), np.asarray(end_m, float)
    length = np.linalg.norm(end - start)
    motion = ToolMotion(speed_m_s=step_m / 1e-3)
    motion.heading[0] = (end - start) / length
    motion.tip_m[:] = start
    model.place(motion)
    for travel in np.append(np.arange(0.0, length, step_m), length):
        motion.tip_m[:] = start + travel * motion.heading[0]
        model.advance(motion)
    model.finish()
    return model


def cap_errors(removal, spacings_m):
    """Return the relative error of a cap's volume for each spacing.

    It is the root mean square over random placements.
    """
    random = np.random.default_rng(1)
    errors = []
    for spacing in spacings_m:
        volume = block(spacing)
        single = []
        for _ in range(4):
            model = ball(volume, removal)
            motion = ToolMotion(speed_m_s=1e-3)
            motion.heading[0] = (0, 0, -1)
            motion.tip_m[:] = (*(random.random(2) * spacing), -DEPTH_M)
            model.place(motion)
            single.append(model.removed_m3.sum() / CAP_M3 - 1.0)
        errors.append(float(np.sqrt(np.mean(np.square(single)))))
    return np.array(errors)


@pytest.mark.parametrize(
    "spacings_m", [SPACINGS_M[:3], pytest.param(SPACINGS_M, marks=pytest.mark.slow)]
)
def test_cap_volume_converges_with_second_order_and_beats_binary_removal(spacings_m):
    subvoxel, binary = cap_errors("subvoxel", spacings_m), cap_errors("binary", spacings_m)
    slope = np.polyfit(np.log(spacings_m), np.log(subvoxel), 1)[0]
    binary_slope = np.polyfit(np.log(spacings_m), np.log(binary), 1)[0]
    rows = zip(1e3 * np.array(spacings_m), subvoxel, binary, strict=True)
    print("\nspacing mm, sub-voxel, binary:", *rows, sep="\n  ")
    print(f"slopes {slope:.2f} and {binary_slope:.2f}")
    assert slope > 1.6  # second order, fitted over its spacings with placement noise
    assert subvoxel[2] < 1e-3  # 0.1 % at 0.1 mm
    assert (subvoxel[3:] < 1e-4).all()
    assert (subvoxel < 0.5 * binary).all()


def test_plunge_spread_over_ticks_ends_at_the_cap():
    model = sweep(ball(block(0.1e-3)), (3e-5, 6e-5, 0.2e-3), (3e-5, 6e-5, -DEPTH_M))
    assert model.removed_m3.sum() == pytest.approx(CAP_M3, rel=1e-3)


def test_fast_plunge_is_carved_in_parts_of_a_tick():
    model = sweep(ball(block(0.1e-3)), (0, 0, 1e-3), (0, 0, -DEPTH_M), step_m=1e-3)
    assert model.removed_m3.sum() == pytest.approx(CAP_M3, rel=1e-3)


def test_slot_leaves_a_capsule():
    """A ball drawn along x removes a cap's two halves and a circular segment times the length."""
    model = sweep(ball(block(0.1e-3)), (-0.8e-3, 0, -0.5e-3), (0.8e-3, 0, -0.5e-3), step_m=5e-6)
    angle = 2.0 * np.arccos(1.0 - 0.5e-3 / RADIUS_M)
    segment = 0.5 * RADIUS_M**2 * (angle - np.sin(angle))
    cap = pi * 0.5e-3**2 * (3.0 * RADIUS_M - 0.5e-3) / 3.0
    assert model.removed_m3.sum() == pytest.approx(cap + 1.6e-3 * segment, rel=2e-3)  # binary: 1e-2


def full_block(spacing_m, count):
    shape = (count,) * 3
    return VoxelVolume(
        np.full(3, -0.5 * count * spacing_m),
        spacing_m,
        np.full(shape, 255, np.uint8),
        np.zeros(shape, np.uint8),
        np.full(shape, 1800, np.uint16),
        ("bone",),
    )


def swept_error(radius_m, spacing_m, along, *, length_m, random):
    """Return the relative error of the volume that a ball removes on a line inside a block.

    The part removed by its first pose is left out.
    """
    along = np.array(along) / np.linalg.norm(along)
    count = 8 * int(np.ceil((2.0 * radius_m + length_m) / spacing_m / 8) + 1)
    tool = Cutter(ball_burr(diameter_m=2 * radius_m), 6, 1000.0)
    model = BoneModel(full_block(spacing_m, count), tool, BONE)
    start = random.uniform(-0.5, 0.5, 3) * spacing_m - 0.5 * length_m * along - [0.0, 0.0, radius_m]
    model.place(ToolMotion(tip_m=start.copy()))
    stamped = model.removed_m3.sum()
    sweep(model, start, start + length_m * along)
    return (model.removed_m3.sum() - stamped) / (pi * radius_m**2 * length_m) - 1.0


@pytest.mark.slow
@pytest.mark.parametrize("along", [(1.0, 0.0, 0.0), (0.3, 0.2, -1.0), (1.0, 1.0, 1.0)])
def test_a_sweep_inside_bone_removes_a_straight_tube(along):
    """A sweep inside bone removes a straight tube.

    A ball of 0.5 mm moves on a line. The volume is its circle times the path; the wall is straight
    along the path where the ball is not. At ten voxels' radius a wall as round as the ball leaves
    0.1 %; second order in the spacing.
    """
    random, errors = np.random.default_rng(3), []
    for spacing in (0.1e-3, 0.05e-3):
        found = [
            swept_error(0.5e-3, spacing, along, length_m=0.4e-3, random=random) for _ in range(3)
        ]
        errors.append(np.mean(found))
    print(f"\nalong {along}: " + ", ".join(f"{100 * error:+.3f} %" for error in errors))
    assert abs(errors[0]) < 2.5e-3
    assert abs(errors[1]) < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("along", [(1.0, 0.0, 0.0), (1.0, 0.7, 0.0)])
def test_a_cylinder_drawn_across_its_axis_leaves_flat_walls(along):
    """A cylinder drawn across its axis leaves flat walls.

    In every layer of voxels that its ends do not reach, it removes twice its radius times the path:
    a round wall leaves 0.05 %.
    """
    random, radius, spacing, length, errors = np.random.default_rng(4), 0.5e-3, 0.05e-3, 0.4e-3, []
    tool, along = (
        cylinder(diameter_m=2 * radius, length_m=1e-3),
        np.array(along) / np.linalg.norm(along),
    )
    for _ in range(3):
        model, left = BoneModel(full_block(spacing, 40), Cutter(tool, 6, 1000.0), BONE), []
        start = random.uniform(-0.5, 0.5, 3) * spacing - 0.5 * length * along - [0.0, 0.0, 0.5e-3]
        model.place(ToolMotion(tip_m=start.copy()))
        left.append(model.remaining()[:, :, 16:24].astype(float))
        sweep(model, start, start + length * along)
        left.append(model.remaining()[:, :, 16:24].astype(float))
        errors.append(
            (left[0] - left[1]).sum() / 255 * spacing**2 / (8 * 2 * radius * length) - 1.0
        )
    print(f"\nalong {along}: {100 * np.mean(errors):+.3f} %")
    assert abs(np.mean(errors)) < 3e-4


def test_removed_and_remaining_add_up_exactly_in_every_layer():
    volume = block(0.1e-3)
    layered = type(volume)(
        volume.origin_m,
        volume.spacing_m,
        volume.fraction,
        np.ascontiguousarray(np.indices(volume.shape)[2] // 3 % 3, dtype=np.uint8),
        volume.density_kg_m3,
        ("a", "b", "c"),
    )
    model = BoneModel(layered, Cutter(ball_burr(diameter_m=2 * RADIUS_M), 6, 1000.0), BONE * 3)
    for x in (-1e-3, 0.3e-3, 1.1e-3):
        sweep(model, (x, 0, 0.1e-3), (x, 2e-4, -7e-4), step_m=1e-5)
        assert (model.removed_steps + model.store.steps_by_layer() == model.store.start_steps).all()
    assert (model.removed_steps > 0).all()


def test_order_of_overlapping_cuts_does_not_matter():
    volume = block(0.1e-3)
    cuts = [(-6e-4, 1e-4), (2e-4, -3e-4), (7e-4, 4e-4), (0.0, 0.0)]
    left = []
    for order in ([0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]):
        model = ball(volume)
        for x, y in (cuts[i] for i in order):
            sweep(model, (x, y, 2e-4), (x, y, -9e-4), step_m=1e-5)
            sweep(model, (x, y, -9e-4), (x, y, 2e-4), step_m=1e-5)
        left.append(model.store.remaining.numpy().copy())
    assert (left[0] == left[1]).all()
    assert (left[0] == left[2]).all()


def test_result_does_not_depend_on_cores():
    runs = []
    for cores in (1, 2, 3):
        model = BoneModel(
            block(0.1e-3), Cutter(ball_burr(diameter_m=2 * RADIUS_M), 6, 1000.0), BONE, cores=cores
        )
        model.carver._carve._work_s = model._forces._work_s = 1.0  # split from the first launch on
        sweep(model, (-5e-4, 0, 1e-4), (5e-4, 0, -8e-4), step_m=2e-5)
        motion = ToolMotion(tip_m=np.array([5e-4, 0, -8e-4]), speed_m_s=1e-3)
        motion.heading[0] = (0, 0, -1)
        runs.append((model.store.remaining.numpy().copy(), model.respond(motion).wrench.copy()))
    for remaining, wrench in runs[1:]:
        assert (remaining == runs[0][0]).all()
        assert (wrench == runs[0][1]).all()
