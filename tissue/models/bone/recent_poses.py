"""Most recent poses of a cutting tool."""

from itertools import pairwise
from math import sqrt

import numpy as np
import warp as wp

from kernels.mirror import Mirror
from meshes.base.arrays import Array
from tissue.models.tissue_model import ToolMotion

RINGS = (
    (12, 4e-6),
    (24, 2.4e-5),
)
"""Number of stored poses and their distance along the path [m], for each ring buffer; chosen.

Together the ring buffers cover a longer path than `tissue.models.bone.carver.OLDER_LAG_M`. If a
tool returns along its path, it meets bone too early by at most the distance between two poses. A
ball of 1 mm radius at two poses 24 um apart leaves a ridge of bone with a height of 0.07 um.
"""
ROUNDING = 1e-9
"""Largest change of the tool's axis that is treated as rounding of its rotation [rad]."""
KEPT_POSES = sum(count for count, _ in RINGS)


class RecentPoses:
    """Most recent poses at which a tool has cut.

    The region that the tool cut at these poses is known exactly, except for rounding errors.

    Parameters
    ----------
    lever_m
        Distance from the tip to the opposite end of the tool [m].
    device
        Warp device name.

    Attributes
    ----------
    mirror
        Stored poses, as displacements and rotations relative to the pose of the last call of
        `seen_from`. The layout is defined by `kernels.engagement.find_bone`.
    turns
        True if the tool's axis has changed its direction since the last call of `place`.
    """

    STATE = ("_poses", "_rings", "turns")
    """Names of the attributes on which later ticks depend."""

    def __init__(self, lever_m: float, *, device: str) -> None:
        # tip [m] and axis of each pose
        self._poses = np.zeros((KEPT_POSES, 6))
        self._pose = np.zeros(6)
        self._lever = lever_m
        # row of the latest pose of each ring, first row of the ring and the row after its last
        ends = np.cumsum([0, *(count for count, _ in RINGS)]).tolist()
        self._rings = [[first, first, last] for first, last in pairwise(ends)]
        self.turns = False
        self._moved = np.zeros((KEPT_POSES, 3))
        self.mirror = Mirror((1 + KEPT_POSES, 2), wp.vec3, device)

    def place(self, motion: ToolMotion) -> None:
        """Set all stored poses to a first pose."""
        self._poses[:] = self._pose_of(motion)
        self.turns = False

    def add(self, motion: ToolMotion) -> None:
        """Add a pose at which the tool has cut.

        Each ring buffer in `RINGS` stores the present pose as its last entry. Later poses overwrite
        this entry until the distance from the previous entry reaches the distance of the buffer in
        `RINGS`.
        """
        pose = self._pose_of(motion)
        for ring, (_, spaced_m) in zip(self._rings, RINGS, strict=True):
            now, first, end = ring
            last = now - 1 if now > first else end - 1
            moved = pose - self._poses[last]
            travel = sqrt(moved[:3].dot(moved[:3]))
            # A rotation about the tool's axis moves its surface into itself.
            turn = sqrt(moved[3:].dot(moved[3:]))
            if turn > ROUNDING:
                self.turns = True
                travel += self._lever * turn
            self._poses[now] = pose
            if travel >= spaced_m:
                ring[0] = now + 1 if now + 1 < end else first
                self._poses[ring[0]] = pose

    def _pose_of(self, motion: ToolMotion) -> Array:
        """Return tip position and axis of the tool, in an array that the next call overwrites."""
        pose = self._pose
        pose[:3] = motion.tip_m
        pose[3:] = motion.rotation[:, 2]
        return pose

    def seen_from(self, tip_m: Array, rotation: Array) -> None:
        """Write stored poses relative to a given pose to the array `mirror`, present pose first."""
        rows = self.mirror.host.reshape(-1, 6)
        np.dot(self._poses[:, :3] - tip_m, rotation, out=self._moved)
        rows[1:, :3] = self._moved
        if self.turns:
            axes = self._poses[:, 3:] @ rotation
            # The smallest rotation that turns the axis is enough: a further rotation about the axis
            # maps the tool's surface onto itself.
            rows[1:, 3] = -axes[:, 1]
            rows[1:, 4] = axes[:, 0]
        rows[0] = rows[1 + self._rings[0][0]]
        self.mirror.push()
