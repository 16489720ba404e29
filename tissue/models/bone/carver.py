"""Removal of the bone that a moving tool reaches, during a run and in its replay.

The poses of the tool determine the bone at any tick of a run. A replay carves the bone at these
poses again, with the kernel of the run. The bone of the replay is bitwise equal to the bone of the
run. The bricks (blocks of 8 x 8 x 8 voxels) are divided into groups. In each tick, the bricks of
the next few groups are carved at the present pose.
"""

from math import ceil, sqrt
from typing import Literal

import numpy as np
import warp as wp

from kernels.bricks import BRICK, FULL
from kernels.carving import (
    ALONG_X,
    ALONG_Y,
    BINARY,
    COUNT,
    EVERY_SIDE,
    FIRST,
    MOVED,
    ORIGIN,
    PHASES,
    PLAN,
    TURNED,
    carve,
)
from kernels.launcher import SplitLaunch
from kernels.mirror import Mirror, filled
from kernels.revolution import Revolution
from meshes.base.arrays import Array, Bytes, Ints
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter, DistanceTable
from tissue.cutters.profile import Profile
from tissue.models.bone.bricks import BrickStore, voxels_of
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import ToolMotion

Removal = Literal["subvoxel", "binary"]

CARVE_LAG_M = 2.0e-5
"""Largest motion of the tool between two carvings of the same brick [m]; chosen.

The motion is also limited to a quarter of a voxel. For a fast tool, the limit is `FAST_LAG_VOXELS`.
The delay of the carving hardly changes the force, see `STEADY_GROUPS`.
"""
STEADY_GROUPS = 16
"""Largest number of groups of bricks that are carved in a tick for a slow tool; chosen.

For a fast tool, the number follows from `FAST_LAG_VOXELS`. Carving one group takes 20 us in the
scene `pedicle`. At a speed of 16 mm/s, `CARVE_LAG_M` requires 25 groups a tick. The reference is
the force if all groups are carved in every tick. In the first 2.5 s of `pedicle`, with a simulated
expert on a Touch device, the RMS difference from the reference is 0.05 % with 25 groups, 0.12 %
with 16 groups and 0.15 % with 12 groups. In the scene `milling` the differences are 0.012 % (25
groups), 0.007 % (16) and 0.006 % (12).
"""
FAST_LAG_VOXELS = 0.4
"""Largest motion of a fast tool between two carvings of the same brick [voxel]; chosen.

A ball with a radius of 10 voxels that is carved at poses this far apart leaves ridges with a height
of 0.002 voxel. This is a fifth of `kernels.older_cuts.RAMP`.
"""
LONGEST_STEP_VOXELS = 0.5
"""Longest motion between two carved poses [voxel]; a longer motion in a tick is divided."""
OLDER_LAG_M = 2.5e-4
"""Motion of the tool between two updates of the older cuts [m]; chosen.

Older cuts are all cuts except the most recent cuts, see `kernels.carving`. The poses that are
stored in `RecentPoses` must cover a longer motion than this value.
"""
TURN = 0.9
"""Cosine of the smallest angle that counts as a change of direction (26 degrees); chosen.

After such a change, the tool may return to places where it has already cut. The most recent cuts
therefore become older cuts. With a larger value, they do so after smaller changes of direction.
"""
WORKERS_CPU = 32
WORKERS_GPU = 2048
"""Number of GPU workers that share one launch of the carving kernel; it affects only the speed."""


STATE = ("_motions", "_marks", "_travelled", "_turned", "_next_group", "_debt", "_behind")
"""Names of the attributes that a copied state contains in addition to bricks and poses."""


