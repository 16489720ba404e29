"""What holds a body: nodes that are held at a given displacement, and springs to the ground."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["NodeSupports"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NodeSupports:
    """NodeSupports of the nodes of a grid, component by component.

    Attributes
    ----------
    fixed
        Components that are held, bool, shape (n, 3).
    displacement_m
        Where they are held [m], shape (n, 3); read only where fixed.
    spring_N_m
        Springs to the ground [N/m], shape (n, 3).
    """

    fixed: NDArray[np.bool_]
    displacement_m: Array
    spring_N_m: Array

    def __post_init__(self) -> None:
        shape = self.fixed.shape
        for name in ("displacement_m", "spring_N_m"):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must have the shape of fixed, {shape}, got {getattr(self, name).shape}")
        if not (self.spring_N_m >= 0.0).all():
            raise ValueError(f"spring_N_m must not be negative, got {self.spring_N_m.min():g}: leave it at 0 for none")

    @classmethod
    def of(
        cls,
        node_count: int,
        *,
        held: NDArray[np.bool_] | None = None,
        displacement_m: Array | None = None,
        spring_N_m: Array | float = 0.0,
    ) -> "NodeSupports":
        """Hold whole nodes (``held``, shape (n,)) or components (shape (n, 3)), and spring any of them."""
        fixed = np.zeros((node_count, 3), dtype=np.bool_)
        if held is not None:
            fixed |= held if held.ndim == 2 else held[:, None]
        where = np.zeros((node_count, 3)) if displacement_m is None else np.where(fixed, displacement_m, 0.0)
        spring = np.zeros((node_count, 3)) + np.asarray(spring_N_m, dtype=np.float64)
        return cls(fixed, where, spring)

    @property
    def any(self) -> NDArray[np.bool_]:
        """Nodes that something holds, shape (n,)."""
        return np.asarray((self.fixed | (self.spring_N_m > 0.0)).any(axis=1))
