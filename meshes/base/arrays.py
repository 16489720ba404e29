"""Arrays by what they hold."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Bytes", "Flags", "Floats", "Ints", "Singles"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Floats = NDArray[np.floating]
Flags = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Singles = NDArray[np.float32]
