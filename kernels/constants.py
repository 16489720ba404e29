"""Constants in double precision for kernels. Warp does not convert Python's number literals.

A variable that changes in a loop must be initialised with ``wp.float64(...)`` instead of a
constant. Warp does not allow a loop to change a constant.
"""

import warp as wp

ZERO = wp.float64(0.0)
HALF = wp.float64(0.5)
ONE = wp.float64(1.0)
TWO = wp.float64(2.0)
THREE = wp.float64(3.0)
