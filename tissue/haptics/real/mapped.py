"""A real device in the scene's frame: its workspace turned and placed, its force limited, faded
in and taken off.
"""

from collections.abc import Callable
from math import sqrt
from time import perf_counter
from types import TracebackType
from typing import Self

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.device.device import DeviceParameters, Sample
from tissue.haptics.device.reach import reach_of
from tissue.haptics.real.adapter import HardwareAdapter, HardwareSample
from tissue.haptics.real.workspace import Workspace
from tissue.motion.quaternion import Triple
from tissue.scene.hardware import Hardware

__all__ = ["MappedDevice"]

STILL: Triple = (0.0, 0.0, 0.0)
MOST_EVENTS = 100
"""Events that are kept one by one."""


class MappedDevice:
    """What a run holds of a real device: an adapter with a workspace in the scene and what protects
    the hand.

    The first sample is where the tool starts; scale is ``coupling.motion_scale`` of the run and not
    made here. Without a new sample the last one is repeated until the watchdog ends; then there is
    none, and the force is zero at once. The force is the commanded one, no longer than the cap,
    times a share that rises in a straight line from 0 to 1 in the ramp: after the start, a lost
    device, the clutch, and the force button; while there is no reason for force, such as a clutch
    that is held, the share is 0.

    Parameters
    ----------
    adapter
        The device in its own frame. It may have ``releases``, how often it has taken the force off
        by itself, after which the ramp begins anew, and ``happened()``, sentences of what it has
        found.
    hardware
        How its workspace lies in the scene, and the limits.
    start_m
        Where the tool starts, in the scene [m].
    now
        Clock of the watchdog [s].

    Attributes
    ----------
    limits
        What the device can do.
    played
        Force [N] and torque [N m] on the hand since the last command, in the world frame.
    share
        Share of the commanded force that is played.
    """

    in_process = False
    real_time = True
    """Whether a run has to follow the wall clock."""
    bounds_itself = True
    """Its workspace bounds the device's own positions; with a clutch the tool may go further."""

    def __init__(
        self,
        adapter: HardwareAdapter,
        hardware: Hardware | None = None,
        *,
        start_m: Triple = (0.0, 0.0, 0.0),
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
        self._releases = getattr(self._adapter, "releases", 0)
        self._noted = 0
        self._begin(0.0)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.command(np.zeros(3), np.zeros(3))
        finally:
            self._adapter.__exit__(kind, error, trace)

    def close(self) -> None:
        """Take all force off the device by other means than a command."""
        self._adapter.close()

    def read(self, time_s: float) -> Sample | None:
        """The newest sample in the world frame, where the clutch leaves it; None once the watchdog
        has ended.

        Raises
        ------
        DeviceError
            If the device leaves its reach, as one does that reports millimetres.
        """
        if time_s < self._time or not self._space.is_placed:
            self._begin(time_s)
        elapsed = time_s - self._time
        self._time = time_s
        now = self._now()
        sample = self._adapter.poll()
        if (releases := getattr(self._adapter, "releases", 0)) != self._releases:
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
                self._log("samples are back: the force comes on again")
            self._lost = False
        newest = self._newest
        clutched = _held(newest.buttons, self._settings.clutch_button, otherwise=False)
        wanted = not clutched and _held(newest.buttons, self._settings.force_button, otherwise=True)
        self.share = self._ramped(elapsed) if wanted else 0.0
        position, quaternion = self._space.pose(
            newest.position_m, newest.quaternion, clutched=clutched
        )
        if clutched:
            return Sample(time_s, position, STILL, quaternion, STILL)
        velocity = self._space.turned(newest.velocity_m_s)
        spin = self._space.turned(newest.spin_rad_s)
        return Sample(time_s, position, velocity, quaternion, spin)

    def command(self, force_N: Array, torque_Nm: Array) -> None:
        """Play a force and a torque of the world frame, as much of them as share and cap let
        through.
        """
        size = sqrt(force_N.dot(force_N))
        share = self.share * (self._cap / size if size > self._cap else 1.0)
        self.played = share * force_N, self.share * torque_Nm
        self._adapter.push(
            self._space.at_device(self.played[0]), self._space.at_device(self.played[1])
        )

    def happened(self) -> list[tuple[float, str]]:
        """What the watchdog and the adapter have found so far, time [s] and a sentence each."""
        self._note()
        return self._events

    def _begin(self, time_s: float) -> None:
        """A run begins: the next sample is where its tool starts, and the force comes on from
        zero.
        """
        self.share = 0.0
        self._time = time_s
        self._space.forget()
        if self._reach is not None:
            self._reach.restart()

    def _ramped(self, elapsed_s: float) -> float:
        """The share after so much more time."""
        return min(self.share + elapsed_s / self._ramp, 1.0) if self._ramp > 0.0 else 1.0

    def _note(self) -> None:
        """Take over what the adapter has found since this was called last."""
        found: tuple[str, ...] = getattr(self._adapter, "happened", tuple)()
        for what in found[self._noted :]:
            self._log(what)
        self._noted = len(found)

    def _log(self, what: str) -> None:
        if len(self._events) < MOST_EVENTS:
            self._events.append((self._time, what))


def _held(buttons: int, button: int | None, *, otherwise: bool) -> bool:
    """Whether a button is held; ``otherwise`` where none is named."""
    return otherwise if button is None else bool(buttons >> button & 1)
