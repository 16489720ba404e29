"""What is cut, as functions of position: signed distance, and the strength of each of its layers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from tissue.materials.constants import CuttingCoefficients

__all__ = ["Solid"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Solid:
    """An anatomy that a tool cuts.

    Attributes
    ----------
    anatomy
        Its surface and layers as functions of position.
    coefficients
        Cutting coefficients of each layer, in the order of the anatomy's names.
    minus
        What was drilled out of it before the run; None where nothing was.
    """

    anatomy: Anatomy
    coefficients: tuple[CuttingCoefficients, ...]
    minus: Shape | None = None

    def distance(self, points: Array) -> Array:
        """Bound of the signed distance [m], shape (n,), negative inside, of points [m], shape (n, 3)."""
        distance = np.asarray(self.anatomy.shape.distance(points), dtype=np.float64)
        return distance if self.minus is None else np.maximum(distance, -self.minus.distance(points))

    def layer(self, points: Array) -> NDArray[np.uint8]:
        """Layer, shape (n,), of points [m], shape (n, 3)."""
        return self.anatomy.classify(points, -self.anatomy.shape.distance(points))[0]

    def strengths(self, points: Array) -> Array:
        """Chip and edge coefficients, shape (6, n): tangential, radial, axial chip [Pa], then edge [N/m].

        Each is that of the point's layer times (density / reference density) ** exponent of the layer.
        """
        layer, density = self.anatomy.classify(points, -self.anatomy.shape.distance(points))
        names = CuttingCoefficients.CHIP + CuttingCoefficients.EDGE
        table = np.array([[getattr(each, name) for each in self.coefficients] for name in names])
        reference = np.array([each.reference_density_kg_m3 for each in self.coefficients])
        exponent = np.array([each.density_exponent for each in self.coefficients])
        scale = (np.asarray(density, dtype=np.float64) / reference[layer]) ** exponent[layer]
        return np.asarray(table[:, layer] * scale)
