"""Contact fields for a rigid tool: bone in voxels, and exact half-spaces, boxes and balls.

The voxels are read in place, in the store that a cutter carves. No copy has to be updated, see
:mod:`kernels.voxmap`. A deformable organ is not part of such a field. Its contact moves both the
surface and the tool, and is solved with the compliance of the organ. There, the tool itself is the
proxy.
"""

from dataclasses import dataclass, field
from math import ceil, sqrt

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from kernels.voxmap import BALL, BOX, CELL, HALF_SPACE, SURFACE, Field, field_distance
from meshes.base.arrays import Array
from tissue.cutters.cutter import Cutter
from tissue.models.bone.bricks import BrickStore

__all__ = ["Ball", "Box", "ContactField", "HalfSpace", "Solid", "ToolShell"]

FELT_VOXELS = 0.5 * sqrt(3.0)
"""Largest distance from a voxel at which its trilinear fraction is not zero [voxel]."""
NOWHERE_M = 1e30


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """Half-space behind a plane.

    Attributes
    ----------
    point_m
        Point of the plane [m], shape (3,).
    normal
        Outward direction, shape (3,), of any length except 0.
    """

    point_m: Array
    normal: Array


@dataclass(frozen=True, eq=False)
class Box:
    """Box.

    Attributes
    ----------
    centre_m
        Centre of the box [m], shape (3,).
    size_m
        Edge lengths [m], shape (3,).
    rotation
        Rotation from box to world, shape (3, 3).
    """

    centre_m: Array
    size_m: Array
    rotation: Array = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class Ball:
    """Ball with centre ``centre_m`` [m], shape (3,), and radius ``radius_m`` [m]."""

    centre_m: Array
    radius_m: float


Solid = HalfSpace | Box | Ball


class ContactField:
    """Solids, and optionally the bone in a store, as arrays for the proxy kernels.

    Parameters
    ----------
    *solids
        Exact convex solids. A concave object consists of several solids: an inner corner is two
        half-spaces.
    store
        Bone that may be carved during contact. Its surface is where the trilinear fraction is 1/4,
        about a quarter of a voxel outside the true surface. A tool with normals corrects for this
        offset; see :mod:`kernels.voxmap`.
    device
        Warp device name; the device of a store takes precedence.
    """

    def __init__(
        self, *solids: Solid, store: BrickStore | None = None, device: str = "cpu"
    ) -> None:
        self.device = str(store.remaining.device) if store is not None else device
        self.spacing_m = store.grid.spacing_m if store is not None else 0.0
        self.sink_m = (0.5 - SURFACE) * self.spacing_m
        """Offset of shell points into the tool [m]."""
        self.solid_count = len(solids)
        arrays = Field()
        kinds, centres, turns, sizes = (
            zip(*map(_solid, solids), strict=True) if solids else ((), (), (), ())
        )
        arrays.kind = wp.array(kinds, dtype=wp.int32, device=self.device)
        arrays.centre = wp.array(np.reshape(centres, (-1, 3)), dtype=wp.vec3d, device=self.device)
        arrays.turn = wp.array(np.reshape(turns, (-1, 3, 3)), dtype=wp.mat33d, device=self.device)
        arrays.size = wp.array(np.reshape(sizes, (-1, 3)), dtype=wp.vec3d, device=self.device)
        arrays.spacing = wp.float64(self.spacing_m)
        if store is not None:
            arrays.voxels_per_m = wp.float64(1.0 / self.spacing_m)
            arrays.brick_of = store.brick_of
            arrays.remaining = store.remaining
            arrays.origin = wp.vec3d(*store.grid.origin_m.tolist())
            clearance = _clearance(store.fraction() > 0, self.spacing_m)
            arrays.clearance = wp.array(clearance, dtype=wp.float32, device=self.device)
        self.arrays = arrays

    def distance(self, points_m: Array) -> tuple[Array, Array]:
        """Return distances to the nearest solid [m] and outward directions at points.

        The shapes are (n,) for distances, and (n, 3) for directions and points. The distances are
        exact for solids. For voxels, the distance to the contact surface is first-order accurate
        within half a voxel of it. Farther away, it is a lower bound and the direction is (0, 0, 0).
        """
        points = np.ascontiguousarray(points_m, dtype=np.float64)
        distance = wp.zeros(len(points), dtype=wp.float64, device=self.device)
        normal = wp.zeros(len(points), dtype=wp.vec3d, device=self.device)
        at: wp.array[object] = wp.array(points, dtype=wp.vec3d, device=self.device)
        wp.launch(
            field_distance,
            dim=len(points),
            inputs=[at, self.arrays],
            outputs=[distance, normal],
            device=self.device,
        )
        return distance.numpy(), normal.numpy()


