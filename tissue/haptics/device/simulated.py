"""Device simulated between its ticks, together with the hand that holds it."""

from collections import deque
from collections.abc import Iterable
from math import ceil, inf, isfinite, sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.device.device import ComputedDevice, DeviceParameters, Sample
from tissue.haptics.hand.hand import Grip, HandAction, HoldingHand
from tissue.haptics.loop.sampled_loop import plant_step
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

__all__ = ["Plant", "SimulatedDevice"]


class Plant:
    """Mass with viscous and Coulomb friction behind an amplifier, held by a spring and a damper.

    The axes x, y and z have equal parameters. Between changes of its inputs, the linear part is
    stepped with the matrix exponential. Coulomb friction is one force against the velocity vector,
    of at most ``friction_N``. It is computed implicitly: acting over the substep, it either stops
    the mass or has its full magnitude against the velocity that the mass would have without it. A
    mass at rest stays exactly at its position until the other forces exceed the friction.

    For a rotation, the units are rotation vector [rad], kg m2, N m s/rad and N m. The code uses
    plain floats, which for three axes are several times faster than arrays.

    Parameters
    ----------
    mass_kg, damping_N_s_m, friction_N
        Apparent mass [kg], viscous friction [N s/m] and Coulomb friction [N] of the device.
    amplifier_Hz
        Bandwidth of the amplifier [Hz]; infinite for no lag.

    Attributes
    ----------
    position, velocity, motor_force
        State of the three axes [m], [m/s], [N].
    motor_work_J
        Work that the motors have done on the mass so far [J].
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
        self._hand: Triple = NOTHING

    def hold(self, *, stiffness_N_m: float, damping_N_s_m: float, mass_kg: float) -> None:
        """Attach the plant to a linear hand, or release it with zeros.

        The aim of the hand enters as an external force.
        """
        self._hand = (stiffness_N_m, damping_N_s_m, mass_kg)

    def advance(
        self, step_s: float, *, command: Triple, external: Triple, substeps: int = 1
    ) -> None:
        """Advance one step with both forces held [N]; friction is computed in every substep."""
        if self._amplifier == inf:
            self.motor_force = command
        stiffness, damping, mass = self._hand
        (xx, xv, xf, xu, xw), (vx, vv, vf, vu, vw), (_, _, ff, fu, _) = plant_step(
            self._mass + mass,
            self._damping + damping,
            stiffness,
            self._amplifier,
            step_s / substeps,
        )
        stop = self._friction * vw
        position = self.position
        velocity = self.velocity
        motor = self.motor_force
        for _ in range(substeps):
            before = position
            resting = not any(velocity)
            axes = list(zip(position, velocity, motor, command, external, strict=True))
            position = _triple(xx * x + xv * v + xf * f + xu * u + xw * w for x, v, f, u, w in axes)
            velocity = _triple(vx * x + vv * v + vf * f + vu * u + vw * w for x, v, f, u, w in axes)
            if stop > 0.0:
                speed = sqrt(sum(v * v for v in velocity))
                share = 1.0 if speed <= stop else stop / speed
                ratio = share * xw / vw
                position = _triple(x - ratio * v for x, v in zip(position, velocity, strict=True))
                velocity = _triple((1.0 - share) * v for v in velocity)
                if share == 1.0 and resting:
                    # static friction follows a motor force that changes within the substep
                    position = before
            driven = motor
            motor = _triple(ff * f + fu * u for f, u in zip(motor, command, strict=True))
            self.motor_work_J += 0.5 * sum(
                (f + g) * (x - a)
                for f, g, x, a in zip(driven, motor, position, before, strict=True)
            )
        self.position = position
        self.velocity = velocity
        self.motor_force = motor


class SimulatedDevice(ComputedDevice):
    """Device with known physics in a simulated hand.

    The device has its own ticks. At each tick, its encoders sample the position, and its velocity
    is the difference to the previous sample. The last command is held and reaches the motors after
    the transport delay. The delay is exact even if it is not a whole number of ticks. Between
    ticks, the plant is integrated in smaller steps.

    A command beyond the largest force or torque is shortened to it and counted. A non-finite
    command is played as zero and counted.

    Parameters
    ----------
    parameters
        Device parameters.
    hand
        Hand that holds the device; None for no hand.
    position_m
        Start position [m].
    substeps
        Integration steps of the plant per tick; they affect only friction.

    Attributes
    ----------
    translation, rotation
        Moving parts with the true state, which the encoders quantise.
    orientation
        True orientation.
    hand_force_N
        Force with which the device pushes the hand [N], mean over the tick before the last sample;
        zeros without a hand.
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
        whole = int(parameters.transport_delay_s / step + 1e-9)
        delay = parameters.transport_delay_s - whole * step
        fine = lambda length: max(ceil(substeps * length / step - 1e-9), 1)  # noqa: E731
        self._spans = (
            ((delay, whole + 1, fine(delay)), (step - delay, whole, fine(step - delay)))
            if delay > 1e-9 * step
            else ((step, whole, substeps),)
        )
        self._commands: deque[tuple[Triple, Triple]] = deque(
            [(NOTHING, NOTHING)] * (whole + 2), maxlen=whole + 2
        )
        self._given: tuple[Triple, Triple] = (NOTHING, NOTHING)
        self._tick = 0
        self._grip = Grip()
        self._sample = Sample(0.0, self._read_position(), quaternion=self._read_orientation())

    @property
    def six_dof(self) -> bool:
        """True if the device can play a torque."""
        return self.parameters.torque_limit_Nm > 0.0

    @property
    def true_position_m(self) -> Triple:
        """True position of the tip, which the encoders quantise [m]."""
        return self.translation.position

    def read(self, time_s: float) -> Sample | None:
        """Advance to the last device tick that is not after ``time_s``, and return its sample."""
        due = int(time_s * self.parameters.rate_Hz + 1e-6)
        while self._tick < due:
            self._advance()
        return self._sample

    def command(self, force_N: Array, torque_Nm: Array) -> None:
        """Play a force and a torque from the next span on, until the next command."""
        limits = self.parameters
        self._given = (
            self._limited(force_N, limits.force_limit_N),
            self._limited(torque_Nm, limits.torque_limit_Nm) if self.six_dof else NOTHING,
        )

    def _limited(self, wanted: Array, limit: float) -> Triple:
        """Return a vector shortened to a limit."""
        x, y, z = np.asarray(wanted).tolist()
        size = sqrt(x * x + y * y + z * z)
        if not isfinite(size):
            self.refused_commands += 1
            return NOTHING
        if size <= limit:
            return x, y, z
        self.saturated_ticks += 1
        share = limit / size
        return share * x, share * y, share * z

    def _advance(self) -> None:
        """Advance one tick of the device: move the hand and the plants, and read the encoders."""
        at = self._tick * self._step
        action = (
            HandAction() if self._hand is None else self._hand.act(at, self.translation.position)
        )
        if action.grip != self._grip:
            self._hold(action.grip)
        self._commands.append(self._given)
        # Scalar arithmetic on three numbers is faster than vectors.
        stiffness = self._grip.stiffness_N_m
        damping = self._grip.damping_N_s_m
        aims = list(zip(action.aim_m, action.aim_velocity_m_s, action.push_N, strict=True))
        external = _triple(stiffness * a + damping * u + f for a, u, f in aims)
        turned = NOTHING
        if self.six_dof:
            turned = turn_between(action.aim_quaternion, self.orientation)
            self.rotation.position = turned
        time = at
        moves = self.translation
        where = moves.position
        went = moves.velocity
        for length, back, fine in self._spans:
            force, torque = self._commands[-1 - back]
            # The aim moves within the tick; the mean pull of the spring is second-order accurate
            # at its middle.
            midpoint = stiffness * (time - at + 0.5 * length)
            pull = _triple(
                e + midpoint * u for e, u in zip(external, action.aim_velocity_m_s, strict=True)
            )
            moves.advance(length, command=force, external=pull, substeps=fine)
            if self.six_dof:
                self.rotation.advance(length, command=torque, external=NOTHING, substeps=fine)
            time += length
        # The force on the hand follows from the momentum of the mass that moves with the hand, and
        # from its spring and damper.
        rate = self.parameters.rate_Hz
        half = 0.5 * self._step
        mass = self._grip.mass_kg
        self.hand_force_N = _triple(
            rate * (damping * (x - a) + mass * (v - b))
            - (e + stiffness * (half * u - 0.5 * (a + x)))
            for x, v, a, b, e, u in zip(
                moves.position,
                moves.velocity,
                where,
                went,
                external,
                action.aim_velocity_m_s,
                strict=True,
            )
        )
        if self.six_dof:
            turn = _difference(self.rotation.position, turned)
            self.orientation = product(exponential(turn), self.orientation)
        elif stiffness > 0.0:
            self.orientation = action.aim_quaternion
        self._tick += 1
        before = self._sample
        position = self._read_position()
        orientation = self._read_orientation()
        spin = NOTHING
        if orientation != before.quaternion:
            spin = _triple(rate * w for w in turn_between(before.quaternion, orientation))
        velocity = _triple(rate * v for v in _difference(position, before.position_m))
        self._sample = Sample(self._tick * self._step, position, velocity, orientation, spin)

    def _hold(self, grip: Grip) -> None:
        """Attach the device to a grip, or release it."""
        self._grip = grip
        self.translation.hold(
            stiffness_N_m=grip.stiffness_N_m, damping_N_s_m=grip.damping_N_s_m, mass_kg=grip.mass_kg
        )
        self.rotation.hold(
            stiffness_N_m=grip.stiffness_Nm_rad,
            damping_N_s_m=grip.damping_Nm_s_rad,
            mass_kg=grip.inertia_kg_m2,
        )

    def _read_position(self) -> Triple:
        """Return the position that the encoders read [m]."""
        return _stepped(self.translation.position, self.parameters.encoder_step_m)

    def _read_orientation(self) -> Quaternion:
        """Return the orientation that the encoders read."""
        if self.parameters.encoder_step_rad == 0.0:
            return self.orientation
        return exponential(_stepped(logarithm(self.orientation), self.parameters.encoder_step_rad))


def _triple(numbers: Iterable[float]) -> Triple:
    x, y, z = numbers
    return x, y, z


def _difference(end: Triple, start: Triple) -> Triple:
    return end[0] - start[0], end[1] - start[1], end[2] - start[2]


def _stepped(vector: Triple, step: float) -> Triple:
    """Return the nearest point of a grid."""
    return vector if step == 0.0 else _triple(step * round(x / step) for x in vector)
