"""Displacement, strain, stress and reaction forces of a whole organ under contact forces."""

from dataclasses import replace
from math import inf

import numpy as np

from meshes.base.arrays import Array, Ints, Singles
from tissue.fem.fields import (
    FieldSeries,
    Frame,
    StressState,
    cell_stress,
    deviator_norm,
    displacement_gradient,
    principal_stresses,
    von_mises,
)
from tissue.fem.quasi_newton import Followed
from tissue.fem.space import EDGES, Space, gauss_points
from tissue.materials.elasticity import VOIGT
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.law_window import LawWindow, LawWindows
from tissue.models.organ.soft_organ import SoftOrgan

TOLERANCE = 1e-3
STEPS = 100
"""Largest number of solver steps for the fields at one time, under a hyperelastic law.

The solver stops earlier if the residual is at most `TOLERANCE`. The residual is the largest
unbalanced force divided by the largest force of the load. The number of steps is larger than
between ticks (`tissue.models.organ.law`), because the fields are computed after the run.
"""


class OrganFields:
    """Displacement, strain, stress and reaction of a whole organ under its contact forces.

    When a frame of the display is due, the tick only copies the contact forces and displacements.
    The fields are computed after the end of the run.

    Parameters
    ----------
    organ
        The organ. An organ with a hyperelastic law must have no weight.
    touchable
        Nodes on which forces act, shape (t,).
    interval_s
        Time between two frames [s]; infinity if no frames are wanted.
    windows
        Parts of the organ in which the hyperelastic law is solved; None for a linear organ.
    """

    def __init__(
        self,
        organ: SoftOrgan,
        touchable: Ints,
        *,
        interval_s: float,
        windows: LawWindows | None = None,
    ) -> None:
        self._organ = organ
        self._windows = windows
        self._space = organ.space
        self._touchable = touchable
        self.interval_s = interval_s
        self.next_s = 0.0 if interval_s < inf else inf
        mesh = organ.mesh
        sets = {"held": organ.held, "touchable": touchable[touchable < len(mesh.nodes_m)]}
        self.series = FieldSeries(
            mesh.nodes_m, mesh.cells, mesh.part, mesh.part_names, node_sets=sets
        )
        self._ends = _edge_ends(organ.space)
        self._kept: list[tuple[float, Array, Array, Array | None]] = []
        self.notices: list[str] = []

    def keep(
        self, time_s: float, force_N: Array, crept_N: Array, moved_m: Array | None = None
    ) -> None:
        """Store the forces and displacements from which a frame is computed after the run.

        Parameters
        ----------
        time_s, force_N
            Time [s] and forces on the touchable nodes [N], shape (t, 3).
        crept_N
            Crept forces [N], shape (t, 3): forces that would cause the present displacement in an
            elastic organ. In an organ that does not relax, they equal `force_N`.
        moved_m
            Displacements of the touchable nodes [m], shape (t, 3); None for a linear organ.
        """
        self.next_s += self.interval_s
        moved = None if moved_m is None else moved_m.copy()
        self._kept.append((time_s, force_N.copy(), crept_N.copy(), moved))

    def compute(self) -> None:
        """Solve for the fields at all stored times."""
        if self._windows is None:
            for time_s, force_N, crept_N, _ in self._kept:
                self._compute_linear(time_s, force_N, crept_N)
        else:
            self._compute_large(self._windows)
        self._kept.clear()

    def _compute_large(self, windows: LawWindows) -> None:
        """Solve for the fields of an organ with a hyperelastic law, with or without creep.

        Displacement and strain are the response of the law to the crept forces (see `keep`). The
        stress and reaction of this response are multiplied by a ratio: the resultant of the contact
        forces divided by the resultant of the crept forces. The result is exact if the contact
        forces are proportional to the crept forces.
        """
        unsettled = 0
        for time_s, forces, crept, moved_m in self._kept:
            assert moved_m is not None
            windows.choose(forces, crept)
            window = windows.now
            found = window.follower.follow(
                window.spread(crept),
                tolerance=TOLERANCE,
                step_limit=STEPS,
                springs=window.springs(crept, moved_m, _compliance_at_rest),
            )
            unsettled += found.residual > TOLERANCE
            moved, stress, reaction = self._state_in(window, found, crept)
            resultant = crept.sum(axis=0)
            square = float(resultant @ resultant)
            if self._organ.prony is not None and square > 0.0:
                share = float(forces.sum(axis=0) @ resultant) / square
                stress = replace(stress, stress_Pa=share * stress.stress_Pa)
                reaction *= share
            self._show(time_s, moved, stress, stress.strain, reaction)
        if unsettled:
            self.notices.append(
                f"the law's equilibrium was not reached in {unsettled} of {len(self._kept)} "
                "frames: their displacement and stress are approximate"
            )

    def _state_in(
        self, window: LawWindow, found: Followed, crept_N: Array
    ) -> tuple[Array, StressState, Array]:
        """Return displacement [m], stress and reaction [N] of the organ at a window's equilibrium.

        Outside the region of the window the organ is linear. The displacement is the response of
        the linear organ to the crept forces and to correction forces in the region. The correction
        forces are the forces of the linear law minus the forces of the hyperelastic law.
        """
        organ = self._organ
        law = organ.law
        assert law is not None
        region = window.region
        load = self._spread(crept_N)
        # The forces of the springs equal the contact forces within the tolerance.
        load[region.nodes] += (found.load_N - window.spread(crept_N))[: len(region.nodes)]
        load[region.all_nodes] += region.linear_difference_N(found.displacement_m)
        moved = organ.factor.solve(load)
        reaction = (organ.body.stiffness @ moved.ravel()).reshape(-1, 3) - load
        # Cells outside the region keep the border displacements of the linear solve. The region
        # represents its border with few modes, which would change the pressure of nearly
        # incompressible cells.
        stress = cell_stress(self._space, moved, organ.elasticity)
        window.nodal_into(moved, found.displacement_m)
        nodal = region.nodal_m(found.displacement_m)
        factors = law.cell_factors[region.cells]
        inside = cauchy_stress(region.body.space, nodal, law.law, factors)
        stress.strain[region.cells] = inside.strain
        stress.stress_Pa[region.cells] = inside.stress_Pa
        return moved, stress, reaction

    def _compute_linear(self, time_s: float, force_N: Array, crept_N: Array) -> None:
        """Solve for the fields of a linear organ at one time, with or without creep.

        Stress is computed from the contact forces. Strain and displacement are computed from the
        crept forces, see `keep`.
        """
        organ = self._organ
        rest_load, rest = organ.rest
        load = self._spread(force_N)
        strained = organ.factor.solve(load) + rest
        stress = cell_stress(self._space, strained, organ.elasticity)
        moved = strained
        strain = stress.strain
        if (force_N != crept_N).any():
            moved = organ.factor.solve(self._spread(crept_N)) + rest
            strain = cell_stress(self._space, moved, organ.elasticity).strain
        carried = (organ.body.stiffness @ strained.ravel()).reshape(-1, 3)
        self._show(time_s, moved, stress, strain, carried - load - rest_load)

    def _spread(self, force_N: Array) -> Array:
        load = np.zeros((self._space.node_count, 3))
        load[self._touchable] = force_N
        return load

    def _show(
        self, time_s: float, moved_m: Array, stress: StressState, strain: Array, reaction: Array
    ) -> None:
        """Add a frame of displacements [m], reactions [N], stress and strain.

        Displacements and reactions are given at the nodes, stress and strain in the cells.
        """
        corners = len(self._space.mesh.nodes_m)
        for end in self._ends.T:  # each end of an edge gets half of its middle node's reaction
            np.add.at(reaction, end, 0.5 * reaction[corners:])
        points = {"displacement_mm": 1e3 * moved_m[:corners], "reaction_N": reaction[:corners]}
        cells = {
            "von_mises_kPa": 1e-3 * von_mises(stress.stress_Pa),
            "principal_stress_kPa": 1e-3 * principal_stresses(stress.stress_Pa),
            # Von Mises equivalent strain sqrt(2/3 e : e), with the deviator e of the strain.
            "strain_percent": 100.0 * np.sqrt(2.0 / 3.0) * deviator_norm(strain),
        }
        self.series.frames.append(Frame(time_s, _single(points), _single(cells)))


