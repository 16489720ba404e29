"""Forces on the elements of a rotating cutter, averaged over a revolution.

Mechanistic model with chip and edge coefficients (Altintas 2012, Manufacturing Automation, ch. 2), per element::

    h  = (v . n) 2 pi / (N omega)
    dF = -(N A / (2 pi r)) [(K_tc h + K_te) t + (K_rc h + K_re) n + (K_ac h + K_ae) a] share

with every K scaled by (density / reference density) ** exponent of the layer. Elements that do not advance do not cut.
The share is that of the element's width which lies below the bone's original surface, and 0 where an older cut has
taken the bone.
"""

import warp as wp

from kernels.bone_lookup import Bone, bone_at
from kernels.bricks import voxel_column, voxel_row
from kernels.elements import CHUNK, Elements, Travel, advance_of, may_cut, travel_of
from kernels.older_cuts import taken_before
from kernels.revolution import Revolution

__all__ = [
    "AREA",
    "CHIP_FORCE",
    "CHIP_TORQUE",
    "DENSITIES",
    "EDGE_FORCE",
    "EDGE_TORQUE",
    "RATE",
    "Coefficients",
    "cutting_forces",
]

wp.set_module_options({"enable_backward": False})

CHIP_FORCE, CHIP_TORQUE, EDGE_FORCE, EDGE_TORQUE, RATE, AREA = 0, 3, 6, 9, 12, 13
"""Places in the sums. Three each per unit of speed: force [N s/m], torque about the tip [N s]; three each independent
of speed: force [N] and torque [N m]; removal rate per unit of speed [m2]; engaged area of each layer [m2]."""
WIDEST = wp.constant(3.5)  # across the surface, an element is taken as this wide at most [voxel]
DENSITIES = 4096
"""Entries of the strength table: densities of 0 to 4095 kg/m3."""


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


@wp.struct
class Load:
    """Force on an element per unit of speed [N s/m], and independent of speed [N]."""

    chip: wp.vec3
    edge: wp.vec3


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
    older: wp.array2d(dtype=wp.uint16),
    alive: wp.array(dtype=wp.uint64),
    # out
    sums_out: wp.array2d(dtype=wp.float64),  # [chunk, AREA + layers], tool frame: see CHIP_FORCE
):
    """Sum the forces on one chunk of elements for a motion of unit speed (1 m/s times the given velocities)."""
    chunk = wp.tid() + chunk_offset
    for m in range(AREA, sums_out.shape[1]):
        sums_out[chunk, m] = wp.float64(0.0)
    travel = travel_of(motion, spacing)
    chip_force = wp.vec3()
    chip_torque = wp.vec3()
    edge_force = wp.vec3()
    edge_torque = wp.vec3()
    rate = float(0.0)
    first = chunk * CHUNK
    if not may_cut(elements, chunk, travel, spacing, brick_of, alive):
        first = elements.point.shape[0]
    for e in range(first, wp.min(first + CHUNK, elements.point.shape[0])):
        advance = advance_of(elements, e, travel)
        if advance > travel.least:
            arm = elements.point[e]
            at = travel.tip + arm[0] * travel.ex + arm[1] * travel.ey + arm[2] * travel.ez
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
                share = share_below(bone, elements.normal[e], elements.area[e], travel, spacing)
                if share > 0.0 and taken_before(
                    tool, motion, travel.axis, travel.heading, brick_of, older, row, column, at
                ):
                    share = 0.0
                if share > 0.0:
                    load = load_on(elements, coefficients, e, bone, share, advance, chip_per_speed)
                    chip_force += load.chip
                    chip_torque += wp.cross(arm, load.chip)
                    edge_force += load.edge
                    edge_torque += wp.cross(arm, load.edge)
                    engaged = elements.area[e] * share
                    rate += engaged * advance
                    sums_out[chunk, AREA + bone.layer] += wp.float64(engaged)
    for c in range(3):
        sums_out[chunk, CHIP_FORCE + c] = wp.float64(chip_force[c])
        sums_out[chunk, CHIP_TORQUE + c] = wp.float64(chip_torque[c])
        sums_out[chunk, EDGE_FORCE + c] = wp.float64(edge_force[c])
        sums_out[chunk, EDGE_TORQUE + c] = wp.float64(edge_torque[c])
    sums_out[chunk, RATE] = wp.float64(rate)


@wp.func
def share_below(bone: Bone, normal: wp.vec3, area: float, travel: Travel, spacing: float):
    """Share of an element's width, taken along the slope of the original surface, that lies below that."""
    share = float(1.0)
    if bone.distance > -1.9:
        across = (normal[0] * travel.ex + normal[1] * travel.ey + normal[2] * travel.ez) * spacing
        tangent = bone.slope - wp.dot(bone.slope, across) * across
        width = wp.min(wp.length(tangent) * wp.sqrt(area) / spacing, WIDEST)
        share = wp.clamp(0.5 - bone.distance / wp.max(width, 1.0e-3), 0.0, 1.0)
    return share


@wp.func
def load_on(
    elements: Elements,
    coefficients: Coefficients,
    e: int,
    bone: Bone,
    share: float,
    advance: float,
    chip_per_speed: float,
):
    """Force on an element in ``bone``."""
    m = bone.layer
    strength = coefficients.strength[m, wp.min(int(bone.density + 0.5), 4095)]
    length = elements.edge_length[e] * share * strength
    chip = length * advance * chip_per_speed
    around = elements.around[e]
    normal = elements.normal[e]
    load = Load()
    load.chip = wp.vec3(0.0, 0.0, -chip * coefficients.axial_chip[m])
    load.chip -= (chip * coefficients.tangential_chip[m]) * around
    load.chip -= (chip * coefficients.radial_chip[m]) * normal
    load.edge = wp.vec3(0.0, 0.0, -length * coefficients.axial_edge[m])
    load.edge -= (length * coefficients.tangential_edge[m]) * around
    load.edge -= (length * coefficients.radial_edge[m]) * normal
    return load
