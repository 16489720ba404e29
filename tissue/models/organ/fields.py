"""Displacement, strain, stress and reaction of a whole organ, computed from what its surface felt."""

from collections.abc import Callable
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Ints
from tissue.fem.fields import FieldSeries, Frame, StressState
from tissue.fem.shapes import EDGES
from tissue.fem.space import Space
from tissue.fem.stress import cell_stress
from tissue.models.organ.large_fields import LargeFields

__all__ = ["OrganFields", "equivalent_strain"]

Solve = Callable[[Array], Array]
"""Displacements [m] of all nodes under several loads [N], shape (loads, n, 3) both."""
BATCH = 16
"""Frames solved at once."""


class OrganFields:
    """Displacement, strain, stress and reaction of a whole organ from the forces of its contact.

    A frame costs a tick a copy of the contact's forces; the fields are computed when the run has ended.

    Parameters
    ----------
    space
        Nodes and cells.
    elasticity
        As for `tissue.fem.assembly.assemble`.
    solve
        Displacement under loads, supports held.
    product
        Stiffness times displacements, shape (n, 3), supports not held: what is left over the load is the reaction.
    touchable
        Nodes that the tool can reach, shape (s,).
    rest_m, rest_load_N
        Displacement without the tool [m] and its load [N], shape (n, 3).
    held
        Nodes of the mesh that are held.
    interval_s
        Time between two frames [s]; infinite for none.
    large
        What answers in place of `solve` where the organ has a hyperelastic law; there is no weight then.
    """

    def __init__(
        self,
        space: Space,
        elasticity: ArrayLike,
        *,
        solve: Solve,
        product: Callable[[Array], Array],
        touchable: Ints,
        rest_m: Array,
        rest_load_N: Array,
        held: Ints,
        interval_s: float,
        large: LargeFields | None = None,
    ) -> None:
        self._space, self._elasticity, self._solve, self._product = space, elasticity, solve, product
        self._large = large
        self._touchable, self._rest_m, self._rest_load_N = touchable, rest_m, rest_load_N
        self.interval_s, self.next_s = interval_s, 0.0 if interval_s < inf else inf
        mesh = space.mesh
        sets = {"held": held, "touchable": touchable[touchable < len(mesh.nodes_m)]}
        self.series = FieldSeries(mesh.nodes_m, mesh.cells, mesh.part, mesh.part_names, node_sets=sets)
        self._ends = _edge_ends(space)
        self._kept: list[tuple[float, Array, Array]] = []
        self.notices: list[str] = []

    def keep(self, time_s: float, force_N: Array, moved: Array) -> None:
        """Keep the state of a frame that is due.

        Parameters
        ----------
        time_s, force_N
            Time [s] and forces on the touchable nodes [N], shape (t, 3).
        moved
            Force whose elastic answer is the displacement [N]; for a hyperelastic law the displacements of the
            touchable nodes [m].
        """
        self.next_s += self.interval_s
        self._kept.append((time_s, force_N.copy(), moved.copy()))

    def compute(self) -> None:
        """Solve the frames that were kept."""
        if self._large is not None:
            for time_s, force, touched in self._kept:
                moved, stress, reaction = self._large.under(force, touched)
                self.series.frames.append(self._shown(time_s, moved, stress, stress.strain, reaction))
            if self._kept and self._large.unsettled:
                self.notices.append(
                    f"the law's equilibrium was not reached in {self._large.unsettled} of {self._large.frames} frames: "
                    "their displacement and stress are approximate"
                )
            self._kept.clear()
        for first in range(0, len(self._kept), BATCH):
            batch = self._kept[first : first + BATCH]
            viscous = any(force is not creeping and (force != creeping).any() for _, force, creeping in batch)
            elastic = self._solve(np.stack([self._spread(force) for _, force, _ in batch]))
            moved = self._solve(np.stack([self._spread(creep) for *_, creep in batch])) if viscous else elastic
            for (time_s, force, _), strained, displaced in zip(batch, elastic, moved, strict=True):
                self.series.frames.append(self._frame(time_s, force, strained, displaced if viscous else strained))
        self._kept.clear()

    def _spread(self, force_N: Array) -> Array:
        load = np.zeros((self._space.node_count, 3))
        load[self._touchable] = force_N
        return load

    def _frame(self, time_s: float, force_N: Array, strained_m: Array, displaced_m: Array) -> Frame:
        """Stress belongs to the force that acts, strain and displacement to how far the tissue has crept."""
        stress = cell_stress(self._space, strained_m + self._rest_m, self._elasticity)
        strain = stress.strain
        if displaced_m is not strained_m:
            strain = cell_stress(self._space, displaced_m + self._rest_m, self._elasticity).strain
        reaction = self._product(strained_m + self._rest_m) - self._spread(force_N) - self._rest_load_N
        return self._shown(time_s, displaced_m + self._rest_m, stress, strain, reaction)

    def _shown(self, time_s: float, moved_m: Array, stress: StressState, strain: Array, reaction: Array) -> Frame:
        """A frame of displacements [m] and reactions [N] of all nodes, and of stress and strain of the cells."""
        corners = len(self._space.mesh.nodes_m)
        for end in self._ends.T:  # a middle node's reaction is shown half at each end of its edge
            np.add.at(reaction, end, 0.5 * reaction[corners:])
        single = lambda values: np.ascontiguousarray(values, dtype=np.float32)  # noqa: E731
        return Frame(
            time_s,
            {
                "displacement_mm": single(1e3 * moved_m[:corners]),
                "reaction_N": single(reaction[:corners]),
            },
            {
                "von_mises_kPa": single(1e-3 * stress.von_mises_Pa),
                "principal_stress_kPa": single(1e-3 * stress.principal_Pa),
                "strain_percent": single(100.0 * equivalent_strain(strain)),
            },
        )


def _edge_ends(space: Space) -> Ints:
    """Corners at the ends of each edge that has a middle node, shape (edges, 2)."""
    corners = len(space.mesh.nodes_m)
    ends = np.zeros((space.node_count - corners, 2), dtype=np.int64)
    for middle, pair in zip(space.cell_nodes[:, 4:].T, EDGES, strict=False):
        ends[middle - corners] = space.mesh.cells[:, pair]
    return ends


def equivalent_strain(strain: Array) -> Array:
    """Von Mises equivalent of strain tensors xx, yy, zz, yz, xz, xy, shape (n, 6): sqrt(2/3 e : e), e the deviator."""
    mean = strain[:, :3].mean(axis=1, keepdims=True)
    deviator = strain[:, :3] - mean
    value: Array = np.sqrt(2.0 / 3.0 * ((deviator**2).sum(axis=1) + 2.0 * (strain[:, 3:] ** 2).sum(axis=1)))
    return value
