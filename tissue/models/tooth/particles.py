"""Material particles: a volume with a modulus and a layer, of which a drill takes a fraction away."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["FULL_STEPS", "ParticleSet"]

FULL_STEPS = 65535
"""Steps of a whole particle, the same as of a whole voxel."""
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ParticleSet:
    """Particles of a body, in the order in which the caller knows them.

    Attributes
    ----------
    position_m
        Positions [m], shape (n, 3).
    volume_m3
        Volume of each whole particle [m3], shape (n,).
    modulus_Pa
        Young's modulus [Pa], shape (n,).
    poisson_ratio
        Poisson's ratio, shape (n,). Trilinear cells lock as it nears 0.5.
    layer
        Layer, uint8, shape (n,).
    remaining
        What is left of each particle, in steps of 1/65535, uint16, shape (n,).
    """

    position_m: Array
    volume_m3: Array
    modulus_Pa: Array
    poisson_ratio: Array
    layer: NDArray[np.uint8]
    remaining: NDArray[np.uint16]

    def __post_init__(self) -> None:
        count = len(self.position_m)
        for name in ("volume_m3", "modulus_Pa", "poisson_ratio", "layer", "remaining"):
            if getattr(self, name).shape != (count,):
                raise ValueError(
                    f"{name} must have one value a particle, shape ({count},), got {getattr(self, name).shape}: "
                    "give arrays of one length"
                )
        if count == 0:
            raise ValueError("position_m must hold at least one particle, got none: give a body that fills some space")
        for name in ("volume_m3", "modulus_Pa"):
            least = float(getattr(self, name).min())
            if not least > 0.0:
                raise ValueError(f"{name} must be positive, got {least:g}: leave such particles out")
        low, high = float(self.poisson_ratio.min()), float(self.poisson_ratio.max())
        if not (low > -1.0 and high < 0.5):
            worst = high if high >= 0.5 else low
            raise ValueError(f"poisson_ratio must be in (-1, 0.5), got {worst:g}: use 0.49 for nearly incompressible")
        if not np.isfinite(self.position_m).all():
            raise ValueError("position_m must be finite, got NaN or infinity: check the transform that made it")

    @classmethod
    def uniform(
        cls, position_m: Array, *, volume_m3: float, modulus_Pa: float, poisson_ratio: float = 0.3
    ) -> "ParticleSet":
        """Whole particles of one size and one material."""
        count = len(position_m)
        return cls(
            np.asarray(position_m, dtype=np.float64),
            np.full(count, float(volume_m3)),
            np.full(count, float(modulus_Pa)),
            np.full(count, float(poisson_ratio)),
            np.zeros(count, dtype=np.uint8),
            np.full(count, FULL_STEPS, dtype=np.uint16),
        )

    @property
    def lame_Pa(self) -> Array:
        """Lame constants lambda and mu [Pa], shape (n, 2)."""
        modulus, ratio = self.modulus_Pa, self.poisson_ratio
        first = modulus * ratio / ((1.0 + ratio) * (1.0 - 2.0 * ratio))
        return np.stack([first, modulus / (2.0 * (1.0 + ratio))], axis=1)
