"""Cutting elements, the small parts of a cutter's surface, and the cutting forces on them."""

from typing import Any

import numpy as np
import warp as wp

from kernels.bricks import corner8f
from kernels.cutting import AREA, cutting_forces
from kernels.elements import CHUNK, LANES, Elements, lanes8
from kernels.engagement import FOUND, Coefficients, find_bone
from kernels.launcher import SplitLaunch
from kernels.mirror import Mirror, filled
from kernels.older_cuts import SLOTS
from kernels.revolution import EDGE_BEND
from meshes.base.arrays import Array
from tissue.cutters.cutter import Cutter, PointShell
from tissue.models.bone.bricks import BrickStore


def elements_of(shell: PointShell, cutter: Cutter, *, spacing_m: float, device: str) -> Elements:
    """Return the cutting elements (points on the cutter's surface) as device arrays."""
    bend = cutter.table(spacing_m=spacing_m).bend_at(
        shell.radii_m / spacing_m, shell.points_m[:, 2] / spacing_m
    )
    # see `Revolution`
    curvature = np.where(bend < EDGE_BEND, 3.0 * bend / spacing_m, 0.0)
    balls, cones = _chunk_bounds(shell)
    return filled(
        Elements,
        device,
        point=shell.points_m,
        lanes=_in_lanes(np.hstack([shell.points_m, shell.normals])),
        normal=shell.normals,
        lever=_in_lanes(levers_of(shell, cutter)),
        area=shell.areas_m2,
        areas=_in_lanes(shell.areas_m2[:, None])[:, 0],
        bend=bend,
        curvature=_in_lanes(curvature[:, None])[:, 0],
        edge_length=edge_lengths_m(shell, cutter),
        chunk_ball=balls,
        chunk_cone=cones,
    )


def _in_lanes(rows: Array) -> Array:
    """Arrange values of cutting elements, shape (n, k), in lanes, shape (groups, k, LANES).

    The last group is filled up with zeros. The added elements do not cut, because their normal is
    zero.
    """
    padded = np.pad(rows, ((0, -len(rows) % LANES), (0, 0)))
    return padded.reshape(-1, LANES, rows.shape[1]).transpose(0, 2, 1)


def levers_of(shell: PointShell, cutter: Cutter) -> Array:
    """Return direction and moment of the three loads on each cutting element, shape (n, 18).

    The loads are tangential, radial and axial. Each direction is multiplied by its load factor
    (`Cutter.load_factors`), and is followed by the moment of this product about the tip [m].
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
    """Return the mean length of cutting edge in each cutting element [m], shape (n,).

    The length is N A / (2 pi r), with N flutes, and the element's area A and distance r from the
    axis.
    """
    return cutter.flute_count * shell.areas_m2 / (2.0 * np.pi * shell.radii_m)


def _chunk_bounds(shell: PointShell) -> tuple[Array, Array]:
    """Return a bounding ball and a cone of normals for each chunk of `CHUNK` successive points.

    Each array has shape (chunks, 4). A ball has a centre and a radius [m]. A cone has an axis and
    the sine of its half angle; the sine is set to 2 if the cone is wider than a half space.
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


CREEP_M_S = 5e-5
"""Speed at which a cutting element of a tool on a haptic device reaches its full edge force [m/s].

The value is chosen. Below this speed the edge force is proportional to the speed. A tool that is
pressed with half of its full edge force therefore moves at half of this speed.
"""


class CuttingForces:
    """Cutting forces that bone exerts on the elements of a tool.

    `find_bone` searches for bone in front of the elements, once for each pose. `sums` then computes
    the forces for any velocity.

    Parameters
    ----------
    store, tool
        Voxels of the bone, and the tool's distance table on the device.
    elements, coefficients
        The tool's cutting elements and the cutting coefficients, with arrays on the device.
    pose, recent
        Present pose and most recent poses of the tool, in the layout that
        `kernels.engagement.find_bone` reads.
    motion
        Velocities of the tool, in the layout that `kernels.cutting.cutting_forces` reads.
    chip_per_speed_s
        Chip thickness divided by the feed velocity's component along the surface normal [s].
    cores
        Number of processor cores that share large kernel launches; default: all cores.

    Attributes
    ----------
    found
        Values that describe the bone in front of the cutting elements, shape (groups, FOUND,
        LANES). A group has LANES elements; `kernels.engagement.FOUND` is the number of values of an
        element.
    find_bone
        Recorded kernel launch that searches for bone in front of the elements.
    slopes
        Index at which the derivatives begin in the array that `sums` returns, see
        `kernels.cutting.VALUE`.
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
        # 36: derivatives of force and torque by six unknowns
        shape = (self._chunks, self.slopes + 36)
        self._sums = Mirror(shape, wp.float64, device)
        lanes = wp.zeros(shape, lanes8, device)
        groups = len(elements.lanes)
        self.found = wp.zeros((groups, FOUND, LANES), wp.float32, device)
        # the same memory, as rows of eight elements
        rows: Any = wp.array(ptr=self.found.ptr, dtype=lanes8, shape=(groups, FOUND), device=device)
        self._engaged = Mirror(self._chunks, wp.float64, device)
        # The value 1 makes the first search write the widths of all elements.
        self._engaged.device.fill_(1)
        self._motion = motion
        self._store = store
        self._given = [
            tool,
            elements,
            coefficients,
            pose.device,
            recent.device,
            store.grid.spacing_m,
        ]
        self._scratch = wp.zeros((self._chunks, SLOTS + 1), corner8f, device)
        self._cores = cores
        given = [elements, coefficients, rows, self._engaged.device]
        self._sum = SplitLaunch(
            cutting_forces,
            self._chunks,
            [*given, motion.device, chip_per_speed_s],
            [lanes, self._sums.device],
            cores=cores,
        )
        self.record()

    def record(self) -> None:
        """Record the search kernel for the present device arrays of the store."""
        self.find_bone = SplitLaunch(
            find_bone,
            self._chunks,
            [*self._given, self._store.on_device],
            [self._scratch, self.found, self._engaged.device],
            cores=self._cores,
        )

    def sums(self) -> Array:
        """Return the forces and their derivatives, summed over all elements.

        The derivatives are with respect to the velocity, and all values hold for the present
        velocities. The order of the values is given at `kernels.cutting.VALUE`.
        """
        self._engaged.pull()
        engaged = self._engaged.host
        rows = self.slopes + 6 * int(self._motion.host[4, 0])
        if not engaged.any():
            return np.zeros(rows)
        self._sum()
        self._sums.pull()
        # Chunks without bone have the factor 0.
        return engaged @ self._sums.host[:, :rows]
