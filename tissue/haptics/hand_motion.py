"""Motion of a tool on a haptic device: each tick reads a sample and commands a force."""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics import hand_measures as at
from tissue.haptics.device.device import Device, DeviceParameters, KnowsTruth, Sample
from tissue.haptics.device.safe_device import SafeDevice
from tissue.haptics.device.sample_guard import NewSamples, guard_of
from tissue.haptics.loop.filters import ConstantAcceleration, DelayLine, ForceRange, LowPass
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.haptics.loop.vibration import PlayedForce
from tissue.haptics.proxy.cutting_tool import CuttingTool, CutTissue
from tissue.haptics.proxy.held_tool import HeldTool
from tissue.haptics.renderer import PassivityObserver, PassivityRenderer, Renderer, TurningRenderer
from tissue.models.tissue_model import TICK_S, Response, TissueModel, ToolMotion
from tissue.motion.motion import Motion, matrix_of
from tissue.motion.quaternion import UPRIGHT, Quaternion
from tissue.prediction.predictor import Contact, Predictor, SeesContact

SMOOTH_S = 0.01
SMOOTH_SAMPLES = 5
"""Smallest averaging time of the speed of a tool without inertia.

`SMOOTH_S` is this time in seconds, and `SMOOTH_SAMPLES` in samples of the device.

Speeds are averaged because encoder positions change in steps. One encoder step of a Touch (0.055
mm) is a speed of 55 mm/s over a tick of 1 ms, and of 5.5 mm/s over 10 ms. For a device below 500
Hz, the number of samples determines the averaging time.
"""


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """Stages of force rendering, from the positions of device and tool to the device force.

    Attributes
    ----------
    law
        Law that computes the force at the device [N] from the positions of device and tool.
    loop
        Loop of the device and the law. The energy taken from the device is computed with the delay
        of the loop. Force and velocity pass the filters of the loop. Without a velocity filter, the
        velocity in the sample is used. The tick of the loop is the time between two samples of the
        device.
    margin
        Stability margin: 1 minus the ratio of the stiffness to the critical stiffness.
    turning_law
        Law that computes the torque at the device [N m]; None for a device without torque.
    delay_ticks
        Number of ticks by which the force is delayed in software.
    model_ticks
        Number of ticks for which one response of the tissue is used.
    predictor
        Predictor of the force. With None, the present force is used.
    lead_ticks
        Prediction horizon [ticks].
    prediction_gain
        Share of the difference between predicted and present force that is added to the present
        force.
    played
        Last stages before the device, such as perceptual scaling and vibration. By default, the
        force is only limited to the range of the device.
    """

    law: Renderer
    loop: WallLoop
    margin: float
    turning_law: TurningRenderer | None = None
    delay_ticks: int = 0
    model_ticks: int = 1
    predictor: Predictor | None = None
    lead_ticks: float = 0.0
    prediction_gain: float = 1.0
    played: PlayedForce | None = None


@dataclass(frozen=True, kw_only=True)
class Script:
    """Scripted motion of the tool, and its relation to the motion of the device.

    Attributes
    ----------
    motion
        Scripted motion, which gives the start, the orientation, the region and the duration.
    motion_scale
        Metres at the tool for each metre at the device.
    stray_m
        Largest distance between the tool and the scripted motion [m].
    after_s
        Additional time for the hand to react, to move and to correct [s].
    device_origin_m
        Position of the tool when the device is at its origin [m]. With None, device and tool start
        at the same position.
    """

    motion: Motion
    motion_scale: float = 1.0
    stray_m: float = 0.0
    after_s: float = 0.0
    device_origin_m: Array | None = None


