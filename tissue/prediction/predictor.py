"""Interface of force predictors, contact data for predictors, and simple predictors."""

from collections import deque
from dataclasses import dataclass, field
from functools import lru_cache
from math import inf, sqrt
from typing import Protocol, runtime_checkable

import numpy as np

from meshes.base.arrays import Array


class Predictor(Protocol):
    """Interface of a predictor of the force on a device some ticks ahead.

    In every tick, `observe` receives the position and velocity of the device. In ticks with a
    response of the tissue, `observe` also receives the force. Then `predict` returns the predicted
    force. The duration of each call must be constant.
    """

    residual_N: float
    """Magnitude of the last one-tick error [N]: predicted force minus measured force."""
    is_primary: bool
    """True if the last predicted force is from the predictor and not from its fallback."""

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Update with position [m], velocity [m/s] and force [N] of the device, each of shape (3,).

        The force is the present force on the device. It is None in a tick without a response of the
        tissue.
        """
        ...

    def predict(self, ticks: float) -> Array:
        """Return the predicted force [N], shape (3,), at `ticks` ticks after the last observation.

        For zero ticks, the result is the present force. The number of ticks need not be a whole
        number, because the delay of a force on its path to the motor is not a whole number of
        ticks, see `tissue.haptics.loop.sampled_loop`.
        """
        ...

    def pause(self) -> None:
        """Reset after missing samples: the next sample is not one tick after the last one."""
        ...


class Hold:
    """Zero-order hold, the baseline: the predicted force is the last force."""

    residual_N = 0.0
    is_primary = True

    def __init__(self) -> None:
        self._force = np.zeros(3)

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Store the force."""
        if force_N is not None:
            change = force_N - self._force
            self.residual_N = float(np.sqrt(change @ change))
            self._force = force_N.copy()

    def predict(self, ticks: float) -> Array:
        """Return the last force."""
        return self._force

    def pause(self) -> None:
        """Do nothing, because the last force remains the prediction."""


@dataclass
class Contact:
    """State of a tool coupled to a device by a spring, and local law of the tissue.

    Lengths [m] and forces [N] at the tool are converted to lengths and forces at the device.

    Attributes
    ----------
    spring_N_m
        Stiffness of the coupling [N/m].
    tip_m
        Position of the tool [m], shape (3,). If no force acts, this is the position of the device.
    force_N
        Force of the tissue on the tool at this position [N], shape (3,).
    stiffness_N_m
        Stiffness -dF/dx of the tissue at the tool [N/m], shape (3, 3). None if the tissue does not
        provide its stiffness.
    gap_m
        Distance of a free tool from the tissue's surface [m]; infinite if the tissue gives no
        distance.
    normal
        Outward unit normal of the surface, shape (3,).
    surface_N_m
        Stiffness of the surface below a free tool, along the normal [N/m]; infinite if it is not
        known.
    cuts
        True for a tool that cuts. Cut tissue does not push the tool back to an earlier position,
        unlike elastic tissue.
    """

    spring_N_m: float
    tip_m: Array
    force_N: Array
    stiffness_N_m: Array | None = None
    gap_m: float = inf
    normal: Array = field(default_factory=lambda: np.zeros(3))
    surface_N_m: float = inf
    cuts: bool = False


@runtime_checkable
class SeesContact(Protocol):
    """Interface of a predictor that receives contact data in a tick before `observe` is called."""

    def meet(self, contact: Contact) -> None:
        """Copy the contact data that belong to the next observation."""
        ...


WINDOW = 10
"""Number of ticks over which `Linear` computes the slope of the force.

Values from 3 to 30 were compared. For predictions 4 to 8 ms ahead in recordings of the scene
`wall`, only a value of 8 has a smaller error. In scenes with slower motion, 10 is better than 8.
With a smaller value, an encoder step looks like a slope.
"""
JERKINESS = 1e-3
"""Variance of the third difference of the force, divided by the variance of the force noise.

`Kalman` uses this ratio. In recordings of the scene `wall`, values from 1e-8 to 1e-2 were compared,
and this value gave the smallest error.
"""


class Linear:
    """Predictor that extrapolates a straight line through the last and an earlier force."""

    residual_N = 0.0
    is_primary = trusted = True

    def __init__(self) -> None:
        self._clock = 0
        self._seen: deque[tuple[int, Array]] = deque([(0, np.zeros(3))])
        self._slope = np.zeros(3)

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Update with the force; position and velocity are not used."""
        self._clock += 1
        if force_N is None:
            return
        seen = self._seen
        missed = force_N - self.predict(0)
        self.residual_N = sqrt(missed.dot(missed))
        seen.append((self._clock, force_N.copy()))
        # One force at least as old as the window is kept, so that the line covers the whole window.
        while len(seen) > 2 and self._clock - seen[1][0] >= WINDOW:
            seen.popleft()
        since, first = seen[0]
        self._slope = (force_N - first) / max(self._clock - since, WINDOW)

    def predict(self, ticks: float) -> Array:
        """Return the force on the straight line after a number of ticks."""
        since, force = self._seen[-1]
        return force + (self._clock - since + ticks) * self._slope

    def pause(self) -> None:
        """Restart the line from the newest force, because samples are missing."""
        self._seen = deque([(self._clock, self._seen[-1][1])])
        self._slope = np.zeros(3)


@lru_cache
def kalman_gains(ticks: int, jerkiness: float) -> Array:
    """Return the steady-state Kalman gains, shape (3,), for a force and its first two derivatives.

    A force is observed every `ticks` ticks. The third derivative of the force is modelled as white
    noise. The gains solve the discrete Riccati equation (Kalman 1960).
    """
    from scipy.linalg import solve_discrete_are

    step = float(ticks)
    onward = np.array([[1.0, step, 0.5 * step**2], [0.0, 1.0, step], [0.0, 0.0, 1.0]])
    # Changes of force, first and second derivative by a constant third derivative during the step.
    noise = np.array([step**3 / 6.0, step**2 / 2.0, step])
    look = np.array([[1.0, 0.0, 0.0]])
    spread = solve_discrete_are(
        onward.T, look.T, jerkiness * np.outer(noise, noise) / step, np.eye(1)
    )
    gains: Array = spread[:, 0] / (spread[0, 0] + 1.0)
    return gains


class Kalman:
    """Predictor that extrapolates a parabola estimated by a steady-state Kalman filter.

    The filter assumes white noise in the third derivative of the force and in the observed force.
    """

    residual_N = 0.0
    is_primary = trusted = True

    def __init__(self) -> None:
        # Force, first and second derivative one tick later, in units of ticks.
        self._onward = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
        self._state = np.zeros((3, 3))
        self._since = 0
        self._force = np.zeros(3)

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Advance by a tick, and correct with the force; position and velocity are not used."""
        state = self._state = self._onward.dot(self._state)
        self._since += 1
        if force_N is not None:
            missed = force_N - state[0]
            self.residual_N = sqrt(missed.dot(missed))
            state += kalman_gains(self._since, JERKINESS)[:, None] * missed
            self._since = 0
            self._force = force_N.copy()

    def predict(self, ticks: float) -> Array:
        """Return the force on the estimated parabola after a number of ticks.

        For 0 ticks after an observed force, the result is the observed force.
        """
        if ticks == 0 and self._since == 0:
            return self._force
        return np.array((1.0, ticks, 0.5 * ticks * ticks)) @ self._state

    def pause(self) -> None:
        """Reset the derivatives of the force, because they belong to an earlier motion."""
        self._state[1:] = 0.0
