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
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from kernels.mirror import Mirror, filled, put
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
from kernels.voxmap import CELL, SURFACE, Field
from meshes.base.arrays import Array
from meshes.base.errors import InputError, in_brackets
from tissue.cutters.cutter import Cutter
from tissue.models.bone.bricks import BrickStore

FELT_VOXELS = 0.5 * sqrt(3.0)
"""Largest distance from a voxel's boundary at which its trilinear fraction is not zero [voxel]."""
NOWHERE_M = 1e30
"""Distance to bone if there is no bone at all [m]; the number is finite in single precision."""


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


class ContactField:
    """Objects that a tool may touch: solid boxes, and optionally bone that is modelled by voxels.

    Parameters
    ----------
    *boxes
        Solid boxes that the tool may touch. Use several boxes for a concave object, such as an
        inner corner.
    store
        Voxels of bone, which may be carved during contact. The surface for contact is where the
        interpolated fraction of bone is 1/4. This surface lies about a quarter of a voxel outside
        the true surface. For a tool with normals, the offset is corrected; see
        :mod:`kernels.voxmap`.
    """

    def __init__(self, *boxes: Box, store: BrickStore | None = None) -> None:
        self.device = str(store.remaining.device) if store is not None else "cpu"
        self.spacing_m = store.grid.spacing_m if store is not None else 0.0
        self.sink_m = (0.5 - SURFACE) * self.spacing_m
        """Offset of shell points into the tool [m]."""
        self.box_count = len(boxes)
        members = {
            "centre": np.reshape([box.centre_m for box in boxes], (-1, 3)),
            "turn": np.reshape([box.rotation for box in boxes], (-1, 3, 3)),
            "size": np.reshape([box.size_m for box in boxes], (-1, 3)),
        }
        arrays = filled(Field, self.device, spacing=wp.float64(self.spacing_m), **members)
        if store is not None:
            arrays.voxels_per_m = wp.float64(1.0 / self.spacing_m)
            arrays.brick_of = store.brick_of
            arrays.remaining = store.remaining
            arrays.origin = wp.vec3d(*store.grid.origin_m.tolist())
            clearance = _clearance(store.fraction() > 0, self.spacing_m)
            arrays.clearance = put(clearance, wp.float32, self.device)
        self.arrays = arrays


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

The value is a design choice. The tests with exact solids also pass with 1 and 10 mm.
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
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass
class ProxyResult:
    """State of the proxy after a tick, in arrays that the next tick overwrites.

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
        tool = filled(
            Shell,
            device,
            point=shell.points_m - field.sink_m * shell.normals,
            radius=wp.float64(shell.radius_m),
            reach=wp.float64(shell.reach_m),
        )
        settings = filled(
            DescentSettings,
            device,
            compliance=wp.float64(compliance),
            friction=wp.float64(friction),
            step=wp.float64(step),
            tolerance=wp.float64(tolerance),
            step_limit=STEP_LIMIT,
            solve_limit=SOLVE_LIMIT,
        )
        self._goal = Mirror(TRAVEL, dtype=wp.float64, device=device)
        self._state = Mirror(STATE, dtype=wp.float64, device=device)
        self._report = Mirror(REPORT, dtype=wp.float64, device=device)
        self._state.host[ROTATION : ROTATION + 4] = IDENTITY
        self._field = field  # the recorded kernel launch reads the arrays of the field
        self._launch = wp.launch(
            advance_proxy,
            dim=1,
            inputs=[field.arrays, tool, settings, self._goal.device],
            outputs=[self._contacts, self._state.device, self._report.device],
            device=device,
            record_cmd=True,
        )
        state = self._state.host
        report = self._report.host
        self.result = ProxyResult(
            position_m=state[POSITION : POSITION + 3],
            quaternion=state[ROTATION : ROTATION + 4],
            push_m=report[FORCE : FORCE + 3],
            push_moment_m2=report[MOMENT : MOMENT + 3],
            arm_m=report[CENTRE : CENTRE + 3],
        )

    def place(self, position_m: Array, quaternion: Array = IDENTITY) -> ProxyResult:
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
        for array in (
            self._contacts.normal_force,
            self._contacts.check_travel,
            self._contacts.plane_normal,
        ):
            array.zero_()
        self._run()
        if self.result.contacts > 0:
            out_m = float(np.linalg.norm(self.result.position_m - position_m))
            raise InputError(
                "position_m",
                "place the tool outside all obstacles",
                f"{in_brackets(position_m, '.4g')} m, about {1e3 * out_m:.3g} mm deep in an "
                "obstacle",
                "start farther away",
            )
        return self.result

    def advance(self, position_m: Array, quaternion: Array = IDENTITY) -> ProxyResult:
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
        self._goal.host[POSITION : POSITION + 3] = position_m
        self._goal.host[ROTATION : ROTATION + 4] = quaternion
        self._goal.push()

    def _run(self) -> None:
        """Launch the kernel of a tick and read its results."""
        self._launch.launch()
        self._state.pull()
        self._report.pull()
        self.result.contacts = int(self._report.host[PRESSING])
        self.result.settled = bool(self._report.host[CONVERGED] != 0.0)


def _contacts(points: int, field: ContactField, *, device: str) -> Contacts:
    """Allocate memory for all possible contacts of a shell with ``points`` points."""
    slots = field.box_count + (VOXEL_PLANES if field.spacing_m > 0.0 else 0)
    struct: Any = Contacts
    shapes: dict[str, Any] = {
        "check_travel": points,
        "plane_normal": (points, VOXEL_PLANES),
        "plane_offset": (points, VOXEL_PLANES),
        "member": MEMBERS,
        "lower": (MEMBERS, MEMBERS),
        "side": (MEMBERS, 3),
    }
    arrays = {
        name: wp.zeros(shapes.get(name, points * slots), dtype=kind.type.dtype, device=device)
        for name, kind in struct.vars.items()
        if name != "slots"
    }
    contacts: Contacts = filled(struct, device, slots=slots, **arrays)
    return contacts
