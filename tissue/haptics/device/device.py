"""Interface of haptic devices, and published parameters of some devices."""

from dataclasses import dataclass, replace
from math import dist, inf, isfinite
from typing import NamedTuple, Protocol, Self, runtime_checkable

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive, require_range
from meshes.base.hints import suggests_arguments
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.materials.scene_constants import Materials
from tissue.motion.quaternion import NOTHING, UPRIGHT, Quaternion, Triple
from tissue.scene.registry import DEVICES


class Sample(NamedTuple):
    """Sample of a device: time, pose and velocities, in the world frame."""

    time_s: float
    position_m: Triple
    velocity_m_s: Triple = NOTHING
    quaternion: Quaternion = UPRIGHT
    spin_rad_s: Triple = NOTHING


class DeviceError(InputError):
    """Error of a device that fails or does not follow the interface `Device`.

    The message is one sentence with the failed call, the observed behaviour and the remedy.
    """


class Device(Protocol):
    """Interface of a haptic device, which provides a position and receives a force.

    A haptic loop needs only the methods `read` and `command`. The loop calls both through
    `tissue.haptics.device.safe_device.SafeDevice`. If the device is a context manager, the loop
    enters it before the first read. The loop leaves it after the last command, which is zero force.
    Do not enter such a device in your own ``with`` statement before a run, because the device would
    be opened twice. Use ``with SafeDevice(device) as held`` instead. A device may also have a
    method ``close()`` that removes all force without calling ``command``. If ``command`` fails, the
    loop calls ``close()``, possibly from another thread.
    """

    def read(self, time_s: float) -> Sample | None:
        """Return the newest sample at the time ``time_s``, or None if there is no sample."""

    def command(self, force_N: Array, torque_Nm: Array) -> None:
        """Apply a force and a torque, in the world frame, to the hand until the next command."""


@runtime_checkable
class KnowsTruth(Protocol):
    """Device that provides its true position and the force on the hand, such as a simulated device.

    In contrast, the positions in the samples are quantised by the encoders.
    """

    @property
    def true_position_m(self) -> Triple:
        """Position of the tip at the last sample [m]."""
        ...

    @property
    def hand_force_N(self) -> Triple:
        """Force with which the device pushes the hand [N].

        The force is the mean over the tick before the last sample.
        """
        ...


@runtime_checkable
class ReportsPlayedForce(Protocol):
    """Device that may apply less than the commanded force, and reports the applied force."""

    @property
    def played(self) -> tuple[Array, Array]:
        """Force [N] and torque [N m] on the hand since the last command, in the world frame."""
        ...

    def happened(self) -> list[tuple[float, str]]:
        """Return the events so far, each as time [s] and a sentence."""
        ...


class ComputedDevice:
    """Base class of devices without hardware, such as simulated and recorded devices.

    The methods of such a device only compute and return at once. At the end of its ``with`` block,
    zero force is commanded.
    """

    in_process = True
    """True if `read` and `command` only compute, so that they cannot block."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.command(np.zeros(3), np.zeros(3))

    def command(self, force_N: Array, torque_Nm: Array) -> None:
        """Ignore the force and the torque, because the device has no motors."""


@suggests_arguments
@dataclass(frozen=True, kw_only=True)
class DeviceParameters:
    """Physical parameters and limits of a device.

    Each value is valid for all directions.

    Attributes
    ----------
    mass_kg, damping_N_s_m, friction_N
        Apparent mass [kg], viscous friction [N s/m] and Coulomb friction [N] at the tip.
    encoder_step_m
        Position resolution of the encoders [m]; 0 for exact positions. A trained force predictor is
        adapted to this resolution.
    force_limit_N
        Largest force [N].
    force_slew_N_ms
        Largest change of the commanded force [N/ms].
    rate_Hz
        Samples and force updates per second. With a rate above 1 kHz, the device is read once in
        each tick of 1 ms. With a lower rate, each force is held until the next sample of the
        device.
    transport_delay_s
        Time from a sample to the force that is computed from it [s]. The zero-order hold adds to
        this time.
    amplifier_Hz
        Bandwidth of the motor amplifiers [Hz]; infinite for no lag.
    inertia_kg_m2, damping_Nm_s_rad, friction_Nm, encoder_step_rad
        Apparent inertia [kg m2], viscous friction [N m s/rad], Coulomb friction [N m] and encoder
        resolution [rad] of the rotation.
    torque_limit_Nm, torque_slew_Nm_ms
        Largest torque [N m] and largest change of the torque [N m/ms]. A torque limit of 0 defines
        a device with three degrees of freedom. The rotation of such a device follows the hand
        freely.
    stiffness_limit_N_m, damping_limit_N_s_m, stiffness_limit_Nm_rad
        Limits in the vendor's software. They are reported, but not enforced by this package.
    workspace_width_m, workspace_height_m, workspace_depth_m
        Edge lengths of the box in which the tip can be moved [m].
    """

    mass_kg: float
    damping_N_s_m: float
    friction_N: float = 0.0
    encoder_step_m: float = 0.0
    force_limit_N: float = 1e3
    force_slew_N_ms: float = inf
    rate_Hz: float = 1000.0
    transport_delay_s: float = 0.0
    amplifier_Hz: float = inf
    inertia_kg_m2: float = 5e-5
    damping_Nm_s_rad: float = 1.5e-4
    friction_Nm: float = 0.0
    encoder_step_rad: float = 0.0
    torque_limit_Nm: float = 0.0
    torque_slew_Nm_ms: float = inf
    stiffness_limit_N_m: float = inf
    damping_limit_N_s_m: float = inf
    stiffness_limit_Nm_rad: float = inf
    workspace_width_m: float = inf
    workspace_height_m: float = inf
    workspace_depth_m: float = inf

    def __post_init__(self) -> None:
        # The bounds reject values in a wrong unit.
        for name in ("mass_kg", "force_limit_N", "inertia_kg_m2"):
            require_positive(name, getattr(self, name), "see devices.toml for usual values")
        friction = "damping_N_s_m", "friction_N", "damping_Nm_s_rad", "friction_Nm"
        for names, low, high in (
            (("rate_Hz",), 10.0, 1e5),
            (("transport_delay_s",), 0.0, 0.2),
            ((*friction, "encoder_step_m", "encoder_step_rad", "torque_limit_Nm"), 0.0, 1e4),
            (("amplifier_Hz", "force_slew_N_ms", "torque_slew_Nm_ms"), 1e-9, inf),
        ):
            for name in names:
                value = getattr(self, name)
                require_range(name, value, low, high, "see devices.toml for usual values")

    def loop(
        self,
        stiffness_N_m: float,
        *,
        wall_damping_N_s_m: float = 0.0,
        filter_s: float = 0.0,
        model_ticks: int = 1,
    ) -> WallLoop:
        """Return the loop used to check the stability of a virtual wall on this device.

        The returned loop has no Coulomb friction, no encoder steps and no hand.
        """
        return WallLoop(
            mass_kg=self.mass_kg,
            damping_N_s_m=self.damping_N_s_m,
            stiffness_N_m=stiffness_N_m,
            wall_damping_N_s_m=wall_damping_N_s_m,
            tick_s=1.0 / self.rate_Hz,
            delay_s=self.transport_delay_s,
            model_ticks=model_ticks,
            filter_s=filter_s,
            amplifier_Hz=self.amplifier_Hz,
        )

    @property
    def workspace_m(self) -> Array:
        """Edge lengths of the workspace in ascending order, shape (3,), in metres."""
        return np.sort([self.workspace_width_m, self.workspace_height_m, self.workspace_depth_m])

    def turning_loop(
        self,
        stiffness_Nm_rad: float,
        *,
        filter_s: float = 0.0,
        model_ticks: int = 1,
    ) -> WallLoop:
        """Return the loop used to check the stability of a rotational spring on this device.

        The values in the returned loop have units of rotation, such as N m/rad.
        """
        loop = self.loop(stiffness_Nm_rad, filter_s=filter_s, model_ticks=model_ticks)
        return replace(loop, mass_kg=self.inertia_kg_m2, damping_N_s_m=self.damping_Nm_s_rad)


def device_parameters(name: str, constants: Materials = Materials.cited) -> DeviceParameters:
    """Return the parameters of a device by its name in `DEVICES`.

    Constants that a scene defines replace the built-in constants.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    return DeviceParameters(**constants.numbers("devices", DEVICES[name].numbers, name))


