"""The force kernel against plain NumPy, element by element."""

import numpy as np
import pytest
from bone_in_numpy import bone_of, stored_voxels
from scipy.spatial.transform import Rotation

from kernels.older_cuts import RAMP, SHORTEST
from kernels.revolution import EDGE_BEND
from meshes.voxels.distances import FAR, INSIDE, OUTSIDE, surface_steps
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, twist_drill
from tissue.materials.constants import CuttingCoefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

NEVER = 65535
"""Kept where the tool has not come near."""
SOFT = CuttingCoefficients(20e6, 9e6, 3e6, 800.0, 500.0, 200.0, 1000.0, 2.0)
HARD = CuttingCoefficients(150e6, 60e6, 10e6, 5e3, 4e3, 1e3, 1800.0, 1.5)


def layered(count=48, seed=5):
    """Return two layers in slabs, with random distances and densities.

    A brick is left out where the tool cuts.
    """
    random, shape = np.random.default_rng(seed), (count,) * 3
    surface = random.integers(INSIDE, 200, shape).astype(np.uint8)
    boundary = random.integers(1, FAR + 1, shape).astype(np.uint8)
    density = random.integers(200, 1900, shape).astype(np.uint16)
    fraction = np.full(shape, 255, np.uint8)
    fraction[16:24, 24:32, 16:24], surface[16:24, 24:32, 16:24] = 0, OUTSIDE
    layer = np.ascontiguousarray(np.indices(shape)[0] // 11 % 2, dtype=np.uint8)
    return VoxelVolume(
        np.full(3, -2.4e-3),
        1e-4,
        fraction,
        layer,
        density,
        ("soft", "hard"),
        None,
        surface,
        boundary,
    )


def store_distances(model, stored, values):
    """Write every voxel's kept distance to the solid that the tool swept or to older cuts.

    The values have the shape of the volume.
    """
    count, store = len(values) // 8, model.store
    rows = values.reshape(count, 4, 2, count, 4, 2, count, 4, 2)
    rows = rows.transpose(0, 3, 6, 1, 4, 7, 2, 5, 8).reshape(count, count, count, 512)
    stored.numpy()[:] = rows[store.brick_of.numpy() >= 0]


def clear_blocks(model, blocks):
    """Clear some blocks of 2 x 2 x 2 voxels.

    `blocks` is bool, with the shape of the volume in blocks.
    """
    count, store = len(blocks) // 4, model.store
    bits = (
        blocks.reshape(count, 4, count, 4, count, 4)
        .transpose(0, 2, 4, 1, 3, 5)
        .reshape(count, count, count, 64)
    )
    bits = bits[store.brick_of.numpy() >= 0]
    store.alive.numpy()[:] &= ~np.packbits(bits, axis=1, bitorder="little").view("<u8").reshape(-1)


def distances(model, motion):
    """Distance of every voxel's centre to the tool [voxel], by its profile, shape of the volume."""
    volume = model.store.volume
    centres = np.stack(
        np.meshgrid(*(volume.centres_m(axis) for axis in range(3)), indexing="ij"), axis=-1
    )
    offset = centres.reshape(-1, 3) - motion.tip_m
    height = offset @ motion.rotation[:, 2]
    radius = np.linalg.norm(offset - height[:, None] * motion.rotation[:, 2], axis=1)
    return (
        model.cutter.profile.distance(np.column_stack([radius, height]))[0].reshape(volume.shape)
        / volume.spacing_m
    )


def older_cuts(model, motion, random):
    """Return kept distances of an older cut that crosses the tool's surface at a slant.

    A tenth of them was never near the tool.
    """
    distance = distances(model, motion)
    across = np.tensordot(np.array([0.6, 0.64, 0.48]), np.indices(distance.shape) - 21.0, axes=1)
    older = np.clip(np.rint(32768 + 4096 * (distance + across)), 0, 65534).astype(np.uint16)
    older[random.uniform(size=distance.shape) < 0.1] = NEVER
    return older


def shares_left(model, motion, older, stored, point):
    """Return the share of each element that older cuts leave, shape (n,).

    The result is computed from the eight voxels around the element.
    """
    nearest = tuple(np.floor(point).astype(int).T)
    kept = np.where(stored & (older != NEVER), (older.astype(float) - 32768.0) / 4096.0, np.nan)
    length = kept - distances(model, motion)
    low = np.floor(point - 0.5).astype(int)
    part = point - 0.5 - low
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
    found = np.stack([length[tuple((low + corner).T)] for corner in corners], axis=1)
    weight = np.stack(
        [np.where(corner, part, 1.0 - part).prod(axis=1) for corner in corners], axis=1
    )
    weight = np.where(np.isnan(found), 0.0, weight)
    most = np.where(np.isnan(found), -np.inf, found).max(axis=1)
    least = np.where(np.isnan(found), np.inf, found).min(axis=1)
    limit = np.clip(most, SHORTEST, 2.0)[:, None]
    limited = np.clip(np.nan_to_num(found), -limit, limit)
    mean = (weight * limited).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
    table, shell = model.cutter.table(spacing_m=model.store.volume.spacing_m), model.shell
    height = shell.points_m[:, 2] / model.store.volume.spacing_m - table.height_min
    radius = shell.radii_m / model.store.volume.spacing_m
    bend = table.bend[tuple((np.stack([radius, height]) * table.cells_per_voxel).astype(int))]
    across = 1.0 - (shell.normals @ motion.rotation.T) ** 2
    bent = np.where(bend < EDGE_BEND, 0.75 * bend * (part * (1.0 - part) * across).sum(axis=1), 0.0)
    with np.errstate(invalid="ignore"):
        lengths = mean + np.minimum(bent, 0.5 * (most - least))
    here = kept[nearest]
    lengths = np.where(here < -0.9, -2.0, np.where(np.isnan(here) | (here > 0.9), 2.0, lengths))
    return np.clip(lengths / RAMP, 0.0, 1.0)


def expected_forces(model, motion, older, swallowed):
    """Compute the formula of :mod:`kernels.cutting` in NumPy, in double precision.

    ``older`` holds the kept distances of older cuts, ``swallowed`` the voxels of blocks that a tool
    held whole.
    """
    volume, shell, cutter = model.store.volume, model.shell, model.cutter
    arm = shell.points_m @ motion.rotation.T
    normal = shell.normals @ motion.rotation.T
    axis = motion.rotation[:, 2]
    velocity = motion.heading[0] + np.cross(motion.heading[1], arm)
    advance = np.einsum("ij,ij->i", velocity, normal)
    point = (motion.tip_m + arm - volume.origin_m) / volume.spacing_m
    stored = stored_voxels(model.store.brick_of.numpy(), volume.shape)
    inside = ((point >= 0.0) & (point < volume.shape)).all(axis=1)
    point = np.where(inside[:, None], point, 1.0)
    at = tuple(np.floor(point).astype(int).T)
    bone = bone_of(volume, stored, point)
    tangent = bone.slope - np.einsum("ij,ij->i", bone.slope, normal)[:, None] * normal
    width = np.linalg.norm(tangent, axis=1) * np.sqrt(shell.areas_m2) / volume.spacing_m
    share = np.clip(0.5 - bone.distance / np.clip(width, 1e-3, 3.5), 0.0, 1.0)
    share = np.where(bone.distance > -1.9, share, 1.0)
    share *= shares_left(model, motion, older, stored, point)
    share = np.where(inside & (advance > 0.0) & stored[at] & ~swallowed[at], share, 0.0)
    layer, density = bone.layer, np.rint(bone.density)
    value = lambda name: np.array([getattr(SOFT, name), getattr(HARD, name)])[layer]  # noqa: E731
    strength = (density / value("reference_density_kg_m3")) ** value("density_exponent")
    length = cutter.flute_count * shell.areas_m2 / (2 * np.pi * shell.radii_m) * share * strength
    around = np.cross(np.sign(cutter.spin_rad_s) * axis, arm)
    around /= np.linalg.norm(around, axis=1)[:, None]

    def wrench(kind, weight):
        force = -weight[:, None] * (
            value(f"tangential_{kind}")[:, None] * around
            + value(f"radial_{kind}")[:, None] * normal
            + value(f"axial_{kind}")[:, None] * axis
        )
        return np.concatenate([force.sum(axis=0), np.cross(arm, force).sum(axis=0)])

    rate = float((shell.areas_m2 * share * advance).sum())
    return (
        wrench("chip_Pa", length * advance * cutter.chip_per_speed_s),
        wrench("edge_N_m", length),
        rate,
    )


def tilted_motion(turning):
    motion = ToolMotion(speed_m_s=3e-3)
    motion.tip_m[:] = (1e-4, -2e-4, -1e-3)
    motion.rotation[:] = Rotation.from_euler("xyz", [0.4, 0.3, -0.8]).as_matrix()
    motion.heading[:] = ((0.6, -0.3, -0.742), turning)
    return motion


@pytest.mark.parametrize(
    "turning", [(0.0, 0.0, 0.0), (40.0, -20.0, 10.0)], ids=["along", "turning"]
)
@pytest.mark.parametrize(
    "profile",
    [ball_burr(diameter_m=3e-3), twist_drill(diameter_m=2e-3, length_m=3e-3, point_angle_rad=2.0)],
    ids=["ball", "drill"],
)
@pytest.mark.parametrize("spin_rad_s", [700.0, -700.0])
def test_forces_against_numpy(profile, spin_rad_s, turning):
    """Over bone and older cuts at random, with chunks of which some face away and are left out."""
    model = BoneModel(layered(), Cutter(profile, 5, spin_rad_s), (SOFT, HARD), shell_spacing_m=5e-5)
    motion = tilted_motion(turning)
    random = np.random.default_rng(6)
    older = older_cuts(model, motion, random)
    store_distances(model, model.store.older, older)
    blocks = random.uniform(size=(24, 24, 24)) < 0.05
    swallowed = blocks.repeat(2, 0).repeat(2, 1).repeat(2, 2)
    clear_blocks(model, blocks)
    chip, edge, rate = expected_forces(model, motion, older, swallowed)
    response = model.respond(motion)
    # Single precision: an element within 1e-7 m of a voxel's face may read its neighbour, 1 in 1e3
    # elements.
    for got, want in ((response.resistance, chip), (response.edge, edge)):
        assert got[:3] == pytest.approx(want[:3], abs=2e-3 * np.linalg.norm(want[:3]))
        assert got[3:] == pytest.approx(want[3:], abs=2e-3 * np.linalg.norm(want[3:]))
    assert response.removal_rate_m3_s == pytest.approx(rate * 3e-3, rel=2e-3)
    assert response.wrench == pytest.approx(3e-3 * response.resistance + response.edge, rel=1e-12)


def solid(below):
    """Bone without end below the voxel plane ``below``, in one brick layer after the other."""
    shape = (48,) * 3
    depth = below - (np.indices(shape)[2] + 0.5)
    fraction = np.where(depth > 0, 255, 0).astype(np.uint8)
    far, layer = np.full(shape, FAR, np.uint8), np.zeros(shape, np.uint8)
    density = np.full(shape, 1000, np.uint16)
    surface = surface_steps(-depth)
    return VoxelVolume(
        np.full(3, -2.4e-3), 1e-4, fraction, layer, density, ("soft",), None, surface, far
    )


def engaged_m2(model, motion):
    model.carver.changes += 1  # these tests write the bone's arrays themselves
    return model.respond(motion).engaged_m2[0]


def test_an_older_cut_as_deep_disengages_and_one_less_deep_does_not():
    """An older cut of the same depth disengages, a shallower one does not.

    Where the same surface was kept, rounding and two poses do not decide: up to 12 steps deeper
    still engages.
    """
    model = BoneModel(solid(48), Cutter(ball_burr(diameter_m=3e-3), 5, 700.0), (SOFT,))
    motion = ToolMotion(speed_m_s=1e-3)
    motion.tip_m[:], motion.heading[0] = (0.0, 0.0, -1e-3), (0.0, 0.0, -1.0)
    steps = 32768 + 4096 * distances(model, motion)
    found = []
    for deeper in (0.05, 0.0, -0.05):  # the table and the tangent sphere are 0.02 voxel off
        store_distances(
            model,
            model.store.older,
            np.clip(np.rint(steps - 4096 * deeper), 1, 65534).astype(np.uint16),
        )
        found.append(engaged_m2(model, motion))
    half = model.shell.areas_m2[model.shell.normals[:, 2] < -1e-5].sum()
    assert found[0] == 0.0 and found[2] == pytest.approx(half, rel=1e-6)
    motion_of_the_cut = ToolMotion(speed_m_s=1e-3, tip_m=motion.tip_m.copy())
    fresh = BoneModel(solid(48), model.cutter, (SOFT,))
    fresh.place(motion_of_the_cut)
    # its own cut, carved by the kernel
    assert engaged_m2(fresh, motion) == pytest.approx(half, rel=1e-6)
