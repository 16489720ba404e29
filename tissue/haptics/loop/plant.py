"""Moving part of a device in a hand: equal axes, exact steps, and friction without chatter."""

from math import inf, sqrt

from meshes.base.errors import require_positive, require_range
from tissue.haptics.loop.sampled_loop import plant_step
from tissue.motion.quaternion import Triple

__all__ = ["Plant"]


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
        self._mass = require_positive("mass_kg", mass_kg, "give the device's apparent mass")
        self._damping = require_range("damping_N_s_m", damping_N_s_m, 0.0, 1e6, "use 0 for none")
        self._friction = require_range("friction_N", friction_N, 0.0, 1e6, "use 0 for none")
        self._amplifier = amplifier_Hz
        self.position: Triple = (0.0, 0.0, 0.0)
        self.velocity: Triple = (0.0, 0.0, 0.0)
        self.motor_force: Triple = (0.0, 0.0, 0.0)
        self.motor_work_J = 0.0
        self._hand: Triple = (0.0, 0.0, 0.0)

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
                    # static friction follows a motor force that changes within the substep
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