REACH_RATIO = 3.0
"""Reach of a device's arm divided by the diagonal of its published workspace.

The Touch has a published workspace of 160 x 120 x 70 mm, but its arm moves in 431 x 348 x 165 mm.
If positions of a Touch are given in millimetres by mistake, a motion of 0.6 mm already exceeds the
computed reach.
"""
UNSTATED_M = 3.0
"""Assumed reach of a device without a published workspace [m].

The value is larger than the length of a human arm.
"""
SAMPLES_BEYOND_REACH = 20
"""Number of consecutive samples beyond the reach after which an error is raised.

A single such sample is a temporary fault, which `SampleGuard` handles.
"""


class Reach:
    """Check whether the positions of a device stay within the reach of its arm.

    Parameters
    ----------
    limits
        Device parameters with the workspace.

    Attributes
    ----------
    limit_m
        Largest distance from the first position [m].
    """

    def __init__(self, limits: DeviceParameters) -> None:
        self._edges_m = limits.workspace_m
        diagonal_m = float(np.linalg.norm(self._edges_m))
        self.limit_m = REACH_RATIO * diagonal_m if isfinite(diagonal_m) else UNSTATED_M
        self._first: Triple | None = None
        self._wrong = 0

    def restart(self) -> None:
        """Use the next position as the centre of the reach."""
        self._first = None
        self._wrong = 0

    def require(self, position_m: Triple, *, samples: int = SAMPLES_BEYOND_REACH) -> None:
        """Check a position [m], and raise an error after several positions beyond the reach.

        The error is raised after ``samples`` consecutive positions beyond the reach.

        Raises
        ------
        DeviceError
            If the device is beyond its reach.
        """
        # The sample guard reports a position that is not finite.
        if not isfinite(sum(position_m)):
            return
        first = self._first = self._first or position_m
        away_m = dist(position_m, first)
        self._wrong = self._wrong + 1 if away_m > self.limit_m else 0
        if self._wrong < samples:
            return
        stated = "no workspace is stated"
        if isfinite(self._edges_m[-1]):
            box = " x ".join(f"{1e3 * edge:.3g}" for edge in self._edges_m[::-1])
            stated = f"its workspace is {box} mm"
        raise DeviceError(
            f"the device reports a position {1e3 * away_m:.4g} mm from its first position, but "
            f"{stated}. If it reports millimetres, convert them to metres. If its workspace is "
            "larger, correct workspace_width_m, workspace_height_m and workspace_depth_m in its "
            "constants"
        )


def reach_of(device: object, limits: DeviceParameters) -> Reach | None:
    """Return the check of a device's reach; None if the device needs no such check.

    No check is needed if the device bounds its positions itself or has no arm.
    """
    return None if getattr(device, "bounds_itself", False) else Reach(limits)
