"""Body of ``K u = f`` with its supports, and the interface of solvers for its inverse."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.csgraph import connected_components

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from tissue.fem.free_modes import free_modes

__all__ = ["ColumnSolver", "HeldBody", "held_nodes", "pointwise_graph"]


class ColumnSolver(Protocol):
    """Solver for columns of the inverse, for a compliance or a basis.

    Attributes
    ----------
    body
        The stiffness and its supports.
    """

    body: "HeldBody"

    def columns(self, unknowns: Ints) -> Array:
        """Return displacements of all unknowns [m/N] for unit forces on some, shape (3n, k).

        Rows of held unknowns are zero.
        """


@dataclass(frozen=True, eq=False)
class HeldBody:
    """Stiffness and supports of a body, checked to leave no part free to move.

    Attributes
    ----------
    stiffness
        K [N/m], shape (3n, 3n), symmetric, unknowns x, y, z node by node.
    nodes_m
        Node positions [m], shape (n, 3).
    fixed
        Components with zero displacement, shape (n, 3).

    Raises
    ------
    InputError
        If shapes do not fit, K is not finite, nothing is held, a held node belongs to no cell, or
        a connected part may move as a rigid body. The message names the free motions.
    """

    stiffness: bsr_array
    nodes_m: Array
    fixed: Flags

    def __post_init__(self) -> None:
        count = len(self.nodes_m)
        if self.stiffness.shape != (3 * count, 3 * count) or self.fixed.shape != (count, 3):
            raise InputError(
                "stiffness and fixed",
                f"be for the {count} nodes of nodes_m",
                f"{self.stiffness.shape} and {self.fixed.shape}",
                "make them on one space",
            )
        if not np.isfinite(self.stiffness.data).all():
            raise InputError("stiffness", "be finite", "NaN or infinity", "check the moduli")
        if not self.fixed.any():
            raise InputError(
                "supports",
                "hold something",
                "none",
                "all six rigid motions are free, fix some nodes",
            )
        if not (self.fixed & self.carrying[:, None]).any():
            raise InputError(
                "supports",
                "touch the body",
                f"{int(self.fixed.any(axis=1).sum())} nodes that no cell uses",
                "hold nodes of cells",
            )
        self._refuse_free_parts()

    def _refuse_free_parts(self) -> None:
        count, label = connected_components(pointwise_graph(self.stiffness), directed=False)
        order = np.argsort(label, kind="stable")
        starts = np.searchsorted(label[order], np.arange(count + 1))
        free = []
        for part in range(count):
            nodes = order[starts[part] : starts[part + 1]]
            if not self.carrying[nodes[0]]:
                continue
            modes = free_modes(self.nodes_m[nodes], self.fixed[nodes])
            if modes:
                free.append((len(nodes), int(nodes[0]), modes))
        if not free:
            return
        size, first, modes = max(free)
        parts = len(np.unique(label[self.carrying]))
        where = (
            "the body"
            if parts == 1
            else f"{len(free)} of {parts} unconnected parts, the largest with node {first}"
        )
        raise InputError(
            "supports",
            "leave no rigid motion free",
            f"{where} ({size} nodes) with {'; '.join(modes)} free",
            "hold more nodes, or leave loose parts out",
        )

    @cached_property
    def carrying(self) -> Flags:
        """Nodes that a cell uses, shape (n,)."""
        return np.asarray(self.stiffness.diagonal().reshape(-1, 3).any(axis=1))

    @cached_property
    def free(self) -> Ints:
        """Indices of the free unknowns."""
        return np.flatnonzero((~self.fixed & self.carrying[:, None]).ravel())

    def right_side(self, load_N: Array) -> Array:
        """Return the forces of a load on the free unknowns [N], shape (f,).

        Raises
        ------
        InputError
            If the load has another shape, is not finite, or acts on nodes that no cell uses.
        """
        load = np.asarray(load_N, dtype=np.float64)
        if load.shape != self.nodes_m.shape:
            raise InputError(
                "load_N", f"have the shape {self.nodes_m.shape}", load.shape, "one force a node"
            )
        if not np.isfinite(load).all():
            node = int(np.flatnonzero(~np.isfinite(load).all(axis=1))[0])
            raise InputError(
                "load_N", "be finite", f"{load[node]} at node {node}", "check where it came from"
            )
        if load[~self.carrying].any():
            raise InputError(
                "load_N", "act on nodes of cells", "forces on others", "move them to the body"
            )
        return np.asarray(load.ravel()[self.free])

    def whole(self, free_m: Array) -> Array:
        """Return displacements of all nodes [m] from the free unknowns, shape (n, 3)."""
        displacement = np.zeros(self.nodes_m.shape)
        displacement.ravel()[self.free] = free_m
        return displacement


def held_nodes(held: Flags) -> Flags:
    """Return the mask of held components, shape (n, 3), for a mask of held nodes, (n,)."""
    return np.repeat(held[:, None], 3, axis=1)


def pointwise_graph(stiffness: bsr_array) -> csr_array:
    """Return the nodes that share a cell, as a sparse matrix of shape (n, n)."""
    blocks = stiffness.tobsr((3, 3))
    count = blocks.shape[0] // 3
    return csr_array(
        (np.ones(len(blocks.indices), dtype=np.int8), blocks.indices, blocks.indptr),
        shape=(count, count),
    )
