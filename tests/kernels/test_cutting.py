"""The force kernel against plain NumPy, element by element."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, twist_drill
from tissue.materials.cutting import CuttingCoefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

SOFT = CuttingCoefficients(20e6, 9e6, 3e6, 800.0, 500.0, 200.0, 1000.0, 2.0)
HARD = CuttingCoefficients(150e6, 60e6, 10e6, 5e3, 4e3, 1e3, 1800.0, 1.5)


def layered(count=48):
    random = np.random.default_rng(5)
    shape = (count,) * 3
    return VoxelVolume(
        np.array([-2.4e-3, -2.4e-3, -2.4e-3]),
        1e-4,
        np.full(shape, 255, np.uint8),
        np.ascontiguousarray(np.indices(shape)[0] // 11 % 2, dtype=np.uint8),
        random.integers(200, 1900, shape).astype(np.uint16),
        ("soft", "hard"),
    )


def with_fill(store, fill):
    """Set every voxel's fill, shape of the volume."""
    counts = [n // 8 for n in fill.shape]
    rows = fill.reshape(counts[0], 4, 2, counts[1], 4, 2, counts[2], 4, 2)
    rows = rows.transpose(0, 3, 6, 1, 4, 7, 2, 5, 8).reshape(-1, 512)
    material = store.material.numpy()
    stored = rows[np.argsort(store.brick_of.numpy().ravel())].astype(np.uint32)
    material[:] = (material & np.uint32(0xFFFFFF00)) | stored


def expected_forces(model, motion, fill):
    """The formula of :mod:`kernels.cutting` in NumPy, in double precision."""
    volume, shell, cutter = model.store.volume, model.shell, model.cutter
    arm = shell.points_m @ motion.rotation.T
    normal = shell.normals @ motion.rotation.T
    axis = motion.rotation[:, 2]
    velocity = motion.heading[0] + np.cross(motion.heading[1], arm)
    advance = np.einsum("ij,ij->i", velocity, normal)
    voxel = np.floor((motion.tip_m + arm - volume.origin_m) / volume.spacing_m).astype(int)
    inside = ((voxel >= 0) & (voxel < np.array(volume.shape))).all(axis=1)
    at = tuple(np.where(inside[:, None], voxel, 0).T)
    share = np.where(inside & (advance > 0.0), fill[at] / 255.0, 0.0)
    layer, density = volume.layer[at], volume.density_kg_m3[at].astype(float)
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
    return wrench("chip_Pa", length * advance * cutter.chip_per_speed_s), wrench("edge_N_m", length), rate


@pytest.mark.parametrize(
    "profile",
    [ball_burr(diameter_m=3e-3), twist_drill(diameter_m=2e-3, length_m=3e-3, point_angle_rad=2.0)],
    ids=["ball", "drill"],
)
@pytest.mark.parametrize("spin_rad_s", [700.0, -700.0])
def test_forces_against_numpy(profile, spin_rad_s):
    volume = layered()
    model = BoneModel(volume, Cutter(profile, 5, spin_rad_s), (SOFT, HARD))
    fill = np.random.default_rng(6).integers(0, 256, volume.shape).astype(np.uint8)
    with_fill(model.store, fill)
    motion = ToolMotion(speed_m_s=3e-3)
    motion.tip_m[:] = (1e-4, -2e-4, -1e-3)
    motion.rotation[:] = Rotation.from_euler("xyz", [0.4, 0.3, -0.8]).as_matrix()
    motion.heading[:] = ((0.6, -0.3, -0.742), (40.0, -20.0, 10.0))
    chip, edge, rate = expected_forces(model, motion, fill)
    response = model.respond(motion)
    # Single precision: an element within 1e-7 m of a voxel's face may read its neighbour, 1 in 1e3 elements.
    for got, want in ((response.resistance, chip), (response.edge, edge)):
        assert got[:3] == pytest.approx(want[:3], abs=2e-3 * np.linalg.norm(want[:3]))
        assert got[3:] == pytest.approx(want[3:], abs=2e-3 * np.linalg.norm(want[3:]))
    assert response.removal_rate_m3_s == pytest.approx(rate * 3e-3, rel=2e-3)
    assert response.wrench == pytest.approx(3e-3 * response.resistance + response.edge, rel=1e-12)


def test_tool_that_backs_off_does_not_cut():
    volume = layered()
    model = BoneModel(volume, Cutter(ball_burr(diameter_m=3e-3), 5, 700.0), (SOFT, HARD))
    fill = np.zeros(volume.shape, np.uint8)
    fill[:, :, :20] = 255  # bone below the ball only
    with_fill(model.store, fill)
    motion = ToolMotion(speed_m_s=1e-3)
    motion.tip_m[:] = (0, 0, -6e-4)
    motion.heading[0] = (0, 0, 1)
    assert np.abs(model.respond(motion).wrench).max() == 0.0
    motion.heading[0] = (0, 0, -1)
    assert model.respond(motion).wrench[2] > 0.0
