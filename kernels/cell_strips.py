"""Matrix-free product of a voxel grid's stiffness and a vector, for eight cells at once.

Each cell consists of eight cubes. Each cube has its own Lame constants and volume. The gradient of
the displacement is evaluated at the centre of each cube, at 1/4 or 3/4 of the cell's edges. The
"modes" X, Y, Z, XY, XZ, YZ and XYZ of a displacement component u_c are sums and differences of the
component's values at the corners, along the three axes. With the edge length h of the cell, the
gradient in the cube on the sides r, s and t (-1 or 1) along x, y and z is::

    4 h d_x u_c = X + s XY/2 + t XZ/2 + s t XYZ/4     (d_y and d_z likewise)

The computation takes 8 additions for all four pairs (s, t) together. The forces are computed by the
transposed additions. The gradient of some modes varies inside a cube, so one evaluation point per
cube does not resolve these modes fully. A stiffness against such unresolved modes is added, as in
:mod:`kernels.particle_stiffness`. The product needs 17 stored numbers and about 500 operations per
cell. A packed cell stiffness would need 324 numbers. The product is therefore limited by arithmetic
and not by memory bandwidth.

A strip consists of eight cells in a row along z, and a pencil consists of several strips. Vectors
have the layout of `LaneVector`. A strip has four edges along z. Along each edge, the values at the
lower nodes of the eight cells are consecutive in memory, and so are the values at the upper nodes.
Each thread processes one pencil. Pencils of one colour do not share nodes. The result has the same
bits on any number of threads.
"""

from functools import cache
from typing import Any

import warp as wp

from kernels.arrays import Int32s

LANES = 8
"""Number of cells in a strip."""
WEIGHTS = 17
"""Number of values stored per cell.

For each of the cell's eight cubes, the Lame constants lambda and mu are stored, multiplied by V /
(16 h^2). The last value is the modulus of the unresolved modes, multiplied by h / 12. V is the
remaining volume of a cube, and h is the edge length of the cell.
"""
OPTIONS = {
    "max_unroll": 1,
    "cpu_compiler_flags": "-march=native -mllvm=-inline-threshold=9000 "
    "-mllvm=-inline-cold-callsite-threshold=3000"
    " -mllvm=-slp-recursion-max-depth=12",
}
"""Module options of Warp. The compiler flags are Warp's defaults except the recursion depth.

With Warp's default depth of 4, the kernel takes 2.5 times as long. The flag ``native`` is safe even
if several machines share a cache, because the name of every compiled file contains the instruction
sets of the processor.
"""


@cache
def lanes_of(scalar: Any) -> Any:
    """Return the Warp vector type with one value of type ``scalar`` for each cell of a strip."""
    return wp.types.vector(length=LANES, dtype=scalar)


@wp.func
def modes_of(a0: Any, a1: Any, a2: Any, a3: Any, a4: Any, a5: Any, a6: Any, a7: Any):
    """Compute the modes X, Y, Z, 2 XY, 2 XZ, 2 YZ and 4 XYZ of a cell from its corner values.

    The modes are sums and differences of the corner values along z, then y, then x.
    """
    s00 = a0 + a1
    d00 = a1 - a0
    s01 = a2 + a3
    d01 = a3 - a2
    s10 = a4 + a5
    d10 = a5 - a4
    s11 = a6 + a7
    d11 = a7 - a6
    sd0 = s01 - s00
    ds0 = d00 + d01
    dd0 = d01 - d00
    sd1 = s11 - s10
    ds1 = d10 + d11
    dd1 = d11 - d10
    return (
        (s10 + s11) - (s00 + s01),
        sd0 + sd1,
        ds0 + ds1,
        sd1 - sd0,
        ds1 - ds0,
        dd0 + dd1,
        dd1 - dd0,
    )


@wp.func
def corners_of(x: Any, y: Any, z: Any, xy: Any, xz: Any, yz: Any, xyz: Any):
    """Compute the forces at a cell's corners from modal forces (transpose of `modes_of`)."""
    dd0 = yz - xyz
    dd1 = yz + xyz
    ds0 = z - xz
    ds1 = z + xz
    sd0 = y - xy
    sd1 = y + xy
    s00 = -x - sd0
    s01 = sd0 - x
    s10 = x - sd1
    s11 = x + sd1
    d00 = ds0 - dd0
    d01 = ds0 + dd0
    d10 = ds1 - dd1
    d11 = ds1 + dd1
    return s00 - d00, s00 + d00, s01 - d01, s01 + d01, s10 - d10, s10 + d10, s11 - d11, s11 + d11


