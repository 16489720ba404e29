"""The smallest change that is felt: Weber's law with a term for low levels."""

from dataclasses import dataclass
from math import exp

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range
from tissue.materials.constants import constants
from tissue.perception.observer import Observer

__all__ = ["QUANTITIES", "Weber", "weber", "weber_of"]

QUANTITIES = {"force": "offset_N", "torque": "offset_Nm", "stiffness": "offset_N_m"}
"""What thresholds are known of, and the name and unit of its low-level term."""


@dataclass(frozen=True, kw_only=True)
class Weber:
    """Threshold kappa (level + offset), discriminated in 75 % of two-interval trials (E6).

    Weber's law alone, kappa level, lets every change be felt at a level of zero; the offset is the level at which the
    threshold, as a share of the level, has doubled. Both are positive, so that every threshold is.

    Attributes
    ----------
    kappa
        Weber's fraction.
    offset
        Low-level term, in the unit of the level: N, N m or N/m.
    """

    kappa: float
    offset: float

    def __post_init__(self) -> None:
        require_range("kappa", self.kappa, 1e-4, 1.0, "use 0.07 for force")
        require_range("offset", self.offset, 1e-6, 1e6, "use 0.2 for force in N")

    def threshold(self, level: ArrayLike) -> Array:
        """Smallest change that is felt at levels of any shape, in their unit.

        Raises
        ------
        InputError
            If a level is negative or no number: levels are sizes.
        """
        levels = np.asarray(level, dtype=float)
        if not (levels >= 0.0).all():
            raise InputError(f"level must be a size of at least 0, got {level!r}: give the length of the vector")
        return self.kappa * (levels + self.offset)


def weber(quantity: str) -> Weber:
    """The population's median threshold of force [N], torque [N m] or stiffness [N/m], from ``perception.toml``.

    Raises
    ------
    InputError
        If the quantity is none of these.
    """
    if quantity not in QUANTITIES:
        raise InputError(f"quantity must be one of {', '.join(QUANTITIES)}, got {quantity}: choose one of these")
    known = constants("perception", quantity)
    return Weber(kappa=known["kappa"].value, offset=known[QUANTITIES[quantity]].value)


def weber_of(observer: Observer, *, quantile: float = 0.5) -> Weber:
    """An observer's threshold of force [N], at a quantile of what is known of the fraction.

    A quantile below one half gives a threshold that is rather too small than too great: at 0.1 the person's own lies
    above it with a probability of 90 %.
    """
    spread = float(np.sqrt(max(observer.covariance[2, 2], 0.0)))
    return Weber(kappa=exp(observer.mean[2] + float(ndtri(quantile)) * spread), offset=observer.offset_N)
