"""The carving kernel against plain NumPy, voxel by voxel."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.voxels.distances import cube_fraction
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import (
    ball_burr,
    cylinder,
    flat_reamer,
    hemispherical_reamer,
    pear_bur,
    twist_drill,
)
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

SPACING_M = 1e-4
PROFILES = {
    "ball burr": ball_burr(diameter_m=4e-3),
    "cylinder": cylinder(diameter_m=3e-3, length_m=2e-3),
    "twist drill": twist_drill(diameter_m=2.5e-3, length_m=4e-3, point_angle_rad=2.06),
    "hemispherical reamer": hemispherical_reamer(
        diameter_m=5e-3, peg_diameter_m=1e-3, peg_length_m=1e-3
    ),
    "pear bur": pear_bur(diameter_m=2.4e-3, length_m=3e-3),
    "flat reamer": flat_reamer(
        diameter_m=4e-3, length_m=1e-3, peg_diameter_m=1e-3, peg_length_m=8e-4
    ),
}


@cache
def full_block():
    count = 64
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
    model = BoneModel(
        full_block(), Cutter(profile, 4, 500.0), (cutting_coefficients("bone"),), removal=removal
    )
    model.place(motion)
    return model


@cache
def ball_cut():
    """Return a bone with one cut of the ball burr at the tilted pose. Tests only read it."""
    return stamp(PROFILES["ball burr"], tilted())


def tilted():
    """A pose off the grid and off the axes."""
    motion = ToolMotion(speed_m_s=1e-3)
    motion.tip_m[:] = (2.3e-5, -4.1e-5, -7.7e-4)
    motion.rotation[:] = Rotation.from_euler("xyz", [0.3, -0.4, 0.2]).as_matrix()
    motion.heading[0] = -motion.rotation[:, 2]
    return motion


@cache
def signed_distance(name):
    """Distance of every voxel centre [voxel] by the profile's closed form, and its gradient."""
    volume = full_block()
    profile = PROFILES[name]
    motion = tilted()
    centres = np.stack(
        np.meshgrid(*(volume.centres_m(axis) for axis in range(3)), indexing="ij"), axis=-1
    )
    offset = centres.reshape(-1, 3) - motion.tip_m
    height = offset @ motion.rotation[:, 2]
    radius = np.sqrt(np.maximum((offset**2).sum(axis=1) - height**2, 0.0))
    distance = profile.distance(np.column_stack([radius, height]))[0] / SPACING_M
    field = distance.reshape(volume.shape)
    return field, np.stack(np.gradient(field), axis=-1)


def dense(store, array):
    """A stored array, shape (bricks, 512), in the shape of the block of whole bricks."""
    rows = array.numpy()[store.brick_of.numpy()]
    count = rows.shape[0]
    return (
        rows.reshape(count, count, count, 4, 4, 4, 2, 2, 2)
        .transpose(0, 3, 6, 1, 4, 7, 2, 5, 8)
        .reshape((8 * count,) * 3)
    )


def blocks(store):
    """Return True for each block of 2 x 2 x 2 voxels that may hold bone.

    Its shape is half that of the volume.
    """
    bits = np.unpackbits(
        store.alive.numpy().astype("<u8").view(np.uint8), bitorder="little"
    ).reshape(-1, 64)
    rows = bits[store.brick_of.numpy()].astype(bool)
    count = rows.shape[0]
    return (
        rows.reshape(count, count, count, 4, 4, 4)
        .transpose(0, 3, 1, 4, 2, 5)
        .reshape((4 * count,) * 3)
    )


@pytest.mark.parametrize("name", PROFILES)
def test_subvoxel_carving_against_numpy(name):
    """Subvoxel carving agrees with fractions from the tangent plane at every voxel, in closed form.

    The kernel takes distances from a table of at least two cells a voxel, and the direction once a
    block where the surface is smooth. The fractions agree within 0.03 of a voxel for 99 % of the
    surface, and within 0.15 at edges, which the table rounds.
    """
    model = ball_cut() if name == "ball burr" else stamp(PROFILES[name], tilted())
    remaining = model.remaining() / 255.0
    distance, gradient = signed_distance(name)
    length = np.linalg.norm(gradient, axis=-1)
    normal = gradient / np.maximum(length, 1e-9)[..., None]
    expected = 1.0 - cube_fraction(distance.ravel(), normal.reshape(-1, 3)).reshape(distance.shape)
    error = remaining - expected
    surface = np.abs(distance) <= 0.9
    smooth = surface & (np.abs(length - 1.0) < 0.01)
    print(
        f"\n{name}: mean {error[surface].mean():+.4f}, 99 % smooth "
        f"{np.percentile(np.abs(error[smooth]), 99):.3f}, "
        f"all {np.percentile(np.abs(error[surface]), 99):.3f}, max {np.abs(error).max():.3f} voxel"
    )
    assert np.percentile(np.abs(error[smooth]), 99) < 0.025
    assert np.percentile(np.abs(error[surface]), 99) < 0.03
    assert np.abs(error[surface]).max() < 0.15
    assert error[surface].mean() == pytest.approx(0.0, abs=0.005)
    assert np.abs(error[np.abs(distance) > 1.2]).max() < 0.01


