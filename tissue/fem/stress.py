"""Strain and stress of a displacement at the cell centres."""

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from kernels import tetrahedra
from kernels.launcher import SplitLaunch
from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.fem.fields import StressState
from tissue.fem.shapes import gradient_slopes
from tissue.fem.space import Space
from tissue.materials.elasticity import elasticity_rows, stiffness_of_lame

__all__ = ["cell_stress", "group_stress"]


def cell_stress(space: Space, displacement_m: Array, elasticity: ArrayLike) -> StressState:
    """Return the stress at the centre of each cell, which is its mean over the cell.

    Parameters
    ----------
    space
        Nodes and cells.
    displacement_m
        Displacement of each node [m], shape (n, 3).
    elasticity
        As for `tissue.fem.assembly.assemble`.

    Raises
    ------
    InputError
        If the displacement has another shape or is not finite, or the elasticity is refused.
    """
    start = np.arange(space.cell_count + 1, dtype=np.int32)
    return group_stress(space, displacement_m, elasticity, start, start[:-1], np.full((1, 4), 0.25))


def group_stress(
    space: Space,
    displacement_m: Array,
    elasticity: ArrayLike,
    start: NDArray[np.int32],
    member: NDArray[np.int32],
    places: Array,
) -> StressState:
    """Return the mean stress of groups of cells at points in them, weighted by the cells' volumes.

    Parameters as of `kernels.tetrahedra.group_stress`, errors as of `cell_stress`.
    """
    moved = np.ascontiguousarray(displacement_m, dtype=np.float64)
    if moved.shape != (space.node_count, 3) or not np.isfinite(moved).all():
        raise InputError(
            "displacement_m",
            f"be finite, shape ({space.node_count}, 3)",
            f"shape {moved.shape}",
            "take it from a solve on the same space",
        )
    rows = elasticity_rows(elasticity, space.cell_count)
    stiffness = stiffness_of_lame(rows) if rows.ndim == 2 else rows
    count = len(start) - 1
    device = space.device
    inputs = [
        wp.array(start, dtype=wp.int32, device=device),
        wp.array(member, dtype=wp.int32, device=device),
        wp.array(places, dtype=wp.vec4d, device=device),
        wp.array(gradient_slopes(4, space.order), dtype=wp.vec4d, device=device),
        wp.array(space.cell_nodes.astype(np.int32), dtype=wp.int32, device=device),
        *space.gradients,
        wp.array(stiffness, dtype=wp.float64, device=device),
        wp.array(moved, dtype=wp.vec3d, device=device),
        0,
    ]
    strain, stress = (wp.empty((count, 6), dtype=wp.float64, device=device) for _ in range(2))
    von_mises = wp.empty(count, dtype=wp.float64, device=device)
    principal = wp.empty(count, dtype=wp.vec3d, device=device)
    outputs = [strain, stress, von_mises, principal]
    SplitLaunch(
        tetrahedra.group_stress,
        dim=count,
        inputs=inputs,
        outputs=outputs,
        offset_index=len(inputs) - 1,
        device=device,
    )()
    return StressState(strain.numpy(), stress.numpy(), von_mises.numpy(), principal.numpy())
