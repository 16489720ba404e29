"""A hand on a device as what moves a tool: samples in, forces out, once a tick."""

from math import pi

import numpy as np
from numpy.typing import NDArray

from tissue.coupling.device import Device, DeviceParameters
from tissue.coupling.guard import SampleGuard
from tissue.coupling.held_tool import HeldTool
from tissue.coupling.loop import WallLoop
from tissue.coupling.passivity import PassivityObserver
from tissue.coupling.renderer import Renderer
from tissue.coupling.rotation import matrix_of
from tissue.coupling.signal import DelayLine, ForceRange, LowPass
from tissue.model import Response, ToolMotion
from tissue.motion import Motion

__all__ = ["MEASURES", "HandMotion"]

Array = NDArray[np.float64]
MEASURES = (
    *(f"device_{c}_mm" for c in "xyz"),
    *(f"device_q{c}" for c in "xyzw"),
    *(f"device_force_{c}_N" for c in "xyz"),
    *(f"device_torque_{c}_Nm" for c in "xyz"),
    *(f"filtered_force_{c}_N" for c in "xyz"),
    "saturated",
    "passivity_J",
    "margin",
)
"""Columns of a device: its pose, what it was told to play, the filtered force before it was brought into the device's
range [N at the device], whether that compressed it, the energy taken from the device, and the share of the critical
stiffness that is left."""
SMOOTH_S = 0.01
"""Time over which the speed of a tool that goes with its device is estimated: encoders step [s]."""


class HandMotion(Motion):
    """A tool that hangs on a device, and the force that the device plays for it.

    Every tick: the sample is judged; the tool follows the device as far as the tissue of the last tick lets it; device
    and tool give the renderer's force, which passes low-pass, delay and the device's range, and is vouched for. So the
    force answers the sample of its own tick. Without a good sample the tool rests, the renderer pauses and the force
    fades to zero.

    The tool is turned by the device and nothing holds the turn back: there is no coupling of rotations yet, and the
    cutting speed of turning is left out. A device that plays torque is given the tissue's own of the last tick, scaled.

    Parameters
    ----------
    device
        What the hand moves.
    tool
        Where the tool is in balance.
    law
        What turns device and tool into a force at the device [N].
    scripted
        Motion that the hand is to make; it gives start, orientation, region and duration.
    limits
        Greatest force and torque of the device.
    loop
        Loop of device and law, by whose delay energy is booked, and whose filter is applied.
    delay_ticks
        Ticks by which the force is held back here.
    torque_scale
        Newton metres at the device for each one at the tool.
    margin
        Share of the critical stiffness that is left.
    stray_m
        How far the tool may leave the scripted motion [m].
    after_s
        How much longer a hand takes than the scripted motion [s].
    """

    measure_names = MEASURES

    def __init__(
        self,
        device: Device,
        tool: HeldTool,
        law: Renderer,
        *,
        scripted: Motion,
        limits: DeviceParameters,
        loop: WallLoop,
        delay_ticks: int = 0,
        torque_scale: float = 1.0,
        margin: float,
        stray_m: float = 0.0,
        after_s: float = 0.0,
    ) -> None:
        self.device, self.tool, self.law = device, tool, law
        self.duration_s = scripted.duration_s + after_s
        self._scripted, self._stray = scripted, stray_m
        self._start = np.array(scripted.rotations()[0])
        tick = loop.tick_s
        self.guard = SampleGuard(force_limit_N=limits.force_limit_N, torque_limit_Nm=limits.torque_limit_Nm)
        self._low_pass = LowPass(loop.filter_s, step_s=tick)
        self._delay = DelayLine(delay_ticks)
        self._range = ForceRange(limit_N=limits.force_limit_N)
        self._turning = LowPass(loop.filter_s, step_s=tick)
        self._turning_delay = DelayLine(delay_ticks)
        self._torques: ForceRange | None = None
        if limits.torque_limit_Nm > 0.0:
            self._torques = ForceRange(limit_N=limits.torque_limit_Nm, scale=torque_scale)
        lag = loop.delay_s + 1.0 / (2.0 * pi * loop.amplifier_hz)
        self.observer = PassivityObserver(delay_ticks=lag / tick)
        self._velocity = np.zeros(3)
        self._smoothing = min(tick / SMOOTH_S, 1.0)
        self.measures = np.zeros(len(MEASURES))
        self.measures[3:7], self.measures[-1] = (0.0, 0.0, 0.0, 1.0), margin

    def sweep_m(self) -> Array:
        """Positions of the scripted motion [m], and the same a stray to every side."""
        tips = self._scripted.sweep_m()
        if self._stray == 0.0:
            return tips
        aside = self._stray * np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
        return np.concatenate([tips, *(tips + shift for shift in aside)])

    def rotations(self) -> Array:
        """Orientations of the scripted motion at those positions."""
        turns = self._scripted.rotations()
        return turns if self._stray == 0.0 else np.concatenate([turns] * 5)

    def begin(self, motion: ToolMotion) -> None:
        """Stand where the scripted motion starts."""
        self._scripted.begin(motion)
        self.measures[:3] = 1e3 * motion.tip_m

    def happened(self) -> list[tuple[float, str]]:
        """Every change between good samples and bad."""
        return list(self.guard.events)

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Read the device, move the tool, play the force."""
        sample = self.guard.believe(self.device.read(time_s), time_s)
        wanted = torque = None
        compressed = False
        if sample is None:
            self.law.pause()
            self.observer.pause()
            self._delay.step(self._low_pass.value)
            self._turning_delay.step(self._turning.value)
            motion.speed_m_s, self._velocity[:] = 0.0, 0.0
        else:
            at, speed, quaternion, _ = sample.arrays()
            before = self.tool.tip_m.copy()
            tip = self.tool.follow(at, response, motion.heading[0], step_s)
            went = (tip - before) / step_s
            motion.tip_m[:], motion.rotation[:] = tip, matrix_of(quaternion) @ self._start
            self._tell_speed(motion, went, at - tip)
            filtered = self._delay.step(self._low_pass.step(self.law.render(at, speed, tip, went, step_s)))
            wanted, compressed = self._range.play(filtered)
            if self._torques is not None:
                torque, _ = self._torques.play(self._turning_delay.step(self._turning.step(response.wrench[3:])))
            self.observer.observe(at)
            told = self.measures
            told[:3], told[3:7], told[13:16] = 1e3 * at, quaternion, filtered
        force, turning = self.guard.vouch(wanted, torque)
        self.device.command(force, turning)
        self.observer.hold(force)
        told = self.measures
        told[7:10], told[10:13], told[16], told[17] = force, turning, compressed, self.observer.energy_J

    def _tell_speed(self, motion: ToolMotion, went_m_s: Array, pull_m: Array) -> None:
        """Heading and speed: of the balance along the pull, or estimated where the tool goes with the device."""
        self._velocity += self._smoothing * (went_m_s - self._velocity)
        velocity, heading = self._velocity, self._velocity
        if self.tool.driven:
            velocity, heading = went_m_s, went_m_s if went_m_s.any() else pull_m
        size = float(np.sqrt(heading @ heading))
        if size > 0.0:
            motion.heading[0] = heading / size
        motion.speed_m_s = float(np.sqrt(velocity @ velocity))
        motion.pressed = self.tool.pressed
