"""Types of arrays, and points of a lattice."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Array", "Bytes", "Flags", "Floats", "Ints", "Numbers", "Singles", "lattice"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Floats = NDArray[np.floating]
Numbers = NDArray[np.number]
Flags = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Singles = NDArray[np.float32]


def lattice(*axes: ArrayLike) -> Any:
    """Return all combinations of coordinates along axes, shape (n, axes), last axis fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
