"""Interface between a moving tool and a tissue; models of free space and of a virtual wall."""

from dataclasses import dataclass, field
from math import inf, pi
from typing import Protocol, runtime_checkable

import numpy as np

from meshes.base.arrays import Array, Bytes
from meshes.base.errors import InputError, require_positive
from tissue.fem.fields import FieldSeries
from tissue.models.state import State

TICK_S = 1e-3
"""Length of a tick [s]."""
SLOW = "longer than its interval"
"""Text that occurs in every notice about a background computation that took too long.

The cause of such a notice is a slow computer, not the tissue.
"""


@dataclass
class ToolMotion:
    """Pose and motion of a tool, reused from tick to tick.

    Attributes
    ----------
    tip_m
        Position of the tool's tip in the world [m], shape (3,).
    rotation
        Rotation matrix from tool to world, shape (3, 3). The columns are the tool's axes x, y and
        z; z runs from tip to shank.
    heading
        Direction of motion, shape (2, 3), in the world frame: velocity of the tip at unit speed,
        and angular velocity of the pose at unit speed [rad/m]. The spin of the tool about its own
        axis is not included.
    speed_m_s
        Speed that scales `heading` [m/s].
    tangent_m_s
        Speed at which the tissue linearises its force [m/s]; None means `speed_m_s`.
    pressed
        Edge force that the bone exerts on a resting tool, as a fraction of the full edge force: 0
        without pressure, 1 if the tool is about to cut.
    balanced
        Force [N] and torque about the tip [N m] of the bone on the tool, shape (6,), from the force
        balance of the tool. None for a tool whose motion does not depend on forces.
    """

    tip_m: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    heading: Array = field(default_factory=lambda: np.zeros((2, 3)))
    speed_m_s: float = 0.0
    tangent_m_s: float | None = None
    pressed: float = 0.0
    balanced: Array | None = None


@dataclass
class Response:
    """Response of a tissue to a tool, reused from tick to tick.

    All forces act on the tool, and all torques are about the tool's tip. The components are in the
    world frame.

    Attributes
    ----------
    resistance
        Derivative of force [N s/m] and torque [N s] with respect to the speed along the direction
        of motion, at the speed of the linearisation, shape (6,).
    edge
        Force [N] and torque [N m] of the linearised response at zero speed, shape (6,). For a law
        that is linear in the speed, this is the force at the onset of motion.
    wrench
        Force [N] and torque [N m] of the linearised response at the motion's speed, shape (6,).
    removal_rate_m3_s
        Volume of material that the cutting elements of the tool sweep per time [m3/s].
    engaged_m2
        Area of the tool in contact with each layer of the tissue [m2], shape (layers,).
    measures
        Further values of the tissue, in the order and units of `TissueModel.measure_names`.
    stiffness_N_m
        Stiffness at the position of a resting tool, -dF/dx [N/m], shape (3, 3). None if the tissue
        does not provide it.
    gap_m, normal
        Distance from the surface to a tool that does not touch the tissue [m], and unit normal out
        of the surface, shape (3,). The distance is infinite if the tissue does not provide it.
    surface_N_m
        Stiffness along the normal [N/m] of the surface near a tool that does not touch the tissue;
        infinite if it is not known.
    """

    resistance: Array
    edge: Array
    wrench: Array
    engaged_m2: Array
    removal_rate_m3_s: float = 0.0
    measures: Array = field(default_factory=lambda: np.zeros(0))
    stiffness_N_m: Array | None = None
    gap_m: float = inf
    normal: Array = field(default_factory=lambda: np.zeros(3))
    surface_N_m: float = inf

    @classmethod
    def empty(cls, layer_count: int, measure_count: int = 0) -> "Response":
        """Return a response without contact."""
        return cls(
            np.zeros(6),
            np.zeros(6),
            np.zeros(6),
            np.zeros(layer_count),
            measures=np.zeros(measure_count),
        )


