"""Displacement, strain, stress and reaction of a whole organ from the forces on its surface."""

from collections.abc import Callable
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, eye_array

from meshes.base.arrays import Array, Ints
from tissue.fem.fields import FieldSeries, Frame, StressState
from tissue.fem.quasi_newton import QuasiNewton, Springs
from tissue.fem.shapes import EDGES, gradient_slopes
from tissue.fem.space import Space
from tissue.fem.stress import cell_stress
from tissue.materials.hyperelasticity import Hyperelastic

__all__ = ["LargeFields", "OrganFields", "cauchy_stress", "equivalent_strain"]

TOLERANCE = 1e-3
STEPS = 100
"""Residual and number of steps allowed for a frame's equilibrium.

The residual is the largest unbalanced force over the largest force of the load.
"""
PLACES = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])
"""Rows and columns of the components xx, yy, zz, yz, xz, xy."""


class LargeFields:
    """Fields of an organ with a hyperelastic law under forces on its surface.

    Parameters
    ----------
    space
        Nodes and cells.
    law, cell_factors
        The law, and the factor on its moduli in each cell, shape (m,).
    follower
        Function that makes the equilibrium solver; called at the first use.
    touchable
        Nodes on which forces act, shape (t,).
    """

    def __init__(
        self,
        space: Space,
        law: Hyperelastic,
        cell_factors: Array,
        follower: Callable[[], QuasiNewton],
        touchable: Ints,
    ) -> None:
        self._space = space
        self._law = law
        self._cell_factors = cell_factors
        self._touchable = touchable
        self._make = follower
        self.frames = self.unsettled = 0
        """Numbers of frames so far, and of frames whose equilibrium was not reached."""

    @cached_property
    def _follower(self) -> QuasiNewton:
        return self._make()

    def under(self, forces_N: Array, moved_m: Array) -> tuple[Array, StressState, Array]:
        """Compute displacement [m], stress at the cell centres, and reaction of the supports [N].

        Displacement and reaction have shape (n, 3).

        Parameters
        ----------
        forces_N
            Forces on the touchable nodes [N], shape (t, 3).
        moved_m
            Displacements of the touchable nodes in the tick of these forces [m], shape (t, 3).
        """
        load = np.zeros((self._space.node_count, 3))
        load[self._touchable] = forces_N
        springs = None
        loaded = np.flatnonzero(forces_N.any(axis=1))
        if len(loaded):
            nodes = self._touchable[loaded]
            between = self._follower.at_rest.compliance_between(nodes)
            shares = csr_array(eye_array(self._space.node_count, format="csr")[nodes])
            springs = Springs.holding(
                shares, np.diag(between).reshape(-1, 3).mean(axis=1), moved_m[loaded]
            )
        found = self._follower.follow(load, tolerance=TOLERANCE, step_limit=STEPS, springs=springs)
        self.frames += 1
        self.unsettled += found.residual > TOLERANCE
        stress = cauchy_stress(self._space, found.displacement_m, self._law, self._cell_factors)
        return found.displacement_m, stress, found.internal_N - found.load_N


def cauchy_stress(
    space: Space, displacement_m: Array, law: Hyperelastic, cell_factors: Array
) -> StressState:
    """Return Cauchy stress and logarithmic strain at the centre of each cell, in the spatial frame.

    Parameters
    ----------
    space, displacement_m
        Nodes and cells, and the displacement of the nodes [m], shape (n, 3).
    law, cell_factors
        The law, and the factor on its moduli in each cell, shape (m,).
    """
    corners = np.asarray(space.gradients[0].numpy())
    shape = np.einsum("aci,i->ac", gradient_slopes(4, space.order), np.full(4, 0.25))
    gradient = np.eye(3) + np.einsum(
        "mai,ac,mcj->mij", displacement_m[space.cell_nodes], shape, corners, optimize=True
    )
    turned = gradient.transpose(0, 2, 1)
    stress = law.stress(gradient) @ turned * (cell_factors / np.linalg.det(gradient))[:, None, None]
    size, frame = np.linalg.eigh(gradient @ turned)
    strain = np.einsum("mik,mk,mjk->mij", frame, 0.5 * np.log(size), frame)
    deviator = stress - np.eye(3) * (np.trace(stress, axis1=1, axis2=2) / 3.0)[:, None, None]
    row, column = PLACES.T
    return StressState(
        strain[:, row, column],
        stress[:, row, column],
        np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))),
        np.linalg.eigvalsh(stress)[:, ::-1],
    )


Solve = Callable[[Array], Array]
"""Function that returns displacements [m] of all nodes under loads [N], (loads, n, 3) both."""
BATCH = 16
"""Number of frames solved at once."""


