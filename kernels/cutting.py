"""Forces on the elements of a rotating cutter, averaged over a revolution.

Mechanistic model with chip and edge coefficients (Altintas 2012, Manufacturing Automation, ch. 2), per element::

    h  = (v . n) 2 pi / (N omega)
    dF = -(N A / (2 pi r)) [(K_tc h + K_te) t + (K_rc h + K_re) n + (K_ac h + K_ae) a] share

with every K scaled by (density / reference density) ** exponent of the layer. Elements that do not advance do not cut.
The share is that of the element's width which lies below the bone's original surface, and 0 where an older cut has
taken the bone.
"""

import warp as wp

from kernels.bone_lookup import bone_at
from kernels.bricks import voxel_column, voxel_row
from kernels.carving import cut_before
from kernels.revolution import Revolution

__all__ = [
    "AREA",
    "CHIP_FORCE",
    "CHIP_TORQUE",
    "CHUNK",
    "DENSITIES",
    "EDGE_FORCE",
    "EDGE_TORQUE",
    "RATE",
    "Coefficients",
    "Elements",
    "cutting_forces",
]

wp.set_module_options({"enable_backward": False})

CHUNK = 128
"""Elements a chunk; chunks are summed in order, so the result does not depend on the number of threads."""
CHIP_FORCE, CHIP_TORQUE, EDGE_FORCE, EDGE_TORQUE, RATE, AREA = 0, 3, 6, 9, 12, 13
"""Places in the sums. Three each per unit of speed: force [N s/m], torque about the tip [N s]; three each independent
of speed: force [N] and torque [N m]; removal rate per unit of speed [m2]; engaged area of each layer [m2]."""
NEVER = wp.constant(65535)  # stored where the tool has not come near
GRAZING_VOXELS = wp.constant(1.5)  # an element this far from the line where the tool slides along the bone grazes it
AHEAD_VOXELS = wp.constant(1.0)  # a grazing element asks of the next voxel, which a pass back does not sweep deeper
WIDEST = wp.constant(3.5)  # across the surface, an element is taken as this wide at most [voxel]
DENSITIES = 4096
"""Entries of the strength table: densities of 0 to 4095 kg/m3."""


@wp.struct
class Elements:
    """Point shell of a cutter in its own frame: origin at the tip, z along the axis."""

    point: wp.array(dtype=wp.vec3)  # [m]
    normal: wp.array(dtype=wp.vec3)  # outward, unit
    around: wp.array(dtype=wp.vec3)  # direction in which the spin moves the element, unit
    area: wp.array(dtype=wp.float32)  # [m2]
    edge_length: wp.array(dtype=wp.float32)  # N A / (2 pi r): mean length of cutting edge in the element [m]
    chunk_ball: wp.array(dtype=wp.vec4)  # centre and radius of a ball around each chunk's points [m]
    chunk_cone: wp.array(dtype=wp.vec4)  # axis of a cone around each chunk's normals, sine of its half angle, 2: none


@wp.struct
class Coefficients:
    """Cutting coefficients at each layer's reference density: chip in [Pa], edge in [N/m]."""

    tangential_chip: wp.array(dtype=wp.float32)  # [layer]
    radial_chip: wp.array(dtype=wp.float32)
    axial_chip: wp.array(dtype=wp.float32)
    tangential_edge: wp.array(dtype=wp.float32)
    radial_edge: wp.array(dtype=wp.float32)
    axial_edge: wp.array(dtype=wp.float32)
    strength: wp.array2d(dtype=wp.float32)  # [layer, density in kg/m3]: (density / reference) ** exponent


