"""Strain and stress in linear or quadratic tetrahedra, averaged over groups of places in cells.

At a place of barycentric coordinates l the displacement gradient is
``sum_A u_A (sum_c (slope_Ac . l) g_c)^T``, strain is its symmetric part, and stress is D times
strain. A group holds the middle of a cell, or one place for a node in each cell around it. Places
are weighted by the volume of their cells.
"""

import warp as wp

from kernels.particle_stress import principal_values

__all__ = ["group_stress"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.kernel
def group_stress(
    # groups
    group_start: wp.array(dtype=wp.int32),  # [group + 1]
    member: wp.array(dtype=wp.int32),  # cell times places a cell plus place
    # places and shape functions
    place_at: wp.array(dtype=wp.vec4d),  # [place], barycentric coordinates
    slope: wp.array2d(dtype=wp.vec4d),  # [shape function, corner], by barycentric coordinate
    # cells
    cell_nodes: wp.array2d(dtype=wp.int32),  # [cell, shape function]
    gradient: wp.array2d(dtype=wp.vec3d),  # [cell, corner] [1/m]
    volume: wp.array(dtype=wp.float64),  # [cell] [m3]
    stiffness: wp.array3d(dtype=wp.float64),  # [1 or cell, 6, 6] [Pa], xx, yy, zz, yz, xz, xy
    displacement: wp.array(dtype=wp.vec3d),  # [node] [m]
    offset: int,
    # out
    strain_out: wp.array2d(dtype=wp.float64),  # [group, 6], tensor components
    stress_out: wp.array2d(dtype=wp.float64),  # [group, 6] [Pa]
    von_mises_out: wp.array(dtype=wp.float64),  # [group] [Pa]
    principal_out: wp.array(dtype=wp.vec3d),  # [group] [Pa], largest first
):
    """Compute mean strain and stress of each group; zero where a group is empty."""
    group = wp.tid() + offset
    strain = wp.mat33d()
    voigt = wp.vector(length=6, dtype=wp.float64)
    total = wp.float64(0.0)
    for i in range(group_start[group], group_start[group + 1]):
        cell = member[i] / place_at.shape[0]
        at = place_at[member[i] - cell * place_at.shape[0]]
        moved = wp.mat33d()
        for a in range(slope.shape[0]):
            along = wp.vec3d()
            for c in range(4):
                along += wp.dot(slope[a, c], at) * gradient[cell, c]
            moved += wp.outer(displacement[cell_nodes[cell, a]], along)
        here = wp.float64(0.5) * (moved + wp.transpose(moved))
        weight = volume[cell]
        row = wp.min(cell, stiffness.shape[0] - 1)
        for k in range(6):
            value = wp.float64(0.0)
            for j in range(3):
                value += stiffness[row, k, j] * here[j, j]
            value += wp.float64(2.0) * (
                stiffness[row, k, 3] * here[1, 2]
                + stiffness[row, k, 4] * here[0, 2]
                + stiffness[row, k, 5] * here[0, 1]
            )
            voigt[k] = voigt[k] + weight * value
        strain += weight * here
        total += weight
    if total > wp.float64(0.0):
        strain = strain / total
        voigt = voigt / total
    for k in range(6):
        stress_out[group, k] = voigt[k]
    for k in range(3):
        strain_out[group, k] = strain[k, k]
    strain_out[group, 3] = strain[1, 2]
    strain_out[group, 4] = strain[0, 2]
    strain_out[group, 5] = strain[0, 1]
    stress = wp.mat33d(
        voigt[0],
        voigt[5],
        voigt[4],
        voigt[5],
        voigt[1],
        voigt[3],
        voigt[4],
        voigt[3],
        voigt[2],
    )
    mean = wp.trace(stress) / wp.float64(3.0)
    deviator = stress - wp.diag(wp.vec3d(mean, mean, mean))
    von_mises_out[group] = wp.sqrt(wp.float64(1.5) * wp.ddot(deviator, deviator))
    principal_out[group] = principal_values(stress)
