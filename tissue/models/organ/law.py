"""Hyperelastic law of a soft organ and the mesh on which it is solved."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import bsr_array

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.quasi_newton import QuasiNewton
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.surface_transfer import surface_transfer
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.compliance import FACTOR_UNKNOWNS
from tissue.models.organ.fields import LargeFields
from tissue.models.organ.law_offset import LawOffset

if TYPE_CHECKING:
    from tissue.models.organ.soft_organ import SoftOrgan

__all__ = ["OrganLaw", "large_fields_of", "law_offset_of"]


@dataclass(frozen=True, eq=False)
class OrganLaw:
    """Hyperelastic law of an organ.

    Attributes
    ----------
    law
        Law of a cell whose factor is 1.
    cell_factors
        Factor on its moduli in each cell, shape (m,).
    interval_s
        Time between two solves, between ticks [s].
    coarser
        The organ on a coarser mesh, on which its law is solved, and the factors there; None for its
        own mesh.
    """

    law: Hyperelastic
    cell_factors: Array
    interval_s: float
    coarser: "tuple[SoftOrgan, Array] | None" = None


def law_offset_of(organ: "SoftOrgan", law: OrganLaw, touchable: Ints) -> LawOffset:
    """Build the offset of the touchable nodes of an organ that follows its law between ticks.

    The nodes have shape (t,).

    Raises
    ------
    InputError
        If the mesh is too large for a factor.
    """
    on, factors = law.coarser or (organ, law.cell_factors)
    transfer = surface_transfer(on.space, organ.space.nodes_m[touchable])
    nodes = np.unique(transfer.indices)
    on.factor.expect(nodes)
    follower = _follower(on, law.law, factors, nodes)
    return LawOffset(follower, on.body.fixed, transfer, interval_s=law.interval_s)


def large_fields_of(organ: "SoftOrgan", law: OrganLaw, touchable: Ints) -> LargeFields:
    """Return displacement, strain and stress of an organ under forces on its touchable nodes.

    They are computed on the organ's own mesh.
    """
    factors = law.cell_factors
    return LargeFields(
        organ.space,
        law.law,
        factors,
        lambda: _follower(organ, law.law, factors, touchable),
        touchable,
    )


def _follower(
    organ: "SoftOrgan", law: Hyperelastic, cell_factors: Array, nodes: Ints
) -> QuasiNewton:
    """Return the solver that follows the equilibria of an organ.

    Its factors hold the compliance between some nodes.
    """
    at_rest = organ.factor.solver
    if not isinstance(at_rest, DirectSolver):
        raise InputError(
            "organ.law",
            f"be linear on more than {FACTOR_UNKNOWNS:,} unknowns",
            f"{len(organ.body.free):,}",
            "use longer edges",
        )

    def factorised(stiffness: bsr_array) -> DirectSolver:
        held = HeldBody(stiffness, organ.space.nodes_m, organ.body.fixed)
        return DirectSolver(held, last=nodes, definite=True)

    body = NonlinearBody(organ.space, None, law=law, cell_factors=cell_factors)
    return QuasiNewton(body, organ.body.fixed, at_rest, factorised)
