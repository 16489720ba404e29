"""Real haptic device in the frame of the scene, with limits and ramps of the force."""

from collections.abc import Callable
from math import isfinite, radians, sqrt
from time import perf_counter
from typing import Self

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.device.device import DeviceParameters, Sample, reach_of
from tissue.haptics.real.adapter import HardwareAdapter, HardwareSample
from tissue.motion.motion import matrix_of
from tissue.motion.quaternion import (
    NOTHING,
    UPRIGHT,
    Quaternion,
    Triple,
    conjugate,
    exponential,
    is_nearly_unit,
    product,
    unit,
)
from tissue.scene.coupling import Hardware


class Workspace:
    """Mapping of device poses to poses in the scene, and of forces to the axes of the device.

    A position x of the device is mapped to ``R x + d`` in the scene. The rotation R is constant,
    and d is chosen so that the first pose is at the start position of the tool. While the clutch
    button is held, the pose in the scene does not change. When the button is released, d and the
    reference orientation are updated, so that the pose does not jump. Because R is a rotation, the
    power (force times velocity) is equal in both frames.

    Parameters
    ----------
    turn_deg
        Rotation from the device's axes to the world's axes, about the world's x, then y, then z
        [degrees].
    start_m
        Position of the first pose in the scene [m].

    Attributes
    ----------
    is_placed
        True after the first pose has been mapped.
    """

    def __init__(self, turn_deg: Triple, start_m: Triple) -> None:
        x, y, z = map(radians, turn_deg)
        self._turn = product(
            exponential((0.0, 0.0, z)),
            product(exponential((0.0, y, 0.0)), exponential((x, 0.0, 0.0))),
        )
        self._matrix = matrix_of(np.array(self._turn))
        self._rows: list[list[float]] = self._matrix.tolist()
        self._start = start_m
        self.forget()

    def forget(self) -> None:
        """Map the next pose to the start position of the tool, as the first pose was mapped."""
        self.is_placed = False
        self._clutched = False
        self._shift: Triple = NOTHING
        self._pose: tuple[Triple, Quaternion] = (self._start, UPRIGHT)
        self._from = UPRIGHT
        self._onto = UPRIGHT

    def turned(self, vector: Triple) -> Triple:
        """Convert a vector from the device's axes to the world's axes."""
        a, b, c = vector
        x, y, z = self._rows
        return (
            x[0] * a + x[1] * b + x[2] * c,
            y[0] * a + y[1] * b + y[2] * c,
            z[0] * a + z[1] * b + z[2] * c,
        )

    def at_device(self, vector: Array) -> Array:
        """Convert a vector, shape (3,), from the world's axes to the device's axes."""
        return vector @ self._matrix

    def pose(
        self, position_m: Triple, quaternion: Quaternion, *, clutched: bool
    ) -> tuple[Triple, Quaternion]:
        """Return position [m] and orientation in the scene for a device pose.

        The first orientation in the scene is the identity.
        """
        if clutched and self.is_placed:
            self._clutched = True
            return self._pose
        x, y, z = self.turned(position_m)
        turned = self._in_world(quaternion)
        usable = isfinite(x + y + z) and is_nearly_unit(turned)
        if usable and (self._clutched or not self.is_placed):
            (a, b, c), onto = self._pose
            self._shift = (a - x, b - y, c - z)
            self._onto = onto
            self._from = conjugate(turned)
            self.is_placed = True
            self._clutched = clutched
        a, b, c = self._shift
        pose = (x + a, y + b, z + c), product(product(turned, self._from), self._onto)
        if usable:
            self._pose = pose
        return pose

    def _in_world(self, quaternion: Quaternion) -> Quaternion:
        """Convert an orientation from the device's axes to the world's axes.

        The length of a quaternion that is far from 1 is kept, so that the `SampleGuard` of the loop
        rejects the quaternion.
        """
        length_one = (unit(quaternion) if is_nearly_unit(quaternion) else None) or quaternion
        return product(product(self._turn, length_one), conjugate(self._turn))


MOST_EVENTS = 100
"""Largest number of stored events.

Without a limit, an unstable connection could fill the memory.
"""