class HandMotion(Motion):
    """Motion of a tool that is coupled to a haptic device, and force on the device.

    Each tick has these steps:

    1. Validate the device sample.
    2. Move the tool towards the device. A tool that cuts moves to the pose at which inertial force,
       coupling force and tissue force are in balance. Any other tool moves to the balance computed
       with the response of the last tick.
    3. Compute the tissue response. If a tool without inertia has entered the tissue from free
       space, it is moved again within the tick.
    4. Render the force from the positions of device and tool.
    5. Apply prediction, low-pass, delay and perceptual scaling, then limit the force and its slew
       rate.

    The force in a tick therefore depends on the sample of the same tick. Without a valid sample,
    the tool rests, the renderer pauses, and the force fades to zero. If a tissue responds only
    every ``model_ticks`` ticks, the tool and the rendered force do not change in the other ticks.
    In these ticks, a predictor uses only the motion of the device.

    Tool and device start at the same position, unless the script gives a device origin. The tool
    moves ``motion_scale`` metres for each metre of the device. If the device can apply torque, a
    rotational spring also couples the tool to the device, and the torque of the tissue turns the
    tool. For a tool that does not cut, this torque is from the last tick. The rendered torque also
    passes the low-pass and the delay.

    Parameters
    ----------
    device
        Device that the hand holds.
    tool
        Tool that follows the device, see `HeldTool`.
    limits
        Largest force and torque of the device, and largest rates of change.
    rendering
        Stages from the positions of device and tool to the force at the device.
    script
        Scripted motion of the tool.
    """

    def __init__(
        self,
        device: Device,
        tool: HeldTool,
        limits: DeviceParameters,
        rendering: Rendering,
        script: Script,
    ) -> None:
        loop = rendering.loop
        predictor = rendering.predictor
        self._limits = limits
        self._played = rendering.played or PlayedForce(limits.force_limit_N)
        self._sample_s = loop.tick_s
        self._margin = rendering.margin
        self.predictor = predictor
        self.device = device
        self.tool = tool
        self.law = rendering.law
        self._gain = rendering.prediction_gain
        self._sees = predictor if isinstance(predictor, SeesContact) else None
        self._contact: Renderer = rendering.law
        self._control = None
        if predictor is not None and isinstance(rendering.law, PassivityRenderer):
            # The correction of a passivity controller lasts one tick and is not a trend of the
            # force. It is therefore added after the prediction.
            self._contact = rendering.law.inner
            self._control = rendering.law.control
        self._scripted = script.motion
        self._stray = script.stray_m
        self.after_s = script.after_s
        self.duration_s = script.motion.duration_s + script.after_s
        self._start = np.array(script.motion.rotations()[0])
        self._scale = script.motion_scale
        origin_m = script.device_origin_m
        self._shift = (
            (1.0 - self._scale) * script.motion.sweep_m()[0] if origin_m is None else origin_m
        )
        self._coupling_N_m = loop.stiffness_N_m
        self._low_pass = LowPass(loop.filter_s, step_s=TICK_S)
        self._delay = DelayLine(rendering.delay_ticks)
        memory = loop.velocity_memory
        filtered = None if memory is None else ConstantAcceleration(memory, step_s=loop.tick_s)
        # The position observer filters the position of the device before the tool follows it.
        # Without this observer, one filter estimates the velocities of device and tool, so that
        # their difference is zero while they move together.
        self._position_observer = filtered if loop.observes else None
        self._speeds = None if loop.observes else filtered
        self._samples = NewSamples(loop.tick_s)
        self._turning = LowPass(loop.filter_s, step_s=TICK_S)
        self._turning_delay = DelayLine(rendering.delay_ticks)
        self._turning_law = rendering.turning_law
        # A device without torque has the limit 0, which `ForceRange` does not accept. Its range is
        # not used.
        self._torques = ForceRange(limit_N=limits.torque_limit_Nm or 1.0)
        # The amplifier delays by its time constant, 1 / (2 pi f).
        lag_s = loop.delay_s + 1.0 / (2.0 * pi * loop.amplifier_Hz)
        # The energy observer receives the force after the delay line, so that the delay of this
        # line is subtracted here.
        self.observer = PassivityObserver(
            delay_ticks=max(lag_s / TICK_S - rendering.delay_ticks, 0.0)
        )
        self._turned: Quaternion | None = None
        self.model_ticks = rendering.model_ticks
        self.lead_ticks = rendering.lead_ticks
        self._step = TICK_S * self.model_ticks
        self._smoothing = min(self._step / max(SMOOTH_S, SMOOTH_SAMPLES * loop.tick_s), 1.0)
        self._ticks = 0
        self._fresh = True
        self._is_new = True
        self._sample: Sample | None = None
        self._before, self._went, self._raw, self._torque = np.zeros((4, 3))
        self._velocity, self._device_velocity = np.zeros((2, 6))
        self._here = np.zeros(3)

    @property
    def observes(self) -> bool:
        """True if position and velocity of the device are filtered before the tool follows."""
        return self._position_observer is not None

    @property
    def device(self) -> Device:
        """Device that the hand moves.

        Set another device only before the first tick, because the sample guard and the measures are
        then replaced.
        """
        return self.held.device

    @device.setter
    def device(self, device: Device | SafeDevice) -> None:
        self.held = SafeDevice(device, limits=self._limits)
        self.guard = guard_of(self.held.device, self._limits, sample_s=self._sample_s)
        self.measure_names = at.MEASURES + at.PREDICTED * (self.predictor is not None)
        self._person = slice(
            len(self.measure_names), len(self.measure_names) + len(self._played.names)
        )
        self.measure_names += self._played.names
        self._truth = self.held.device if isinstance(self.held.device, KnowsTruth) else None
        self.measure_names += (at.TRUE + at.HAND_FORCE) * (self._truth is not None)
        self.measures = np.zeros(len(self.measure_names))
        self.measures[at.QUATERNION] = UPRIGHT
        self.measures[at.MARGIN] = self._margin

    def sweep_m(self) -> Array:
        """Return the positions of the scripted motion [m], and copies shifted by ``stray_m``.

        The copies are shifted along +x, -x, +y and -y.
        """
        tips = self._scripted.sweep_m()
        if self._stray == 0.0:
            return tips
        # The surface at the site is perpendicular to z, so that these copies cover the surface
        # around the path.
        aside = self._stray * np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
        return np.concatenate([tips, *(tips + shift for shift in aside)])

    def rotations(self) -> Array:
        """Return the orientations of the scripted motion at the positions of `sweep_m`."""
        turns = self._scripted.rotations()
        return turns if self._stray == 0.0 else np.concatenate([turns] * 5)

    def set_tissue(self, tissue: TissueModel) -> None:
        """Set the tissue that a cutting tool cuts."""
        tissue = getattr(tissue, "milling", tissue)
        if isinstance(self.tool, CuttingTool) and isinstance(tissue, CutTissue):
            self.tool.set_tissue(tissue, self._start)

    def begin(self, motion: ToolMotion) -> None:
        """Place the tool at the start of the scripted motion."""
        self._scripted.begin(motion)
        motion.balanced = self.tool.wrench
        self.measures[at.POSITION] = 1e3 * motion.tip_m

    def happened(self) -> list[tuple[float, str]]:
        """Return the events of sample validation and of the device's timing."""
        return self.guard.events + self.held.happened()

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Read the device and let the tool follow it."""
        sample = self.guard.validate_sample(self.held.read(time_s), time_s)
        if self.held.released:
            self.held.released = False
            self.guard.share = 0.0  # the force increases again from zero
        self._fresh = self._ticks % self.model_ticks == 0
        self._ticks += 1
        self._sample = None
        if sample is None:
            motion.speed_m_s = 0.0
            self._velocity[:] = 0.0
            self.tool.rest()
            return
        self._sample = sample
        self._is_new = self._samples.is_new(sample, time_s)
        self._observe(sample)
        if self._fresh:
            self._before[:] = self.tool.tip_m
            self._follow(sample, response, motion)

    def correct(self, response: Response, motion: ToolMotion) -> bool:
        """Move the tool to its force balance if it has entered the tissue from free space.

        The method returns True if it has moved the tool.
        """
        if self._sample is None or not self.tool.has_entered(response):
            return False
        self._follow(self._sample, response, motion)
        return True

    def _follow(self, sample: Sample, response: Response, motion: ToolMotion) -> None:
        """Move the tool towards the device."""
        device = self._scale * self._here + self._shift
        velocity = self._device_velocity
        tip = self.tool.follow(device, sample.quaternion, velocity, response, self._step)
        self._went[:] = (tip - self._before) / self._step
        motion.tip_m[:] = tip
        # Most tools never turn, so the matrix is computed only after a change.
        if self.tool.quaternion != self._turned:
            self._turned = self.tool.quaternion
            motion.rotation[:] = matrix_of(np.array(self._turned)) @ self._start
        self._set_speed(motion, self._went)

    def _observe(self, sample: Sample) -> None:
        """Update position and velocity of the device from a sample.

        For a tool that cuts, position and velocity are estimated with the filter of the loop.
        """
        self._here[:] = sample.position_m
        velocity = self._device_velocity
        velocity[:3] = sample.velocity_m_s
        velocity[3:] = sample.spin_rad_s
        if self._position_observer is not None:
            # A slower device repeats its last sample. The filter would treat repeated samples as
            # rest.
            if self._is_new:
                self._position_observer.step(self._here)
            self._here[:] = self._position_observer.position
            velocity[:3] = self._position_observer.velocity
        velocity[:3] *= self._scale

    def play(self, response: Response) -> None:
        """Compute the force for the sample of this tick, and send the force to the device."""
        wanted = None
        torque = None
        compressed = False
        row = self.measures
        if (sample := self._sample) is None:
            self._pause()
        else:
            here, speed = self._render(sample)
            if self._fresh and self._turning_law is not None:
                turned = self.tool.quaternion
                spin = np.array(sample.spin_rad_s)
                still = np.zeros(3)
                self._torque = self._turning_law.render(
                    sample.quaternion, spin, turned, still, self._step
                )
            row[at.RAW_FORCE] = force = self._raw
            if self.predictor is not None:
                if self._sees is not None:
                    self._sees.meet(self.contact(response))
                # The predictor gets the sample itself: the filtered position would delay the
                # predictor.
                measured = np.array(sample.position_m)
                self.predictor.observe(measured, speed, force if self._fresh else None)
                predicted = self.predictor.predict(self.lead_ticks)
                row[at.PREDICTED_FORCE] = predicted
                row[at.RESIDUAL] = self.predictor.residual_N
                row[at.PREDICTED_BY] = self.predictor.is_primary
                # With gain 1 the predicted force itself is played, without rounding.
                force = force + self._gain * (predicted - force) if self._gain != 1.0 else predicted
                if self._control is not None:
                    force = self._control.step(force, here, speed, TICK_S)
            filtered = self._delay.step(self._low_pass.step(force))
            wanted, compressed = self._played.step(filtered, response)
            if self._turning_law is not None:
                torque, squeezed = self._torques.play(
                    self._turning_delay.step(self._turning.step(self._torque))
                )
                compressed = compressed or squeezed
            self.observer.observe(here)
            row[at.POSITION] = 1e3 * np.array(sample.position_m)
            row[at.QUATERNION] = sample.quaternion
            row[at.FILTERED_FORCE] = filtered
            row[self._person] = self._played.measures
            if self._truth is not None:
                # The columns `TRUE` and `HAND_FORCE` are the last six.
                row[-6:-3] = 1e3 * np.array(self._truth.true_position_m)
                row[-3:] = self._truth.hand_force_N
        played, turning = self.held.play(*self.guard.limit_force(wanted, torque))
        self.observer.hold(played)
        row[at.PLAYED_FORCE] = played
        row[at.PLAYED_TORQUE] = turning
        row[at.SATURATED] = compressed
        row[at.ENERGY] = self.observer.energy_J

    def contact(self, response: Response) -> Contact:
        """Return the contact of the tool, converted to lengths and forces at the device.

        Lengths at the device are lengths at the tool divided by m, the motion scale. Forces at the
        device are f times the forces at the tool. Here f = k / (m k_tool), where k is the stiffness
        of the coupling at the device, and k_tool the stiffness of the tool's spring.
        """
        tool = self.tool
        scale = self._scale
        felt = self._coupling_N_m / (scale * tool.stiffness_N_m)
        known = response.stiffness_N_m
        return Contact(
            self._coupling_N_m,
            (tool.tip_m - self._shift) / scale,
            felt * response.wrench[:3],
            None if known is None else (scale * felt) * known,
            response.gap_m / scale,
            response.normal,
            scale * felt * response.surface_N_m,
            isinstance(tool, CuttingTool),
        )

    def raw_force_N(self) -> Array:
        """Return the rendered force of this tick [N], shape (3,), without sending it to the device.

        Without a valid sample, the result is the force of the last tick.
        """
        if self._sample is not None:
            self._render(self._sample)
        else:
            self._pause_filters()
        return self._raw

    def _render(self, sample: Sample) -> tuple[Array, Array]:
        """Update the rendered force; return the device position and velocity."""
        here = self._here
        tip = (self.tool.tip_m - self._shift) / self._scale
        speed = self._device_velocity[:3] / self._scale
        went = self._went / self._scale
        if self._speeds is not None:
            if self._is_new:
                self._speeds.step(np.concatenate((here, tip)))
            velocities = self._speeds.velocity
            speed = velocities[:3]
            went = velocities[3:]
        if self._fresh:
            self._raw = self._contact.render(here, speed, tip, went, self._step)
        return here, speed

    def _pause_filters(self) -> None:
        """Reset the filters of position and velocity; they start at rest with the next sample."""
        self._samples.pause()
        for part in (self._position_observer, self._speeds):
            if part is not None:
                part.pause()

    def _pause(self) -> None:
        """Reset filters, renderer and predictor after missing samples."""
        self._pause_filters()
        for part in (
            self.law,
            self._turning_law,
            self.observer,
            self.predictor,
            self._played,
        ):
            if part is not None:
                part.pause()
        self.measures[self._person] = self._played.measures
        self._delay.step(self._low_pass.value)
        self._turning_delay.step(self._turning.value)

    def _set_speed(self, motion: ToolMotion, went_m_s: Array) -> None:
        """Write the direction of motion and the speed of the tool.

        The velocity of a tool with inertia is known. For any other tool, the speed is estimated
        from the change of position.
        """
        velocity = self.tool.velocity
        if velocity is None:
            self._velocity[:3] += self._smoothing * (went_m_s - self._velocity[:3])
            velocity = self._velocity
        size = sqrt(velocity[:3].dot(velocity[:3]))
        if size > 0.0:
            motion.heading[:] = (velocity / size).reshape(2, 3)
        motion.speed_m_s = size
