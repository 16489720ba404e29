"""Elements of a cutter's surface on a device, and the range of validity of the cutting law."""

from itertools import pairwise
from math import pi, sqrt
from typing import Any

import numpy as np
import warp as wp

from kernels.bricks import corner8f
from kernels.cutting import AREA, cutting_forces
from kernels.elements import CHUNK, LANES, Elements, lanes8
from kernels.engagement import FOUND, Coefficients, find_bone
from kernels.launcher import SplitLaunch
from kernels.mirror import Mirror, put
from kernels.older_cuts import SLOTS
from kernels.revolution import EDGE_BEND
from meshes.base.arrays import Array
from tissue.cutters.cutter import Cutter, PointShell
from tissue.cutters.profile import Line
from tissue.models.bone.bricks import BrickStore
from tissue.models.tissue_model import ToolMotion

__all__ = [
    "THICKEST_M",
    "CuttingForces",
    "LawLimits",
    "RecentPoses",
    "SmoothSurface",
    "edge_lengths_m",
    "elements_of",
    "levers_of",
]

LEVER = [0, 1, 3, 4, 5, 6, 7, 8, 9, 10, 11, 14, 15, 16]
"""Components of the forces and torques of element loads that are not 0 on every element.

The loads are tangential, radial and axial.
"""


def elements_of(shell: PointShell, cutter: Cutter, *, spacing_m: float, device: str) -> Elements:
    """Return the cutter's point shell on a device."""
    elements = Elements()
    elements.point = put(shell.points_m, wp.vec3, device)
    missing = (0, -len(shell.areas_m2) % LANES), (0, 0)  # elements without a normal do not advance
    eights = (
        np.pad(np.hstack([shell.points_m, shell.normals]), missing)
        .reshape(-1, LANES, 6)
        .transpose(0, 2, 1)
    )
    elements.lanes = put(eights, lanes8, device)
    elements.normal = put(shell.normals, wp.vec3, device)
    levers = np.pad(levers_of(shell, cutter)[:, LEVER], missing).reshape(-1, LANES, len(LEVER))
    elements.lever = put(levers.transpose(0, 2, 1), lanes8, device)
    elements.area = put(shell.areas_m2, wp.float32, device)
    elements.areas = put(np.pad(shell.areas_m2, missing[0]).reshape(-1, LANES), lanes8, device)
    bend = cutter.table(spacing_m=spacing_m).bend_at(
        shell.radii_m / spacing_m, shell.points_m[:, 2] / spacing_m
    )
    elements.bend = put(bend, wp.float32, device)
    # see `Revolution`
    curvature = np.where(bend < EDGE_BEND, 3.0 * bend / spacing_m, 0.0)
    elements.curvature = put(np.pad(curvature, missing[0]).reshape(-1, LANES), lanes8, device)
    elements.edge_length = put(edge_lengths_m(shell, cutter), wp.float32, device)
    balls, cones = _chunk_bounds(shell)
    elements.chunk_ball = put(balls, wp.vec4, device)
    elements.chunk_cone = put(cones, wp.vec4, device)
    return elements


def levers_of(shell: PointShell, cutter: Cutter) -> Array:
    """Return the directions of a tangential, a radial and an axial load on each element, (n, 18).

    Each direction is scaled by its load factor, see `Cutter.load_factors`. Each is followed by its
    moment about the tip [m].
    """
    around = np.column_stack(
        [-shell.points_m[:, 1], shell.points_m[:, 0], np.zeros(len(shell.radii_m))]
    )
    around *= np.sign(cutter.spin_rad_s) / shell.radii_m[:, None]
    axis = np.broadcast_to([0.0, 0.0, 1.0], around.shape)
    tangential, radial = cutter.load_factors(shell.radii_m).T[:, :, None]
    parts = [
        part
        for each in (tangential * around, radial * shell.normals, axis)
        for part in (each, np.cross(shell.points_m, each))
    ]
    return np.hstack(parts)


def edge_lengths_m(shell: PointShell, cutter: Cutter) -> Array:
    """Return the mean length of cutting edge in each element, N A / (2 pi r) [m], shape (n,)."""
    return np.asarray(cutter.flute_count * shell.areas_m2 / (2.0 * np.pi * shell.radii_m))


