"""How a solve ended, with cause and remedy, and what it found."""

from dataclasses import dataclass
from enum import Enum

from meshes.base.arrays import Array

__all__ = ["Solution", "SolverOutcome"]


class SolverOutcome(Enum):
    """How a solve ended; the value holds the cause and the remedy."""

    CONVERGED = "the displacement holds to the tolerance"
    NOT_CONVERGED = "the iterations ran out: allow more, loosen the tolerance, or take smaller steps"
    INACCURATE = "rounding is too large: mend sliver cells, or lower the contrast of moduli"
    INDEFINITE = "the stiffness is not positive definite: check moduli, Poisson's ratio, sliver cells and loose parts"
    OUTSIDE_BASIS = "the basis does not hold this load to the tolerance: take more modes, or another solver"
    INVERTED = "the held nodes turn cells over: move them in smaller steps"
    STALLED = "no step lowers the energy, cells are about to turn over: press less deep, or use the neo-Hookean law"
    UNSUPPORTED = "nothing holds the body: fix nodes that carry load, or give them springs"


@dataclass(frozen=True, eq=False)
class Solution:
    """Displacement and how it was reached.

    Attributes
    ----------
    displacement_m
        Nodal displacements [m], shape (n, 3); the last iterate where the outcome is not CONVERGED.
    outcome
        How the solve ended.
    iterations
        Iterations; 0 where the path does not iterate.
    residual
        Norm of ``f - K u`` over the free components, relative to that of f. For a reduced basis the relative error in
        the energy norm instead: what it leaves out moves little and weighs much in f.
    """

    displacement_m: Array
    outcome: SolverOutcome
    iterations: int
    residual: float

    @property
    def converged(self) -> bool:
        """Whether the displacement may be used."""
        return self.outcome is SolverOutcome.CONVERGED