class TissueModel(Protocol):
    """Tissue that a tool moves through: the interface of every model.

    Other protocols of this module, such as `HasState`, describe members that only some models have.

    `place` puts the tool at its first pose. In every tick `advance` removes the tissue that the
    tool reaches at its new pose, and then `respond` returns the force at that pose. `advance` and
    `respond` allocate no device memory. For a tool that is pushed by a force, `respond` is called
    first, at trial poses. `advance` is then called once, at the pose where the forces balance.
    `respond` must therefore not change the state.
    """

    @property
    def layer_names(self) -> tuple[str, ...]:
        """Names of the tissue's layers."""

    @property
    def measure_names(self) -> tuple[str, ...]:
        """Names, with units, of the tissue's own columns in the trace."""

    @property
    def start_m3(self) -> Array:
        """Volume of each layer before the first cut [m3]."""

    @property
    def removed_m3(self) -> Array:
        """Volume removed from each layer so far [m3]."""

    def place(self, motion: ToolMotion) -> None:
        """Put the tool at its first pose, before the first tick."""

    def advance(self, motion: ToolMotion) -> None:
        """Move the tool to its new pose."""

    def respond(self, motion: ToolMotion) -> Response:
        """Return force and torque on the tool at its pose.

        The next call overwrites the returned object.
        """


@runtime_checkable
class SchedulesBackground(Protocol):
    """Tissue that computes in the background."""

    @property
    def scheduling(self) -> str:
        """Priority and cores of the background work; an empty text without background work."""
        ...


@runtime_checkable
class HasNotices(Protocol):
    """Tissue that reports events."""

    notices: list[str]
    """Events, one sentence each. The simulation loop logs an event and then removes it."""


@runtime_checkable
class StopsReporting(Protocol):
    """Object that reports events until the tool leaves the simulated region."""

    def stop_reporting(self) -> None:
        """Report no further events, and keep the present results."""


@runtime_checkable
class HasState(Protocol):
    """Tissue whose state can be copied, sent to another process and restored."""

    def state(self) -> State:
        """Return a copy of the state on which later ticks depend; the copy can be pickled."""
        ...

    def restore(self, state: State) -> None:
        """Restore a state that `state` of this tissue or of an equal tissue has returned."""


@runtime_checkable
class HasSummary(Protocol):
    """Tissue that adds its own values to the summary of a run."""

    def summary(self) -> dict[str, object]:
        """Return the entries of the summary by name."""
        ...


@runtime_checkable
class HasFields(Protocol):
    """Tissue with fields of displacement and stress over time."""

    @property
    def fields(self) -> FieldSeries | None:
        """Fields computed so far; None if the scene requests no fields."""


@runtime_checkable
class HasHeat(Protocol):
    """Tissue that is heated by cutting."""

    @property
    def heat_balance_J(self) -> dict[str, float] | None:
        """Energy of cutting and the energies into which it is divided [J], keyed by name.

        The value is None if the scene does not compute heat.
        """


@runtime_checkable
class HasVoxels(Protocol):
    """Tissue of voxels that a tool removes."""

    def remaining(self) -> Bytes:
        """Return the amount of tissue left in every voxel, from 0 to 255 (full voxel).

        The array has the same shape as the voxel volume.
        """


@runtime_checkable
class WaitsForBackground(Protocol):
    """Tissue with background work whose result is due at a certain tick."""

    def wait_for_background(self, time_s: float) -> None:
        """Wait for background work whose result is due at a time [s]; called before every tick."""


@runtime_checkable
class MayLag(Protocol):
    """Tissue whose background work may be late, because a real device cannot wait for it."""

    waits: bool
    """True if a tick waits for background work that is due."""


@runtime_checkable
class StartsBackground(Protocol):
    """Tissue with work at a lower rate than the ticks."""

    def start_background(self, time_s: float, motion: ToolMotion) -> None:
        """Do the slower work, or start it in the background; called at the end of every tick."""


