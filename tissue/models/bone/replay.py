"""Bone at any tick of a run: the tool's poses, carved again by the kernel of the run."""

import numpy as np

from kernels.bricks import FULL
from meshes.base.arrays import Array, Bytes, Ints
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.models.bone.bricks import BrickStore, voxels_of
from tissue.models.bone.carver import Carver, Removal
from tissue.models.tissue_model import ToolMotion

__all__ = ["CarvingReplay"]


class CarvingReplay:
    """Bone at the end of any tick, bitwise equal to the bone of a run that stops there.

    Parameters
    ----------
    volume
        The bone before the first cut.
    cutter, removal
        The tool and its mode of removal.
    poses
        Poses of the run, see `tissue.simulation.loop.PoseLog`.
    device
        Warp device name; the device of the run gives bitwise equal results.

    Attributes
    ----------
    fraction
        Bone in every voxel at the tick, 255 = full, uint8, shape (nx, ny, nz); the next call of
        `at` changes it.
    """

    def __init__(
        self,
        volume: VoxelVolume,
        cutter: Cutter,
        poses: Array,
        *,
        removal: Removal = "subvoxel",
        device: str = "cpu",
    ) -> None:
        self._poses = poses
        self._motion = ToolMotion()
        self._store = BrickStore.from_volume(volume, device=device)
        self._carver = Carver(self._store, cutter, removal=removal, device=device)
        self._start = self._carver.state()
        self.fraction = volume.fraction.copy()
        self._next = 0  # first pose that was not carved yet
        # bricks whose entry in `fraction` is out of date
        self._changed = np.zeros(0, dtype=np.intp)
        self._cut = np.zeros(0, dtype=np.intp)  # bricks that differ from the start

    def at(self, tick: int) -> Bytes:
        """Return the bone at the end of a tick, see `fraction`.

        A tick before the last one restarts the replay at the first pose.
        """
        last = int(np.searchsorted(self._poses[:, 0], tick, side="right"))
        if last < self._next:
            self._carver.restore(self._start)
            self._changed = self._cut
            self._next = 0
        for pose in self._poses[self._next : last]:
            self._carve(pose)
        self._next = last
        carved, _ = self._store.take_touched()
        before = self._carver.state()
        self._carver.finish()
        completed, _ = self._store.take_touched()
        self._cut = np.union1d(self._cut, np.union1d(carved, completed))
        self._store.write_fraction(
            self.fraction, np.union1d(self._changed, np.union1d(carved, completed))
        )
        self._carver.restore(before)
        self._changed = completed
        return self.fraction

    def removals(self) -> tuple[Ints, Ints]:
        """Return the voxels that fall below half during the run, and the tick of each, increasing.

        The indices have shape (n, 3). Removal is fractional; a voxel that was below half before the
        first cut is not included. A slow tool's bricks take turns, so that a voxel may be up to 20
        µm of the tool's path late.
        """
        self._carver.restore(self._start)
        self._store.take_touched()
        below = self._store.remaining.numpy()[: len(self._store.places)] <= FULL // 2
        found = [np.zeros((0, 3), dtype=np.int64)]
        ticks = [np.zeros(0, dtype=np.int64)]

        def take(tick: int) -> None:
            rows, left = self._store.take_touched()
            self._cut = np.union1d(self._cut, rows)
            new = (left <= FULL // 2) & ~below[rows]
            if new.any():
                below[rows] |= new
                places, _ = voxels_of(self._store.places, rows, new.astype(np.int64))
                found.append(places)
                ticks.append(np.full(len(places), tick))

        tick = 0
        for pose in self._poses:
            if int(pose[0]) > tick:
                take(tick)
                tick = int(pose[0])
            self._carve(pose)
        self._carver.finish()
        take(tick)
        self._carver.restore(self._start)
        self._changed = self._cut
        self._next = 0
        return np.concatenate(found), np.concatenate(ticks)

    def _carve(self, pose: Array) -> None:
        motion = self._motion
        motion.tip_m[:] = pose[1:4]
        motion.rotation[:, 2] = pose[4:7]
        motion.heading[:] = pose[7:].reshape(2, 3)
        if pose[0] < 0.0:
            self._carver.place(motion)
        else:
            self._carver.advance(motion)
