"""Search for bone and forces of the kernels against plain NumPy, element by element."""

from dataclasses import replace

import numpy as np
import pytest
from bone_blocks import (
    SOFT,
    SPACING_M,
    clear_blocks,
    layered,
    solid,
    store_distances,
    tilted_motion,
)
from cutting_in_numpy import NEVER, find, forces, shares, voxel_distances
from scipy.spatial.transform import Rotation

from kernels.cutting import AREA, RATE
from kernels.engagement import DENSITY, DISTANCE, LAYER, SLOPE, WIDTH
from kernels.older_cuts import RAMP
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, twist_drill
from tissue.materials.constants import CuttingCoefficients
from tissue.models.bone.elements import CREEP_M_S
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

HARD = CuttingCoefficients(150e6, 60e6, 10e6, 5e3, 4e3, 1e3, 1800.0, 1.5)
MINIMUM_M = 2e-7
LAWS = {
    "linear": {},
    "minimum chip": {"minimum_chip_m": MINIMUM_M},
    "size effect": {"size_exponent": 0.3, "minimum_chip_m": MINIMUM_M, "reference_chip_m": 1e-4},
}
PROFILES = {
    "ball": ball_burr(diameter_m=3e-3),
    "drill": twist_drill(diameter_m=2e-3, length_m=3e-3, point_angle_rad=2.0),
}
TICK_S = 1e-3
NO_VELOCITY = np.zeros(6)


def older_cuts(model, motion, random):
    """Return kept distances of an older cut that crosses the tool's surface at a slant.

    A tenth of them was never near the tool.
    """
    distance = voxel_distances(model, motion.tip_m, motion.rotation)
    across = np.tensordot(np.array([0.6, 0.64, 0.48]), np.indices(distance.shape) - 21.0, axes=1)
    older = np.clip(np.rint(32768 + 4096 * (distance + across)), 0, 65534).astype(np.uint16)
    older[random.uniform(size=distance.shape) < 0.1] = NEVER
    return older


class RandomCut:
    """A tool in random bone with random older cuts.

    Parameters
    ----------
    profile, spin_rad_s
        The tool.
    law
        Entries of the cutting coefficients.
    turning
        Angular velocity per speed [1/m].
    """

    def __init__(self, profile, *, spin_rad_s=700.0, law="linear", turning=(0.0, 0.0, 0.0)):
        self.motion = tilted_motion(turning)
        coefficients = replace(SOFT, **LAWS[law]), replace(HARD, **LAWS[law])
        cutter = Cutter(PROFILES[profile], 5, spin_rad_s)
        self.model = BoneModel(layered(), cutter, coefficients, shell_spacing_m=5e-5)
        random = np.random.default_rng(6)
        self.older = older_cuts(self.model, self.motion, random)
        store_distances(self.model, self.model.store.older, self.older)
        blocks = random.uniform(size=(24, 24, 24)) < 0.05
        self.swallowed = blocks.repeat(2, 0).repeat(2, 1).repeat(2, 2)
        clear_blocks(self.model, blocks)
        self.count = len(self.model.shell.areas_m2)

    def wanted(self, **options):
        """Return the bone that NumPy finds."""
        pose = self.motion.tip_m, self.motion.rotation
        return find(self.model, *pose, self.older, self.swallowed, **options)

    def around(self, before=NO_VELOCITY):
        """Return the bone that the kernel finds around the whole tool, shape (FOUND, elements)."""
        self.model.find_bone(self.motion.tip_m, self.motion.rotation, before, TICK_S)
        found = self.model._forces.found.numpy()
        assert not found[:, WIDTH].reshape(-1)[self.count :].any()
        return found.transpose(1, 0, 2).reshape(found.shape[1], -1)[:, : self.count]

    def assert_same(self, found, wanted):
        """Assert that the kernel finds the bone of NumPy, where rounding does not decide.

        In single precision, an element within 1e-7 m of a voxel's face may read its neighbour: 1 in
        1000 elements. The tool's table and its tangent spheres are 0.02 voxel off.
        """
        has = found[WIDTH] > 0.0
        clear = wanted.clear
        assert (has != (wanted.width_m > 0.0))[clear].mean() < 2e-3
        both = clear & has & (wanted.width_m > 0.0)
        off_m = np.where(wanted.by == 1, 0.03, 0.005) * SPACING_M
        fits = np.abs(found[DISTANCE] - wanted.distance_m) < off_m
        fits &= np.abs(found[WIDTH] - wanted.width_m) < 2e-3 * wanted.width_m + 1e-12
        fits &= (np.abs(found[SLOPE : SLOPE + 3].T - wanted.slope) < 1e-3).all(axis=1)
        fits &= found[LAYER] == wanted.layer
        fits &= np.abs(found[DENSITY] - wanted.density) <= 1.0
        assert fits[both].mean() > 0.998
        return both


