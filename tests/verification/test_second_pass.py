"""Second pass over an older cut, against an integral over the ball's surface.

The integral covers the solid that the first pass left. It is written from the law alone: dF = -(N A
/ (2 pi r)) [(K_tc h + K_te) t + (K_rc h + K_re) n] on the surface that advances, lies below the
face and lies outside all capsules that the ball swept on its earlier lines.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from voxel_cuts import BONE, UPRIGHT, VoxelCut, layered

from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr

R, DEPTH = 1.5e-3, -0.4
BURR = Cutter(ball_burr(diameter_m=2 * R), 6, -100.0)
FIRST = [(-2, 0, 0.3), (-2, 0, DEPTH), (2, 0, DEPTH)]
LIFT = [(2, 0, 0.3)]
NOTHING_LEFT, LITTLE_LEFT = 0.01, 0.02
"""Bounds relative to the full cut's force, over 50 ms.

The first bounds the force where nothing is left, the second the error where little is left.
"""
FRAMES = {"lattice": UPRIGHT, "turned": Rotation.from_euler("xyz", [0.5, -0.3, 0.7])}


def across(degrees, deeper=0.0):
    """A pass through the middle of the first one at an angle."""
    x, y = 2 * np.cos(np.radians(degrees)), 2 * np.sin(np.radians(degrees))
    return [*LIFT, (-x, -y, 0.3), (-x, -y, DEPTH - deeper), (x, y, DEPTH - deeper)]


def along(aside=0.0, start=DEPTH, end=DEPTH):
    """A pass along the first one, moved aside, from one depth to another."""
    return [*LIFT, (-2, aside, 0.3), (-2, aside, start), (2, aside, end)]


NOTHING = {
    "back": [(-2, 0, DEPTH)],
    "again": along(),
    "rising": along(end=DEPTH + 0.3),
    "higher and aside": along(0.05, DEPTH + 0.1, DEPTH + 0.1),
}
LITTLE = {f"across {angle}": across(angle) for angle in (90, 45, 10)}
LITTLE |= {f"across {angle} deeper 0.05": across(angle, 0.05) for angle in (90, 45, 10)}
LITTLE |= {f"deeper {by}": along(0.0, DEPTH - by, DEPTH - by) for by in (0.05, 0.1, 0.5)}
LITTLE |= {f"aside {by}": along(by) for by in (0.05, 0.1, 0.5)}
LITTLE |= {"slanted in depth": along(0.0, DEPTH + 0.2, DEPTH - 0.2)}


def surface_sum(cut, ticks, rows=300):
    """Return the force [N] at ticks, shape (n, 3).

    It is summed over `rows` by twice as many cells of equal angles.
    """
    tips, velocities, lines = cut.ticks()
    centres = 1e-3 * np.array(cut.corners_mm) + [0.0, 0.0, R]
    polar = np.repeat((np.arange(rows) + 0.5) / rows * np.pi, 2 * rows)
    turn = np.tile((np.arange(2 * rows) + 0.5) / rows * np.pi, rows)
    normal = np.column_stack(
        [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), -np.cos(polar)]
    )
    around = np.sign(BURR.spin_rad_s) * np.column_stack(
        [-np.sin(turn), np.cos(turn), np.zeros_like(turn)]
    )
    per_radian = BURR.flute_count / (2 * np.pi) * R * (np.pi / rows) ** 2
    found = []
    for tick in ticks:
        advance = normal @ velocities[tick]
        points = tips[tick] + [0.0, 0.0, R] + R * normal
        left = np.flatnonzero((advance > 1e-12) & (points[:, 2] < 0.0))
        for line in range(lines[tick]):
            start, span = centres[line], centres[line + 1] - centres[line]
            offset = points[left] - start
            share = np.clip(offset @ span / (span @ span), 0.0, 1.0)
            left = left[np.linalg.norm(offset - share[:, None] * span, axis=1) > R + 1e-10]
        chip = (advance[left] * BURR.chip_per_speed_s)[:, None]
        law = (BONE.tangential_chip_Pa * chip + BONE.tangential_edge_N_m) * around[left]
        law += (BONE.radial_chip_Pa * chip + BONE.radial_edge_N_m) * normal[left]
        found.append(-per_radian * law.sum(axis=0))
    return np.array(found)


def second_pass(corners, frame, shift_m=(0.0, 0.0, 0.0)):
    """Largest error over 50 ms and mean true force of the last line, by the full cut's force."""
    cut = VoxelCut(BURR, layered(), tuple(FIRST + corners), 8e-3)
    lines = cut.ticks()[2]
    full = np.linalg.norm(surface_sum(cut, np.flatnonzero(lines == 1)[-1:])[0])
    ticks = np.flatnonzero(lines == lines.max())[::10]  # five of every 50 ms
    wanted = surface_sum(cut, ticks)
    off = cut.engine(1e-4, frame=frame, shift_m=shift_m)[ticks] - wanted
    windows = off[: len(off) // 5 * 5].reshape(-1, 5, 3).mean(axis=1)
    return np.linalg.norm(windows, axis=1).max() / full, np.linalg.norm(
        wanted, axis=1
    ).mean() / full


@pytest.mark.parametrize(("name", "frame"), [("back", "lattice"), ("again", "turned")])
def test_where_nothing_is_left_nothing_is_felt(name, frame):
    error, true = second_pass(NOTHING[name], FRAMES[frame])
    print(f"\n{name}, {frame}: {100 * error:.2f} %")
    assert true == 0.0 and error < NOTHING_LEFT


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rising", "higher and aside", *LITTLE])
def test_every_second_pass_in_a_turned_and_shifted_frame(name):
    frame = Rotation.random(random_state=4)
    shift_m = np.random.default_rng(0).uniform(-5e-4, 5e-4, 3)
    error, true = second_pass((NOTHING | LITTLE)[name], frame, shift_m)
    print(f"\n{name}: {100 * error:.2f} % of the full cut, true force {100 * true:.1f} %")
    assert error < (NOTHING_LEFT if name in NOTHING else LITTLE_LEFT)
