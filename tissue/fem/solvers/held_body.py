"""What holds the body of ``K u = f``, and what finds columns of its inverse."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.fem.free_modes import free_modes

__all__ = ["ColumnSolver", "HeldBody", "Supports", "pointwise_graph"]


@dataclass(frozen=True, eq=False)
class Supports:
    """What holds a body, component by component.

    Attributes
    ----------
    fixed
        Components that are held, shape (n, 3).
    displacement_m
        Where they are held [m], shape (n, 3); read only where fixed. Default: where they are at rest.
    spring_N_m
        Springs to the ground [N/m], shape (n, 3). Default: none.

    Raises
    ------
    InputError
        If shapes differ, a held displacement is not finite, or a spring is negative or not finite.
    """

    fixed: NDArray[np.bool_]
    displacement_m: Array | None = None
    spring_N_m: Array | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.fixed)
        if len(shape) != 2 or shape[1] != 3 or self.fixed.dtype != np.bool_:
            raise InputError(f"fixed must be booleans of shape (n, 3), got {self.fixed.dtype} of shape {shape}: "
                             "use Supports.of_nodes")  # fmt: skip
        for name in ("displacement_m", "spring_N_m"):
            if (values := getattr(self, name)) is None:
                continue
            if np.shape(values) != shape:
                raise InputError(f"{name} must have the shape of fixed, {shape}, got {np.shape(values)}: name all")
            used = values[self.fixed] if name == "displacement_m" else values
            if not np.isfinite(used).all():
                raise InputError(f"{name} must be finite, got NaN or infinity: hold the component at 0")
        if self.spring_N_m is not None and self.spring_N_m.min(initial=0.0) < 0.0:
            raise InputError(f"spring_N_m must not be negative, got {self.spring_N_m.min():g}: use 0 for none")

    @classmethod
    def of_nodes(cls, held: NDArray[np.bool_]) -> "Supports":
        """Hold whole nodes, shape (n,), at rest."""
        return cls(np.repeat(np.asarray(held, dtype=np.bool_)[:, None], 3, axis=1))


class ColumnSolver(Protocol):
    """A path that finds columns of the inverse, for a compliance or a basis.

    Attributes
    ----------
    body
        The stiffness and what holds it.
    """

    body: "HeldBody"

    def columns(self, unknowns: Ints) -> Array:
        """Displacements of all unknowns [m/N] for unit forces on some, shape (3n, k); zero for held ones.

        An ``InputError`` refuses displaced supports: the answer to a force alone is asked for.
        """


@dataclass(frozen=True, eq=False)
class HeldBody:
    """A stiffness and what holds it, found to leave no part free to move.

    Attributes
    ----------
    stiffness
        K [N/m], shape (3n, 3n), symmetric, unknowns x, y, z node by node.
    nodes_m
        Node positions [m], shape (n, 3).
    supports
        What holds the nodes.

    Raises
    ------
    InputError
        If shapes do not fit, K is not finite, nothing is held, what is held belongs to no cell, or a connected part may
        move as a rigid body: the sentence names the free motions.
    """

    stiffness: bsr_array
    nodes_m: Array
    supports: Supports

    def __post_init__(self) -> None:
        count = len(self.nodes_m)
        if self.stiffness.shape != (3 * count, 3 * count) or self.supports.fixed.shape != (count, 3):
            raise InputError(
                f"stiffness and supports must be for the {count} nodes of nodes_m, got {self.stiffness.shape} and "
                f"{self.supports.fixed.shape}: make them on one space"
            )
        if not np.isfinite(self.stiffness.data).all():
            raise InputError("stiffness must be finite, got NaN or infinity: check the moduli")
        held = self.held
        if not held.any():
            raise InputError("supports must hold something, got none: all six rigid motions are free, fix some nodes")
        if not (held & self.carrying[:, None]).any():
            raise InputError(f"supports must touch the body, got {int(held.any(axis=1).sum())} nodes "
                             "that no cell uses: hold nodes of cells")  # fmt: skip
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
            modes = free_modes(self.nodes_m[nodes], self.held[nodes])
            if modes:
                free.append((len(nodes), int(nodes[0]), modes))
        if not free:
            return
        size, first, modes = max(free)
        parts = len(np.unique(label[self.carrying]))
        where = "the body" if parts == 1 else f"{len(free)} of {parts} unconnected parts, the largest with node {first}"
        raise InputError(
            f"supports must leave no rigid motion free, got {where} ({size} nodes) with {'; '.join(modes)} free: "
            "hold more nodes, or leave loose parts out"
        )

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """Components that are fixed or on springs, shape (n, 3)."""
        springs = self.supports.spring_N_m
        return self.supports.fixed if springs is None else self.supports.fixed | (springs > 0.0)

    @cached_property
    def carrying(self) -> NDArray[np.bool_]:
        """Nodes that a cell uses, shape (n,)."""
        return np.asarray(self.stiffness.diagonal().reshape(-1, 3).any(axis=1))

    @cached_property
    def free(self) -> Ints:
        """Unknowns that are solved for."""
        return np.flatnonzero((~self.supports.fixed & self.carrying[:, None]).ravel())

    @cached_property
    def sprung(self) -> bsr_array:
        """K with the springs on its diagonal."""
        springs = self.supports.spring_N_m
        if springs is None or not springs.any():
            return self.stiffness
        return bsr_array((self.stiffness + diags_array(springs.ravel())).tobsr((3, 3)))

    @cached_property
    def moved(self) -> bool:
        """Whether supports are held away from rest."""
        away = self.supports.displacement_m
        return away is not None and bool(away[self.supports.fixed].any())

    @cached_property
    def given_m(self) -> Array:
        """Displacement of the fixed components and zero elsewhere [m], shape (n, 3)."""
        if self.supports.displacement_m is None:
            return np.zeros(self.nodes_m.shape)
        return np.where(self.supports.fixed, self.supports.displacement_m, 0.0)

    def right_side(self, load_N: Array) -> Array:
        """Forces on the free unknowns [N] of a load, those of displaced supports included, shape (f,).

        Raises
        ------
        InputError
            If the load has another shape, is not finite, or acts on nodes that no cell uses.
        """
        load = np.asarray(load_N, dtype=np.float64)
        if load.shape != self.nodes_m.shape:
            raise InputError(f"load_N must have the shape {self.nodes_m.shape}, got {load.shape}: one force a node")
        if not np.isfinite(load).all():
            node = int(np.flatnonzero(~np.isfinite(load).all(axis=1))[0])
            raise InputError(f"load_N must be finite, got {load[node]} at node {node}: check where it came from")
        if load[~self.carrying].any():
            raise InputError("load_N must act on nodes of cells, got forces on others: move them to the body")
        flat = load.ravel()
        if self.moved:
            flat = flat - self.stiffness @ self.given_m.ravel()
        return np.asarray(flat[self.free])

    def require_rest(self) -> None:
        """Refuse displaced supports where a compliance is asked for.

        Raises
        ------
        InputError
            If a component is held away from rest.
        """
        if self.moved:
            raise InputError("supports must be at rest for a compliance, got displaced ones: hold them at 0")

    def whole(self, free_m: Array) -> Array:
        """Displacements of all nodes [m], shape (n, 3), from those of the free unknowns."""
        displacement = self.given_m.copy()
        displacement.ravel()[self.free] = free_m
        return displacement


def pointwise_graph(stiffness: bsr_array) -> csr_array:
    """Nodes that share a cell, as a sparse matrix of shape (n, n)."""
    blocks = stiffness.tobsr((3, 3))
    count = blocks.shape[0] // 3
    return csr_array((np.ones(len(blocks.indices), dtype=np.int8), blocks.indices, blocks.indptr), shape=(count, count))
