"""Chisel edge of a twist drill, and the rake along its lips.

The cited coefficients hold for one rake. Two closed forms scale them to the rake of a drill.

Lips: orthogonal cutting with a shear plane (Merchant 1945, doi 10.1063/1.1707586). With the
friction angle b and the rake a, the forces per chip section are::

    K_t = 2 k cos(b - a) / (1 - sin(b - a)),    K_r = 2 k sin(b - a) / (1 - sin(b - a))

k is the yield stress in shear. It cancels out of the ratios to the reference rake.

Chisel edge: indentation of a rigid-plastic solid by a wedge with half angle t (Hill, Lee and Tupper
1947, doi 10.1098/rspa.1947.0009). The pressure 2 k (1 + s) acts on the width h tan(t) of the wedge
at a depth h, with cos(2 t - s) = cos(s) / (1 + sin(s)). Both flanks bound the wedge: tan(t) =
tan(half point angle) sin(chisel angle).
"""

from dataclasses import dataclass
from math import atan, cos, pi, radians, sin, tan

import numpy as np

from meshes.base.arrays import Array

__all__ = ["DrillPoint"]

CHISEL_ANGLE = radians(130.0)
"""Angle between chisel edge and lip, in a view along the axis; drills have 120 to 135 degrees."""
FRICTION_ANGLE = atan(160.0 / 250.0)
"""Friction angle of the chip at the reference rake of zero.

It follows from Merchant's formulas and the cited chip coefficients of bone, radial over tangential.
"""


@dataclass(frozen=True)
class DrillPoint:
    """Point of a twist drill with two lips.

    Attributes
    ----------
    radius_m
        Radius of the drill [m].
    web_m
        Thickness of the web between both flutes at the tip [m].
    helix_rad, point_angle_rad
        Helix angle at the rim, and included angle of the point.
    """

    radius_m: float
    web_m: float
    helix_rad: float
    point_angle_rad: float

    @property
    def chisel_radius_m(self) -> float:
        """Half the length of the chisel edge [m]."""
        return 0.5 * self.web_m / sin(CHISEL_ANGLE)

    def rakes_rad(self, radii_m: Array) -> Array:
        """Return the normal rake of the lips at radii outside the web [m], shape (n,).

        The flute is a helix surface through the straight lip (Galloway 1957, Transactions of the
        ASME 79).
        """
        half = 0.5 * self.point_angle_rad
        web = np.arcsin(0.5 * self.web_m / radii_m)
        helix = radii_m / self.radius_m * tan(self.helix_rad)
        flute = helix * np.cos(web) / (sin(half) - helix * np.sin(web) * cos(half))
        return np.asarray(np.arctan(flute) - np.arctan(np.tan(web) * cos(half)))

    def load_factors(self, radii_m: Array) -> Array:
        """Return factors of tangential and radial loads at radii of the point [m], shape (n, 2).

        They are relative to the loads of an edge with the reference rake. Tangential loads on the
        chisel edge keep their size.
        """
        factors = np.ones((len(radii_m), 2))
        at_lips = (radii_m >= self.chisel_radius_m) & (radii_m < self.radius_m)
        if at_lips.any():
            loads = _merchant(FRICTION_ANGLE - self.rakes_rad(radii_m[at_lips]))
            reference = _merchant(np.array([FRICTION_ANGLE]))
            # A steep flute pulls the lip into the bone. The law has no negative coefficients.
            factors[at_lips] = np.maximum(loads / reference, 0.0)
        factors[radii_m < self.chisel_radius_m, 1] = self.indentation
        return factors

    @property
    def indentation(self) -> float:
        """Thrust on the chisel edge over the thrust on an edge with the reference rake."""
        from scipy.optimize import brentq

        wedge = atan(tan(0.5 * self.point_angle_rad) * sin(CHISEL_ANGLE))
        # The angle of the fan lies between 0, for a thin blade, and pi / 2, for a flat punch.
        fan = brentq(lambda s: cos(2.0 * wedge - s) - cos(s) / (1.0 + sin(s)), 0.0, 0.5 * pi)
        reference = float(_merchant(np.array([FRICTION_ANGLE]))[0, 1])
        return 2.0 * (1.0 + fan) * tan(wedge) / reference


def _merchant(angles: Array) -> Array:
    """Return tangential and radial load over k, shape (n, 2), for friction angle minus rake."""
    loads = 2.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.asarray(loads / (1.0 - np.sin(angles))[:, None])
