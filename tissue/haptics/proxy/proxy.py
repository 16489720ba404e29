"""God-object (proxy): pose of a tool that follows a device without penetrating solids.

The proxy has three or six degrees of freedom. The device follows the hand and may enter solids, but
the proxy stays outside. The coupling between device and proxy gives the force on the hand; see
`tissue.haptics.renderer.ProxyRenderer`. At the pose of the proxy, the coupling springs and the
contact forces are in static equilibrium. The proxy moves to this pose in small steps from its last
pose, and each step reduces the energy of the springs. In contrast, a search for the free point
nearest to the device could end on the far side of a thin wall.
"""

from dataclasses import dataclass, field
from math import ceil, isfinite, sqrt

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from kernels.mirror import Mirror
from kernels.proxy import (
    CENTRE,
    CONVERGED,
    FORCE,
    MOMENT,
    POSITION,
    PRESSING,
    REPORT,
    ROTATION,
    STATE,
    TRAVEL,
    advance_proxy,
)
from kernels.proxy_contacts import VOXEL_PLANES, Contacts, Shell
from kernels.proxy_descent import DescentSettings
from kernels.proxy_forces import MEMBERS
from kernels.voxmap import BALL, BOX, CELL, HALF_SPACE, SURFACE, Field
from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.cutters.cutter import Cutter
from tissue.models.bone.bricks import BrickStore

FELT_VOXELS = 0.5 * sqrt(3.0)
"""Largest distance from a voxel at which its trilinear fraction is not zero [voxel]."""
NOWHERE_M = 1e30
"""Distance to bone if there is no bone at all [m]; the number is finite in single precision."""


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
    """Solid box.

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
    """Solid ball with centre ``centre_m`` [m], shape (3,), and radius ``radius_m`` [m]."""

    centre_m: Array
    radius_m: float


Solid = HalfSpace | Box | Ball


class ContactField:
    """Objects that a tool may touch: solids, and optionally bone that is modelled by voxels.

    Parameters
    ----------
    *solids
        Convex solids that the tool may touch. Use several solids for a concave object, such as two
        half-spaces for an inner corner.
    store
        Voxels of bone, which may be carved during contact. The surface for contact is where the
        interpolated fraction of bone is 1/4. This surface lies about a quarter of a voxel outside
        the true surface. For a tool with normals, the offset is corrected; see
        :mod:`kernels.voxmap`.
    device
        Warp device name. If a store is given, the device of the store is used.
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


def _solid(solid: Solid) -> tuple[int, Array, Array, Array]:
    """Return the kind, centre, rotation and size of a solid, as the kernels require them."""
    match solid:
        case HalfSpace():
            z = np.asarray(solid.normal, dtype=np.float64) / np.linalg.norm(solid.normal)
            # With the axis that is farthest from the normal, the cross product is never zero.
            helper = np.eye(3)[int(np.argmin(np.abs(z)))]
            x = helper - z * (helper @ z)
            x /= np.linalg.norm(x)
            return HALF_SPACE, solid.point_m, np.column_stack([x, np.cross(z, x), z]), np.zeros(3)
        case Box():
            return BOX, solid.centre_m, solid.rotation, 0.5 * np.asarray(solid.size_m)
        case Ball():
            return BALL, solid.centre_m, np.eye(3), np.full(3, solid.radius_m)


def _clearance(holds: NDArray[np.bool_], spacing_m: float) -> NDArray[np.float32]:
    """Return a lower bound of the distance to bone [m] for each block of voxels.

    The bound is valid for all points in a block. Points near bone count as bone if their trilinear
    fraction is above zero.
    """
    counts = [ceil(n / CELL) for n in holds.shape]
    padded = np.pad(
        holds, [(0, CELL * count - n) for count, n in zip(counts, holds.shape, strict=True)]
    )
    x, y, z = counts
    full = padded.reshape(x, CELL, y, CELL, z, CELL).any(axis=(1, 3, 5))
    if not full.any():
        return np.full(counts, NOWHERE_M, dtype=np.float32)
    # Distances are computed between centres, but points of the two cells may lie half a diagonal
    # from these centres.
    cells = distance_transform_edt(~full) - sqrt(3.0)
    return np.maximum(spacing_m * (CELL * cells - FELT_VOXELS), 0.0).astype(np.float32)


