"""Stress computed from a displacement, and time series of fields for display and export."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Bytes, Ints, Singles
from tissue.fem.space import Space, gradient_slopes
from tissue.materials.elasticity import VOIGT, elasticity_rows, stiffness_of_lame

CENTRE = np.full(4, 0.25)
"""Barycentric coordinates of the centre of a cell."""


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
    """

    strain: Array
    stress_Pa: Array


def von_mises(stress: Array) -> Array:
    """Return the von Mises stress, shape (n,), of stress components as columns, shape (n, 6).

    The columns are xx, yy, zz, yz, xz, xy.
    """
    return np.sqrt(1.5) * deviator_norm(stress)


def principal_stresses(stress: Array) -> Array:
    """Return the principal stresses, largest first, shape (n, 3).

    The components xx, yy, zz, yz, xz, xy of the stress have the shape (n, 6).
    """
    values = np.linalg.eigvalsh(stress[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]])
    return np.asarray(values[:, ::-1], dtype=np.float64)


def deviator_norm(components: Array) -> Array:
    """Return the norm sqrt(d : d) of the deviator d of symmetric tensors, shape (n,).

    The tensor components xx, yy, zz, yz, xz, xy have the shape (n, 6).
    """
    normal = components[:, :3] - components[:, :3].mean(axis=1, keepdims=True)
    return np.sqrt((normal**2).sum(axis=1) + 2.0 * (components[:, 3:] ** 2).sum(axis=1))


def displacement_gradient(space: Space, displacement_m: Array, point: Array) -> Array:
    """Return the gradient of the displacement at a point of each cell, shape (m, 3, 3).

    Parameters
    ----------
    space, displacement_m
        Space, and displacement of each of its nodes [m], shape (n, 3).
    point
        Barycentric coordinates of the point, shape (4,).
    """
    slope = gradient_slopes(4, space.order) @ point
    corners = space.gradients[0].numpy()
    moved = displacement_m[space.cell_nodes]
    return np.einsum("mai,ac,mcj->mij", moved, slope, corners, optimize=True)


def cell_stress(
    space: Space, displacement_m: Array, elasticity: ArrayLike, *, point: Array = CENTRE
) -> StressState:
    """Return the stress at a point of each cell.

    The stress at the centre equals the mean stress of the cell.

    Parameters
    ----------
    space
        Nodes and cells.
    displacement_m
        Displacement of each node [m], shape (n, 3).
    elasticity
        Elastic constants of the cells, see `tissue.fem.assembly.assemble`.
    point
        Barycentric coordinates of the point, shape (4,).

    Raises
    ------
    InputError
        If the elasticity is not valid.
    """
    rows = elasticity_rows(elasticity, space.cell_count)
    # Rows of two numbers are the Lamé constants of isotropic cells; other rows are whole matrices.
    stiffness = stiffness_of_lame(rows) if rows.ndim == 2 else rows
    gradient = displacement_gradient(space, displacement_m, point)
    row, column = VOIGT.T
    strain = 0.5 * (gradient[:, row, column] + gradient[:, column, row])
    engineering = strain * [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    return StressState(strain, (stiffness @ engineering[:, :, None])[:, :, 0])