def _compliance_at_rest(window: LawWindow, loaded: Ints) -> Array:
    """Return the compliance at rest [m/N], shape (3l, 3l), of l loaded nodes of a window."""
    return window.follower.at_rest.compliance_between(window.places[loaded])


def _single(values: dict[str, Array]) -> dict[str, Singles]:
    """Return arrays in single precision."""
    return {name: np.ascontiguousarray(array, dtype=np.float32) for name, array in values.items()}


def cauchy_stress(
    space: Space, displacement_m: Array, law: Hyperelastic, cell_factors: Array
) -> StressState:
    """Return the mean Cauchy stress and logarithmic strain of each cell, in the spatial frame.

    The means are taken over the quadrature points. In an equilibrium, no cell is inverted at these
    points, but a quadratic cell may be inverted at its centre.

    Parameters
    ----------
    space, displacement_m
        Finite elements, and displacement of their nodes [m], shape (n, 3).
    law, cell_factors
        Hyperelastic law, and factor by which its moduli are multiplied in each cell, shape (m,).
    """
    points = gauss_points(space.order)
    stress = np.zeros((space.cell_count, 3, 3))
    strain = np.zeros_like(stress)
    for point in points:
        gradient = np.eye(3) + displacement_gradient(space, displacement_m, point)
        turned = gradient.transpose(0, 2, 1)
        factors = cell_factors / np.linalg.det(gradient)
        stress += law.stress(gradient) @ turned * factors[:, None, None]
        size, frame = np.linalg.eigh(gradient @ turned)
        strain += np.einsum("mik,mk,mjk->mij", frame, 0.5 * np.log(size), frame)
    row, column = VOIGT.T
    return StressState(strain[:, row, column] / len(points), stress[:, row, column] / len(points))


def _edge_ends(space: Space) -> Ints:
    """Return the corners at the ends of each edge that has a middle node, shape (edges, 2)."""
    corners = len(space.mesh.nodes_m)
    ends = np.zeros((space.node_count - corners, 2), np.int64)
    for middle, pair in zip(space.cell_nodes[:, 4:].T, EDGES, strict=False):
        ends[middle - corners] = space.mesh.cells[:, pair]
    return ends