class Carver:
    """Cutter that removes voxels of a brick store.

    Parameters
    ----------
    store
        The bone.
    cutter
        The tool.
    removal
        ``subvoxel`` removes the part of a voxel that is inside the tool. ``binary`` removes each
        voxel whose centre is inside the tool.
    device
        Warp device name.
    cores
        Number of processor cores that share large kernel launches; default: all cores. The result
        does not depend on the number of cores.

    Attributes
    ----------
    tool
        The cutter's distance table on the device.
    removed_steps
        Amount by which the sum of `BrickStore.remaining` in each layer has decreased so far, shape
        (layers,).
    changes
        Counter that increases when bricks are carved or a state is restored. While the counter is
        constant, the bone does not change.
    """

    def __init__(
        self,
        store: BrickStore,
        cutter: Cutter,
        *,
        removal: Removal,
        device: str,
        cores: int | None = None,
    ) -> None:
        grid = store.grid
        layers = len(grid.layer_names)
        spacing = grid.spacing_m
        store.begin(self)
        self.store = store
        self.removed_steps = np.zeros(layers, np.int64)
        self.changes = 0
        self._binary = int(removal == "binary")
        self._origin = grid.origin_m
        self._spacing = spacing
        table = cutter.table(spacing_m=spacing)
        self.tool = _revolution(table, cutter.profile, device=device)
        self._lag = min(CARVE_LAG_M / spacing, 0.25)
        self._older_lag = OLDER_LAG_M / spacing
        # motion of tip [voxel] and axis of each group at its last change of direction
        self._motions = np.zeros((PHASES, 6))
        # travel of the tool so far, and at the time the cuts in each group last became older cuts
        # [voxel]
        self._travelled = 0.0
        self._marks = np.zeros(PHASES)
        # True for groups whose cuts last became older cuts at a change of direction
        self._turned = np.zeros(PHASES, bool)
        # A turn moves the far end of the tool most.
        self._lever = max(abs(table.low), abs(table.high))
        self._next_group = 0
        # The groups are fixed in the world frame. The same cut in a larger region of voxels is
        # therefore visited at the same ticks.
        factors = ALONG_X, ALONG_Y, 1
        self._first_group = int(np.rint(self._origin / (BRICK * spacing)) @ factors) % PHASES
        self._debt = 0.0  # visits that are due for the path so far
        self._behind = 0  # groups not visited at the present pose
        self._now = np.zeros(6)
        workers = WORKERS_CPU if device == "cpu" else WORKERS_GPU
        self._pose = Mirror((1 + 2 * PHASES, 2), wp.vec3d, device)
        self._poses: Array = self._pose.host.reshape(-1, 6)
        self._plan = Mirror(PLAN, wp.int64, device)
        self._removed = Mirror((workers, layers), wp.int64, device)
        self._workers = workers
        self._cores = cores
        self.record()

    def record(self) -> None:
        """Record the launch of the carving kernel with the store's present device arrays."""
        self._carve = SplitLaunch(
            carve,
            self._workers,
            [self.tool, self._pose.device, self._plan.device, self._workers],
            [self.store.on_device, self._removed.device],
            device=str(self._pose.device.device),
            cores=self._cores,
        )

    def place(self, motion: ToolMotion) -> None:
        """Carve all bone inside the tool at its first pose."""
        self._poses[:] = self._pose_of(motion)
        self._motions[:] = 0.0
        self._marks[:] = self._travelled
        self._turned[:] = False
        self._visit(PHASES, every_side=True)

    def advance(self, motion: ToolMotion) -> None:
        """Carve the bone that the tool reaches at its new pose.

        If the tool is slow, the carving is spread over several ticks.
        """
        now = self._pose_of(motion)
        step = self._distance(now, self._poses[0])
        self._travelled += step
        if step > LONGEST_STEP_VOXELS:
            self._sweep(now, parts=ceil(step / LONGEST_STEP_VOXELS))
        elif step > 0.0:
            self._poses[0] = now
            self._behind = PHASES
            self._debt = min(self._debt + PHASES * step / self._lag, PHASES)
            most = max(STEADY_GROUPS, ceil(PHASES * step / FAST_LAG_VOXELS))
            groups = min(int(self._debt), most)
            if groups > 0:
                self._visit(groups)
        elif self._behind > 0:
            self._visit(1)  # at rest: visit the remaining groups, one a tick

    def _distance(self, one: Array, other: Array) -> float:
        """Return an upper bound of the motion of the tool's points between two poses [voxel]."""
        moved = one - other
        return sqrt(moved[:3].dot(moved[:3])) + self._lever * sqrt(moved[3:].dot(moved[3:]))

    def _turns(self, group: int, motion: Array) -> bool:
        """Return True if a motion differs in direction from the stored motion of a group of bricks.

        The stored motion is the motion after the last change of direction, see `TURN`.
        """
        before = self._motions[group]
        travelled = self._travelled - self._marks[group]
        return float(motion.dot(before)) <= TURN * travelled * sqrt(before.dot(before))

    def _pose_of(self, motion: ToolMotion) -> Array:
        """Return tip [voxel] and axis of a motion, in an array that the next call overwrites."""
        now = self._now
        np.subtract(motion.tip_m, self._origin, out=now[:3])
        now[:3] /= self._spacing
        now[3:] = motion.rotation[:, 2]
        return now

    def _sweep(self, now: Array, *, parts: int) -> None:
        """Carve the bone at `parts` poses on the path of a fast tool, up to the pose `now`."""
        before = self._poses[0].copy()
        for part in range(1, parts + 1):
            pose = before + part / parts * (now - before)
            # An axis interpolated between two unit axes is shorter than 1.
            pose[3:] /= np.linalg.norm(pose[3:])
            self._poses[0] = pose
            self._visit(PHASES)

    def finish(self) -> None:
        """Complete the carving that was postponed to later ticks."""
        if self._behind > 0:
            self._visit(PHASES)

    def state(self) -> State:
        """Return a copy of the cutter's state for `restore`."""
        poses = self._poses.copy()
        return {"bricks": self.store.state(self), "poses": poses, "own": copied(self, STATE)}

    def restore(self, state: State) -> None:
        """Restore a state that `state` has returned; `removed_steps` keeps its present value."""
        self.store.restore(state["bricks"], self)
        self.changes += 1
        self._poses[:] = state["poses"]
        put_back(self, state["own"])

    def _visit(self, groups: int, *, every_side: bool = False) -> None:
        """Carve the next groups of bricks at the present pose, and add up the removed material."""
        self.changes += 1
        first = self._next_group
        poses = self._poses
        visited = [(first + visit) % PHASES for visit in range(groups)]
        older = poses[1 + PHASES :]
        moved = [g for g in visited if self._travelled - self._marks[g] >= self._older_lag]
        turned = [g for g in moved if self._turns(g, poses[0] - older[g])]
        plan = self._plan.host
        plan[FIRST] = first
        plan[COUNT] = groups
        plan[BINARY] = self._binary
        plan[EVERY_SIDE] = every_side
        plan[MOVED] = sum(1 << group for group in moved)
        # The cuts just before a change of direction become older cuts the next time that the group
        # moved far enough.
        plan[TURNED] = sum(1 << group for group in moved if group in turned or self._turned[group])
        plan[ORIGIN] = self._first_group
        self._plan.push()
        self._pose.push()
        self._carve()
        self._removed.pull()
        self.removed_steps += np.add.reduce(self._removed.host, axis=0)
        for group in visited:
            poses[1 + group] = poses[0]
        for group in turned:
            self._motions[group] = poses[0] - older[group]
        for group in moved:
            older[group] = poses[0]
            self._marks[group] = self._travelled
            self._turned[group] = group in turned
        self._next_group = (first + groups) % PHASES
        # After a visit of all groups no visit is due.
        self._debt = 0.0 if groups == PHASES else max(self._debt - groups, 0.0)
        self._behind -= min(groups, self._behind)


