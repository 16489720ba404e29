"""How a solve ended, with cause and remedy."""

from enum import Enum

__all__ = ["SolverOutcome"]


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