class OrganFields:
    """Displacement, strain, stress and reaction of a whole organ from the forces of its contact.

    A frame costs a tick a copy of the contact's forces. The fields are computed after the end of
    the run.

    Parameters
    ----------
    space
        Nodes and cells.
    elasticity
        As for `tissue.fem.assembly.assemble`.
    solve
        Displacement under loads, supports held.
    product
        Stiffness times displacements, shape (n, 3), supports not held: the product minus the load
        is the reaction.
    touchable
        Nodes that the tool can reach, shape (s,).
    rest_m, rest_load_N
        Displacement without the tool [m] and its load [N], shape (n, 3).
    held
        Nodes of the mesh that are held.
    interval_s
        Time between two frames [s]; infinite for no frames.
    large
        Solver that replaces `solve` where the organ has a hyperelastic law; the organ has no weight
        then.
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
        self._space = space
        self._elasticity = elasticity
        self._solve = solve
        self._product = product
        self._large = large
        self._touchable = touchable
        self._rest_m = rest_m
        self._rest_load_N = rest_load_N
        self.interval_s = interval_s
        self.next_s = 0.0 if interval_s < inf else inf
        mesh = space.mesh
        sets = {"held": held, "touchable": touchable[touchable < len(mesh.nodes_m)]}
        self.series = FieldSeries(
            mesh.nodes_m, mesh.cells, mesh.part, mesh.part_names, node_sets=sets
        )
        self._ends = _edge_ends(space)
        self._kept: list[tuple[float, Array, Array]] = []
        self.notices: list[str] = []

    def keep(self, time_s: float, force_N: Array, moved: Array) -> None:
        """Store the state of a frame that is due.

        Parameters
        ----------
        time_s, force_N
            Time [s] and forces on the touchable nodes [N], shape (t, 3).
        moved
            Force whose elastic response is the displacement [N]; for a hyperelastic law the
            displacements of the touchable nodes [m].
        """
        self.next_s += self.interval_s
        self._kept.append((time_s, force_N.copy(), moved.copy()))

    def compute(self) -> None:
        """Solve the stored frames."""
        if self._large is not None:
            for time_s, force, touched in self._kept:
                moved, stress, reaction = self._large.under(force, touched)
                self.series.frames.append(
                    self._shown(time_s, moved, stress, stress.strain, reaction)
                )
            if self._kept and self._large.unsettled:
                self.notices.append(
                    f"the law's equilibrium was not reached in {self._large.unsettled} of "
                    f"{self._large.frames} frames: "
                    "their displacement and stress are approximate"
                )
            self._kept.clear()
        for first in range(0, len(self._kept), BATCH):
            batch = self._kept[first : first + BATCH]
            viscous = any(
                force is not creeping and (force != creeping).any() for _, force, creeping in batch
            )
            elastic = self._solve(np.stack([self._spread(force) for _, force, _ in batch]))
            moved = (
                self._solve(np.stack([self._spread(creep) for *_, creep in batch]))
                if viscous
                else elastic
            )
            for (time_s, force, _), strained, displaced in zip(batch, elastic, moved, strict=True):
                self.series.frames.append(
                    self._frame(time_s, force, strained, displaced if viscous else strained)
                )
        self._kept.clear()

    def _spread(self, force_N: Array) -> Array:
        load = np.zeros((self._space.node_count, 3))
        load[self._touchable] = force_N
        return load

    def _frame(self, time_s: float, force_N: Array, strained_m: Array, displaced_m: Array) -> Frame:
        """Return a frame of an organ that creeps.

        Stress belongs to the force that acts; strain and displacement belong to the tissue after
        creep.
        """
        stress = cell_stress(self._space, strained_m + self._rest_m, self._elasticity)
        strain = stress.strain
        if displaced_m is not strained_m:
            strain = cell_stress(self._space, displaced_m + self._rest_m, self._elasticity).strain
        reaction = (
            self._product(strained_m + self._rest_m) - self._spread(force_N) - self._rest_load_N
        )
        return self._shown(time_s, displaced_m + self._rest_m, stress, strain, reaction)

    def _shown(
        self, time_s: float, moved_m: Array, stress: StressState, strain: Array, reaction: Array
    ) -> Frame:
        """Return a frame of displacements [m], reactions [N], stress and strain.

        Displacements and reactions belong to the nodes, stress and strain to the cells.
        """
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
    """Return the corners at the ends of each edge that has a middle node, shape (edges, 2)."""
    corners = len(space.mesh.nodes_m)
    ends = np.zeros((space.node_count - corners, 2), dtype=np.int64)
    for middle, pair in zip(space.cell_nodes[:, 4:].T, EDGES, strict=False):
        ends[middle - corners] = space.mesh.cells[:, pair]
    return ends


def equivalent_strain(strain: Array) -> Array:
    """Return the von Mises equivalent of strain tensors xx, yy, zz, yz, xz, xy, shape (n, 6).

    It is sqrt(2/3 e : e) with e the deviator.
    """
    mean = strain[:, :3].mean(axis=1, keepdims=True)
    deviator = strain[:, :3] - mean
    value: Array = np.sqrt(
        2.0 / 3.0 * ((deviator**2).sum(axis=1) + 2.0 * (strain[:, 3:] ** 2).sum(axis=1))
    )
    return value
