"""The carving kernel against plain NumPy, voxel by voxel."""

import numpy as np
import pytest

from meshes.shapes.plane_cube import cube_fraction
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, cylinder, flat_reamer, hemispherical_reamer, pear_bur, twist_drill
from tissue.materials.cutting import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

SPACING_M = 1e-4
PROFILES = {
    "ball burr": ball_burr(diameter_m=4e-3),
    "cylinder": cylinder(diameter_m=3e-3, length_m=2e-3),
    "twist drill": twist_drill(diameter_m=2.5e-3, length_m=4e-3, point_angle_rad=2.06),
    "hemispherical reamer": hemispherical_reamer(diameter_m=5e-3, peg_diameter_m=1e-3, peg_length_m=1e-3),
    "pear bur": pear_bur(diameter_m=2.4e-3, length_m=3e-3),
    "flat reamer": flat_reamer(diameter_m=4e-3, length_m=1e-3, peg_diameter_m=1e-3, peg_length_m=8e-4),
}


def full_block(count=64):
    shape = (count,) * 3
    return VoxelVolume(
        np.full(3, -0.5 * count * SPACING_M),
        SPACING_M,
        np.full(shape, 255, np.uint8),
        np.zeros(shape, np.uint8),
        np.full(shape, 1800, np.uint16),
        ("bone",),
    )


def stamp(profile, motion, removal="subvoxel"):
    model = BoneModel(full_block(), Cutter(profile, 4, 500.0), (cutting_coefficients("bone"),), removal=removal)
    model.place(motion)
    return model


def tilted():
    """A pose off the grid and off the axes."""
    from scipy.spatial.transform import Rotation

    motion = ToolMotion(speed_m_s=1e-3)
    motion.tip_m[:] = (2.3e-5, -4.1e-5, -7.7e-4)
    motion.rotation[:] = Rotation.from_euler("xyz", [0.3, -0.4, 0.2]).as_matrix()
    motion.heading[0] = -motion.rotation[:, 2]
    return motion


def signed_distance(profile, motion):
    """Distance of every voxel centre [voxel] by the profile's closed form, and its gradient."""
    volume = full_block()
    centres = np.stack(np.meshgrid(*(volume.centres_m(axis) for axis in range(3)), indexing="ij"), axis=-1)
    offset = centres.reshape(-1, 3) - motion.tip_m
    height = offset @ motion.rotation[:, 2]
    radius = np.sqrt(np.maximum((offset**2).sum(axis=1) - height**2, 0.0))
    distance = profile.distance(np.column_stack([radius, height]))[0] / SPACING_M
    field = distance.reshape(volume.shape)
    return field, np.stack(np.gradient(field), axis=-1)


@pytest.mark.parametrize("name", PROFILES)
def test_subvoxel_carving_against_numpy(name):
    """Fractions from the tangent plane at every voxel, in closed form.

    The kernel takes distances from a table of two cells a voxel, and the direction once a block where the surface is
    smooth: within 0.05 of a voxel for 99 % of the smooth surface, within a quarter at edges, which the table rounds.
    """
    profile, motion = PROFILES[name], tilted()
    remaining = stamp(profile, motion).remaining() / 255.0
    distance, gradient = signed_distance(profile, motion)
    length = np.linalg.norm(gradient, axis=-1)
    normal = gradient / np.maximum(length, 1e-9)[..., None]
    expected = 1.0 - cube_fraction(distance.ravel(), normal.reshape(-1, 3)).reshape(distance.shape)
    error = remaining - expected
    surface = np.abs(distance) <= 0.9
    smooth = surface & (np.abs(length - 1.0) < 0.01)
    print(
        f"\n{name}: mean {error[surface].mean():+.4f}, 99 % smooth {np.percentile(np.abs(error[smooth]), 99):.3f}, "
        f"all {np.percentile(np.abs(error[surface]), 99):.3f}, max {np.abs(error).max():.3f} voxel"
    )
    assert np.percentile(np.abs(error[smooth]), 99) < 0.05
    assert np.percentile(np.abs(error[surface]), 99) < 0.25
    assert error[surface].mean() == pytest.approx(0.0, abs=0.01)
    assert np.abs(error[np.abs(distance) > 1.2]).max() < 0.01


@pytest.mark.parametrize("name", PROFILES)
def test_binary_carving_against_numpy(name):
    """Whole voxels by their centres; within 0.25 of the surface the table's rounding of edges may decide otherwise."""
    profile, motion = PROFILES[name], tilted()
    remaining = stamp(profile, motion, "binary").remaining()
    distance, _ = signed_distance(profile, motion)
    clear = np.abs(distance) > 0.25
    assert (remaining[clear] == np.where(distance[clear] < 0.0, 0, 255)).all()


def test_booking_equals_what_is_missing():
    model = stamp(PROFILES["cylinder"], tilted())
    missing = 64**3 * 65535 - model.store.remaining.numpy().astype(np.int64).sum()
    assert model.removed_steps.sum() == missing


def test_tool_outside_the_grid_takes_nothing():
    motion = tilted()
    motion.tip_m[:] = (0.0, 0.0, 2e-2)
    assert stamp(PROFILES["ball burr"], motion).removed_steps.sum() == 0


def test_cut_twice_is_cut_once():
    motion = tilted()
    model = stamp(PROFILES["ball burr"], motion)
    once = model.removed_steps.copy()
    model.finish()
    model.finish()
    assert (model.removed_steps == once).all()
