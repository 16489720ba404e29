"""Simulated haptic device in a simulated hand, integrated in steps between the ticks."""

from collections import deque
from collections.abc import Sequence
from math import ceil, inf, isfinite, sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.device.device import ComputedDevice, DeviceParameters, Sample
from tissue.haptics.hand.hand import HandAction, HoldingHand
from tissue.haptics.loop.sampled_loop import parts_of_tick, plant_step
from tissue.motion.quaternion import (
    NOTHING,
    UPRIGHT,
    Quaternion,
    Triple,
    exponential,
    logarithm,
    product,
    turn_between,
)


class Plant:
    """Dynamics of a device's moving mass with friction and amplifier, held by a spring and damper.

    The axes x, y and z have equal parameters. The commanded force and the external force are
    constant during a step. The linear part of the dynamics is therefore integrated exactly, with
    the matrix exponential. Coulomb friction is computed implicitly in every substep. It either
    stops the mass, or acts with its full magnitude ``friction_N``. The direction of the friction
    force is opposite to the velocity that the mass would have without friction. A mass at rest
    stays exactly at its position until the other forces exceed the friction.

    For a rotation, the units are rad (rotation vector), kg m2, N m s/rad and N m. The code uses
    Python floats, which are several times faster than arrays for three axes.

    Parameters
    ----------
    mass_kg, damping_N_s_m, friction_N
        Apparent mass [kg], viscous friction [N s/m] and Coulomb friction [N] of the device.
    amplifier_Hz
        Bandwidth of the amplifier [Hz]; infinite for no lag.

    Attributes
    ----------
    position, velocity, motor_force
        Position [m], velocity [m/s] and motor force [N] of the three axes.
    motor_work_J
        Work that the motors have done on the mass so far [J].
    hand
        Stiffness [N/m], damping [N s/m] and mass [kg] of the linear hand that holds the device;
        zero without a hand. The spring of the hand pulls the mass towards position zero. If the
        hand's target position is not zero, add the stiffness times the target position to the
        external force of `advance`.
    """

    def __init__(
        self,
        *,
        mass_kg: float,
        damping_N_s_m: float,
        friction_N: float = 0.0,
        amplifier_Hz: float = inf,
    ) -> None:
        self._mass = mass_kg
        self._damping = damping_N_s_m
        self._friction = friction_N
        self._amplifier = amplifier_Hz
        self.position = self.velocity = self.motor_force = NOTHING
        self.motor_work_J = 0.0
        self.hand: Sequence[float] = NOTHING

    def advance(
        self, step_s: float, *, command: Triple, external: Triple, substeps: int = 1
    ) -> None:
        """Advance one step with constant commanded force and external force [N].

        Friction is computed in every substep.
        """
        if self._amplifier == inf:
            self.motor_force = command
        stiffness, damping, mass = self.hand
        (xx, xv, xf, xu, xw), (vx, vv, vf, vu, vw), (_, _, ff, fu, _) = plant_step(
            self._mass + mass,
            self._damping + damping,
            stiffness,
            self._amplifier,
            step_s / substeps,
        )
        u0, u1, u2 = command
        w0, w1, w2 = external
        stop = self._friction * vw
        work = self.motor_work_J
        (x0, x1, x2) = self.position
        (v0, v1, v2) = self.velocity
        (f0, f1, f2) = self.motor_force
        for _ in range(substeps):
            p0 = xx * x0 + xv * v0 + xf * f0 + xu * u0 + xw * w0
            p1 = xx * x1 + xv * v1 + xf * f1 + xu * u1 + xw * w1
            p2 = xx * x2 + xv * v2 + xf * f2 + xu * u2 + xw * w2
            q0 = vx * x0 + vv * v0 + vf * f0 + vu * u0 + vw * w0
            q1 = vx * x1 + vv * v1 + vf * f1 + vu * u1 + vw * w1
            q2 = vx * x2 + vv * v2 + vf * f2 + vu * u2 + vw * w2
            if stop > 0.0:
                speed = sqrt(q0 * q0 + q1 * q1 + q2 * q2)
                share = 1.0 if speed <= stop else stop / speed
                ratio = share * xw / vw
                p0 = p0 - ratio * q0
                p1 = p1 - ratio * q1
                p2 = p2 - ratio * q2
                q0 = (1.0 - share) * q0
                q1 = (1.0 - share) * q1
                q2 = (1.0 - share) * q2
                if share == 1.0 and v0 == v1 == v2 == 0.0:
                    # static friction balances a motor force that changes within the substep
                    p0 = x0
                    p1 = x1
                    p2 = x2
            g0 = ff * f0 + fu * u0
            g1 = ff * f1 + fu * u1
            g2 = ff * f2 + fu * u2
            work += 0.5 * ((f0 + g0) * (p0 - x0) + (f1 + g1) * (p1 - x1) + (f2 + g2) * (p2 - x2))
            x0 = p0
            x1 = p1
            x2 = p2
            v0 = q0
            v1 = q1
            v2 = q2
            f0 = g0
            f1 = g1
            f2 = g2
        self.position = (x0, x1, x2)
        self.velocity = (v0, v1, v2)
        self.motor_force = (f0, f1, f2)
        self.motor_work_J = work