@wp.func
def to_cubes(linear: Any, first: Any, second: Any, both: Any):
    """Compute the derivative, along one axis, of a displacement component in each of four cubes.

    The cubes lie on the sides (-, -), (-, +), (+, -) and (+, +) of the cell along the two other
    axes. The arguments are modes of the displacement component: the linear mode along the axis, the
    two bilinear modes that contain the axis, and the trilinear mode.
    """
    low = linear - first
    high = linear + first
    less = second - both
    more = second + both
    return low - less, low + less, high - more, high + more


@wp.func
def from_cubes(t0: Any, t1: Any, t2: Any, t3: Any):
    """Apply the transpose of `to_cubes`."""
    low = t1 - t0
    high = t3 - t2
    return (t0 + t1) + (t2 + t3), (t2 + t3) - (t0 + t1), low + high, high - low


@cache
def strip_products(scalar: Any) -> Any:
    """Return a kernel that adds the product of the stiffness and a vector to a force vector.

    ``scalar`` is `wp.float32` or `wp.float64`.
    """
    V = lanes_of(scalar)
    Strips = wp.array(dtype=V)
    Strips2D = wp.array2d(dtype=V)
    half, quarter, two = scalar(0.5), scalar(0.25), scalar(2.0)
    # Energy of the gradients of XYZ in a full cell with Lame constants of 1, divided by the weight
    # w of the other modes.
    trilinear = scalar(20.0 / 3.0)

    @wp.func
    def put(values: Strips, at: int, linear: V, first: V, second: V, both: V):
        """Write the four results of `to_cubes` to four entries of ``values``."""
        v0, v1, v2, v3 = to_cubes(linear, first, second, both)
        values[at] = v0
        values[at + 1] = v1
        values[at + 2] = v2
        values[at + 3] = v3

    @wp.func
    def take(stress: Strips, at: int, across: int, first: int, second: int):
        """Sum a stress along an axis, and compute the modes of the sum.

        `across`, `first` and `second` are the steps in the indices of ``stress`` along this axis
        and along the two other axes.
        """
        both = first + second
        return from_cubes(
            stress[at] + stress[at + across],
            stress[at + second] + stress[at + second + across],
            stress[at + first] + stress[at + first + across],
            stress[at + both] + stress[at + both + across],
        )

    @wp.func
    def set_gradient(
        vector: Strips2D,
        s: wp.vec4i,
        gradient_out: Strips,
        mode_out: Strips,
    ):
        """Compute gradients and unresolved modes of a strip from the corner values.

        Unresolved modes are the modes that one point per cube does not resolve.
        """
        for c in range(3):
            x, y, z, xy, xz, yz, xyz = modes_of(
                vector[c, s[0]],
                vector[c, s[0] + 1],
                vector[c, s[1]],
                vector[c, s[1] + 1],
                vector[c, s[2]],
                vector[c, s[2] + 1],
                vector[c, s[3]],
                vector[c, s[3] + 1],
            )
            xy = half * xy
            xz = half * xz
            yz = half * yz
            xyz = quarter * xyz
            mode_out[4 * c] = xy
            mode_out[4 * c + 1] = xz
            mode_out[4 * c + 2] = yz
            mode_out[4 * c + 3] = xyz
            put(gradient_out, 12 * c, x, xy, xz, xyz)
            put(gradient_out, 12 * c + 4, y, xy, yz, xyz)
            put(gradient_out, 12 * c + 8, z, xz, yz, xyz)

    @wp.func
    def set_stress(
        weight: Strips2D,
        k: int,
        gradient: Strips,
        stress_out: Strips,
    ):
        """Compute the weighted stress of a strip's cubes from their gradients."""
        for cube in range(8):
            across_x = cube & 3
            across_y = 4 + ((cube >> 2) << 1) + (cube & 1)
            across_z = 8 + (cube >> 1)
            mu = weight[k, 8 + cube]
            xx = gradient[across_x]
            yy = gradient[12 + across_y]
            zz = gradient[24 + across_z]
            pressure = wp.cw_mul(weight[k, cube], xx + yy + zz)
            twice = mu + mu
            at = 6 * cube
            stress_out[at] = pressure + wp.cw_mul(twice, xx)
            stress_out[at + 1] = pressure + wp.cw_mul(twice, yy)
            stress_out[at + 2] = pressure + wp.cw_mul(twice, zz)
            stress_out[at + 3] = wp.cw_mul(mu, gradient[12 + across_z] + gradient[24 + across_y])
            stress_out[at + 4] = wp.cw_mul(mu, gradient[across_z] + gradient[24 + across_x])
            stress_out[at + 5] = wp.cw_mul(mu, gradient[across_y] + gradient[12 + across_x])

    @wp.func
    def set_unseen(w: V, mode_out: Strips):
        """Replace the unresolved modes by the forces on these modes.

        Modes whose strains are linear in one of x, y and z are converted first. Modes whose strains
        are linear in two of these coordinates follow.
        """
        in_x = mode_out[4] + mode_out[9]
        in_y = mode_out[0] + mode_out[10]
        in_z = mode_out[1] + mode_out[6]
        yz_x = mode_out[8] + mode_out[5]
        xz_y = mode_out[8] + mode_out[2]
        xy_z = mode_out[5] + mode_out[2]
        mode_out[2] = wp.cw_mul(w, xz_y + xy_z)
        mode_out[5] = wp.cw_mul(w, yz_x + xy_z)
        mode_out[8] = wp.cw_mul(w, yz_x + xz_y)
        mode_out[0] = wp.cw_mul(w, in_y + mode_out[0] + two * mode_out[0])
        mode_out[1] = wp.cw_mul(w, in_z + mode_out[1] + two * mode_out[1])
        mode_out[4] = wp.cw_mul(w, in_x + mode_out[4] + two * mode_out[4])
        mode_out[6] = wp.cw_mul(w, in_z + mode_out[6] + two * mode_out[6])
        mode_out[9] = wp.cw_mul(w, in_x + mode_out[9] + two * mode_out[9])
        mode_out[10] = wp.cw_mul(w, in_y + mode_out[10] + two * mode_out[10])
        w = trilinear * w
        for c in range(3):
            mode_out[4 * c + 3] = wp.cw_mul(w, mode_out[4 * c + 3])

    @wp.func
    def add_force(
        stress: Strips,
        mode: Strips,
        s: wp.vec4i,
        force_out: Strips2D,
    ):
        """Add the forces at the corners of a strip's cells: the transpose of `set_gradient`."""
        for c in range(3):
            # indices of the stress along each axis; for c = 0, xx, xy and xz have the indices 0, 5
            # and 4
            across_x = wp.where(c == 0, 0, 6 - c)
            across_y = wp.where(c == 1, 1, 5 - c)
            x, of_xy, of_xz, of_xyz = take(stress, across_x, 24, 12, 6)
            xy = mode[4 * c] + of_xy
            xz = mode[4 * c + 1] + of_xz
            xyz = mode[4 * c + 3] + of_xyz
            y, of_xy, of_yz, of_xyz = take(stress, across_y, 12, 24, 6)
            xy = half * (xy + of_xy)
            yz = mode[4 * c + 2] + of_yz
            xyz = xyz + of_xyz
            z, of_xz, of_yz, of_xyz = take(stress, 4 - c, 6, 24, 12)
            xz = half * (xz + of_xz)
            yz = half * (yz + of_yz)
            xyz = quarter * (xyz + of_xyz)
            f0, f1, f2, f3, f4, f5, f6, f7 = corners_of(x, y, z, xy, xz, yz, xyz)
            force_out[c, s[0]] = force_out[c, s[0]] + f0
            force_out[c, s[0] + 1] = force_out[c, s[0] + 1] + f1
            force_out[c, s[1]] = force_out[c, s[1]] + f2
            force_out[c, s[1] + 1] = force_out[c, s[1] + 1] + f3
            force_out[c, s[2]] = force_out[c, s[2]] + f4
            force_out[c, s[2] + 1] = force_out[c, s[2] + 1] + f5
            force_out[c, s[3]] = force_out[c, s[3]] + f6
            force_out[c, s[3] + 1] = force_out[c, s[3] + 1] + f7

    @wp.kernel(module="unique", module_options=OPTIONS)
    def products(
        pencils: Int32s,  # pencils of one colour
        strip_start: Int32s,  # [pencil + 1], first strip of each pencil
        # [strip], slot of the lowest node at the corner edges (0, 0), (0, 1), (1, 0) and (1, 1)
        slot: wp.array(dtype=wp.vec4i),
        weight: Strips2D,  # [strip, WEIGHTS]
        vector: Strips2D,  # [component, slot], eight from the slot on
        offset: int,
        # out
        force_out: Strips2D,  # [component, slot], as above; the product is added
    ):
        """Compute strains and stresses of the cubes and forces of the corners, strip by strip."""
        pencil = pencils[wp.tid() + offset]
        gradient = wp.zeros(shape=(36,), dtype=V)  # [component, axis, cubes across it]
        mode = wp.zeros(shape=(12,), dtype=V)  # [component, (XY, XZ, YZ, XYZ)], then their forces
        stress = wp.zeros(shape=(48,), dtype=V)  # [cube, (xx, yy, zz, yz, xz, xy)]
        for k in range(strip_start[pencil], strip_start[pencil + 1]):
            set_gradient(vector, slot[k], gradient, mode)
            set_stress(weight, k, gradient, stress)
            set_unseen(weight[k, 16], mode)
            add_force(stress, mode, slot[k], force_out)

    return products
