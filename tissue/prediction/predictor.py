"""What a loop asks of a predictor, and the one that knows nothing but the last force."""

from typing import Protocol

import numpy as np

from meshes.base.arrays import Array

__all__ = ["AffineMap", "Hold", "Predictor", "interpolated"]

AffineMap = tuple[Array, Array]
"""Matrix M and offset c of a map M x + c."""


class Predictor(Protocol):
    """Predicts the force on a device some ticks ahead of what has been seen of it.

    Once a tick `observe` gets where the device is and, in ticks in which the tissue has answered,
    the force; then `predict` gives the force to be expected. Both keep to a fixed cost.
    """

    residual_N: float
    """Size of the last one-tick error [N]: what was expected for the newest force, less that
    force.
    """
    is_primary: bool
    """Whether the last predicted force is the predictor's, not that of its fallback."""

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Take in the device's position [m] and velocity [m/s], shape (3,), and the force on it
        [N], or None.
        """
        ...

    def predict(self, ticks: float) -> Array:
        """Force to be expected so many ticks after the last observation [N], shape (3,); 0 is the
        present one.

        Ticks need not be whole: what delays a force on its path to the motor is not, see
        `tissue.haptics.loop.motor_path`.
        """
        ...

    def pause(self) -> None:
        """No sample came, so that the next one does not follow the last."""
        ...


class Hold:
    """The baseline: the last force stays."""

    residual_N = 0.0
    is_primary = True

    def __init__(self) -> None:
        self._force = np.zeros(3)

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Keep the force."""
        if force_N is not None:
            change = force_N - self._force
            self.residual_N = float(np.sqrt(change @ change))
            self._force = force_N.copy()

    def predict(self, ticks: float) -> Array:
        """The last force."""
        return self._force

    def pause(self) -> None:
        """Nothing depends on the ticks between forces."""


def interpolated(before: AffineMap, after: AffineMap, share: float) -> AffineMap:
    """The map at a share of the step from one to the next, on a straight line; exactly theirs at
    0 and 1.
    """
    return (1.0 - share) * before[0] + share * after[0], (1.0 - share) * before[1] + share * after[
        1
    ]
