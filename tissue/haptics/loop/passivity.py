"""Passivity observer and controller in the time domain (Hannaford and Ryu, 2002)."""

from collections import deque
from math import copysign, inf, sqrt

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive, require_range

__all__ = ["RELEASE_RAD_S", "PassivityControl", "PassivityObserver"]

SPEED_TICKS = 3
"""Number of ticks over which the speed is averaged."""
RELEASE_M_S, RELEASE_RAD_S = (0.03, 0.1), (1.2, 4.0)
"""Outward speeds at which the removal of an unpaid force begins and is complete [m/s], [rad/s].

They are far above the speeds of encoder steps and of a hand that rests on a wall. The rotational
values correspond to a handle of 25 mm.
"""
LEAST_N = 1e-6
"""Force below which a force counts as zero [N], such as the tail of a low-pass."""
STILL = 1e-6
"""Speed below which no energy can be dissipated [m/s]."""


class PassivityObserver:
    """Observer of the energy taken from the device, exact for a force that is held.

    A force F on the device that is held while the device moves by dx takes -F . dx from it. With
    the force of the last tick and the displacement since then, the sum is exact. It includes the
    energy that the hold leaks. A spring K that is entered and left at speed v returns K (v T)^2
    more per sample of depth than it took, half on entry and half on exit. A delayed force works on
    a later displacement. A known delay is also booked exactly.

    Parameters
    ----------
    delay_ticks
        Delay from the sample to the force at the motor, in addition to the hold [ticks]; any real
        number.

    Attributes
    ----------
    energy_J
        Energy taken so far [J]. If it is negative, the environment has created energy.
    """

    def __init__(self, *, delay_ticks: float = 0.0) -> None:
        require_range("delay_ticks", delay_ticks, 0.0, 400.0, "use 0 for none")
        whole = int(delay_ticks + 1e-9)
        self._delay = max(delay_ticks - whole, 0.0)
        self.energy_J = 0.0
        self._position: Array | None = None
        self._forces: deque[Array] = deque([np.zeros(3)] * (whole + 2), maxlen=whole + 2)

    def observe(self, position_m: Array) -> float:
        """Book the work of the acting forces up to this position [m]; return the energy [J]."""
        if self._position is not None:
            moved = position_m - self._position
            self.energy_J -= (1.0 - self._delay) * float(self._forces[1].dot(moved))
            self.energy_J -= self._delay * float(self._forces[0].dot(moved))
        self._position = position_m.copy()
        return self.energy_J

    def hold(self, force_N: Array) -> None:
        """Record the force [N] that is sent now."""
        self._forces.append(np.array(force_N))

    def pause(self) -> None:
        """Skip the motion to the next sample after missing samples; clear the pending forces."""
        self._position = None
        self._forces.extend([np.zeros(3)] * len(self._forces))

    def waiting_N(self) -> Array:
        """Return the pending forces, oldest first, shape (n, 3).

        Each force is weighted by its share of a tick.
        """
        waiting = np.array(self._forces)[1:]
        waiting[0] *= self._delay
        return waiting


class PassivityControl:
    """Controller that dissipates energy that an environment would create or has created.

    A force acts after the pending forces have acted. Until then, these forces push the device. Its
    speed along the force is therefore predicted as v + sum F T / m with the device's own mass,
    which overestimates the motion of a held device. The outward work of the pending forces and the
    new force at these speeds must not exceed the observed energy E. The excess is subtracted from
    the new force. If the device will move out fast, up to the whole force is removed. A damper -d v
    is added, which also dissipates a debt during entry. Damping is sampled too and would itself be
    unstable above m / T, so that d has an upper bound. Near rest no energy can be dissipated, and
    the debt remains. v is the mean speed over the last ticks, because encoder positions change in
    steps.

    An environment without force stores no energy. The energy taken until then has been dissipated.
    It is discarded, so that a later contact cannot use it. A debt remains.

    Parameters
    ----------
    damping_limit_N_s_m
        Upper bound of d [N s/m]; half of m / (T + t_d) is safe.
    delay_ticks
        See `PassivityObserver`.
    mass_kg
        Mass moved by the forces [kg]; infinite for a motion that they do not change.

    Attributes
    ----------
    observer
        Energy observer, which books the played force.
    dissipated_J
        Energy that the controller has planned to dissipate so far [J].
    damping_N_s_m
        Force removed in the last step over the predicted speed [N s/m].
    release_speeds
        Outward speeds between which the removable share of the force rises from zero to one.
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
        """Return the force [N] to play instead of ``force_N`` for a step [s]."""
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
        speeds[-1] -= 0.5 * gained[-1]  # a device at rest is subject to its spring
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
        """Handle missing samples: the motion until the next sample is unknown.

        The force then fades and returns slowly, so that entry takes less energy than is booked. The
        energy taken until now is discarded so that exit cannot release it.
        """
        self.observer.pause()
        self.observer.energy_J = min(self.observer.energy_J, 0.0)
        self._places.clear()
