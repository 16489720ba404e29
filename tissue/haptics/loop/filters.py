"""Processing of a force before the device plays it: low-pass, delay, range and slew limit."""

from collections import deque
from dataclasses import dataclass
from math import exp, expm1, inf, sqrt

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive, require_range

VELOCITY_MEMORY = 0.85
"""Memory (see `constant_acceleration_map`) of the filter for the velocity of a device.

For simulated hands in all scenes, this value has the smallest error of all filters with at most 4
ms of delay. The error is 41 % of the velocity. For the difference of two positions, the error is
212 %; see tests/bench/bench_velocity.py.
"""
OBSERVER_MEMORY = 0.93
"""Memory of the position observer, which filters the device position for a cutting tool.

The value is a compromise. A larger memory smooths encoder steps more, but lowers the critical
stiffness of the loop (tests/tissue/haptics/test_velocity.py). An encoder step of 55 um changes the
observed position by 11 um in the same tick (1 - 0.93^3 of the step), and by less in each later
tick.
"""


def low_pass_gain(time_constant_s: float, step_s: float) -> float:
    """Return the gain 1 - exp(-T / a) per step T of the low-pass 1 / (1 + a s).

    In each step, the output moves by the gain times the difference between input and output. The
    time constant a is in seconds. For a = 0, there is no filter and the gain is 1. The amplitude
    falls to 1 / sqrt(2) at the frequency 1 / (2 pi a).
    """
    require_range(
        "time_constant_s", time_constant_s, 0.0, 10.0, "use 0 for no filter, or 1e-3 for 159 Hz"
    )
    require_positive("step_s", step_s, "use 1e-3 for 1 kHz")
    return -expm1(-step_s / time_constant_s) if time_constant_s > 0.0 else 1.0


class LowPass:
    """First-order low-pass of a vector u: y += (1 - exp(-T / a)) (u - y).

    T is the time step, and a the time constant. The output y is exact for an input that is constant
    during each step.
    """

    def __init__(self, time_constant_s: float, *, step_s: float) -> None:
        self.gain = low_pass_gain(time_constant_s, step_s)
        self.value: Array = np.zeros(3)

    def step(self, target: Array) -> Array:
        """Advance the output one step towards the target, and return a copy of it, shape (3,)."""
        self.value += self.gain * (target - self.value)
        return self.value.copy()


def constant_acceleration_map(memory: float) -> tuple[Array, Array]:
    """Return matrix M, shape (3, 3), and gains g, shape (3,), of the filter s' = M s + g x.

    A new position x changes the state from s to s'. The three entries of a state are the position,
    the velocity per tick, and the acceleration per tick squared. The filter of Morrison (1969) fits
    a parabola to all previous samples. The weight of a sample is `memory` to the power of its age.
    The result is an alpha-beta-gamma filter with three poles equal to the memory. For a constant
    acceleration, the estimate has no delay.
    """
    fresh = 1.0 - memory
    # Gains of the fading-memory polynomial filter of second order (Morrison, 1969).
    gains = np.array([1.0 - memory**3, 1.5 * fresh**2 * (1.0 + memory), fresh**3])
    onward = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    return onward - np.outer(gains, onward[0]), gains


class ConstantAcceleration:
    """Estimator of the velocity of a vector, with the filter of `constant_acceleration_map`.

    Parameters
    ----------
    memory
        Weight of a sample relative to the weight of the next sample.
    step_s
        Time between two samples [s].
    """

    def __init__(self, memory: float, *, step_s: float) -> None:
        self._map, self._gains = constant_acceleration_map(memory)
        self._rate = 1.0 / step_s
        self._state: Array | None = None

    def step(self, position: Array) -> Array:
        """Update with a position, shape (n,), and return the velocity per second, shape (n,).

        The velocity after the first sample is zero.
        """
        if self._state is None:
            self._state = np.zeros((3, len(position)))
            self._state[0] = position
        self._state = self._map.dot(self._state)
        self._state += self._gains[:, None] * position
        return self.velocity

    @property
    def velocity(self) -> Array:
        """Velocity estimated from the samples, per second, shape (n,)."""
        assert self._state is not None
        estimate: Array = self._rate * self._state[1]
        return estimate

    @property
    def position(self) -> Array:
        """Position estimated from the samples, shape (n,)."""
        assert self._state is not None
        estimate: Array = self._state[0]
        return estimate

    def pause(self) -> None:
        """Reset after missing samples; the velocity after the next sample is zero."""
        self._state = None


class DelayLine:
    """Delay of a vector by a whole number of samples.

    The output is zero until the first value has passed the delay.
    """

    def __init__(self, samples: int) -> None:
        self._queue = deque([np.zeros(3)] * samples)

    def step(self, value: Array) -> Array:
        """Append a value, and return the delayed value."""
        self._queue.append(value.copy())
        return self._queue.popleft()


class SlewLimit:
    """Vector that moves along a straight line towards a target, with a limited change per step.

    Parameters
    ----------
    most
        Largest change in a step; infinite for no limit.

    Attributes
    ----------
    value
        Present value, shape (3,).
    limited
        Number of steps in which the limit was active.
    """

    def __init__(self, most: float) -> None:
        self._most = most
        self.value: Array = np.zeros(3)
        self.limited = 0

    def step(self, wanted: Array) -> Array:
        """Move towards ``wanted``, and return the new value.

        The new value is ``wanted`` if the change is within the limit.
        """
        change = wanted - self.value
        square = float(change.dot(change))
        if square <= self._most * self._most:
            self.value = wanted
        else:
            self.limited += 1
            self.value = self.value + change * (self._most / sqrt(square))
        return self.value


KNEE = 0.7
"""Force at which the compression begins, divided by the largest force of the device.

The value is a design choice. Compressed forces are in the upper 30 % of the range.
"""


@dataclass(frozen=True, kw_only=True)
class ForceRange:
    """Compression of a force into the range of a device.

    The direction is kept. The magnitude F is unchanged up to a knee. Above the knee, the magnitude
    is compressed. The result increases with the force, and approaches the limit without exceeding
    it::

        F                                                              F <= knee
        knee + (limit - knee) (1 - exp(-(F - knee) / (limit - knee)))  otherwise

    The law has a continuous first derivative and is invertible.

    Attributes
    ----------
    limit_N
        Largest force [N] or torque [N m] of the device.
    """

    limit_N: float

    def __post_init__(self) -> None:
        require_positive("limit_N", self.limit_N, "give the device's largest force")

    @property
    def knee_N(self) -> float:
        """Force at which the compression begins [N]."""
        return KNEE * self.limit_N

    def play(self, force: Array) -> tuple[Array, bool]:
        """Return the force after compression, and True if the force was above the knee.

        Raises
        ------
        InputError
            If the force is not finite.
        """
        x, y, z = np.asarray(force).tolist()
        size = sqrt(x * x + y * y + z * z)
        if not size < inf:
            raise InputError(
                "force", "be finite", force, "use a SampleGuard, which removes such samples"
            )
        knee = self.knee_N
        if size <= knee:
            return force.copy(), False
        above = self.limit_N - knee
        played = knee + above * (1.0 - exp(-(size - knee) / above))
        return force * (played / size), True
