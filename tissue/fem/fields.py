"""Stress computed from a displacement, and time series of fields for display and export."""

from dataclasses import dataclass, field

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from kernels import tetrahedra
from kernels.launcher import SplitLaunch
from meshes.base.arrays import Array, Bytes, Int32s, Ints, Singles
from tissue.fem.space import Space, gradient_slopes
from tissue.materials.elasticity import elasticity_rows, stiffness_of_lame


@dataclass(frozen=True, eq=False)
class Frame:
    """Fields at one time.

    Attributes
    ----------
    time_s
        Time of the fields [s].
    points
        Values at the nodes, shape (nodes,) or (nodes, 3), keyed by a name with unit.
    cells
        Values in the cells, shape (cells,) or (cells, 3), keyed by a name with unit. The value of a
        removed cell is NaN.
    """

    time_s: float
    points: dict[str, Singles]
    cells: dict[str, Singles]


@dataclass(frozen=True, eq=False)
class FieldSeries:
    """Mesh, and fields on this mesh at several times (frames).

    Attributes
    ----------
    nodes_m
        Node positions [m], shape (nodes, 3).
    cells
        Nodes of each cell in VTK's order, shape (cells, 8) for hexahedra or (cells, 4) for
        tetrahedra.
    layer
        Layer of each cell, shape (cells,).
    layer_names
        Names of the layers.
    frames
        Frames computed so far, in the order of time.
    node_sets
        Indices of nodes, keyed by role: ``held`` or ``touchable``.
    """

    nodes_m: Array
    cells: Ints
    layer: Bytes
    layer_names: tuple[str, ...]
    frames: list[Frame] = field(default_factory=list)
    node_sets: dict[str, Ints] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class StressState:
    """Strain and stress at points.

    Attributes
    ----------
    strain
        Tensor components xx, yy, zz, yz, xz, xy of the strain, shape (n, 6).
    stress_Pa
        Tensor components of the stress [Pa] in the order of the strain, shape (n, 6).
    von_mises_Pa
        Von Mises stress [Pa], shape (n,).
    principal_Pa
        Principal stresses [Pa], largest first, shape (n, 3).
    """

    strain: Array
    stress_Pa: Array
    von_mises_Pa: Array
    principal_Pa: Array


def cell_stress(space: Space, displacement_m: Array, elasticity: ArrayLike) -> StressState:
    """Return the stress at the centre of each cell, which equals the mean stress of the cell.

    Parameters
    ----------
    space
        Nodes and cells.
    displacement_m
        Displacement of each node [m], shape (n, 3).
    elasticity
        Elastic constants of the cells, see `tissue.fem.assembly.assemble`.

    Raises
    ------
    InputError
        If the elasticity is not valid.
    """
    start = np.arange(space.cell_count + 1, dtype=np.int32)
    # at the centre all four barycentric coordinates are equal
    return group_stress(space, displacement_m, elasticity, start, start[:-1], np.full((1, 4), 0.25))


def group_stress(
    space: Space,
    displacement_m: Array,
    elasticity: ArrayLike,
    start: Int32s,
    member: Int32s,
    places: Array,
) -> StressState:
    """Return the mean stress of groups of points, weighted by the volumes of the cells.

    See `kernels.tetrahedra.group_stress` for the parameters, and `cell_stress` for the raised
    errors.
    """
    rows = elasticity_rows(elasticity, space.cell_count)
    # Rows of two numbers are the Lamé constants of isotropic cells; other rows are whole matrices.
    stiffness = stiffness_of_lame(rows) if rows.ndim == 2 else rows
    count = len(start) - 1
    device = space.device
    inputs = [
        start,
        member,
        places,
        gradient_slopes(4, space.order),
        space.cell_nodes,
        *space.gradients,
        stiffness,
        displacement_m,
    ]
    strain, stress = (wp.empty((count, 6), wp.float64, device) for _ in range(2))
    von_mises = wp.empty(count, wp.float64, device)
    principal = wp.empty(count, wp.vec3d, device)
    outputs = [strain, stress, von_mises, principal]
    SplitLaunch(tetrahedra.group_stress, count, inputs, outputs)()
    return StressState(strain.numpy(), stress.numpy(), von_mises.numpy(), principal.numpy())
