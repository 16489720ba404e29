"""Passivity observer and controller in the time domain (Hannaford and Ryu, 2002)."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from meshes.errors import require_positive, require_range

__all__ = ["PassivityControl", "PassivityObserver"]

Array = NDArray[np.float64]


class PassivityObserver:
    """Books the energy that a sampled environment has taken from the device, exactly for a force that is held.

    A force F on the device that is held while the device moves by dx takes -F . dx from it. With the force of the last
    tick and the displacement since then the sum is exact, and shows what the hold leaks: a spring K that is entered and
    left at speed v gives back K (v T)^2 more for every sample of depth than it took, half of it on either way. A force
    that acts later works on a later displacement; with a known delay that is booked exactly, too.

    Parameters
    ----------
    delay_ticks
        From the sample to the force at the motor, beside the hold [ticks]; any real number.

    Attributes
    ----------
    energy_J
        Taken so far [J]; below zero, the environment has created energy.
    lowest_J
        Lowest value so far [J].
    """

    def __init__(self, *, delay_ticks: float = 0.0) -> None:
        require_range("delay_ticks", delay_ticks, 0.0, 400.0, "use 0 for none")
        whole = int(delay_ticks + 1e-9)
        self._late = max(delay_ticks - whole, 0.0)
        self.energy_J = 0.0
        self.lowest_J = 0.0
        self._position: Array | None = None
        self._forces: deque[Array] = deque([np.zeros(3)] * (whole + 2), maxlen=whole + 2)

    def observe(self, position_m: Array) -> float:
        """Book what the acting forces did on the way to this position [m]; the energy [J]."""
        if self._position is not None:
            moved = position_m - self._position
            self.energy_J -= (1.0 - self._late) * float(self._forces[1].dot(moved))
            self.energy_J -= self._late * float(self._forces[0].dot(moved))
            self.lowest_J = min(self.lowest_J, self.energy_J)
        self._position = position_m.copy()
        return self.energy_J

    def hold(self, force_N: Array) -> None:
        """The force [N] that is sent out now."""
        self._forces.append(np.array(force_N))

    def pause(self) -> None:
        """Samples are missing: what happens until the next one is not booked, and no force is on its way then."""
        self._position = None
        self._forces.extend([np.zeros(3)] * len(self._forces))

    def coming_N(self) -> Array:
        """Sum over ticks of the forces that were sent out and have not acted yet [N]."""
        waiting = list(self._forces)
        coming = self._late * waiting[1]
        for force in waiting[2:]:
            coming = coming + force
        return coming


class PassivityControl:
    """Pays back what an environment is about to create, by damping along the motion.

    If the force, and those on their way, would at the present velocity v bring the observer below zero, a force -d v is
    added with d = -E / (T v.v), E the energy that would be left and T the step. That also pays back what the errors of
    earlier predictions have left open. d has an upper bound, because damping is sampled, too: beyond m / T it would
    itself be unstable. Near rest nothing can be paid and the debt waits.

    An environment that exerts no force stores nothing, so what was taken until then has been dissipated: it is struck
    off, lest a later contact should live on it. A debt stays.

    Parameters
    ----------
    damping_limit_N_s_m
        Upper bound of d [N s/m]; a half of m / (T + t_d) is safe.
    delay_ticks
        See `PassivityObserver`.

    Attributes
    ----------
    observer
        The ledger, which books the force that was played.
    dissipated_J
        What the control has planned to dissipate so far [J].
    damping_N_s_m
        d in the last step [N s/m].
    """

    def __init__(self, damping_limit_N_s_m: float, *, delay_ticks: float = 0.0) -> None:
        self._limit = require_positive("damping_limit_N_s_m", damping_limit_N_s_m, "use a half of m / T")
        self._delayed = delay_ticks > 0.0
        self.observer = PassivityObserver(delay_ticks=delay_ticks)
        self.damping_N_s_m = self.dissipated_J = 0.0

    def step(self, force_N: Array, position_m: Array, velocity_m_s: Array, step_s: float) -> Array:
        """The force [N] to play instead of ``force_N`` for a step [s]."""
        observer = self.observer
        energy = observer.observe(position_m)
        coming = force_N + observer.coming_N() if self._delayed else force_N
        if energy > 0.0 and not any(coming.tolist()):
            observer.energy_J = energy = 0.0
        square = float(velocity_m_s.dot(velocity_m_s))
        left = energy - step_s * float(coming.dot(velocity_m_s))
        self.damping_N_s_m = 0.0
        played = force_N
        if left < 0.0 and square > 1e-12 and any(force_N.tolist()):
            self.damping_N_s_m = min(-left / (step_s * square), self._limit)
            self.dissipated_J += self.damping_N_s_m * square * step_s
            played = force_N - self.damping_N_s_m * velocity_m_s
        observer.hold(played)
        return played
