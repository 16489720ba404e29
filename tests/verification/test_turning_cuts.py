"""Force on a tool that reverses, dithers or turns, as a tool that is held by hand does.

The cuts are milled in voxels of 0.1 mm.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from voxel_cuts import BONE, VoxelCut, layered, over_50_ms

from kernels.carving import PHASES
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.evaluation.reference.force import Resolution, Solid
from tissue.evaluation.reference.history import wrench_at
from tissue.evaluation.reference.path import ToolPath
from tissue.models.bone.carver import Carver
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import TICK_S, ToolMotion

R_M = 1.5e-3
DEPTH_MM = -0.6
BURR = Cutter(ball_burr(diameter_m=2 * R_M), 6, -100.0)


def forces(tips_m, cutter=BURR):
    """Return the force at every tick [N], shape (n, 3), on a cutter that moves through tips.

    The velocity at a tick is the mean velocity since the previous tick.
    """
    margin = 2.2 * R_M
    volume = voxelise(
        layered(),
        spacing_m=1e-4,
        region_m=(tips_m.min(axis=0) - margin, tips_m.max(axis=0) + 2 * margin),
    )
    model = BoneModel(volume, cutter, (BONE, BONE), cores=1)
    motion, found = ToolMotion(), []
    for tick, velocity in enumerate(velocities_of(tips_m)):
        motion.tip_m[:] = tips_m[tick]
        motion.speed_m_s = float(np.linalg.norm(velocity))
        motion.heading[0] = velocity / motion.speed_m_s
        if tick == 0:
            model.place(motion)
        model.advance(motion)
        found.append(model.respond(motion).wrench[:3].copy())
    return np.array(found)


def velocities_of(tips_m):
    """Return the mean velocity since the previous tick [m/s], shape (n, 3)."""
    moved = np.diff(tips_m, axis=0) / TICK_S
    return np.vstack([moved[:1], moved])


def plunge_and_slot(feed_m_s, length_m):
    """Return tips [m] of a plunge and a slot along x."""
    down = np.arange(2e-4, 1e-3 * DEPTH_MM, -feed_m_s * TICK_S)
    along = np.arange(0.0, length_m, feed_m_s * TICK_S)
    first = np.column_stack([np.zeros((len(down), 2)), down])
    second = np.column_stack([along, np.zeros_like(along), np.full_like(along, 1e-3 * DEPTH_MM)])
    return first, second


@pytest.mark.parametrize(("feed_m_s", "degrees"), [(5e-4, 37.0), (2e-3, 0.0), (8e-3, 37.0)])
def test_a_tool_that_reverses_has_little_force_in_its_own_cut(feed_m_s, degrees):
    """The force is at most 2.2 % of the force before the turn, and 1.2 % on average over 0.12 mm.

    It acts on the flanks, where the surface is parallel to the path within half a degree. There, the
    cuts at the last poses are less than 0.02 um deeper than the present pose. Such a gap counts as
    bone.
    """
    first, second = plunge_and_slot(feed_m_s, 8e-4)
    back = second[::-1][1 : round(1.2e-4 / (feed_m_s * TICK_S)) + 1]
    tips = np.concatenate([first, second, back])
    force = np.linalg.norm(
        forces(Rotation.from_euler("z", degrees, degrees=True).apply(tips)), axis=1
    )
    before, reversed_ = force[: -len(back)][-5:].mean(), force[-len(back) :]
    print(
        f"\n{1e3 * feed_m_s:g} mm/s, {degrees:g} deg: first tick {100 * reversed_[0] / before:.2f} %, "
        f"largest {100 * reversed_.max() / before:.2f} %, mean {100 * reversed_.mean() / before:.2f} %"
    )
    assert reversed_.max() < 0.022 * before and reversed_.mean() < 0.012 * before


DITHERS = {"sideways": (0.0, 1.0, 0.0), "up and down": (0.0, 0.0, 1.0), "along": (1.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("name", "feed_m_s", "bound"),
    [
        ("along", 1e-3, 0.002),
        ("along", 2e-4, 0.012),
        pytest.param("sideways", 1e-3, 0.004, marks=pytest.mark.slow),
        pytest.param("up and down", 1e-3, 0.007, marks=pytest.mark.slow),
    ],
)
def test_a_tool_that_dithers_while_it_advances(name, feed_m_s, bound, monkeypatch):
    """The mean force of a tool that dithers by 10 um at 10 Hz agrees with the exact geometry.

    The error is at most 0.7 % at a feed of 1 mm/s. It is at most 1.2 % at 0.2 mm/s, where the tool
    moves backward for a part of each period. The mean is taken over every fifth tick of a period,
    or over every twentieth tick for motions across the path. No tick visits more than an eighth of
    the groups of bricks.
    """
    groups = []
    visit = Carver._visit

    def counted(self, count, **options):
        groups.append(count)
        visit(self, count, **options)

    monkeypatch.setattr(Carver, "_visit", counted)
    first, _ = plunge_and_slot(2e-3, 1e-9)
    time_s = np.arange(1, 301) * TICK_S
    along = first[-1] + feed_m_s * time_s[:, None] * [1.0, 0.0, 0.0]
    swing = 1e-5 * np.sin(2.0 * np.pi * 10.0 * time_s)[:, None] * DITHERS[name]
    tips = np.concatenate([first, along + swing])
    count = len(tips)
    # The exact force is expensive where the tool moves across its path.
    every = 5 if name == "along" else 20
    ticks = np.arange(count - 100, count, every)
    found = forces(tips)[ticks].mean(axis=0)
    still = np.broadcast_to(np.eye(3), (count, 3, 3))
    path = ToolPath(tips, still, velocities_of(tips), np.zeros_like(tips), 2 * R_M)
    solid = Solid(layered(), (BONE, BONE))
    wanted = np.mean(
        [wrench_at(int(t), path, BURR, solid, resolution=Resolution(8, 3))[:3] for t in ticks],
        axis=0,
    )
    off = np.linalg.norm(found - wanted) / np.linalg.norm(wanted)
    print(f"\n{name}, {1e3 * feed_m_s:g} mm/s: {100 * off:.2f} %, groups {max(groups[1:])}")
    assert off < bound and max(groups[1:]) <= PHASES // 8


CORNERS_MM = (
    (-0.4, 0.1, 0.2),
    (-0.4, 0.1, DEPTH_MM),
    (0.7, 0.4, DEPTH_MM),
    (0.3, -0.5, DEPTH_MM - 0.1),
)


def test_the_same_cut_at_four_headings_and_mirrored():
    """Forces over 50 ms of a cut that turns by 110 degrees agree within 0.15 %."""
    plain = over_50_ms(VoxelCut(BURR, layered(), CORNERS_MM).engine(1e-4))
    size = np.linalg.norm(plain, axis=1).max()
    off = []
    for degrees in (90.0, 180.0, 270.0):
        frame = Rotation.from_euler("z", degrees, degrees=True)
        off.append(
            over_50_ms(VoxelCut(BURR, layered(), CORNERS_MM).engine(1e-4, frame=frame)) - plain
        )
    side = np.array([1.0, -1.0, 1.0])
    mirrored = VoxelCut(
        Cutter(BURR.profile, BURR.flute_count, -BURR.spin_rad_s),
        layered(),
        tuple(tuple(side * corner) for corner in CORNERS_MM),
    )
    off.append(over_50_ms(mirrored.engine(1e-4)) * side - plain)
    found = [np.linalg.norm(each, axis=1).max() / size for each in off]
    print(f"\nfour headings and mirrored: {np.round(100 * np.array(found), 3)} %")
    assert max(found) < 0.0015