def last_poses(model, motion):
    """Give the tool 30 last poses on an arc that turns by 0.05 rad, and return them.

    The last of them is the present pose. For some elements, the other poses are half a voxel ahead
    of it.
    """
    angles = np.linspace(-0.05, 0.0, 30)
    along = np.array([0.3, 0.8, -0.52])
    poses = []
    for angle in angles:
        pose = ToolMotion(speed_m_s=1e-3)
        pose.rotation[:] = (
            motion.rotation @ Rotation.from_rotvec([angle, 0.4 * angle, 0.0]).as_matrix()
        )
        pose.tip_m[:] = motion.tip_m + 5e-5 * np.sin(40.0 * angle) * along - 4e-5 * angle
        poses.append(pose)
    model._recent.place(poses[0])
    for pose in poses[1:]:
        model._recent.add(pose)
    tips, rotations = np.array([pose.tip_m for pose in poses]), [pose.rotation for pose in poses]
    return tips[::-1], rotations[::-1]


@pytest.mark.parametrize(
    "turning", [(0.0, 0.0, 0.0), (40.0, -20.0, 10.0)], ids=["along", "turning"]
)
@pytest.mark.parametrize("profile", PROFILES)
def test_bone_in_front_of_elements_that_advance(profile, turning):
    cut = RandomCut(profile, turning=turning)
    motion = cut.motion
    wanted = cut.wanted(heading=motion.heading)
    both = cut.assert_same(cut.model.found_along(motion)[:, : cut.count], wanted)
    # Older cuts have taken bone from some elements, and the others are in both layers.
    assert set(wanted.layer[both]) == {0, 1}
    assert (wanted.clear & (wanted.by == 1) & (wanted.width_m == 0.0)).sum() > 100


@pytest.mark.parametrize("has_poses", [False, True])
@pytest.mark.parametrize("profile", PROFILES)
def test_bone_around_the_whole_tool(profile, has_poses):
    cut = RandomCut(profile)
    recent = last_poses(cut.model, cut.motion) if has_poses else None
    wanted = cut.wanted(recent=recent)
    both = cut.assert_same(cut.around(), wanted)
    assert set(wanted.by[both]) == ({0, 1, 2} if has_poses else {0, 1})
    whole = len(both) // 8 * 8
    layers = np.where(both, wanted.layer, -1)[:whole].reshape(-1, 8)
    assert ((layers == 0).any(axis=1) & (layers == 1).any(axis=1)).sum() > 2


def found_by(cut, before):
    """Return the bone that the kernel finds in the form of NumPy, to compare the law alone."""
    rows, wanted = cut.around(before).astype(float), cut.wanted()
    slope = rows[SLOPE : SLOPE + 3].T
    layer, density = rows[LAYER].astype(int), rows[DENSITY]
    return replace(
        wanted,
        distance_m=rows[DISTANCE],
        width_m=rows[WIDTH],
        slope=slope,
        layer=layer,
        density=density,
    )


