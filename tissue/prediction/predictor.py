"""Interface of a force predictor in a loop, and the zero-order hold."""

from typing import Protocol

import numpy as np

from meshes.base.arrays import Array

__all__ = ["AffineMap", "Hold", "Predictor", "interpolated"]

AffineMap = tuple[Array, Array]
"""Matrix M and offset c of a map M x + c."""


class Predictor(Protocol):
    """Predictor of the force on a device some ticks ahead of the last observation.

    Once a tick `observe` receives the device position and velocity and, in ticks with a tissue
    answer, the force. Then `predict` returns the expected force. Both have a fixed cost.
    """

    residual_N: float
    """Size of the last one-tick error [N]: expected minus measured newest force."""
    is_primary: bool
    """True if the last predicted force is the predictor's own, not its fallback's."""

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Update with the device's position [m] and velocity [m/s], shape (3,), and the force [N].

        The force acts on the device. It is None in a tick without a force.
        """
        ...

    def predict(self, ticks: float) -> Array:
        """Predict the force a number of ticks after the last observation [N], shape (3,).

        Zero ticks give the present force. The number of ticks need not be whole, because the delay
        of a force on its path to the motor is not, see `tissue.haptics.loop.motor_path`.
        """
        ...

    def pause(self) -> None:
        """Pause after a missing sample: the next sample does not follow the last."""
        ...


class Hold:
    """Zero-order hold: the baseline that keeps the last force."""

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
        """Do nothing: the hold does not depend on the ticks between forces."""


def interpolated(before: AffineMap, after: AffineMap, share: float) -> AffineMap:
    """Return the linear interpolation of two maps, exact at the shares 0 and 1."""
    return (1.0 - share) * before[0] + share * after[0], (1.0 - share) * before[1] + share * after[
        1
    ]
