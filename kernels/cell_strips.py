"""Product of a voxel body's stiffness with a vector, eight cells of a row at once and without any stored matrix.

Each cell is eight cubes, each with its own Lame constants times volume, that are summed at their centres: at 1/4 and
3/4 of the cell's edges. In the sums and differences of the corners ("modes") of a component u_c along the three axes,
X, Y, Z, XY, XZ, YZ and XYZ, the gradient at the cube of signs (r, s, t) is::

    4 h d_x u_c = X + s XY/2 + t XZ/2 + s t XYZ/4     and so on,

which 8 additions give for all four (s, t); the forces come back through the transposed additions. To it come the modes
that one point does not see, as in :mod:`kernels.particle_stiffness`. A cell costs 17 numbers and some 500 operations,
where its packed stiffness has 324 numbers: the product is limited by arithmetic and not by memory.

A strip is eight cells in a row along z. Vectors lie in `LaneVector`'s layout, in which the eight nodes below and the
eight above a strip's corner are eight numbers in a row each. Strips of pencils of one colour share no node and every
thread works through one pencil: the same bits on any number of threads.
"""

from functools import cache
from typing import Any

import warp as wp

__all__ = ["LANES", "WEIGHTS", "lanes_of", "strip_products"]

LANES = 8
"""Cells of a strip."""
WEIGHTS = 17
"""Numbers a cell: lambda and mu of its cubes times V / 16 h^2, and the modulus of the unseen modes times h / 12."""
OPTIONS = {
    "enable_backward": False,
    "max_unroll": 1,
    "cpu_compiler_flags": "-march=native -mllvm=-inline-threshold=9000 -mllvm=-inline-cold-callsite-threshold=3000"
    " -mllvm=-slp-recursion-max-depth=12",  # 2.5 times faster than at the depth of 4 that is the default
}


@cache
def lanes_of(scalar: Any) -> Any:
    """Type of a strip's eight numbers."""
    return wp.types.vector(length=LANES, dtype=scalar)