def _revolution(table: DistanceTable, profile: Profile, *, device: str) -> Revolution:
    """Return the cutter's distance table on a device."""
    form = {"convex": int(profile.convex), "round": int(len(profile.pieces) == 1)}
    return filled(Revolution, device, **vars(table), **form)


class CarvingReplay:
    """Bone at the end of any tick of a finished run, computed by carving again.

    The bone is carved at the poses of the run.

    Parameters
    ----------
    volume
        The bone before the first cut.
    cutter, removal
        The tool, and the mode of removal (see `Carver`).
    poses
        Poses of the run, see `tissue.simulation.loop.PoseLog`.
    device
        Warp device name. With the device name of the run, the bone is bitwise equal to the bone of
        the run.

    Attributes
    ----------
    fraction
        Remaining fraction of every voxel (255 is full) at the tick of the last call of `at`, uint8,
        shape (nx, ny, nz). Every call of `at` overwrites the array.
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
        # True for bricks whose part of `fraction` is out of date
        self._changed = np.zeros(0, np.intp)
        self._cut = np.zeros(0, np.intp)  # True for bricks that differ from the start

    def at(self, tick: int) -> Bytes:
        """Return the remaining fraction of every voxel at the end of a tick, see `fraction`.

        If the tick is earlier than in the last call, the replay restarts at the first pose.
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
        """Return the voxels that become less than half full in the run, and the tick of each.

        The indices of the voxels have shape (n, 3). The ticks have shape (n,) and increase. Voxels
        that were less than half full before the first cut are not included. Carving may lag behind
        a slow tool. A removal may therefore be recorded late: the tool may have moved on by up to
        20 µm.
        """
        self._carver.restore(self._start)
        self._store.take_touched()
        below = self._store.remaining.numpy()[: len(self._store.places)] <= FULL // 2
        found = [np.zeros((0, 3), np.int64)]
        ticks = [np.zeros(0, np.int64)]

        def take(tick: int) -> None:
            """Record the voxels that have fallen below half since the last call."""
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
        if pose[0] < 0.0:
            self._carver.place(motion)
        else:
            self._carver.advance(motion)
