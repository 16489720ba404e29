"""A hyperelastic law of a soft organ: what follows its equilibria, and on which mesh."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import bsr_array, kron

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.quasi_newton import QuasiNewton
from tissue.fem.sampled_body import SampledBody
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.surface_transfer import surface_transfer
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.compliance import FACTOR_UNKNOWNS
from tissue.models.organ.contact import SurfaceContact
from tissue.models.organ.large_fields import LargeFields
from tissue.models.organ.law_offset import LawOffset
from tissue.models.organ.law_reduced import LawReduced
from tissue.models.organ.law_training import ReducedSettings, trained

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
    reduced
        Size of the reduced model that follows the law in every tick; None to solve it between ticks.
    """

    law: Hyperelastic
    cell_factors: Array
    interval_s: float
    coarser: "tuple[SoftOrgan, Array] | None" = None
    reduced: ReducedSettings | None = None


def law_offset_of(
    organ: "SoftOrgan",
    law: OrganLaw,
    touchable: Ints,
    contact: SurfaceContact,
    *,
    tips_m: Array,
    rotations: Array,
    report: Progress = silent,
) -> LawOffset | LawReduced:
    """How far the law has the touchable nodes of an organ, shape (t,), from where a compliance has them.

    Parameters
    ----------
    organ, law, touchable
        The organ, its law and the nodes.
    contact
        The tool on them, at rest.
    tips_m, rotations, report
        The tool's path, on which a reduced model is trained, and what hears of that.

    Raises
    ------
    InputError
        If the mesh is too large for a factor, or a reduced model's path does not touch the organ.
    """
    on, factors = law.coarser or (organ, law.cell_factors)
    transfer = surface_transfer(on.space, organ.space.nodes_m[touchable])
    nodes = np.unique(transfer.indices)
    on.factor.expect(nodes)

    def follower() -> QuasiNewton:
        return _follower(on, law.law, factors, nodes)

    if law.reduced is None:
        return LawOffset(follower(), on.body.fixed, transfer, interval_s=law.interval_s)
    training = trained(
        on.space, on.body, law.law, factors, transfer, contact, follower, tips_m, rotations, law.reduced, report
    )
    modes = training.modes
    few = SampledBody(
        on.space, law.law, factors, modes, points=training.points, volumes_m3=training.volumes_m3
    )  # fmt: skip
    surface = (kron(transfer, np.eye(3), format="csr") @ modes).astype(np.float64)
    return LawReduced(few, surface, contact, training, interval_s=law.interval_s)


def large_fields_of(organ: "SoftOrgan", law: OrganLaw, touchable: Ints) -> LargeFields:
    """Displacement, strain and stress of an organ under forces on its touchable nodes, on its mesh."""
    factors = law.cell_factors
    return LargeFields(organ.space, law.law, factors, lambda: _follower(organ, law.law, factors, touchable), touchable)


def _follower(organ: "SoftOrgan", law: Hyperelastic, cell_factors: Array, nodes: Ints) -> QuasiNewton:
    """What follows the equilibria of an organ; its factors know the compliance between some nodes."""
    at_rest = organ.factor.solver
    if not isinstance(at_rest, DirectSolver):
        raise InputError(
            f"organ.law must be linear on more than {FACTOR_UNKNOWNS:,} unknowns, got {len(organ.body.free):,}: "
            "use longer edges"
        )

    def factorised(stiffness: bsr_array) -> DirectSolver:
        return DirectSolver(HeldBody(stiffness, organ.space.nodes_m, organ.body.fixed), last=nodes)

    body = NonlinearBody(organ.space, None, law=law, cell_factors=cell_factors)
    return QuasiNewton(body, organ.body.fixed, at_rest, factorised)