def _chunk_bounds(shell: PointShell) -> tuple[Array, Array]:
    """Return a bounding ball and a cone of normals for each chunk of points.

    Each array has shape (chunks, 4). A ball is its centre and radius [m]. A cone is its axis and
    the sine of its half angle, 2 where it is wider than a half space.
    """
    balls = []
    cones = []
    for start in range(0, len(shell.areas_m2), CHUNK):
        points = shell.points_m[start : start + CHUNK]
        normals = shell.normals[start : start + CHUNK]
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        balls.append([*middle, np.linalg.norm(points - middle, axis=1).max()])
        axis = normals.sum(axis=0)
        # 1e-12: normals of a whole ring add up to zero.
        axis /= max(float(np.linalg.norm(axis)), 1e-12)
        cosine = float((normals @ axis).min())
        cones.append([*axis, np.sqrt(max(1.0 - cosine**2, 0.0)) if cosine > 0.0 else 2.0])
    return np.array(balls), np.array(cones)


THICKEST_M = 1e-4
"""Largest feed per tooth for which the law holds [m].

Cortical bone is sheared at depths of cut of 10 to 50 um and breaks off in pieces above 100 um (Luo
et al. 2022, Chinese Journal of Mechanical Engineering 35).
"""
SMOOTH_ELEMENTS = 500
"""Number of elements over the surface that does not cut; chosen."""
BLOCKED = 0.25
"""Share of the smooth end's area in contact with bone above which it is reported; chosen.

A peg touches the rim of its pilot hole.
"""


RINGS = (12, 4e-6), (24, 2.4e-5)
"""Numbers of the tool's last poses that are kept, and their distances along its path [m].

Together they reach further back than `tissue.models.bone.carver.OLDER_LAG_M`. A tool that returns
on its path meets bone at most a distance too early. Between two poses of a ball of 1 mm, 0.07 um of
bone seem to be left.
"""
ROUNDING = 1e-9
"""Change of the tool's axis up to which it has not turned [rad]: rounding of rotations."""
KEPT_POSES = sum(count for count, _ in RINGS)


class CuttingForces:
    """Cutting forces on the elements of a tool in bone.

    The bone in front of the elements is found once a pose. The forces are then summed, for any
    velocity, over chunks of elements.

    Parameters
    ----------
    store, tool
        Bone, and the tool's distance table on the device.
    elements, coefficients
        Elements of the tool and cutting coefficients on the device.
    pose, recent
        Pose and last poses, as `kernels.engagement.find_bone` reads them.
    motion
        Velocities, as `kernels.cutting.cutting_forces` reads them.
    chip_per_speed_s
        Chip thickness over normal feed speed [s].
    cores
        Processor cores to split large launches over; default all.

    Attributes
    ----------
    found
        Bone in front of the elements, shape (eights, FOUND, LANES).
    find_bone
        Launch of the search on the present arrays of the store.
    slopes
        Place of the derivatives in the sums, see `kernels.cutting.VALUE`.
    """

    def __init__(
        self,
        store: BrickStore,
        tool: Any,
        elements: Elements,
        coefficients: Coefficients,
        pose: Mirror,
        recent: Mirror,
        motion: Mirror,
        *,
        chip_per_speed_s: float,
        cores: int | None,
    ) -> None:
        device = str(pose.device.device)
        self._chunks = len(elements.chunk_ball)
        self.slopes = AREA + len(store.grid.layer_names)
        shape = (self._chunks, self.slopes + 36)
        self._sums = wp.zeros(shape, lanes8, device)
        self.found = wp.zeros((len(elements.lanes), FOUND), lanes8, device)
        self._engaged = wp.full(self._chunks, 1, wp.int32, device)
        self._motion = motion
        self._store = store
        self._given = [tool, elements, coefficients, pose.device, recent.device]
        self._given.append(store.grid.spacing_m)
        self._scratch = wp.zeros((self._chunks, SLOTS + 1), corner8f, device)
        self._cores = cores
        given = [elements, coefficients, self.found, self._engaged]
        self._sum = SplitLaunch(
            cutting_forces,
            dim=self._chunks,
            inputs=[*given, motion.device, chip_per_speed_s, 0],
            outputs=[self._sums],
            cores=cores,
            offset_index=len(given) + 2,
        )
        self.record()

    def record(self) -> None:
        """Record the search on the present arrays of the store."""
        self.find_bone = SplitLaunch(
            find_bone,
            dim=self._chunks,
            inputs=[*self._given, 0, *self._store.read_by_forces],
            outputs=[self._scratch, self.found, self._engaged],
            offset_index=len(self._given),
            cores=self._cores,
        )

    def sums(self) -> Array:
        """Return the sums over all elements at the present velocities."""
        self._sum()
        rows = self.slopes + 6 * int(self._motion.host[4, 0])
        parts = self._sums.numpy()[self._engaged.numpy() != 0, :rows]
        return np.asarray(np.add.reduce(np.add.reduce(parts, axis=0, dtype=np.float64), axis=-1))