@cache
def strip_products(scalar: Any) -> Any:
    """Kernel that adds the product to a force, in single (`wp.float32`) or double precision."""
    V = lanes_of(scalar)
    half, quarter, two = scalar(0.5), scalar(0.25), scalar(2.0)
    trilinear = scalar(20.0 / 3.0)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def products(
        pencils: wp.array(dtype=wp.int32),  # pencils of one colour
        strip_start: wp.array(dtype=wp.int32),  # [pencil + 1], first strip of each
        slot: wp.array(dtype=wp.vec4i),  # [strip], of its lowest node in the pencils (0, 0), (0, 1), (1, 0), (1, 1)
        weight: wp.array2d(dtype=V),  # [strip, WEIGHTS]
        vector: wp.array2d(dtype=V),  # [component, slot], eight from the slot on
        offset: int,
        # out
        force_out: wp.array2d(dtype=V),  # [component, slot], eight from the slot on, added to
    ):
        pencil = pencils[wp.tid() + offset]
        gradient = wp.zeros(shape=(36,), dtype=V)  # [component, axis, cubes across it]
        mode = wp.zeros(shape=(12,), dtype=V)  # [component, (XY, XZ, YZ, XYZ)], then their forces
        stress = wp.zeros(shape=(48,), dtype=V)  # [cube, (xx, yy, zz, yz, xz, xy)]
        for k in range(strip_start[pencil], strip_start[pencil + 1]):
            s = slot[k]
            for c in range(3):
                a0 = vector[c, s[0]]
                a1 = vector[c, s[0] + 1]
                a2 = vector[c, s[1]]
                a3 = vector[c, s[1] + 1]
                a4 = vector[c, s[2]]
                a5 = vector[c, s[2] + 1]
                a6 = vector[c, s[3]]
                a7 = vector[c, s[3] + 1]
                # sums s and differences d along z, then along y, then along x
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
                x = (s10 + s11) - (s00 + s01)
                y = sd0 + sd1
                z = ds0 + ds1
                xy = half * (sd1 - sd0)
                xz = half * (ds1 - ds0)
                yz = half * (dd0 + dd1)
                xyz = quarter * (dd1 - dd0)
                mode[4 * c] = xy
                mode[4 * c + 1] = xz
                mode[4 * c + 2] = yz
                mode[4 * c + 3] = xyz
                at = 12 * c
                low = x - xy
                high = x + xy
                less = xz - xyz
                more = xz + xyz
                gradient[at] = low - less
                gradient[at + 1] = low + less
                gradient[at + 2] = high - more
                gradient[at + 3] = high + more
                low = y - xy
                high = y + xy
                less = yz - xyz
                more = yz + xyz
                gradient[at + 4] = low - less
                gradient[at + 5] = low + less
                gradient[at + 6] = high - more
                gradient[at + 7] = high + more
                low = z - xz
                high = z + xz
                gradient[at + 8] = low - less
                gradient[at + 9] = low + less
                gradient[at + 10] = high - more
                gradient[at + 11] = high + more
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
                stress[at] = pressure + wp.cw_mul(twice, xx)
                stress[at + 1] = pressure + wp.cw_mul(twice, yy)
                stress[at + 2] = pressure + wp.cw_mul(twice, zz)
                stress[at + 3] = wp.cw_mul(mu, gradient[12 + across_z] + gradient[24 + across_y])
                stress[at + 4] = wp.cw_mul(mu, gradient[across_z] + gradient[24 + across_x])
                stress[at + 5] = wp.cw_mul(mu, gradient[across_y] + gradient[12 + across_x])
            # what one point does not see: strains that are linear in x, y or z, then those in two of them
            w = weight[k, 16]
            in_x = mode[4] + mode[9]
            in_y = mode[0] + mode[10]
            in_z = mode[1] + mode[6]
            yz_x = mode[8] + mode[5]
            xz_y = mode[8] + mode[2]
            xy_z = mode[5] + mode[2]
            mode[2] = wp.cw_mul(w, xz_y + xy_z)
            mode[5] = wp.cw_mul(w, yz_x + xy_z)
            mode[8] = wp.cw_mul(w, yz_x + xz_y)
            mode[0] = wp.cw_mul(w, in_y + mode[0] + two * mode[0])
            mode[1] = wp.cw_mul(w, in_z + mode[1] + two * mode[1])
            mode[4] = wp.cw_mul(w, in_x + mode[4] + two * mode[4])
            mode[6] = wp.cw_mul(w, in_z + mode[6] + two * mode[6])
            mode[9] = wp.cw_mul(w, in_x + mode[9] + two * mode[9])
            mode[10] = wp.cw_mul(w, in_y + mode[10] + two * mode[10])
            w = trilinear * w
            for c in range(3):
                mode[4 * c + 3] = wp.cw_mul(w, mode[4 * c + 3])
            for c in range(3):
                # of the stress on each axis: sums over the cubes with the signs of its modes
                at = 6 - c
                if c == 0:
                    at = 0
                t0 = stress[at] + stress[at + 24]
                t1 = stress[at + 6] + stress[at + 30]
                t2 = stress[at + 12] + stress[at + 36]
                t3 = stress[at + 18] + stress[at + 42]
                low = t1 - t0
                high = t3 - t2
                x = (t0 + t1) + (t2 + t3)
                xy = mode[4 * c] + ((t2 + t3) - (t0 + t1))
                xz = mode[4 * c + 1] + (low + high)
                xyz = mode[4 * c + 3] + (high - low)
                at = 5 - c
                if c == 1:
                    at = 1
                t0 = stress[at] + stress[at + 12]
                t1 = stress[at + 6] + stress[at + 18]
                t2 = stress[at + 24] + stress[at + 36]
                t3 = stress[at + 30] + stress[at + 42]
                low = t1 - t0
                high = t3 - t2
                y = (t0 + t1) + (t2 + t3)
                xy = half * (xy + ((t2 + t3) - (t0 + t1)))
                yz = mode[4 * c + 2] + (low + high)
                xyz = xyz + (high - low)
                at = 4 - c
                t0 = stress[at] + stress[at + 6]
                t1 = stress[at + 12] + stress[at + 18]
                t2 = stress[at + 24] + stress[at + 30]
                t3 = stress[at + 36] + stress[at + 42]
                low = t1 - t0
                high = t3 - t2
                z = (t0 + t1) + (t2 + t3)
                xz = half * (xz + ((t2 + t3) - (t0 + t1)))
                yz = half * (yz + (low + high))
                xyz = quarter * (xyz + (high - low))
                # and back to the corners
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
                force_out[c, s[0]] = force_out[c, s[0]] + (s00 - d00)
                force_out[c, s[0] + 1] = force_out[c, s[0] + 1] + (s00 + d00)
                force_out[c, s[1]] = force_out[c, s[1]] + (s01 - d01)
                force_out[c, s[1] + 1] = force_out[c, s[1] + 1] + (s01 + d01)
                force_out[c, s[2]] = force_out[c, s[2]] + (s10 - d10)
                force_out[c, s[2] + 1] = force_out[c, s[2] + 1] + (s10 + d10)
                force_out[c, s[3]] = force_out[c, s[3]] + (s11 - d11)
                force_out[c, s[3] + 1] = force_out[c, s[3] + 1] + (s11 + d11)

    return products
