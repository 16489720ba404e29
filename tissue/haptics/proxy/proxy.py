"""God-object: pose of a tool without penetration, in three or six degrees of freedom.

The device follows the hand, even through walls. The proxy follows the device as far as possible and
stays outside. The coupling between both, see `tissue.haptics.renderer.ProxyRenderer`, is the force
on the hand. The proxy is the static equilibrium of the tool between the coupling springs and the
contacts. It is reached by local descent from the last proxy. A search for the nearest free point
would end on the far side of a thin wall.
"""

from dataclasses import dataclass
from math import isfinite

import numpy as np
import warp as wp

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
from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.proxy.voxmap import ContactField, ToolShell

__all__ = ["Proxy", "ProxyResult"]

STEP_M = 2.5e-4
"""Longest step near solids [m]."""
STEP_VOXELS = 0.5
"""Longest step near voxels [voxel]."""
TOLERANCE_M, TOLERANCE_VOXELS = 1e-12, 1e-3
"""Step below which the proxy has settled [m], [voxel].

The first value covers rounding near exact solids. The second is a thousandth voxel near voxels.
"""
STEP_LIMIT, SOLVE_LIMIT = 64, 150
"""Largest number of steps and of active-set solves in a tick; the rest is done in the next tick."""
_POSITION = slice(POSITION, POSITION + 3)
_ROTATION = slice(ROTATION, ROTATION + 4)
_FORCE = slice(FORCE, FORCE + 3)
_MOMENT = slice(MOMENT, MOMENT + 3)
_CENTRE = slice(CENTRE, CENTRE + 3)
_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass
class ProxyResult:
    """State of the proxy, reused from tick to tick.

    Attributes
    ----------
    position_m
        Position of the tool's origin [m], shape (3,).
    quaternion
        Rotation from tool to world (x, y, z, w), shape (4,).
    settled
        False if the steps of a tick ran out. The proxy then goes on in the next tick.
    contacts
        Number of pressing contacts.
    push_m, push_moment_m2
        Sum of the contact forces on the tool, and of their moments about its origin, both divided
        by the coupling stiffness k. Multiplied by k, they are in N and N m. They balance the
        coupling springs once the proxy has settled.
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
        Solids and bone that the tool may touch.
    lever_m
        Square root of the coupling's rotational stiffness over its stiffness [m]; None for three
        degrees of freedom, in which the tool keeps its initial orientation.
    friction
        Coulomb's coefficient.
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
        self._field = field  # the recorded launch reads its arrays
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
                "leave the tool outside everything",
                f"{position_m} where it lies about {1000.0 * out_m:.3g} mm deep",
                "start farther off",
            )
        return self.result

    def advance(self, position_m: Array, quaternion: Array = _IDENTITY) -> ProxyResult:
        """Follow the device to its pose [m], (x, y, z, w).

        The next call overwrites the returned object.

        Raises
        ------
        InputError
            If a number is not finite; the proxy then keeps its pose.
        """
        self._aim(position_m, quaternion)
        self._run()
        return self.result

    def _aim(self, position_m: Array, quaternion: Array) -> None:
        """Set the pose of the device as the goal."""
        if not isfinite(float(position_m.sum()) + float(quaternion.sum())):
            raise InputError(
                "the device's pose",
                "be finite",
                f"{position_m} m, {quaternion}",
                "hold the last pose and ramp the force to zero",
            )
        self._goal.host[_POSITION] = position_m
        self._goal.host[_ROTATION] = quaternion
        self._goal.push()

    def _run(self) -> None:
        """Launch the tick and read its results."""
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
