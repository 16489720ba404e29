"""Time series of fields on a finite element mesh, for display and export."""

from dataclasses import dataclass, field

from meshes.base.arrays import Array, Bytes, Ints, Singles

__all__ = ["FieldSeries", "Frame", "StressState"]


@dataclass(frozen=True, eq=False)
class Frame:
    """Fields at one time.

    Attributes
    ----------
    time_s
        Time of the state that the fields belong to [s].
    points
        Values at the nodes by name with unit, shape (nodes,) or (nodes, 3).
    cells
        Values of the cells by name with unit, shape (cells,) or (cells, 3); NaN where a cell is
        gone.
    """

    time_s: float
    points: dict[str, Singles]
    cells: dict[str, Singles]


@dataclass(frozen=True, eq=False)
class FieldSeries:
    """Mesh and the frames computed on it so far.

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
        Frames in the order of time.
    node_sets
        Nodes by role: ``held``, ``touchable``.
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
