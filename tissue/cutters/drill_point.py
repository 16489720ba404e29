"""Chisel edge of a twist drill, and the rake along its lips.

The cutting coefficients in ``cutting.toml`` are valid for one rake. Two formulas scale them to the
rake of a drill.

Lips: orthogonal cutting with a shear plane (Merchant 1945, doi 10.1063/1.1707586). With the
friction angle b and the rake a, the forces per chip section are::

    K_t = 2 k cos(b - a) / (1 - sin(b - a)),    K_r = 2 k sin(b - a) / (1 - sin(b - a))

Here k is the yield stress in shear, which cancels in the ratios to the reference rake.

Chisel edge: indentation of a rigid-plastic solid by a wedge with half angle t (Hill, Lee and Tupper
1947, doi 10.1098/rspa.1947.0009). The pressure 2 k (1 + s) acts on the width h tan(t) of the wedge
at a depth h, with cos(2 t - s) = cos(s) / (1 + sin(s)). The wedge lies between the two flanks:
tan(t) = tan(half point angle) sin(chisel angle).
"""

from dataclasses import dataclass
from math import atan, cos, pi, radians, sin, tan

import numpy as np

from meshes.base.arrays import Array

CHISEL_ANGLE = radians(130.0)
"""Angle between chisel edge and lip, in a view along the axis; drills have 120 to 135 degrees."""
FRICTION_ANGLE = atan(160.0 / 250.0)
"""Friction angle between chip and tool at the reference rake of zero.

By Merchant's formulas, the tangent of this angle is the ratio of the radial to the tangential chip
coefficient of bone.
"""


@dataclass(frozen=True)
class DrillPoint:
    """Point of a twist drill with two lips.

    Attributes
    ----------
    radius_m
        Radius of the drill [m].
    web_m
        Thickness of the web between the two flutes at the tip [m].
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
        """Return the normal rake of the lips [rad], shape (n,), at radii [m] outside the web.

        The flute is a helix surface through the straight lip (Galloway 1957, Transactions of the
        ASME 79).
        """
        half = 0.5 * self.point_angle_rad
        web = np.arcsin(0.5 * self.web_m / radii_m)
        helix = radii_m / self.radius_m * tan(self.helix_rad)
        flute = helix * np.cos(web) / (sin(half) - helix * np.sin(web) * cos(half))
        return np.arctan(flute) - np.arctan(np.tan(web) * cos(half))

    def load_factors(self, radii_m: Array) -> Array:
        """Return factors of the tangential and the radial load at n radii [m], shape (n, 2).

        The factors are relative to the loads of an edge with the reference rake. The tangential
        factor of the chisel edge is 1.
        """
        factors = np.ones((len(radii_m), 2))
        at_lips = (radii_m >= self.chisel_radius_m) & (radii_m < self.radius_m)
        if at_lips.any():
            loads = _merchant(FRICTION_ANGLE - self.rakes_rad(radii_m[at_lips]))
            reference = _merchant(np.array([FRICTION_ANGLE]))
            # A steep flute would pull the lip into the bone. The cutting law does not allow
            # negative coefficients.
            factors[at_lips] = np.maximum(loads / reference, 0.0)
        factors[radii_m < self.chisel_radius_m, 1] = self.indentation
        return factors

    @property
    def indentation(self) -> float:
        """Thrust on the chisel edge, divided by the thrust on an edge with the reference rake."""
        from scipy.optimize import brentq

        wedge = atan(tan(0.5 * self.point_angle_rad) * sin(CHISEL_ANGLE))
        # The angle of the fan lies between 0, for a thin blade, and pi / 2, for a flat punch.
        fan = brentq(lambda s: cos(2.0 * wedge - s) - cos(s) / (1.0 + sin(s)), 0.0, 0.5 * pi)
        reference = float(_merchant(np.array([FRICTION_ANGLE]))[0, 1])
        return 2.0 * (1.0 + fan) * tan(wedge) / reference


def _merchant(angles: Array) -> Array:
    """Return tangential and radial load divided by k, shape (n, 2).

    `angles` contains n differences between friction angle and rake [rad].
    """
    loads = 2.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    return loads / (1.0 - np.sin(angles))[:, None]