@pytest.mark.parametrize("name", ["ball burr", "flat reamer"])
def test_binary_carving_against_numpy(name):
    """Binary carving removes whole voxels by their centres.

    Within 0.25 of the surface the table's rounding of edges may decide otherwise.
    """
    remaining = stamp(PROFILES[name], tilted(), "binary").remaining()
    distance, _ = signed_distance(name)
    clear = np.abs(distance) > 0.25
    assert (remaining[clear] == np.where(distance[clear] < 0.0, 0, 255)).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("profile", "scale"),
    [
        (cylinder(diameter_m=3.75e-4, length_m=2.5e-4), 0.125),
        (pear_bur(diameter_m=8.4e-4, length_m=1.05e-3), 0.35),
        (ball_burr(diameter_m=4e-3), 1.0),
    ],
    ids=["cylinder", "pear bur", "ball burr"],
)
def test_a_convex_tool_passes_over_nothing_that_it_reaches(profile, scale):
    """Skipping blocks for a convex tool gives the same integers as visiting every block.

    The tool scales put 2 to 6 cells of the distance table in a voxel.
    """
    turns = np.random.default_rng(5).uniform(-1.5, 1.5, (6, 3))
    found = []
    for convex in (True, False):
        cutter = Cutter(replace(profile, convex=convex), 4, 500.0)
        model = BoneModel(full_block(), cutter, (cutting_coefficients("bone"),))
        for turn in turns:
            motion = tilted()
            motion.rotation[:] = Rotation.from_euler("xyz", turn).as_matrix()
            motion.tip_m[:] = scale * turn[::-1] * 1e-3
            model.place(motion)
        arrays = (model.store.swept, model.store.alive, model.store.remaining)
        found.append([array.numpy().astype(np.int64) for array in arrays])
    assert all((once == again).all() for once, again in zip(*found, strict=True))


def test_booking_equals_what_is_missing():
    model = ball_cut()
    missing = 64**3 * 65535 - model.store.remaining.numpy().astype(np.int64).sum()
    assert model.removed_steps.sum() == missing


def test_the_kept_distance_is_that_to_the_ball():
    """The kept distance is the distance to the ball, in stored steps of 1/4096 voxel.

    The error of table, tangent sphere and rounding is 0.02 voxel at most.
    """
    model = ball_cut()
    distance, _ = signed_distance("ball burr")
    swept = dense(model.store, model.store.swept).astype(float)
    near = np.abs(distance) < 0.5  # every block of these is within reach
    assert (swept[near] - 32768.0) / 4096.0 == pytest.approx(distance[near], abs=0.02)
    assert ((swept[near] - 32768.0) / 4096.0 - distance[near]).mean() == pytest.approx(
        0.0, abs=0.003
    )
    assert (swept[distance < -4.0] == 0).all()  # swallowed
    assert (swept[distance > 4.0] == 65535).all()  # never near


def test_a_swallowed_block_keeps_nothing():
    """A swallowed block keeps nothing.

    A block is removed once its middle lies deeper than its half diagonal; every block with bone in
    it is still visited.
    """
    model = ball_cut()
    distance, _ = signed_distance("ball burr")
    middle = distance.reshape(32, 2, 32, 2, 32, 2).mean(axis=(1, 3, 5))
    alive = blocks(model.store)
    # the mean is not the middle's distance
    deep, clear = middle < -1.7320508 - 0.05, middle > -1.7320508 + 0.05
    assert not alive[deep].any() and alive[clear].all() and deep.any()
    for array in (model.store.remaining, model.store.swept):
        assert (
            not dense(model.store, array)
            .reshape(32, 2, 32, 2, 32, 2)
            .max(axis=(1, 3, 5))[deep]
            .any()
        )


def test_two_cuts_in_either_order():
    """Minima of distances and of what remains: the same bone bit for bit, in any order."""
    random, found = np.random.default_rng(2), []
    moved = random.uniform(-1e-3, 1e-3, (4, 3))
    for order in ([0, 1, 2, 3], [3, 1, 0, 2]):
        model = BoneModel(
            full_block(), Cutter(PROFILES["ball burr"], 4, 500.0), (cutting_coefficients("bone"),)
        )
        for each in order:
            motion = tilted()
            motion.tip_m[:] += moved[each]
            model.place(motion)
        arrays = (model.store.swept, model.store.alive, model.store.remaining)
        found.append([array.numpy().astype(np.int64) for array in arrays])
    assert all((once == again).all() for once, again in zip(*found, strict=True))


def test_the_same_cut_again_changes_nothing():
    model = stamp(PROFILES["ball burr"], tilted())
    arrays = [getattr(model.store, name) for name in ("remaining", "swept", "alive")]
    before = [array.numpy().copy() for array in arrays]
    model.store.take_touched()
    model.place(tilted())
    for old, array in zip(before, arrays, strict=True):
        assert (old == array.numpy()).all()
    assert len(model.store.take_touched()[0]) == 0


def test_the_least_distance_on_a_path_is_kept():
    """A ball along a line: voxels within reach keep the distance to the capsule that it swept."""
    model = stamp(PROFILES["ball burr"], tilted())
    motion, start = tilted(), tilted().tip_m.copy()
    along = motion.rotation @ [0.6, 0.0, 0.8]
    motion.heading[0] = along
    for travel in np.arange(1, 21) * 1e-5:
        motion.tip_m[:] = start + travel * along
        model.advance(motion)
    model.finish()
    volume = full_block()
    centres = np.stack(
        np.meshgrid(*(volume.centres_m(axis) for axis in range(3)), indexing="ij"), axis=-1
    )
    offset = centres - (start + 2e-3 * motion.rotation[:, 2])
    at = np.clip(offset @ along, 0.0, 2e-4)
    distance = (np.linalg.norm(offset - at[..., None] * along, axis=-1) - 2e-3) / SPACING_M
    near = np.abs(distance) < 0.4
    kept = (dense(model.store, model.store.swept)[near].astype(float) - 32768.0) / 4096.0
    # a brick is visited every 0.2 voxel: 0.2 ** 2 / 2 + 0.02
    assert kept == pytest.approx(distance[near], abs=0.05)
    assert (kept - distance[near]).mean() == pytest.approx(0.0, abs=0.005)