@wp.kernel
def cutting_forces(
    # tool
    tool: Revolution,
    elements: Elements,
    coefficients: Coefficients,
    motion: wp.array2d(dtype=wp.float64),  # rows: tip [voxel]; tool axes x, y, z; tip's and angular velocity, own frame
    chip_per_speed: float,  # 2 pi / (N omega) [s]
    spacing: float,  # [m]
    chunk_offset: int,
    # grid
    brick_of: wp.array3d(dtype=wp.int32),
    material: wp.array2d(dtype=wp.uint32),
    nearby: wp.array2d(dtype=wp.uint16),
    swept: wp.array2d(dtype=wp.uint16),
    alive: wp.array(dtype=wp.uint64),
    # out
    sums_out: wp.array2d(dtype=wp.float64),  # [chunk, AREA + layers], tool frame: see CHIP_FORCE
):
    """Sum the forces on one chunk of elements for a motion of unit speed (1 m/s times the given velocities)."""
    chunk = wp.tid() + chunk_offset
    for m in range(AREA, sums_out.shape[1]):
        sums_out[chunk, m] = wp.float64(0.0)
    tip = wp.vec3(float(motion[0, 0]), float(motion[0, 1]), float(motion[0, 2]))
    ex = wp.vec3(float(motion[1, 0]), float(motion[1, 1]), float(motion[1, 2])) / spacing
    ey = wp.vec3(float(motion[2, 0]), float(motion[2, 1]), float(motion[2, 2])) / spacing
    ez = wp.vec3(float(motion[3, 0]), float(motion[3, 1]), float(motion[3, 2])) / spacing
    axis = ez * spacing
    velocity = wp.vec3(float(motion[4, 0]), float(motion[4, 1]), float(motion[4, 2]))
    turning = wp.vec3(float(motion[5, 0]), float(motion[5, 1]), float(motion[5, 2]))
    turns = wp.length(turning) > 0.0
    least = 1.0e-5 * wp.length(velocity)
    grazing = GRAZING_VOXELS / tool.radius * wp.length(velocity)
    onward = (velocity[0] * ex + velocity[1] * ey + velocity[2] * ez) * (
        AHEAD_VOXELS * spacing / wp.max(wp.length(velocity), 1.0e-12)
    )
    chip_force = wp.vec3()
    chip_torque = wp.vec3()
    edge_force = wp.vec3()
    edge_torque = wp.vec3()
    rate = float(0.0)
    first = chunk * CHUNK
    cone = elements.chunk_cone[chunk]
    facing = wp.dot(velocity, wp.vec3(cone[0], cone[1], cone[2])) + wp.length(velocity) * cone[3]
    ball = elements.chunk_ball[chunk]
    middle = tip + ball[0] * ex + ball[1] * ey + ball[2] * ez
    if (facing <= 0.0 and not turns) or not meets_bone(brick_of, alive, middle, ball[3] / spacing + 2.0):
        first = elements.point.shape[0]
    for e in range(first, wp.min(first + CHUNK, elements.point.shape[0])):
        normal = elements.normal[e]
        advance = wp.dot(velocity, normal)
        if turns:
            advance += wp.dot(wp.cross(turning, elements.point[e]), normal)
        if advance > least:
            arm = elements.point[e]
            at = tip + arm[0] * ex + arm[1] * ey + arm[2] * ez
            ix = int(wp.floor(at[0]))
            iy = int(wp.floor(at[1]))
            iz = int(wp.floor(at[2]))
            row = voxel_row(brick_of, ix, iy, iz)
            column = voxel_column(ix, iy, iz)
            reached = int(0)
            if row >= 0:
                reached = int(swept[row, column])
            if reached > 0:
                bone = bone_at(brick_of, material, nearby, row, column, at)
                share = float(1.0)
                if bone.distance > -1.9:
                    across = (normal[0] * ex + normal[1] * ey + normal[2] * ez) * spacing
                    tangent = bone.slope - wp.dot(bone.slope, across) * across
                    width = wp.min(wp.length(tangent) * wp.sqrt(elements.area[e]) / spacing, WIDEST)
                    share = wp.clamp(0.5 - bone.distance / wp.max(width, 1.0e-3), 0.0, 1.0)
                if share > 0.0:
                    asked = at
                    if advance < grazing:
                        asked = at + onward
                    if taken_before(tool, motion, axis, brick_of, swept, asked):
                        share = 0.0
                if share > 0.0:
                    m = bone.layer
                    strength = coefficients.strength[m, wp.min(int(bone.density + 0.5), 4095)]
                    length = elements.edge_length[e] * share * strength
                    chip = length * advance * chip_per_speed
                    around = elements.around[e]
                    chip_here = wp.vec3(0.0, 0.0, -chip * coefficients.axial_chip[m])
                    chip_here -= (chip * coefficients.tangential_chip[m]) * around
                    chip_here -= (chip * coefficients.radial_chip[m]) * normal
                    edge_here = wp.vec3(0.0, 0.0, -length * coefficients.axial_edge[m])
                    edge_here -= (length * coefficients.tangential_edge[m]) * around
                    edge_here -= (length * coefficients.radial_edge[m]) * normal
                    chip_force += chip_here
                    chip_torque += wp.cross(arm, chip_here)
                    edge_force += edge_here
                    edge_torque += wp.cross(arm, edge_here)
                    engaged = elements.area[e] * share
                    rate += engaged * advance
                    sums_out[chunk, AREA + m] += wp.float64(engaged)
    for c in range(3):
        sums_out[chunk, CHIP_FORCE + c] = wp.float64(chip_force[c])
        sums_out[chunk, CHIP_TORQUE + c] = wp.float64(chip_torque[c])
        sums_out[chunk, EDGE_FORCE + c] = wp.float64(edge_force[c])
        sums_out[chunk, EDGE_TORQUE + c] = wp.float64(edge_torque[c])
    sums_out[chunk, RATE] = wp.float64(rate)


@wp.func
def meets_bone(brick_of: wp.array3d(dtype=wp.int32), alive: wp.array(dtype=wp.uint64), middle: wp.vec3, radius: float):
    """Whether a brick that still holds material meets the box around a ball [voxel]."""
    low = wp.vec3i(0, 0, 0)
    high = wp.vec3i(0, 0, 0)
    for c in range(3):
        low[c] = wp.max(int(wp.floor((middle[c] - radius) / 8.0)), 0)
        high[c] = wp.min(int(wp.floor((middle[c] + radius) / 8.0)), brick_of.shape[c] - 1)
    for bx in range(low[0], high[0] + 1):
        for by in range(low[1], high[1] + 1):
            for bz in range(low[2], high[2] + 1):
                row = int(brick_of[bx, by, bz])
                held = wp.uint64(0)
                if row >= 0:
                    held = alive[row]
                if held != wp.uint64(0):
                    return True
    return False


@wp.func
def taken_before(
    tool: Revolution,
    pose: wp.array2d(dtype=wp.float64),
    axis: wp.vec3,
    brick_of: wp.array3d(dtype=wp.int32),
    swept: wp.array2d(dtype=wp.uint16),
    point: wp.vec3,
):
    """Whether an older cut has taken the bone at ``point`` [voxel] on or before the tool's surface."""
    ix = int(wp.floor(point[0]))
    iy = int(wp.floor(point[1]))
    iz = int(wp.floor(point[2]))
    row = voxel_row(brick_of, ix, iy, iz)
    if row < 0:
        return False
    reached = int(swept[row, voxel_column(ix, iy, iz)])
    if reached == NEVER:
        return False
    if reached == 0:
        return True
    return cut_before(tool, pose, axis, ix, iy, iz, reached)
