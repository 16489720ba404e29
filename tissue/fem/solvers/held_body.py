"""Body with supports, and a check that the supports prevent every rigid motion."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.csgraph import connected_components

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError

LEAST_HOLD = 1e-6
"""Relative motion of held components below which the supports do not prevent a rigid motion.

The relative motion is the ratio of the motion of the held components to the motion of the whole
body. The rounding error of this ratio is 1e-8.
"""


def rigid_modes(nodes_m: Array, about_m: Array) -> Array:
    """Return the nodal displacements in six unit rigid motions, shape (n, 3, 6).

    Three translations come first, followed by three rotations about `about_m`.
    """
    modes = np.zeros((len(nodes_m), 3, 6))
    modes[:, :, :3] = np.eye(3)
    modes[:, :, 3:] = np.cross(np.eye(3)[None], (nodes_m - about_m)[:, None, :]).transpose(0, 2, 1)
    return modes


def free_motion_count(nodes_m: Array, held: Flags) -> int:
    """Return the number of independent rigid motions in which all held components stay at rest.

    Parameters
    ----------
    nodes_m
        Nodes of one connected body [m], shape (n, 3).
    held
        True for displacement components that are held, shape (n, 3).
    """
    centre = nodes_m.mean(axis=0)
    # A single node has no extent.
    size = max(float(np.linalg.norm(nodes_m - centre, axis=1).max()), 1e-300)
    rows = rigid_modes((nodes_m - centre) / size, np.zeros(3))[held]
    values = np.linalg.eigvalsh(rows.T @ rows / max(len(rows), 1))
    return int((values < LEAST_HOLD**2).sum())


class ColumnSolver(Protocol):
    """Interface of a solver that computes columns of the inverse stiffness.

    Attributes
    ----------
    body
        The stiffness and its supports.
    """

    body: "HeldBody"

    def columns(self, unknowns: Ints) -> Array:
        """Return the displacements [m/N] under a unit force on each of k unknowns, shape (3n, k).

        Rows of held unknowns are zero.
        """


@dataclass(frozen=True, eq=False)
class HeldBody:
    """Stiffness and supports of a body; the supports must prevent every rigid motion.

    Attributes
    ----------
    stiffness
        Symmetric stiffness matrix K [N/m], shape (3n, 3n). The order of the unknowns is x, y, z
        node by node.
    nodes_m
        Node positions [m], shape (n, 3).
    fixed
        True for components with zero displacement, shape (n, 3).
    is_grounded
        True if the stiffness itself contains supports, so that no component has to be held.

    Raises
    ------
    InputError
        If K is not finite; if no component is held; if a held node belongs to no cell; or if a
        connected part may move as a rigid body.
    """

    stiffness: bsr_array
    nodes_m: Array
    fixed: Flags
    is_grounded: bool = False

    def __post_init__(self) -> None:
        if not np.isfinite(self.stiffness.data).all():
            raise InputError("stiffness", "be finite", "NaN or infinity", "check the moduli")
        if self.is_grounded:
            return
        if not (self.fixed & self.carrying[:, None]).any():
            raise InputError(
                "supports",
                "hold at least one node of a cell",
                "none",
                "add nodes of cells to supports",
            )
        count, label = connected_components(pointwise_graph(self.stiffness), directed=False)
        order = np.argsort(label, kind="stable")
        starts = np.searchsorted(label[order], np.arange(count + 1))
        for first, last in pairwise(starts):
            nodes = order[first:last]
            if not self.carrying[nodes[0]]:
                continue
            free = free_motion_count(self.nodes_m[nodes], self.fixed[nodes])
            if free:
                raise InputError(
                    "supports",
                    "leave no rigid motion free",
                    f"{free} free motions of the part with node {nodes[0]} ({len(nodes)} nodes)",
                    "hold more nodes, or leave loose parts out",
                )

    @cached_property
    def carrying(self) -> Flags:
        """Mask of the nodes that belong to a cell, shape (n,)."""
        return self.stiffness.diagonal().reshape(-1, 3).any(axis=1)

    @cached_property
    def free(self) -> Ints:
        """Indices of the free unknowns."""
        return np.flatnonzero((~self.fixed & self.carrying[:, None]).ravel())

    def right_side(self, load_N: Array) -> Array:
        """Return the forces of a load on the free unknowns [N], shape (f,).

        Raises
        ------
        InputError
            If the load has a wrong shape, is not finite, or acts on nodes that belong to no cell.
        """
        load = np.asarray(load_N, np.float64)
        if load.shape != self.nodes_m.shape or not np.isfinite(load).all():
            raise InputError(
                "load_N",
                f"be finite, with the shape {self.nodes_m.shape}",
                "NaN or infinity" if load.shape == self.nodes_m.shape else f"shape {load.shape}",
                "give a force at each node",
            )
        if load[~self.carrying].any():
            raise InputError(
                "load_N",
                "act on nodes of cells",
                "forces on other nodes",
                "apply the forces to nodes of the body",
            )
        return load.ravel()[self.free]

    def whole(self, free_m: Array) -> Array:
        """Return the displacements of all nodes [m], shape (n, 3), given the free unknowns [m]."""
        displacement = np.zeros(self.nodes_m.shape)
        displacement.ravel()[self.free] = free_m
        return displacement


def components_of(nodes: Ints) -> Ints:
    """Return the indices of the unknowns x, y, z of k nodes, node by node, shape (3k,)."""
    return (3 * nodes[:, None] + np.arange(3)).ravel()


def held_nodes(held: Flags) -> Flags:
    """Return the mask of held components, shape (n, 3), for a mask of held nodes, shape (n,)."""
    return np.repeat(held[:, None], 3, axis=1)


def pointwise_graph(stiffness: bsr_array) -> csr_array:
    """Return a sparse matrix with an entry for each two nodes that share a cell, shape (n, n)."""
    blocks = stiffness.tobsr((3, 3))
    count = blocks.shape[0] // 3
    return csr_array(
        (np.ones(len(blocks.indices), np.int8), blocks.indices, blocks.indptr),
        shape=(count, count),
    )
