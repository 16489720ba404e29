"""Time of a tick at a setting that was not measured, from those that were."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.charts.measure import Measured

__all__ = ["CostModel"]


@dataclass(frozen=True)
class CostModel:
    """Median tick of a scene's model: a constant, and a share per element and per cell.

    ``tick = a + b elements + c met`` with nonnegative coefficients, fitted to relative errors. A
    cutter touches a surface, so voxels are counted over the area of contact. An organ's contacts
    are swept until they rest, and each sums over all others. There an element is a contact that a
    sweep visits, and the cells are the other contacts.

    Attributes
    ----------
    constant_us, element_us, cell_us
        a, b and c [us].
    """

    constant_us: float
    element_us: float
    cell_us: float

    @classmethod
    def fitted(cls, points: Sequence[Measured]) -> "CostModel":
        """Fit three or more measurements of one scene and one compute device.

        Raises
        ------
        InputError
            If there are fewer.
        """
        if len(points) < 3:
            raise InputError(
                f"points must be at least 3 to fit a cost, got {len(points)}: measure more settings"
            )
        ticks = np.array([point.median_us for point in points])
        terms = np.array([_terms(point) for point in points])
        scale = terms.max(axis=0)
        found, _ = nnls(terms / scale / ticks[:, None], np.ones(len(points)))
        constant, element, cell = (found / scale).tolist()
        return cls(constant, element, cell)

    def tick_us(self, point: Measured) -> float:
        """Median tick [us] at a setting, of which only what it counts is read."""
        return float(_terms(point) @ (self.constant_us, self.element_us, self.cell_us))


def _terms(point: Measured) -> Array:
    """Return the terms whose weighted sum is the cost."""
    return np.array([1.0, float(point.elements), point.met])