VELOCITIES = {
    "slow": (1e-5, np.array([0.6, -0.3, -0.742, 0.0, 0.0, 0.0])),
    "fast": (8e-3, np.array([0.6, -0.3, -0.742, 0.0, 0.0, 0.0])),
    "turning": (4e-3, np.array([0.1, -0.9, -0.42, 300.0, -150.0, 200.0])),
}


@pytest.mark.parametrize(
    ("law", "name", "unknowns"),
    [
        ("linear", "turning", 3),
        ("linear", "slow", 6),
        ("minimum chip", "slow", 6),
        ("minimum chip", "turning", 6),
        ("size effect", "fast", 6),
    ],
)
def test_tangent_of_the_force_against_finite_differences(law, name, unknowns):
    """Force, torque and their derivatives agree with the law in NumPy.

    The force agrees within 2e-5 of the largest component. The derivatives are central differences
    over 2e-5 of the speed. Elements that cross a kink of the law in between contribute up to 1 %.
    """
    cut = RandomCut("ball", law=law)
    last_poses(cut.model, cut.motion)
    model = cut.model
    speed, along = VELOCITIES[name]
    frame = np.kron(np.eye(2), cut.motion.rotation.T)
    velocity = frame @ (speed * along)
    before = frame @ (speed * np.array([0.5, -0.4, -0.6, 100.0, 0.0, 50.0]))
    found = found_by(cut, before)
    value, slopes = model.forces(velocity, unknowns=unknowns)
    options = {"least_m": CREEP_M_S * model.cutter.chip_per_speed_s}

    def law_at(moving):
        return forces(found, model, moving, before, TICK_S, **options)

    wanted, rate, areas = law_at(velocity)
    arm = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
    size = np.abs(wanted / arm).max()
    result = value + slopes @ velocity[:unknowns]
    assert result / arm == pytest.approx(wanted / arm, abs=2e-5 * size)
    assert model._sums[RATE] == pytest.approx(rate, rel=1e-4)
    assert model._sums[AREA : AREA + 2] == pytest.approx(areas, rel=1e-4)
    share = shares(found, model.shell, velocity, before, TICK_S)
    assert ((share > 0.0) & (share < 1.0)).sum() > 100
    step = 2e-5 * speed
    rows = slice(None) if unknowns == 6 else slice(3)
    for k in range(unknowns):
        change = np.zeros(6)
        change[k] = step if k < 3 else step * 500.0
        high, low = (law_at(velocity + sign * change)[0] for sign in (1.0, -1.0))
        slope = (high - low) / (2.0 * change[k])
        largest = np.abs(slopes[rows, k] / arm[rows]).max()
        assert slopes[rows, k] / arm[rows] == pytest.approx(
            slope[rows] / arm[rows], abs=0.01 * largest
        )
    if unknowns == 3:
        assert not slopes[3:].any()


ALONG = (0.0, 0.0, 0.0), 700.0
TURNING = (40.0, -20.0, 10.0), -700.0


@pytest.mark.parametrize(
    ("profile", "law", "path"),
    [
        ("ball", "linear", ALONG),
        ("ball", "minimum chip", TURNING),
        ("ball", "size effect", ALONG),
        ("drill", "linear", TURNING),
        ("drill", "minimum chip", ALONG),
        ("drill", "size effect", TURNING),
    ],
)
def test_tangent_in_the_speed(profile, law, path):
    """The force along a path and its derivative by the speed, from NumPy's bone and law alone.

    The force is linear in the speed for a linear law. Of the elements, 1 in 1000 differ by rounding.
    """
    turning, spin_rad_s = path
    cut = RandomCut(profile, law=law, turning=turning, spin_rad_s=spin_rad_s)
    motion, model = cut.motion, cut.model
    frame = np.kron(np.eye(2), motion.rotation)
    found = cut.wanted(heading=motion.heading)
    heading = frame.T @ motion.heading.reshape(6)
    response = model.respond(motion)

    def wrench(speed):
        still = np.zeros(6)
        parts = forces(found, model, heading, still, 0.0, speed=speed)
        return frame @ parts[0], parts[1], parts[2]

    wanted, rate, areas = wrench(3e-3)
    slope = (wrench(3.003e-3)[0] - wrench(2.997e-3)[0]) / 6e-6
    for got, want, off in ((response.wrench, wanted, 2e-3), (response.resistance, slope, 3e-3)):
        assert got[:3] == pytest.approx(want[:3], abs=off * np.linalg.norm(want[:3]))
        assert got[3:] == pytest.approx(want[3:], abs=off * np.linalg.norm(want[3:]))
    assert response.removal_rate_m3_s == pytest.approx(3e-3 * rate, rel=2e-3)
    assert response.engaged_m2 == pytest.approx(areas, rel=2e-3)
    assert response.wrench == pytest.approx(3e-3 * response.resistance + response.edge, rel=1e-12)