class MappedDevice:
    """Real device in the frame of the scene, with safety functions.

    The first sample is mapped to the start position of the tool. The scale
    ``coupling.motion_scale`` is not applied here, because the run applies it. Without a new sample,
    the last sample is repeated until the watchdog time has passed. After this time, `read` returns
    None, and the force is set to zero at once.

    The force on the hand is the commanded force, limited to a largest magnitude and multiplied by a
    factor, `share`. During a ramp, the factor increases linearly from 0 to 1. A ramp begins at the
    start, after a lost connection, and when the clutch button or the force button changes. The
    factor is 0 while no force is allowed, for example while the clutch button is held.

    Parameters
    ----------
    adapter
        Adapter of the device. A ramp begins each time the adapter has removed the force by itself.
    hardware
        Settings: placement of the workspace in the scene, and limits.
    start_m
        Start position of the tool in the scene [m].
    now
        Function that returns the time for the watchdog [s].

    Attributes
    ----------
    limits
        Limits of the device.
    played
        Force [N] and torque [N m] on the hand since the last command, in the world frame.
    share
        Factor, 0 to 1, by which the commanded force is currently multiplied.
    """

    in_process = False
    real_time = True
    """True, because the ticks of a run with a real device must start in real time."""
    bounds_itself = True
    """True, because `read` itself checks the reach of the device.

    Positions in the scene may lie beyond this reach, because the clutch shifts the workspace.
    """

    def __init__(
        self,
        adapter: HardwareAdapter,
        hardware: Hardware | None = None,
        *,
        start_m: Triple = NOTHING,
        now: Callable[[], float] = perf_counter,
    ) -> None:
        self._adapter = adapter
        self._settings = hardware or Hardware()
        self._now = now
        self.limits: DeviceParameters = adapter.limits
        self._space = Workspace(self._settings.turn_deg, start_m)
        self._reach = reach_of(adapter, self.limits)
        self._cap = min(
            self._settings.force_cap_N or self.limits.force_limit_N, self.limits.force_limit_N
        )
        self._patience = 1e-3 * self._settings.watchdog_ms
        self._ramp = 1e-3 * self._settings.ramp_ms
        self.played: tuple[Array, Array] = (np.zeros(3), np.zeros(3))
        self.share = 0.0
        self._events: list[tuple[float, str]] = []
        self._newest: HardwareSample | None = None
        self._came = self._time = 0.0
        self._lost = False
        self._releases = 0
        self._noted = 0
        self._begin(0.0)

    def __enter__(self) -> Self:
        self._adapter.__enter__()
        self._newest = None
        self._releases = self._adapter.releases
        self._noted = 0
        self._begin(0.0)
        return self

    def __exit__(self, *raised: object) -> None:
        try:
            self.command(np.zeros(3), np.zeros(3))
        finally:
            self._adapter.__exit__(*raised)

    def close(self) -> None:
        """Remove all force from the device without using `command`."""
        self._adapter.close()

    def read(self, time_s: float) -> Sample | None:
        """Return the newest sample in the world frame, constant while the clutch is held.

        If there was no new sample for the watchdog time, the result is None.

        Raises
        ------
        DeviceError
            If the device leaves its reach, for example because it reports millimetres.
        """
        # If the time is earlier than before, another run has started with the same device.
        if time_s < self._time or not self._space.is_placed:
            self._begin(time_s)
        elapsed = time_s - self._time
        self._time = time_s
        now = self._now()
        sample = self._adapter.poll()
        if (releases := self._adapter.releases) != self._releases:
            self._releases = releases
            self.share = 0.0
            self._note()
        if sample is not None:
            self._newest = sample
            self._came = now
            if self._reach is not None:
                self._reach.require(sample.position_m)
        elif self._newest is None or now - self._came > self._patience:
            if not self._lost and self._space.is_placed:
                self._log(f"no sample came for {1e3 * self._patience:g} ms: the force is zero")
            self._lost = True
            self.share = 0.0
            return None
        if self._lost:
            if self._space.is_placed:
                self._log("samples arrive again: the force returns")
            self._lost = False
        newest = self._newest
        clutched = _held(newest.buttons, self._settings.clutch_button, otherwise=False)
        wanted = not clutched and _held(newest.buttons, self._settings.force_button, otherwise=True)
        # If the ramp has no duration, the whole force is played at once.
        step = elapsed / self._ramp if self._ramp > 0.0 else 1.0
        self.share = min(self.share + step, 1.0) if wanted else 0.0
        position, quaternion = self._space.pose(
            newest.position_m, newest.quaternion, clutched=clutched
        )
        if clutched:
            return Sample(time_s, position, NOTHING, quaternion, NOTHING)
        velocity = self._space.turned(newest.velocity_m_s)
        spin = self._space.turned(newest.spin_rad_s)
        return Sample(time_s, position, velocity, quaternion, spin)

    def command(self, force_N: Array, torque_Nm: Array) -> None:
        """Apply the limited force and the torque (world frame), multiplied by `share`."""
        size = sqrt(force_N.dot(force_N))
        share = self.share * (self._cap / size if size > self._cap else 1.0)
        self.played = share * force_N, self.share * torque_Nm
        self._adapter.push(
            self._space.at_device(self.played[0]), self._space.at_device(self.played[1])
        )

    def happened(self) -> list[tuple[float, str]]:
        """Return the events of watchdog and adapter so far, each with time [s] and a sentence."""
        self._note()
        return self._events

    def _begin(self, time_s: float) -> None:
        """Start a run: map the next sample to the start of the tool, and begin a ramp."""
        self.share = 0.0
        self._time = time_s
        self._space.forget()
        if self._reach is not None:
            self._reach.restart()

    def _note(self) -> None:
        """Store the new events of the adapter."""
        found = self._adapter.happened()
        for what in found[self._noted :]:
            self._log(what)
        self._noted = len(found)

    def _log(self, what: str) -> None:
        if len(self._events) < MOST_EVENTS:
            self._events.append((self._time, what))


def _held(buttons: int, button: int | None, *, otherwise: bool) -> bool:
    """Return True if a button is held; return ``otherwise`` if ``button`` is None."""
    return otherwise if button is None else bool(buttons >> button & 1)
