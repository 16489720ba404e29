"""Volumes that a ball removes from a block, against the exact volume of a spherical cap."""

from math import pi

import numpy as np
import pytest

from meshes.shapes.anatomy import cortical_block
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
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
    print("\nspacing / mm, sub-voxel / %, binary / %:")
    for spacing, fine, coarse in zip(spacings_m, subvoxel, binary, strict=True):
        print(f"  {1e3 * spacing:.2f}  {100 * fine:.4f}  {100 * coarse:.3f}")
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