def _combined(first: float, one: Triple, second: float, other: Triple) -> Triple:
    """Return the linear combination ``first * one + second * other``."""
    # Without a loop, a tick of the device takes less time.
    (a, b, c) = one
    (x, y, z) = other
    return first * a + second * x, first * b + second * y, first * c + second * z


def _times(factor: float, vector: Triple) -> Triple:
    return factor * vector[0], factor * vector[1], factor * vector[2]


class SimulatedDevice(ComputedDevice):
    """Simulated device, held by a simulated hand.

    The device has its own ticks. At each tick, its encoders sample the position. The velocity is
    computed from the difference of the last two samples. A command reaches the motors after the
    transport delay, and is held until the next command arrives. The delay need not be a whole
    number of ticks. Between ticks, the moving mass is integrated in smaller steps.

    A command beyond the largest force or torque is shortened to this limit. A non-finite command is
    replaced by zero. Both kinds of commands are counted.

    Parameters
    ----------
    parameters
        Device parameters.
    hand
        Hand that holds the device; None for no hand.
    position_m
        Start position [m].
    substeps
        Integration steps of the moving mass per tick; they affect only the friction. For a
        simulated hand on a virtual wall, 5 and 100 integration steps give encoder positions that
        differ by single increments (RMS 4.5 um).

    Attributes
    ----------
    translation, rotation
        Moving masses in translation and rotation, with their true states. The encoders read
        quantised values of these states.
    orientation
        True orientation.
    hand_force_N
        Force with which the device pushes the hand [N], as the mean over the tick before the last
        sample. Without a hand, the force is zero.
    saturated_ticks, refused_commands
        Number of commands beyond the limits, and number of non-finite commands.
    """

    def __init__(
        self,
        parameters: DeviceParameters,
        hand: HoldingHand | None = None,
        *,
        position_m: Triple = NOTHING,
        substeps: int = 5,
    ) -> None:
        self.parameters = parameters
        self._hand = hand
        self.translation = Plant(
            mass_kg=parameters.mass_kg,
            damping_N_s_m=parameters.damping_N_s_m,
            friction_N=parameters.friction_N,
            amplifier_Hz=parameters.amplifier_Hz,
        )
        self.rotation = Plant(
            mass_kg=parameters.inertia_kg_m2,
            damping_N_s_m=parameters.damping_Nm_s_rad,
            friction_N=parameters.friction_Nm,
            amplifier_Hz=parameters.amplifier_Hz,
        )
        self.translation.position = position_m
        self.orientation: Quaternion = UPRIGHT
        self.hand_force_N: Triple = NOTHING
        self.saturated_ticks = self.refused_commands = 0
        step = self._step = 1.0 / parameters.rate_Hz
        parts = parts_of_tick(parameters.transport_delay_s, step)
        # 1e-9 is for lengths that are a whole number of substeps apart from rounding.
        self._spans = [
            (length, back, max(ceil(substeps * length / step - 1e-9), 1)) for length, back in parts
        ]
        # The first part of a tick uses the oldest command.
        count = parts[0][1] + 1
        self._commands: deque[tuple[Triple, Triple]] = deque(
            [(NOTHING, NOTHING)] * count, maxlen=count
        )
        self._given: tuple[Triple, Triple] = (NOTHING, NOTHING)
        self._tick = 0
        self._sample = Sample(0.0, self._read_position(), quaternion=self._read_orientation())

    @property
    def six_dof(self) -> bool:
        """True if the device can apply a torque."""
        return self.parameters.torque_limit_Nm > 0.0

    @property
    def true_position_m(self) -> Triple:
        """True position of the tip [m], not rounded to encoder steps."""
        return self.translation.position

    def read(self, time_s: float) -> Sample | None:
        """Advance to the last device tick at or before ``time_s``, and return its sample."""
        # 1e-6: a time of a whole tick may be rounded down.
        due = int(time_s * self.parameters.rate_Hz + 1e-6)
        while self._tick < due:
            self._advance()
        return self._sample

    def command(self, force_N: Array, torque_Nm: Array) -> None:
        """Apply a force and a torque from the next tick on, until the next command."""
        limits = self.parameters
        self._given = (
            self._limited(force_N, limits.force_limit_N),
            self._limited(torque_Nm, limits.torque_limit_Nm) if self.six_dof else NOTHING,
        )

    def _limited(self, wanted: Array, limit: float) -> Triple:
        """Return a vector, shortened to the length `limit` if it is longer."""
        x, y, z = np.asarray(wanted).tolist()
        size = sqrt(x * x + y * y + z * z)
        if not isfinite(size):
            self.refused_commands += 1
            return NOTHING
        if size <= limit:
            return x, y, z
        self.saturated_ticks += 1
        return _times(limit / size, (x, y, z))

    def _advance(self) -> None:
        """Advance the hand and the device by one tick of the device, and read the encoders."""
        at = self._tick * self._step
        action = (
            HandAction() if self._hand is None else self._hand.act(at, self.translation.position)
        )
        self.translation.hand = action.grip[:3]
        self.rotation.hand = action.grip[3:]
        self._commands.append(self._given)
        stiffness, damping, _ = self.translation.hand
        aimed = action.aim_velocity_m_s
        grasp = _combined(stiffness, action.aim_m, damping, aimed)
        external = _combined(1.0, grasp, 1.0, action.push_N)
        turned = NOTHING
        if self.six_dof:
            turned = turn_between(action.aim_quaternion, self.orientation)
            # Rotation vectors can be added only if they are small. They are therefore measured from
            # the target of the hand in every tick.
            self.rotation.position = turned
        time = at
        where = self.translation.position
        went = self.translation.velocity
        for length, back, fine in self._spans:
            force, torque = self._commands[-1 - back]
            # The target moves within the tick. With its position in the middle of the tick, the
            # mean pull of the spring is accurate to second order.
            midpoint = stiffness * (time - at + 0.5 * length)
            pull = _combined(1.0, external, midpoint, aimed)
            self.translation.advance(length, command=force, external=pull, substeps=fine)
            if self.six_dof:
                self.rotation.advance(length, command=torque, external=NOTHING, substeps=fine)
            time += length
        self._feel(external, aimed, where, went)
        if self.six_dof:
            turn = _combined(1.0, self.rotation.position, -1.0, turned)
            self.orientation = product(exponential(turn), self.orientation)
        # Without motors of rotation, the handle turns freely with the hand.
        elif stiffness > 0.0:
            self.orientation = action.aim_quaternion
        self._tick += 1
        before = self._sample
        rate = self.parameters.rate_Hz
        position = self._read_position()
        orientation = self._read_orientation()
        spin = NOTHING
        # For two equal quaternions the rotation would only be rounding noise.
        if orientation != before.quaternion:
            spin = _times(rate, turn_between(before.quaternion, orientation))
        velocity = _times(rate, _combined(1.0, position, -1.0, before.position_m))
        self._sample = Sample(self._tick * self._step, position, velocity, orientation, spin)

    def _feel(
        self, external: Triple, aim_velocity_m_s: Triple, where: Triple, went: Triple
    ) -> None:
        """Compute the force on the hand in this tick.

        The force balances the acceleration of the hand's mass, the spring and damper of the grip,
        and the hand's own push. All terms are means over the tick.
        """
        spring, damper, mass = self.translation.hand
        rate = self.parameters.rate_Hz
        # Means over the tick: the target moves half a step, and the position is the mean of start
        # and end.
        half = 0.5 * self._step
        (x0, y0, z0) = where
        (x1, y1, z1) = self.translation.position
        (u0, v0, w0) = went
        (u1, v1, w1) = self.translation.velocity
        (aim_x, aim_y, aim_z) = aim_velocity_m_s
        stretch_x = half * aim_x - 0.5 * (x0 + x1)
        stretch_y = half * aim_y - 0.5 * (y0 + y1)
        stretch_z = half * aim_z - 0.5 * (z0 + z1)
        pull_x, pull_y, pull_z = _combined(1.0, external, spring, (stretch_x, stretch_y, stretch_z))
        self.hand_force_N = (
            rate * (damper * (x1 - x0) + mass * (u1 - u0)) - pull_x,
            rate * (damper * (y1 - y0) + mass * (v1 - v0)) - pull_y,
            rate * (damper * (z1 - z0) + mass * (w1 - w0)) - pull_z,
        )

    def _read_position(self) -> Triple:
        """Return the position that the encoders read [m]."""
        return _stepped(self.translation.position, self.parameters.encoder_step_m)

    def _read_orientation(self) -> Quaternion:
        """Return the orientation that the encoders read."""
        if self.parameters.encoder_step_rad == 0.0:
            return self.orientation
        return exponential(_stepped(logarithm(self.orientation), self.parameters.encoder_step_rad))


def _stepped(vector: Triple, step: float) -> Triple:
    """Round each component of a vector to a multiple of ``step``; 0 means no rounding."""
    if step == 0.0:
        return vector
    (x, y, z) = vector
    return step * round(x / step), step * round(y / step), step * round(z / step)
