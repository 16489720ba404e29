"""Bone in front of each element of a rotating cutter, without a force.

The bone is the same as in `kernels.cutting.cutting_forces`.

Loads for any cutting coefficients follow from sums over the elements, see
`tissue.models.bone.engagement`.
"""

import warp as wp

from kernels.bricks import corner8f
from kernels.cutting import bone_met
from kernels.elements import CHUNK, LANES, Elements, advance_of, may_cut, place_of, travel_of
from kernels.older_cuts import SLOTS
from kernels.revolution import Revolution

__all__ = ["engaged_elements"]

wp.set_module_options({"enable_backward": False})


@wp.kernel
def engaged_elements(
    # tool
    tool: Revolution,
    elements: Elements,
    motion: wp.array2d(dtype=wp.float64),  # as the force kernel's
    spacing: float,  # [m]
    chunk_offset: int,
    # grid
    brick_of: wp.array3d(dtype=wp.int32),
    material: wp.array2d(dtype=wp.uint32),
    nearby: wp.array2d(dtype=wp.uint16),
    older: wp.array2d(dtype=wp.uint16),
    alive: wp.array(dtype=wp.uint64),
    # out
    seen_out: wp.array2d(dtype=corner8f),  # as the force kernel's
    share_out: wp.array(dtype=wp.float32),  # [element] share of its width that cuts, 0 if none
    advance_out: wp.array(dtype=wp.float32),  # speed along its normal, per unit of speed
    layer_out: wp.array(dtype=wp.int32),
    density_out: wp.array(dtype=wp.int32),  # [kg/m3], an entry of the strength table
):
    """Find the bone in front of one chunk of elements in a motion of unit speed.

    All other values are set only for elements with a nonzero share.
    """
    chunk = wp.tid() + chunk_offset
    seen_out[chunk, SLOTS] = corner8f()
    travel = travel_of(motion, spacing)
    meets = may_cut(elements, chunk, travel, spacing, brick_of, alive)
    first = chunk * (CHUNK // LANES)
    last = wp.min(first + CHUNK // LANES, elements.lanes.shape[0])
    for eight in range(first, last):
        advances = advance_of(elements, eight, travel)
        x = place_of(elements, eight, travel, 0)
        y = place_of(elements, eight, travel, 1)
        z = place_of(elements, eight, travel, 2)
        for lane in range(LANES):
            e = eight * LANES + lane
            share_out[e] = 0.0
            if meets and advances[lane] > travel.least:
                at = wp.vec3(x[lane], y[lane], z[lane])
                met = bone_met(
                    tool,
                    elements,
                    motion,
                    travel,
                    spacing,
                    brick_of,
                    material,
                    nearby,
                    older,
                    alive,
                    e,
                    at,
                    seen_out,
                    chunk,
                )
                share_out[e] = met.share
                advance_out[e] = advances[lane]
                layer_out[e] = met.layer
                density_out[e] = met.density