class RecentPoses:
    """Last poses of a tool that has cut.

    The bone that the tool has cut at these poses is known to rounding.

    Parameters
    ----------
    lever_m
        Distance of the tool's far end from its tip [m].
    device
        Warp device name.

    Attributes
    ----------
    mirror
        Displacements and rotations, as `kernels.engagement.find_bone` reads them.
    """

    def __init__(self, lever_m: float, *, device: str) -> None:
        self._tips = np.zeros((KEPT_POSES, 3))
        self._rotations = np.tile(np.eye(3), (KEPT_POSES, 1, 1))
        self._lever = lever_m
        # place of the last pose of each ring, and of its first and beyond its last pose
        ends = np.cumsum([0, *(count for count, _ in RINGS)]).tolist()
        self._rings = [[first, first, last] for first, last in pairwise(ends)]
        self.turns = False
        self._moved = np.zeros((KEPT_POSES, 3))
        self.mirror = Mirror((1 + KEPT_POSES, 6), dtype=wp.float32, device=device)

    def place(self, motion: ToolMotion) -> None:
        """Start at a pose."""
        self._tips[:] = motion.tip_m
        self._rotations[:] = motion.rotation
        self.turns = False

    def add(self, motion: ToolMotion) -> None:
        """Add a pose at which the tool has cut.

        The first place of a ring holds the present pose, which the next pose replaces unless it is
        far enough from the pose before.
        """
        for ring, (_, spaced_m) in zip(self._rings, RINGS, strict=True):
            now, first, end = ring
            last = now - 1 if now > first else end - 1
            moved = motion.tip_m - self._tips[last]
            travel = sqrt(moved.dot(moved))
            # A rotation about the tool's axis moves its surface into itself.
            turned = motion.rotation[:, 2] - self._rotations[last, :, 2]
            turn = sqrt(turned.dot(turned))
            if turn > ROUNDING:
                self.turns = True
                travel += self._lever * turn
            self._tips[now] = motion.tip_m
            self._rotations[now] = motion.rotation
            if travel >= spaced_m:
                ring[0] = now + 1 if now + 1 < end else first
                self._tips[ring[0]] = motion.tip_m
                self._rotations[ring[0]] = motion.rotation

    def seen_from(self, tip_m: Array, rotation: Array) -> None:
        """Write the displacements from a pose to `mirror`, the present pose first."""
        rows = self.mirror.host
        np.dot(self._tips - tip_m, rotation, out=self._moved)
        rows[1:, :3] = self._moved
        if self.turns:
            axes = self._rotations[:, :, 2] @ rotation
            # The smallest rotation that turns the axis. A further one about the axis moves the
            # surface into itself.
            rows[1:, 3] = -axes[:, 1]
            rows[1:, 4] = axes[:, 0]
        rows[0] = rows[1 + self._rings[0][0]]
        self.mirror.push()


CREEP_M_S = 5e-5
"""Speed at which an element of a held tool has its full edge force at the latest [m/s]; chosen.

A tool that rests against part of its edge force creeps at this part of the speed.
"""
SINK_M_S = 2e-3
"""Speed at which a smooth surface has its full pressure [m/s]; chosen.

A peg of 10 mm2 in contact sinks by 4 um/s under 10 N. At a fortieth of this speed, the balance is
not found in some ticks.
"""
HARDNESS_Pa = 5e8
"""Pressure under which a smooth surface sinks into bone of the reference density [Pa].

Hardness of wet bone, 0.3 to 0.7 GPa, from memory of Zysset et al. 1999 (doi
10.1016/S0021-9290(99)00111-6), whose summary has moduli only: confidence L. Smooth surfaces of
tools carry far less than this pressure.
"""
FRICTION = 0.3
"""Coulomb's coefficient of smooth metal on bone, as in `tissue.haptics.proxy.probing_tool`."""


