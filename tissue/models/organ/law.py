"""A hyperelastic law of a soft organ: what follows its equilibria, and on which mesh."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from scipy.sparse import bsr_array

from meshes.base.arrays import Array, Ints
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.quasi_newton import QuasiNewton, Solve
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.surface_transfer import surface_transfer
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.large_fields import LargeFields
from tissue.models.organ.law_offset import LawOffset

if TYPE_CHECKING:
    from tissue.models.organ.soft_organ import SoftOrgan

__all__ = ["OrganLaw", "large_fields_of", "law_offset_of"]


@dataclass(frozen=True, eq=False)
class OrganLaw:
    """A hyperelastic law of an organ.

    Attributes
    ----------
    law
        The law of a cell whose factor is 1.
    cell_factors
        What its moduli are multiplied by in each cell, shape (m,).
    interval_s
        Time between two solves, between ticks [s].
    coarser
        The organ on a coarser mesh, on which its law is solved, and the factors there; None for its own mesh.
    """

    law: Hyperelastic
    cell_factors: Array
    interval_s: float
    coarser: "tuple[SoftOrgan, Array] | None" = None


def law_offset_of(organ: "SoftOrgan", law: OrganLaw, touchable: Ints) -> LawOffset:
    """How far the law has the touchable nodes of an organ, shape (t,), from where the compliance at rest has them."""
    on, factors = law.coarser or (organ, law.cell_factors)
    transfer = surface_transfer(on.space, organ.space.nodes_m[touchable])
    return LawOffset(_follower(on, law.law, factors), on.body, on.factor.solve, transfer, interval_s=law.interval_s)


def large_fields_of(organ: "SoftOrgan", law: OrganLaw, touchable: Ints) -> LargeFields:
    """Displacement, strain and stress of an organ under forces on its touchable nodes, on its mesh."""
    return LargeFields(
        organ.space, law.law, law.cell_factors, lambda: _follower(organ, law.law, law.cell_factors), touchable
    )


def _follower(organ: "SoftOrgan", law: Hyperelastic, cell_factors: Array) -> QuasiNewton:
    """What follows the equilibria of an organ."""

    def solver_of(stiffness: bsr_array) -> Solve:
        solver = DirectSolver(HeldBody(stiffness, organ.space.nodes_m, organ.body.fixed))
        return lambda load_N: solver.solve(load_N).displacement_m

    body = NonlinearBody(organ.space, None, law=law, cell_factors=cell_factors)
    return QuasiNewton(body, organ.body.fixed, organ.factor.solve, solver_of)
