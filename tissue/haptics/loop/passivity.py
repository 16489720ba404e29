"""Passivity observer and controller in the time domain (Hannaford and Ryu, 2002)."""

from collections import deque
from math import copysign, inf, sqrt

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive, require_range

__all__ = ["RELEASE_RAD_S", "PassivityControl", "PassivityObserver"]

SPEED_TICKS = 3
"""Ticks over which the speed is taken."""
RELEASE_M_S, RELEASE_RAD_S = (0.03, 0.1), (1.2, 4.0)
"""Outward speeds from which a force without energy begins to be taken off, and is taken off whole:
far above those of an encoder's steps, and of a hand that rests on a wall. In radians for a handle
of 25 mm."""
LEAST_N = 1e-6
"""Force that counts as none [N], such as the end of a low-pass."""
STILL = 1e-6
"""Speed below which nothing can be paid [m/s]."""


class PassivityObserver:
    """Books the energy that a sampled environment has taken from the device, exactly for a force
    that is held.

    A force F on the device that is held while the device moves by dx takes -F . dx from it. With
    the force of the last tick and the displacement since then the sum is exact, and shows what the
    hold leaks: a spring K that is entered and left at speed v gives back K (v T)^2 more for every
    sample of depth than it took, half in and half out. A force that acts later works on a later
    displacement; with a known delay that is booked exactly, too.

    Parameters
    ----------
    delay_ticks
        From the sample to the force at the motor, besides the hold [ticks]; any real number.

    Attributes
    ----------
    energy_J
        Taken so far [J]; below zero, the environment has created energy.
    """

    def __init__(self, *, delay_ticks: float = 0.0) -> None:
        require_range("delay_ticks", delay_ticks, 0.0, 400.0, "use 0 for none")
        whole = int(delay_ticks + 1e-9)
        self._delay = max(delay_ticks - whole, 0.0)
        self.energy_J = 0.0
        self._position: Array | None = None
        self._forces: deque[Array] = deque([np.zeros(3)] * (whole + 2), maxlen=whole + 2)

    def observe(self, position_m: Array) -> float:
        """Book what the acting forces did up to this position [m]; the energy [J]."""
        if self._position is not None:
            moved = position_m - self._position
            self.energy_J -= (1.0 - self._delay) * float(self._forces[1].dot(moved))
            self.energy_J -= self._delay * float(self._forces[0].dot(moved))
        self._position = position_m.copy()
        return self.energy_J

    def hold(self, force_N: Array) -> None:
        """The force [N] that is sent out now."""
        self._forces.append(np.array(force_N))

    def pause(self) -> None:
        """Samples are missing: what happens until the next one is not booked, and no force is
        pending then.
        """
        self._position = None
        self._forces.extend([np.zeros(3)] * len(self._forces))

    def waiting_N(self) -> Array:
        """Forces that were sent out and have not acted yet, each by its share of a tick, oldest
        first, shape (n, 3).
        """
        waiting = np.array(self._forces)[1:]
        waiting[0] *= self._delay
        return waiting


class PassivityControl:
    """Holds back what an environment is about to create, and pays back what it has created.

    A force acts when the pending ones have acted. Until then they go on pushing the device, so its
    speed along the force is predicted as v + sum F T / m with the device's own mass, which
    overstates what a held device does. The work that the pending forces and the new one would do at
    those speeds, as far as they drive the device out, must not exceed the energy E in the
    observer's ledger. What exceeds it is taken off the new force: where the device will move out
    fast, as far as to nothing; and a damper -d v is added, which also pays a debt while going in. d
    has an upper bound, because damping is sampled, too: beyond m / T it would itself be unstable.
    Near rest nothing can be paid and the debt waits. v is the mean speed over the last ticks, for
    encoders step.

    An environment that exerts no force stores nothing, so what was taken until then has been
    dissipated: it is struck off, lest a later contact should live on it. A debt stays.

    Parameters
    ----------
    damping_limit_N_s_m
        Upper bound of d [N s/m]; a half of m / (T + t_d) is safe.
    delay_ticks
        See `PassivityObserver`.
    mass_kg
        What the forces move [kg]; infinite for a motion that they do not change.

    Attributes
    ----------
    observer
        The ledger, which books the force that was played.
    dissipated_J
        What the control has planned to dissipate so far [J].
    damping_N_s_m
        What was taken off over the predicted speed in the last step [N s/m].
    release_speeds
        Outward speeds between which the force may be taken off whole.
    """

    def __init__(
        self, damping_limit_N_s_m: float, *, delay_ticks: float = 0.0, mass_kg: float = inf
    ) -> None:
        self._limit = require_positive(
            "damping_limit_N_s_m", damping_limit_N_s_m, "use a half of m / T"
        )
        self._mass = mass_kg
        self.observer = PassivityObserver(delay_ticks=delay_ticks)
        self.damping_N_s_m = self.dissipated_J = 0.0
        self.release_speeds = RELEASE_M_S
        self._places: deque[Array] = deque(maxlen=SPEED_TICKS + 1)

    def step(self, force_N: Array, position_m: Array, velocity_m_s: Array, step_s: float) -> Array:
        """The force [N] to play instead of ``force_N`` for a step [s]."""
        observer = self.observer
        places = self._places
        energy = observer.observe(position_m)
        places.append(position_m.copy())
        self.damping_N_s_m = 0.0
        size = sqrt(force_N.dot(force_N))
        if size < LEAST_N:
            if energy > 0.0 and np.abs(observer.waiting_N()).max() < LEAST_N:
                observer.energy_J = 0.0
            observer.hold(force_N)
            return force_N
        if len(places) > 1:
            velocity_m_s = (places[-1] - places[0]) / (step_s * (len(places) - 1))
        direction = force_N / size
        pushes = np.append(observer.waiting_N() @ direction, size)
        gained = (step_s / self._mass) * pushes
        speeds = float(velocity_m_s.dot(direction)) + np.cumsum(gained) - 0.5 * gained
        speeds[-1] -= 0.5 * gained[-1]  # a device at rest feels its spring
        speed = float(speeds[-1])
        left = energy - step_s * float(pushes.dot(np.maximum(speeds, 0.0)))
        played = force_N
        if left < 0.0 and abs(speed) > STILL:
            slow, fast = self.release_speeds
            released = min(max((speed - slow) / (fast - slow), 0.0), 1.0)
            most = self._limit * abs(speed) + released * size
            taken = min(-left / (step_s * abs(speed)), most)
            self.damping_N_s_m = taken / abs(speed)
            self.dissipated_J += taken * abs(speed) * step_s
            played = force_N - copysign(taken, speed) * direction
        observer.hold(played)
        return played

    def pause(self) -> None:
        """Samples are missing: nothing is known of the motion until the next one.

        The force fades then and comes back slowly, so that less is taken while going in than is
        booked: what was taken until now is struck off, lest going out should spend it.
        """
        self.observer.pause()
        self.observer.energy_J = min(self.observer.energy_J, 0.0)
        self._places.clear()