class SmoothSurface:
    """Tool's surface that does not cut.

    On a given path, its area in bone is measured. A held tool is pushed back by it, as by a rigid
    and plastic body.

    Parameters
    ----------
    cutter, store
        Tool and bone.
    tool
        The tool's distance table on the device.
    pose, recent, motion
        See `CuttingForces`.
    strength
        Strength of each layer over its density, see `Coefficients`.
    """

    def __init__(
        self,
        cutter: Cutter,
        store: BrickStore,
        tool: Any,
        pose: Mirror,
        recent: Mirror,
        motion: Mirror,
        strength: Any,
    ) -> None:
        pieces = [piece for piece in cutter.profile.pieces if not piece.cutting]
        total_m2 = sum(piece.area_m2 for piece in pieces)
        shell = cutter.smooth_shell(spacing_m=(total_m2 / SMOOTH_ELEMENTS) ** 0.5)
        ends = [
            piece for piece in pieces if isinstance(piece, Line) and piece.start[1] == piece.end[1]
        ]
        radii = [max(piece.start[0], piece.end[0]) for piece in ends]
        # The smallest end counts: a peg is narrow compared with the top of its tool.
        self.blocked_m2 = BLOCKED * min([total_m2, *(pi * radius**2 for radius in radii)])
        device = str(pose.device.device)
        layers = len(store.grid.layer_names)
        elements = elements_of(shell, cutter, spacing_m=store.grid.spacing_m, device=device)
        # A pressure takes the place of a force per length of edge.
        elements.edge_length = elements.area
        rubbing = Coefficients()
        rubbing.chip = wp.zeros(layers, wp.vec3, device)
        pressure = [FRICTION * HARDNESS_Pa * (cutter.spin_rad_s != 0.0), HARDNESS_Pa, 0.0]
        rubbing.edge = put(np.tile(pressure, (layers, 1)), wp.vec3, device)
        rubbing.strength = strength
        rubbing.size = put(np.tile([0.0, SINK_M_S, 1.0], (layers, 1)), wp.vec3, device)
        # The velocity takes the place of the chip thickness.
        self.forces = CuttingForces(
            store, tool, elements, rubbing, pose, recent, motion, chip_per_speed_s=1.0, cores=1
        )

    @property
    def is_blocked(self) -> bool:
        """True if too much of the surface is pushed into bone, so that a force is missing."""
        self.forces.find_bone()
        return float(self.forces.sums()[AREA : self.forces.slopes].sum()) > self.blocked_m2


class LawLimits:
    """Check of the feed per tooth and of the smooth surface of a tool in bone, at every answer.

    Parameters
    ----------
    cutter
        The tool.
    smooth
        Its surface that does not cut; None without such a surface.

    Attributes
    ----------
    notices
        A sentence at the first time that each limit is passed; the loop removes them as it logs
        them.
    passed
        All these sentences, by subject.
    thickest_m
        Largest feed per tooth in bone so far [m].
    """

    def __init__(self, cutter: Cutter, smooth: SmoothSurface | None) -> None:
        self._cutter = cutter
        self._smooth = smooth
        self.notices: list[str] = []
        self.passed: dict[str, str] = {}
        self.thickest_m = 0.0

    def restart(self) -> None:
        """Reset the limits that were passed."""
        self.notices.clear()
        self.passed.clear()
        self.thickest_m = 0.0

    def record(self) -> None:
        """Record launches anew, after the store's arrays have grown."""
        if self._smooth is not None:
            self._smooth.forces.record()

    def check(self, motion: ToolMotion, engaged_m2: float, *, is_new: bool) -> None:
        """Check one answer.

        `is_new` is True if the tool or the bone has changed since the last answer.
        """
        # A tool at rest takes no chip and does not advance into bone.
        if motion.speed_m_s == 0.0:
            return
        if engaged_m2 > 0.0:
            feed_m_s = motion.speed_m_s * float(np.linalg.norm(motion.heading[0]))
            self.thickest_m = max(self.thickest_m, feed_m_s * self._cutter.chip_per_speed_s)
            if self.thickest_m > THICKEST_M and "chips" not in self.passed:
                self._pass(
                    "chips",
                    f"the feed of {1e3 * feed_m_s:.3g} mm/s is {1e3 * self.thickest_m:.2g} "
                    "mm per tooth, but the "
                    f"cutting law holds up to {1e3 * THICKEST_M:g} mm: forces are "
                    "extrapolated. Use a slower feed or "
                    "a higher speed of the tool",
                )
        if (
            is_new
            and self._smooth is not None
            and "smooth surface" not in self.passed
            and self._smooth.is_blocked
        ):
            self._pass(
                "smooth surface",
                "a smooth part of the tool, such as its peg, is pushed into bone, which it "
                "cannot cut: no force is "
                "computed for it. Drill a pilot hole for the peg, or lead the tool elsewhere",
            )

    def _pass(self, about: str, sentence: str) -> None:
        """Record a limit that is passed."""
        self.passed[about] = sentence
        self.notices.append(sentence)
