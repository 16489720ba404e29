"""Roache's grid-convergence index from three spacings, for forces without exact geometry.

Roache (1994), J. Fluids Eng. 116, 405-413; ASME V&V 20-2009, section 2-4. With h1 < h2 < h3, the
forces f1, f2, f3 and the norm over time, the observed order p solves ||f3 - f2|| / ||f2 - f1|| =
(h3^p - h2^p) / (h2^p - h1^p), and::

    index of grid k = F (||fk - f1|| + ||f2 - f1|| / ((h2 / h1)^p - 1)) / ||f1||

For k = 1 this is Roache's index. If all errors have the same shape over time, it applies to the
other grids too. Only the discretisation error is bounded. An error that all three grids share, such
as the error of a law or of the file's resolution, is not included.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.reference.history import means_over_50_ms

__all__ = ["GridIndex", "Order", "grid_index", "observed_order"]

FORMAL_ORDER = 2.0
"""Order of the force in the spacing, and the highest that an index is computed with."""
ASYMPTOTIC = 0.5, 2.2
"""Observed orders that count as asymptotic.

The range is from 0.5 (Eça and Hoekstra 2014, J. Comput. Phys. 262, 104-130) to a tenth above the
formal order (Oberkampf and Roy 2010, Verification and Validation in Scientific Computing).
"""
SAFETY = 1.25
SAFETY_OUTSIDE = 3.0
"""Roache's safety factors, within the asymptotic range and outside it."""
STEEPEST = 30.0
"""Largest searched order, of either sign. Larger orders count as infinite."""


@dataclass(frozen=True)
class Order:
    """Convergence in one norm, as shares of the norm of the finest force.

    Attributes
    ----------
    order
        Observed order. Infinite if the two finer forces agree, negative if they lie farther apart
        than the two coarser ones, NaN if all three agree.
    index
        Index of each grid, coarsest first.
    distance
        Distance of each grid to the finest, coarsest first.
    """

    order: float
    index: tuple[float, ...]
    distance: tuple[float, ...]

    @property
    def asymptotic(self) -> bool:
        """True if an extrapolation may use the observed order, or the three forces are equal."""
        return np.isnan(self.order) or ASYMPTOTIC[0] <= self.order <= ASYMPTOTIC[1]


@dataclass(frozen=True)
class GridIndex:
    """Grid-convergence index of three forces.

    Attributes
    ----------
    spacings
        Spacing of each grid, coarsest first.
    over_ticks, over_50_ms
        Over all ticks, and over means of 50 ms.
    bias
        Mean of each force less the finest along the finest, by the mean size of the finest;
        coarsest first.
    """

    spacings: tuple[float, ...]
    over_ticks: Order
    over_50_ms: Order
    bias: tuple[float, ...]


def grid_index(forces_N: Sequence[Array], spacings: Sequence[float]) -> GridIndex:
    """Compute the grid-convergence index of the forces of one motion on three grids.

    Parameters
    ----------
    forces_N
        Force at every tick on each grid [N], each shape (n, 3).
    spacings
        Spacing of each grid, in any unit. All other lengths of the grid must change by the same
        factor.

    Raises
    ------
    InputError
        If there are not three forces of one length at three different spacings.
    """
    if (
        len(forces_N) != 3
        or len(spacings) != 3
        or len({np.shape(force) for force in forces_N}) != 1
    ):
        raise InputError(
            "forces_N",
            "hold three forces of one motion with a spacing each",
            (
                f"{len(forces_N)} of shapes {sorted({np.shape(force) for force in forces_N})} "
                f"and {len(spacings)} spacings"
            ),
            "run the same motion on three grids",
        )
    order = np.argsort(spacings)[::-1]
    h = tuple(float(spacings[k]) for k in order)
    if not h[0] > h[1] > h[2] > 0.0:
        raise InputError(
            "spacings", "be positive and differ", tuple(spacings), "use h, 0.58 h and h / 3"
        )
    forces = [np.asarray(forces_N[k], dtype=np.float64) for k in order]
    sizes = np.linalg.norm(forces[2], axis=1)
    unit = forces[2] / np.maximum(sizes, 1e-300)[:, None]
    bias = [
        float(((force - forces[2]) * unit).sum()) / max(float(sizes.sum()), 1e-300)
        for force in forces
    ]
    windows = [means_over_50_ms(force) for force in forces]
    return GridIndex(h, _convergence(forces, h), _convergence(windows, h), tuple(bias))


def _convergence(forces: Sequence[Array], spacings: tuple[float, ...]) -> Order:
    """Return observed order and index, grids coarsest first."""
    coarse, middle, fine = forces
    size = max(float(np.linalg.norm(fine)), 1e-300)
    distance = tuple(float(np.linalg.norm(force - fine)) / size for force in forces)
    order = observed_order(float(np.linalg.norm(coarse - middle)) / size, distance[1], spacings)
    found = Order(order, (), distance)
    safety = SAFETY if found.asymptotic else SAFETY_OUTSIDE
    used = float(np.clip(np.nan_to_num(order, nan=FORMAL_ORDER), ASYMPTOTIC[0], FORMAL_ORDER))
    left = distance[1] / ((spacings[1] / spacings[2]) ** used - 1.0)
    return Order(order, tuple(safety * (each + left) for each in distance), distance)


def observed_order(coarse: float, fine: float, spacings: Sequence[float]) -> float:
    """Return the order p of an error C h^p from two differences of forces.

    The differences are ``coarse`` (h3 to h2) and ``fine`` (h2 to h1).

    Parameters
    ----------
    spacings
        h3 > h2 > h1.
    """
    if coarse == fine == 0.0:
        return float("nan")
    if fine == 0.0 or coarse == 0.0:
        return float("inf") if fine == 0.0 else float("-inf")
    h = np.log(np.array(spacings) / spacings[1])  # the middle one has h^p = 1

    def excess(p: float) -> float:
        ratio = -np.expm1(p * h[0]) / np.expm1(p * h[2]) if abs(p) > 1e-9 else -h[0] / h[2]
        return float(np.log(ratio) - np.log(coarse / fine))

    if excess(STEEPEST) < 0.0:
        return float("inf")
    if excess(-STEEPEST) > 0.0:
        return float("-inf")
    return float(brentq(excess, -STEEPEST, STEEPEST, xtol=1e-10))
