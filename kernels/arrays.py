"""Types of the arrays in arguments of kernels and in members of Warp structures.

The name of an array type states the type of the elements. If the array has more than one dimension,
a suffix states the number of dimensions. For example, `Doubles2D` is a matrix of numbers in double
precision.
"""

import warp as wp

Doubles = wp.array(dtype=wp.float64)
Doubles2D = wp.array2d(dtype=wp.float64)
Doubles3D = wp.array3d(dtype=wp.float64)
Singles = wp.array(dtype=wp.float32)
Singles2D = wp.array2d(dtype=wp.float32)
Singles3D = wp.array3d(dtype=wp.float32)

Int32s = wp.array(dtype=wp.int32)
Int32s2D = wp.array2d(dtype=wp.int32)
Int32s3D = wp.array3d(dtype=wp.int32)
Int64s = wp.array(dtype=wp.int64)
Int64s2D = wp.array2d(dtype=wp.int64)
"""Signed integers with 32 bits and with 64 bits."""

Bytes = wp.array(dtype=wp.uint8)
Shorts = wp.array(dtype=wp.uint16)
Shorts2D = wp.array2d(dtype=wp.uint16)
Words2D = wp.array2d(dtype=wp.uint32)
Bits = wp.array(dtype=wp.uint64)
"""Unsigned integers with 8, 16, 32 and 64 bits. Each bit of an element of `Bits` is a flag."""

Vectors = wp.array(dtype=wp.vec3d)
Vectors2D = wp.array2d(dtype=wp.vec3d)
Matrices = wp.array(dtype=wp.mat33d)
Matrices2D = wp.array2d(dtype=wp.mat33d)
SingleVectors = wp.array(dtype=wp.vec3f)
SingleMatrices = wp.array(dtype=wp.mat33f)
"""Vectors of 3 numbers and matrices of 3 x 3 numbers, in double and in single precision."""
