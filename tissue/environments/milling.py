"""Environment for milling a pocket into cortical bone with a ball burr."""

from functools import cached_property
from typing import Any

import numpy as np

from meshes.base.arrays import Array, Ints, Singles
from meshes.voxels.volume import VoxelVolume, density_volume
from tissue.cutters import ball_burr
from tissue.environments.environment import LAYER_BITS, BoneEnvironment, Entry
from tissue.models.bone.bricks import voxels_of
from tissue.models.tissue_model import Response, ToolMotion

LAYERS = ("target", "tolerance", "spared")
BLOCK_MM = (13.2, 10.8, 3.6)
"""Size of the block [mm]: the largest pocket, the burr and a margin, in whole voxels.

The burr always stays at least 1.6 mm from the sides of the block and 2.5 mm from its bottom.
"""
SPACING_MM = 0.2
"""Edge of a voxel [mm]: a twentieth of the diameter of the burr.

For the paths that were compared, the forces differ by at most 2 % from the forces with voxels of
0.1 mm.
"""
BURR_MM = 4.0
FLUTES = 6
SPIN_RPM = 20_000.0
TOLERANCE_MM = 0.25
"""Distance from the wall of the pocket within which bone is neither target nor overcut [mm].

The distance applies to both sides of the wall. It is larger than half a voxel, and larger than the
scallops between tracks 0.7 mm apart.
"""
DONE = 0.99
"""Removed share of the target at which the pocket is complete.

The scripted expert removes 0.9 of the target in 4 s, 0.99 in 5.5 s and 0.999 in 5.9 s.
"""