def _solid(solid: Solid) -> tuple[int, Array, Array, Array]:
    """Return kind, centre, rotation and size of a solid for the kernels."""
    match solid:
        case HalfSpace():
            z = np.asarray(solid.normal, dtype=np.float64) / np.linalg.norm(solid.normal)
            helper = np.eye(3)[int(np.argmin(np.abs(z)))]
            x = helper - z * (helper @ z)
            x /= np.linalg.norm(x)
            return HALF_SPACE, solid.point_m, np.column_stack([x, np.cross(z, x), z]), np.zeros(3)
        case Box():
            return BOX, solid.centre_m, solid.rotation, 0.5 * np.asarray(solid.size_m)
        case Ball():
            return BALL, solid.centre_m, np.eye(3), np.full(3, solid.radius_m)


def _clearance(holds: NDArray[np.bool_], spacing_m: float) -> NDArray[np.float32]:
    """Return a lower bound of the distance from cells of voxels to the contact range of bone [m].

    The bound holds anywhere in each cell.
    """
    counts = [ceil(n / CELL) for n in holds.shape]
    padded = np.pad(
        holds, [(0, CELL * count - n) for count, n in zip(counts, holds.shape, strict=True)]
    )
    x, y, z = counts
    full = padded.reshape(x, CELL, y, CELL, z, CELL).any(axis=(1, 3, 5))
    if not full.any():
        return np.full(counts, NOWHERE_M, dtype=np.float32)
    cells = distance_transform_edt(~full) - sqrt(3.0)
    return np.maximum(spacing_m * (CELL * cells - FELT_VOXELS), 0.0).astype(np.float32)


@dataclass(frozen=True, eq=False)
class ToolShell:
    """Surface points of a tool in its own frame: origin at the tip, z from tip to shank.

    Attributes
    ----------
    points_m
        Positions [m], shape (n, 3).
    normals
        Outward unit normals, shape (n, 3); zero where a point has no normal.
    radius_m
        Radius of a ball around every point [m]. A tool of several balls is exact on solids. Voxels
        are tested only against points.
    """

    points_m: Array
    normals: Array
    radius_m: float = 0.0

    @classmethod
    def ball(
        cls, radius_m: float = 0.0, *, centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> "ToolShell":
        """Return one exact ball of ``radius_m`` [m].

        With radius 0, it is the point of the classical god-object.
        """
        return cls(np.array([centre_m], dtype=np.float64), np.zeros((1, 3)), radius_m)

    @classmethod
    def of_cutter(cls, cutter: Cutter, *, point_count: int = 700) -> "ToolShell":
        """Return about ``point_count`` points over the cutting surface of a cutter."""
        shell = cutter.shell(spacing_m=(cutter.cutting_area_m2 / point_count) ** 0.5)
        return cls(shell.points_m, shell.normals)

    @property
    def reach_m(self) -> float:
        """Largest distance of the surface from the tool's origin [m]."""
        return float(np.linalg.norm(self.points_m, axis=1).max()) + self.radius_m