@dataclass(frozen=True, eq=False)
class ToolShell:
    """Points on the surface of a tool, with the origin at the tip and z from tip to shank.

    Attributes
    ----------
    points_m
        Positions [m], shape (n, 3).
    normals
        Outward unit normals, shape (n, 3); zero where a point has no normal.
    radius_m
        Radius of a ball around every point [m]. Contact with solids is computed exactly for these
        balls. Contact with voxels is computed for the points only, as if the radius were zero.
    """

    points_m: Array
    normals: Array
    radius_m: float = 0.0

    @classmethod
    def ball(
        cls, radius_m: float = 0.0, *, centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> "ToolShell":
        """Return a shell that consists of one ball.

        With a radius of 0, the tool is a point, as in the classical god-object method.
        """
        return cls(np.array([centre_m], dtype=np.float64), np.zeros((1, 3)), radius_m)

    @classmethod
    def of_cutter(cls, cutter: Cutter, *, point_count: int = 700) -> "ToolShell":
        """Return about ``point_count`` points over the cutting surface of a cutter.

        With the default of 700 points, a tick takes less than 1 ms. For a ball of 4 mm on a rough
        surface of 0.2 mm voxels, the 99th percentile of the time per tick is 0.2 ms. It is 0.9 ms
        with 1400 points, and 4 ms with 2800 points.
        """
        shell = cutter.shell(spacing_m=(cutter.cutting_area_m2 / point_count) ** 0.5)
        return cls(shell.points_m, shell.normals)

    @property
    def reach_m(self) -> float:
        """Largest distance of the tool's surface from the tool's origin [m]."""
        return float(np.linalg.norm(self.points_m, axis=1).max()) + self.radius_m


STEP_M = 2.5e-4
"""Largest motion of the proxy in one step near solids [m].

The value is chosen. The tests with exact solids also pass with 1 and 10 mm.
"""
STEP_VOXELS = 0.5
"""Largest motion of the proxy in one step near voxels [voxels].

On a rough surface of 0.2 mm voxels, points of a burr penetrate the bone by up to 11 um with steps
of 1 voxel, and by up to 23 um with steps of 2 voxels. The tests allow 10 um.
"""
TOLERANCE_M = 1e-12
TOLERANCE_VOXELS = 1e-3
"""Length of a step below which the proxy has settled [voxel]; `TOLERANCE_M` is in metres.

`TOLERANCE_M` is used for solids, where only rounding limits the accuracy. `TOLERANCE_VOXELS` is
used for voxels.
"""
STEP_LIMIT = 64
SOLVE_LIMIT = 150
"""Largest number of active-set solves in a tick; `STEP_LIMIT` is the largest number of steps.

If a tick reaches a limit, the proxy continues its motion in the next tick. On a jerky path over a
rough surface of voxels, 6 of 1500 ticks reach a limit. If both limits are halved, 49 ticks reach a
limit.
"""
_POSITION = slice(POSITION, POSITION + 3)
_ROTATION = slice(ROTATION, ROTATION + 4)
_FORCE = slice(FORCE, FORCE + 3)
_MOMENT = slice(MOMENT, MOMENT + 3)
_CENTRE = slice(CENTRE, CENTRE + 3)
_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass
class ProxyResult:
    """State of the proxy after a tick; the next tick overwrites the object.

    Attributes
    ----------
    position_m
        Position of the tool's origin [m], shape (3,).
    quaternion
        Rotation from tool to world (x, y, z, w), shape (4,).
    settled
        True if the proxy has reached its equilibrium. Otherwise it continues to move in the next
        tick.
    contacts
        Number of contacts with force.
    push_m, push_moment_m2
        Sum of the contact forces on the tool, and sum of their moments about the tool's origin,
        both divided by the coupling stiffness k. Multiply by k to obtain N and N m. When the proxy
        has settled, the sums balance the coupling springs.
    arm_m
        Vector from the tool's origin to the centre of pressure, in the world's axes [m], shape
        (3,).
    """

    position_m: Array
    quaternion: Array
    push_m: Array
    push_moment_m2: Array
    arm_m: Array
    settled: bool = True
    contacts: int = 0


class Proxy:
    """Rigid tool that follows a device and never enters a solid.

    Parameters
    ----------
    shell
        Surface of the tool.
    field
        Objects that the tool may touch.
    lever_m
        Square root of the ratio of rotational stiffness [N m/rad] to translational stiffness [N/m]
        of the coupling [m]. With None, the tool has three degrees of freedom and keeps its initial
        orientation.
    friction
        Coulomb's coefficient of friction.
    """

    def __init__(
        self,
        shell: ToolShell,
        field: ContactField,
        *,
        lever_m: float | None = None,
        friction: float = 0.0,
    ) -> None:
        compliance = 0.0 if lever_m is None else lever_m**-2
        step = STEP_M
        tolerance = TOLERANCE_M
        if field.spacing_m > 0.0:
            step = STEP_VOXELS * field.spacing_m
            tolerance = TOLERANCE_VOXELS * field.spacing_m
        device = field.device
        self._contacts = _contacts(len(shell.points_m), field, device=device)
        tool = Shell()
        tool.point = wp.array(
            shell.points_m - field.sink_m * shell.normals, dtype=wp.vec3d, device=device
        )
        tool.radius, tool.reach = map(wp.float64, (shell.radius_m, shell.reach_m))
        settings = DescentSettings()
        numbers = map(wp.float64, (compliance, friction, step, tolerance))
        settings.compliance, settings.friction, settings.step, settings.tolerance = numbers
        settings.step_limit = STEP_LIMIT
        settings.solve_limit = SOLVE_LIMIT
        self._goal = Mirror(TRAVEL, dtype=wp.float64, device=device)
        self._state = Mirror(STATE, dtype=wp.float64, device=device)
        self._report = Mirror(REPORT, dtype=wp.float64, device=device)
        self._goal.host[_ROTATION] = self._state.host[_ROTATION] = _IDENTITY
        self._field = field  # the recorded kernel launch reads the arrays of the field
        self._launch = wp.launch(
            advance_proxy,
            dim=1,
            inputs=[field.arrays, tool, settings, self._goal.device],
            outputs=[self._contacts, self._state.device, self._report.device],
            device=device,
            record_cmd=True,
        )
        self.result = ProxyResult(
            np.zeros(3), _IDENTITY.copy(), np.zeros(3), np.zeros(3), np.zeros(3)
        )

    def place(self, position_m: Array, quaternion: Array = _IDENTITY) -> ProxyResult:
        """Place the proxy at a free pose, and clear all contacts.

        Raises
        ------
        InputError
            If a number is not finite or the tool would lie in a solid.
        """
        self._aim(position_m, quaternion)
        self._state.host[:TRAVEL] = self._goal.host
        self._state.host[TRAVEL] = 0.0
        self._state.push()
        self._report.host[:] = 0.0
        self._report.push()
        for array in (self._contacts.press, self._contacts.wake, self._contacts.plane_normal):
            array.zero_()
        self._run()
        if self.result.contacts > 0:
            out_m = float(np.linalg.norm(self.result.position_m - position_m))
            raise InputError(
                "position_m",
                "place the tool outside all obstacles",
                f"{position_m}, where the tool lies about {1e3 * out_m:.3g} mm deep",
                "start farther away",
            )
        return self.result

    def advance(self, position_m: Array, quaternion: Array = _IDENTITY) -> ProxyResult:
        """Follow the device to a pose, given by position [m] and quaternion (x, y, z, w).

        The next call overwrites the object that this call returns.

        Raises
        ------
        InputError
            If a number is not finite. The proxy then keeps its pose.
        """
        self._aim(position_m, quaternion)
        self._run()
        return self.result

    def _aim(self, position_m: Array, quaternion: Array) -> None:
        """Set the pose of the device as the goal of the proxy."""
        if not isfinite(float(position_m.sum()) + float(quaternion.sum())):
            raise InputError(
                "the device's pose",
                "be finite",
                f"{position_m} m, {quaternion}",
                "keep the last finite pose and ramp the force to zero",
            )
        self._goal.host[_POSITION] = position_m
        self._goal.host[_ROTATION] = quaternion
        self._goal.push()

    def _run(self) -> None:
        """Launch the kernel of a tick and read its results."""
        self._launch.launch()
        self._state.pull()
        self._report.pull()
        state = self._state.host
        report = self._report.host
        result = self.result
        result.position_m[:] = state[_POSITION]
        result.quaternion[:] = state[_ROTATION]
        result.push_m[:] = report[_FORCE]
        result.push_moment_m2[:] = report[_MOMENT]
        result.arm_m[:] = report[_CENTRE]
        result.contacts = int(report[PRESSING])
        result.settled = bool(report[CONVERGED] != 0.0)


def _contacts(points: int, field: ContactField, *, device: str) -> Contacts:
    """Allocate memory for all possible contacts of a shell with ``points`` points."""
    slots = field.solid_count + (VOXEL_PLANES if field.spacing_m > 0.0 else 0)
    contacts = Contacts()
    contacts.slots = slots
    for name, count, kind in (
        ("press", points * slots, wp.float64),
        ("wake", points, wp.float64),
        ("plane_normal", (points, VOXEL_PLANES), wp.vec3d),
        ("plane_offset", (points, VOXEL_PLANES), wp.float64),
        ("slot", points * slots, wp.int32),
        ("arm", points * slots, wp.vec3d),
        ("normal", points * slots, wp.vec3d),
        ("moment", points * slots, wp.vec3d),
        ("gap", points * slots, wp.float64),
        ("chosen", points * slots, wp.int32),
        ("member", MEMBERS, wp.int32),
        ("lower", (MEMBERS, MEMBERS), wp.float64),
        ("side", (MEMBERS, 3), wp.float64),
    ):
        setattr(contacts, name, wp.zeros(count, dtype=kind, device=device))
    return contacts