class Milling(BoneEnvironment):
    """Mill a complete pocket into cortical bone, with low force and without overcut.

    A ball burr of 4 mm diameter rotates at 20,000 revolutions per minute above a block whose top is
    at z = 0. The pocket is the volume that the burr sweeps if its tip covers a rectangle of 4 x 2
    mm at a depth of 0.8 mm. Bone within 0.25 mm of the wall of the pocket, on either side, counts
    neither as target nor as overcut. The tool follows the commanded velocity exactly. Each episode
    draws the density of the bone and the start position of the tool.

    **Action**, 3 numbers in [-1, 1]: velocity of the tip along x, y and z, in units of 10 mm/s. A
    virtual fixture keeps the tip within 2.75 mm of the pocket's centre along x, and within 1.75 mm
    along y. Along z, the tip stays between 2 mm above and 1.1 mm below the surface of the bone.

    **Observation**, see `entries`: position of the tip relative to the middle of the pocket's
    opening, velocity of the tip, force and torque on the tool, vector from the tip to the nearest
    remaining voxel of the target, removed share of the target, ratio of overcut to target volume,
    and remaining time.

    **Reward**, see `ContactEnvironment`, with the potential::

        P = (removed volume in the target - removed volume beyond the margin)
            / volume of the target

    ``reward_terms`` contains the two parts of the potential as ``progress`` and ``overcut``. The
    score is the sum of rewards in an episode. It is at most 1; without any action it is -0.1. An
    episode ends when 99 % of the target is removed, and is truncated after 12 s. Force above 20 N
    reduces the reward.

    Parameters
    ----------
    options
        As for `BoneEnvironment`.
    """

    entries = (
        # The scales are twice the reach, the largest speed, and the loads of a full plunge into the
        # densest bone. Its force is 49 N, and its torque at the burr's radius of 2 mm is 100 N mm.
        Entry("tip", 6.0, "mm", 3),
        Entry("velocity", 10.0, "mm/s", 3),
        Entry("force", 50.0, "N", 3),
        Entry("torque", 100.0, "N mm", 3),
        Entry("to_nearest_target", 6.0, "mm", 3),
        Entry("removed_share", 1.0, "1"),
        Entry("overcut_share", 1.0, "1"),
        Entry("time_left", 1.0, "1"),
    )
    action_count = 3
    ranges = {  # noqa: RUF012
        # The densities are those of porous to dense cortical bone. The start lies above the pocket,
        # within reach.
        "density_kg_m3": (1200.0, 1900.0),
        "start_x_mm": (-2.5, 2.5),
        "start_y_mm": (-1.5, 1.5),
        "start_z_mm": (0.3, 1.0),
    }
    # The time is twice that of the scripted expert. The force limit is less than half of the force
    # of a full plunge.
    usual_duration_s = 12.0
    usual_force_limit_N = 20.0
    pocket_mm = (4.0, 2.0, 0.8)
    """Sides of the rectangle that the tip covers, and depth of the rectangle [mm]."""
    top_speed_mm_s = 10.0
    # The reach extends 0.75 mm beyond the pocket at each side and 0.3 mm below it. This is more
    # than the tolerance, so overcut is possible.
    reach_mm = np.array([[-2.75, -1.75, -1.1], [2.75, 1.75, 2.0]])

    cutter = ball_burr(diameter_mm=BURR_MM, flutes=FLUTES, spin_rpm=SPIN_RPM)

    @cached_property
    def volume(self) -> VoxelVolume:
        """Voxels of the block."""
        return _block(self.pocket_mm)

    @cached_property
    def _target_mm3(self) -> float:
        return 1e9 * float(self.model.start_m3[0])

    @cached_property
    def _target(self) -> tuple[Ints, Array]:
        """Indices of the target's voxels in the store, and centres of these voxels [m]."""
        store = self.model.store
        # Voxels of the target: the first layer, full before any cut. A full voxel has 65,535.
        full = self._uncut_content == np.iinfo(np.uint16).max
        chosen = full & (self._material & LAYER_BITS == 0)
        places, _ = voxels_of(store.places, np.arange(len(chosen)), chosen.astype(np.int64))
        centres_m = store.grid.origin_m + store.grid.spacing_m * (places + 0.5)
        return np.flatnonzero(chosen), centres_m

    @property
    def tip_mm(self) -> Array:
        """Position of the tip of the burr [mm], shape (3,)."""
        return 1e3 * self.tool.tip_m

    def _prepare(self) -> None:
        self.restore_bone(dict.fromkeys(LAYERS, self.drawn["density_kg_m3"]))

    def begin(self, motion: ToolMotion) -> None:
        """Place the tip at the position that was drawn at random."""
        motion.tip_m[:] = [1e-3 * self.drawn[f"start_{axis}_mm"] for axis in "xyz"]
        motion.heading[0] = (0.0, 0.0, -1.0)
        motion.speed_m_s = 0.0

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Move the tip with the commanded velocity, but keep its position within the limits."""
        wanted = motion.tip_m + 1e-3 * self.top_speed_mm_s * step_s * self._command
        moved = np.clip(wanted, *(1e-3 * self.reach_mm)) - motion.tip_m
        length = float(np.sqrt(moved.dot(moved)))
        motion.tip_m += moved
        motion.speed_m_s = length / step_s
        if length > 0.0:
            motion.heading[0] = moved / length

    def _shares(self) -> tuple[float, float]:
        """Return the removed volume of the target, and the volume removed beyond the tolerance.

        Both volumes are divided by the volume of the target.
        """
        target, _, spared = (1e9 * self.model.removed_m3 / self._target_mm3).tolist()
        return target, spared

    def _potential(self) -> dict[str, float]:
        share, over = self._shares()
        return {"progress": share, "overcut": -over}

    def _is_over(self) -> bool:
        return self._shares()[0] >= DONE

    def _observe(self) -> Singles:
        indices, centres_m = self._target
        stored = self.model.store.remaining.numpy().ravel()[indices]
        # A voxel that is at least half full belongs to the rest of the target.
        left = centres_m[stored > np.iinfo(np.uint16).max // 2]
        away = left - self.tool.tip_m
        nearest = (
            1e3 * away[np.einsum("ij,ij->i", away, away).argmin()] if len(left) else np.zeros(3)
        )
        velocity = 1e3 * self.tool.speed_m_s * self.tool.heading[0]
        return self._scaled(
            self.tip_mm, velocity, *self._loads_shown, nearest, *self._shares(), self.time_left
        )

    def _facts(self) -> dict[str, Any]:
        share, over = self._shares()
        volumes = {"removed_mm3": share * self._target_mm3, "overcut_mm3": over * self._target_mm3}
        return {"removed_share": share, **volumes, "tip_mm": self.tip_mm}


def _block(pocket_mm: tuple[float, float, float]) -> VoxelVolume:
    """Return the block with its layers.

    The layers are the pocket, the margin at the wall of the pocket, and the remaining bone.
    """
    counts = np.round(np.array(BLOCK_MM) / SPACING_MM).astype(int)
    origin = np.array([-0.5, -0.5, -1.0]) * SPACING_MM * counts
    x, y, z = (
        start + SPACING_MM * (np.arange(n) + 0.5) for start, n in zip(origin, counts, strict=True)
    )
    length, width, depth = pocket_mm
    aside = (
        np.maximum(np.abs(x)[:, None, None] - 0.5 * length, 0.0),
        np.maximum(np.abs(y)[:, None] - 0.5 * width, 0.0),
    )
    # Pockets are shallower than the radius of the ball, so its surface limits them below and at the
    # sides.
    wall = np.sqrt(aside[0] ** 2 + aside[1] ** 2 + (z - 0.5 * BURR_MM + depth) ** 2) - 0.5 * BURR_MM
    layer = 1 + (wall > TOLERANCE_MM).astype(np.uint8) - (wall < -TOLERANCE_MM).astype(np.uint8)
    density = np.full(layer.shape, 1800.0)  # replaced at every reset by the drawn density
    return density_volume(
        density, spacing_mm=SPACING_MM, origin_mm=origin, layer=layer, layer_names=LAYERS
    )