def test_share_over_a_tick_is_the_mean_of_an_element_that_passes_the_surface():
    """The share of a point is the part of the tick in which it lies below the surface.

    The share of an element wider than its motion is the part of its width below the surface in the
    middle of the tick.
    """
    cut = RandomCut("ball")
    last_poses(cut.model, cut.motion)
    before = np.array([1e-3, 1e-3, -2e-3, 0.0, 0.0, 0.0])
    found, shell = found_by(cut, before), cut.model.shell
    velocity = np.array([2e-3, -3e-3, -4e-3, 0.0, 0.0, 0.0])
    share = shares(found, shell, velocity, before, TICK_S)
    start = found.distance_m - TICK_S * found.slope @ before[:3]
    times = (np.arange(4000) + 0.5) / 4000
    shift = TICK_S * found.slope @ velocity[:3]
    has = found.width_m > 0.0
    narrow = has & (np.abs(shift) > 20.0 * found.width_m)
    below = start[narrow] + times[:, None] * shift[narrow] < 0.0
    assert narrow.sum() > 50
    assert share[narrow] == pytest.approx(below.mean(axis=0), abs=1e-3)
    wide = has & (found.width_m > np.abs(shift))
    middle = (start + 0.5 * shift)[wide] / found.width_m[wide]
    assert wide.sum() > 500
    assert share[wide] == pytest.approx(np.clip(0.5 - middle, 0.0, 1.0), abs=1e-12)


def engaged_m2(model, motion):
    model.carver.changes += 1  # these tests write the bone's arrays themselves
    return model.respond(motion).engaged_m2[0]


def test_an_older_cut_as_deep_disengages_and_one_less_deep_does_not():
    """An older cut of the same depth disengages, and one shallower by more than the ramp does not.

    The table and the tangent sphere are 0.02 voxel off.
    """
    model = BoneModel(solid(48), Cutter(ball_burr(diameter_m=3e-3), 5, 700.0), (SOFT,))
    motion = ToolMotion(speed_m_s=1e-3)
    motion.tip_m[:], motion.heading[0] = (0.0, 0.0, -1e-3), (0.0, 0.0, -1.0)
    steps = 32768 + 4096 * voxel_distances(model, motion.tip_m, motion.rotation)
    found = []
    for deeper in (0.05, 0.0, -1.25 * RAMP - 0.03):
        store_distances(
            model,
            model.store.older,
            np.clip(np.rint(steps - 4096 * deeper), 1, 65534).astype(np.uint16),
        )
        found.append(engaged_m2(model, motion))
    half = model.shell.areas_m2[model.shell.normals[:, 2] < -1e-5].sum()
    assert found[0] == 0.0 and found[1] < 0.6 * half
    assert found[2] == pytest.approx(half, rel=1e-6)
    motion_of_the_cut = ToolMotion(speed_m_s=1e-3, tip_m=motion.tip_m.copy())
    fresh = BoneModel(solid(48), model.cutter, (SOFT,))
    fresh.place(motion_of_the_cut)
    # its own cut, carved by the kernel
    assert engaged_m2(fresh, motion) == pytest.approx(half, rel=1e-6)
