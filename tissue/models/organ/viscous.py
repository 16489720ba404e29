"""Contact at 1 kHz on a viscoelastic organ, from its elastic compliance.

Where every modulus of the body relaxes by one Prony series, Poisson's ratio is constant and the supports are rigid, the
elastic-viscoelastic correspondence gives the displacement of the surface under any history of nodal forces f::

    u(t) = integral j(t - s) d(W f)(s),    W the instantaneous elastic compliance, j the creep function

(Lee 1955, Q. Appl. Math. 13:183). One tick further, with the exact exponential step of each creep term::

    u = instant_factor W f + offset,

where the offset per surface node is known before the tick. A contact solver uses the scaled compliance, adds the offset
to the free surface and needs nothing else: any unilateral condition, with or without friction, for a contact that
grows, shrinks, moves or lifts off. The shortcut of relaxing the elastic force instead is right only while the contact
grows (Lee and Radok 1960, J. Appl. Mech. 27:438; Ting 1966, J. Appl. Mech. 33:845): when the tool retreats, it pulls
where the surface, slow to rise, has let go. Both hold for small strains without inertia. Neither holds where parts
relax by different series, nor where the shear modulus relaxes alone, unless the bulk modulus is so large that it does
not show (Poisson's ratio near 0.5).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import InputError
from tissue.materials.prony import HereditaryIntegral, Prony

__all__ = ["CreepState"]


class CreepState:
    """Creep of the surface nodes, exact for nodal forces that are linear within each tick.

    Parameters
    ----------
    node_count
        Surface nodes.
    prony
        The series that every modulus of the body follows; the compliance W is the instantaneous one.
    step_s
        Length of a tick [s].

    Raises
    ------
    InputError
        If there is no node, or the tick is not positive.
    """

    def __init__(self, node_count: int, prony: Prony, *, step_s: float) -> None:
        if node_count < 1:
            raise InputError(f"node_count must be at least 1, got {node_count}: give the surface nodes of a mesh")
        self._creep = HereditaryIntegral(prony.retardation, (node_count, 3), step_s=step_s)
        self.instant_factor = self._creep.instant_factor
        """What to multiply W with in this tick, slightly above 1."""

    @property
    def offset_m(self) -> NDArray[np.float64]:
        """Displacement that the surface has in this tick without any force [m], shape (node_count, 3); a view."""
        return self._creep.history

    def displacement_m(self, elastic_displacement_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement [m] at the end of this tick for W f [m], shape (node_count, 3)."""
        return self.instant_factor * elastic_displacement_m + self._creep.history

    def advance(self, elastic_displacement_m: NDArray[np.float64]) -> None:
        """End the tick with W f [m], shape (node_count, 3), of the forces that were found. Allocates nothing."""
        self._creep.advance(elastic_displacement_m)

    def restart(self, elastic_displacement_m: ArrayLike = 0.0) -> None:
        """Forget all that was; the forces jump now to those of this W f [m]."""
        self._creep.restart(elastic_displacement_m)