@runtime_checkable
class Finishes(Protocol):
    """Tissue with work that is spread over ticks."""

    def finish(self) -> None:
        """Complete the work after the last tick; a second call has no effect."""


class _Stateless:
    """Tissue that is not cut and has no state."""

    def advance(self, motion: ToolMotion) -> None:
        """Do nothing: the tool removes nothing."""

    def state(self) -> State:
        """Return an empty state."""
        return {}

    def restore(self, state: State) -> None:
        """Do nothing: the model has no state."""


class FreeSpace(_Stateless):
    """Free space without any force: the simplest tissue model."""

    layer_names: tuple[str, ...] = ("nothing",)
    measure_names: tuple[str, ...] = ()

    def __init__(self) -> None:
        self._response = Response.empty(1)
        self.start_m3 = np.zeros(1)
        self.removed_m3 = np.zeros(1)

    def place(self, motion: ToolMotion) -> None:
        """Do nothing: free space has no surface."""

    def respond(self, motion: ToolMotion) -> Response:
        """Return zero force."""
        return self._response


class WallModel(_Stateless):
    """Virtual wall: linear unilateral spring below the plane z = 0, F = k depth, without friction.

    The only value in ``measures`` is the depth of the ball's lowest point [mm]. ``engaged_m2`` is
    the area of the circle in which the plane intersects the ball. The response includes the wall's
    stiffness, so that the force balance of a tool on a device is found without iteration.

    Parameters
    ----------
    stiffness_N_m
        Stiffness of the wall [N/m].
    radius_m
        Radius of the ball [m]. The tip is the point of the ball opposite to the shank.
    """

    layer_names: tuple[str, ...] = ("wall",)
    measure_names: tuple[str, ...] = ("depth_mm",)

    def __init__(self, stiffness_N_m: float, *, radius_m: float) -> None:
        self.stiffness_N_m = require_positive(
            "stiffness_N_m", stiffness_N_m, "use a value such as 1e4"
        )
        self._radius = require_positive("radius_m", radius_m, "use a value such as 5e-3")
        self.start_m3 = np.zeros(1)
        self.removed_m3 = np.zeros(1)
        self._free = np.zeros((3, 3))
        self._pressed = np.diag((0.0, 0.0, self.stiffness_N_m))
        self._response = Response.empty(1, 1)
        self._response.normal[2] = 1.0
        self._response.surface_N_m = self.stiffness_N_m

    def place(self, motion: ToolMotion) -> None:
        """Put the ball at its first pose.

        Raises
        ------
        InputError
            If the ball starts inside the wall.
        """
        depth = self._depth_m(motion)
        if depth > 0.0:
            raise InputError(
                "motion",
                "start outside the wall",
                f"a ball {1000.0 * depth:g} mm inside",
                "start higher",
            )

    def respond(self, motion: ToolMotion) -> Response:
        """Return the force on the ball, and its torque about the tip."""
        response = self._response
        depth = self._depth_m(motion)
        response.gap_m = max(-depth, 0.0)
        depth = max(depth, 0.0)
        force = self.stiffness_N_m * depth
        arm_x, arm_y, _ = self._radius * motion.rotation[:, 2]
        response.wrench[2] = force
        response.wrench[3] = arm_y * force
        response.wrench[4] = -arm_x * force
        response.edge[:] = response.wrench
        response.stiffness_N_m = self._pressed if depth > 0.0 else self._free
        response.engaged_m2[0] = pi * depth * max(2.0 * self._radius - depth, 0.0)
        response.measures[0] = 1e3 * depth
        return response

    def _depth_m(self, motion: ToolMotion) -> float:
        """Return the depth of the ball's lowest point below the plane [m]; negative above it."""
        return float(-motion.tip_m[2] + self._radius * (1.0 - motion.rotation[2, 2]))
