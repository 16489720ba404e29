"""Arrays by what they hold."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Ints"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
