"""Parts of a procedural lower first molar: crown, roots and pulp.

The parts are in the site frame of `meshes.tooth.molar`.

Lengths are in metres. The crown has a side wall with superelliptic sections and an occlusal surface
of cones. There is one cone for each cusp. Neighbouring cones meet in the grooves. Roots and canals
are round cones with curved axes, flattened along x.
"""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Floats
from meshes.shapes.sdf import Shape, box, capsule, smooth_maximum, smooth_minimum, union

_CUSPS = (
    (0.44, 0.50, 0.90),  # mesiobuccal
    (-0.15, 0.54, 0.86),  # distobuccal
    (-0.62, 0.28, 0.70),  # distal
    (0.42, -0.52, 1.00),  # mesiolingual
    (-0.34, -0.53, 0.97),  # distolingual
    (0.76, 0.0, 0.45),  # mesial marginal ridge
    (-0.74, -0.20, 0.42),  # distal marginal ridge
)
"""Positions and heights of the cusp tips.

Each entry has three numbers. The first is the mesial position x, relative to half the crown's
width. The second is the buccal position y, relative to half the crown's length. The third is the
height, relative to the highest cusp.
"""
_TRUE_CUSPS = 5
"""Number of cusps at the start of `_CUSPS`. The other entries are ridges."""
# The sizes in the table of `meshes.tooth.molar` are from the sources in the table. The other
# numbers below and in this module are chosen by eye, so that the parts look like a molar.
_TIP_RADIUS_M = 0.5e-3  # roundness of the cusps
_GROOVE_M = 0.35e-3  # width of the blend between two cusps
_EDGE_M = 1.0e-3  # width of the blend between chewing surface and wall
_CERVIX = (9.0 / 11.0, 9.0 / 10.5)  # width and length at the cervix / largest, from the table
_TABLE = (0.80, 0.78)  # width and length at the height of the cusp tips / largest
_BULGE = (0.62, 0.45)  # height of the widest section along x and y, 0 (cervix) to 1 (cusp tips)
_LINGUAL_LEAN_M = 0.35e-3  # shift of the crown towards the tongue at the cusp tips
_TRUNK_M = 3.2e-3  # from the table
_TRUNK_TAPER = 22.0  # relative narrowing of the trunk per metre below the cervix
_TRUNK_BLEND_M = 1.6e-3  # width of the blend between trunk and roots
_CERVICAL_CURVE_M = 0.9e-3  # from the table
_FULL_ENAMEL = 0.60  # height / crown height from which the enamel of the wall is full
_FOSSA_ENAMEL = 0.62  # thickness in the fossa / thickness above cusps, 1.4 of 2.2 mm
_WALL_ENAMEL = 0.62  # thickness at the wall / thickness above cusps
_STEEPEST = 1.85
"""Upper bound of the slope of `tooth_distance`.

In a search over valid sizes, the largest slope was 1.74.
"""
_CANAL_RISE_M = 0.8e-3  # height above the roots at which canals start, within the chamber


@dataclass(frozen=True)
class Crown:
    """Sizes of a molar's crown.

    Attributes
    ----------
    half_width, half_length
        Half the mesiodistal and buccolingual size [m] at the widest section.
    height
        Height [m] from the cervical line on the buccal side to the highest cusp tip.
    cusp_height
        Height [m] from the central fossa to the highest cusp tip.
    enamel
        Thickness [m] of the enamel above the highest cusp.
    """

    half_width: float
    half_length: float
    height: float
    cusp_height: float
    enamel: float

    @property
    def cervix(self) -> float:
        """Height z [m] of the cervical line on the buccal side."""
        return self.cusp_height - self.height

    @property
    def fossa_enamel(self) -> float:
        """Thickness [m] of the enamel in the central fossa."""
        return _FOSSA_ENAMEL * self.enamel

    @property
    def cusp_tips(self) -> Floats:
        """Tips [m], shape (5, 3), of the five cusps."""
        scale = np.array([self.half_width, self.half_length, self.cusp_height])
        return np.array(_CUSPS[:_TRUE_CUSPS]) * scale

    def occlusal_height(self, x: Floats, y: Floats) -> Floats:
        """Compute the height z [m] of the chewing surface.

        Each cusp is a cone with a round tip that extends down to the fossa.
        """
        surface = np.full_like(x, -np.inf)
        for along, across, relative in _CUSPS:
            px = along * self.half_width
            py = across * self.half_length
            reach = float(np.hypot(np.hypot(px, py), _TIP_RADIUS_M)) - _TIP_RADIUS_M
            away = np.sqrt((x - px) ** 2 + (y - py) ** 2 + _TIP_RADIUS_M**2) - _TIP_RADIUS_M
            cone = (relative * self.cusp_height) * (1.0 - away / reach)
            surface = smooth_maximum(surface, cone, _GROOVE_M)
        return (surface - self._fossa) * (self.cusp_height / (self.cusp_height - self._fossa))

    @property
    def _fossa(self) -> float:
        """Height [m] of the occlusal surface at the point where the cones of the seven cusps meet.

        The height of each cone is 0 at this point, but the surface is higher, because the cones are
        blended.
        """
        level = 0.0
        for _ in _CUSPS[1:]:
            level = float(smooth_maximum(np.array([level]), np.array([0.0]), _GROOVE_M)[0])
        return level

    def cervical_line(self, x: Floats) -> Floats:
        """Compute the height z [m] of the cervical line.

        The cervical line is higher on the mesial and distal sides.
        """
        return self.cervix + _CERVICAL_CURVE_M * np.minimum(
            (x / (_CERVIX[0] * self.half_width)) ** 2, 1.0
        )

    def wall(self, p: Floats) -> Floats:
        """Compute the horizontal distance [m] of points from the wall of the crown and root trunk.

        The distance is negative inside.
        """
        height = (p[:, 2] - self.cervix) * (1.0 / self.height)
        below = np.maximum(-height, 0.0) * (self.height * _TRUNK_TAPER)
        half = [
            size * self._bulge(height, k) * (1.0 - below)
            for k, size in enumerate((self.half_width, self.half_length))
        ]
        lean = _LINGUAL_LEAN_M * np.clip(height, 0.0, 1.0)
        u = np.abs(p[:, 0]) / half[0]
        v = np.abs(p[:, 1] + lean) / half[1]
        return (np.cbrt(u * u * u + v * v * v) - 1.0) * np.minimum(half[0], half[1])

    @staticmethod
    def _bulge(height: Floats, axis: int) -> Floats:
        """Compute the crown's half width at given heights, relative to the largest half width.

        Heights are relative: 0 is the cervix, and 1 is the height of the cusp tips.
        """
        widest = _BULGE[axis]
        low = np.clip((widest - height) / widest, 0.0, 1.0)
        # Above the tips, the wall continues to narrow up to the height 1.2. Above this height, its
        # shape has no effect.
        high = np.clip((height - widest) / (1.0 - widest), 0.0, 1.2)
        return 1.0 - (1.0 - _CERVIX[axis]) * low * low - (1.0 - _TABLE[axis]) * high * high

    def outside(self, p: Floats) -> Floats:
        """Compute the distance [m] of points from the union of crown and root trunk.

        The distance from the chewing surface is measured along z. The distance from the side wall
        is measured horizontally.
        """
        top = p[:, 2] - self.occlusal_height(p[:, 0], p[:, 1])
        return smooth_maximum(self.wall(p), top, _EDGE_M)

    def outside_dentin(self, p: Floats) -> Floats:
        """Compute the distance [m] of points from the dentin and the root trunk, like `outside`.

        Below the cervical line, the result is equal to `outside`.
        """
        height = self.occlusal_height(p[:, 0], p[:, 1])
        relative = np.clip(height / self.cusp_height, 0.0, 1.0)
        over = self.enamel * (_FOSSA_ENAMEL + (1.0 - _FOSSA_ENAMEL) * relative)
        rise = (p[:, 2] - self.cervical_line(p[:, 0])) * (1.0 / (_FULL_ENAMEL * self.height))
        rise = np.clip(rise, 0.0, 1.0)
        thickened = (_WALL_ENAMEL * self.enamel) * rise * (2.0 - rise)
        return smooth_maximum(self.wall(p) + thickened, p[:, 2] - height + over, _EDGE_M)


@dataclass(frozen=True)
class Root:
    """Root of a molar: a rounded cone with a curved axis in the x-z plane and a larger width in y.

    Attributes
    ----------
    top, length
        Height of the root's upper end [m], and length from the upper end to the apex [m].
    axis
        Coefficients [m] of 1, u and u² in the polynomial for the x coordinate of the axis. The
        variable u is 0 at the top and 1 at the apex.
    radius, apex_radius
        Half widths [m] along x, at the top and at the apex.
    flattening
        Ratio of the half width along x to the half width along y.
    """

    top: float
    length: float
    axis: tuple[float, float, float]
    radius: float
    apex_radius: float
    flattening: float

    @property
    def reach_x(self) -> float:
        """Largest distance [m], along x, of a point of the root from the tooth's long axis."""
        u = np.linspace(0.0, 1.0, 33)
        axis = self.axis[0] + u * (self.axis[1] + u * self.axis[2])
        return float(np.max(np.abs(axis) + self.radius + u * (self.apex_radius - self.radius)))

    def centre_x(self, z: Floats) -> Floats:
        """Compute the x coordinates [m] of the root's axis at the heights z [m]."""
        u = np.clip((self.top - z) * (1.0 / self.length), 0.0, 1.0)
        return self.axis[0] + u * (self.axis[1] + u * self.axis[2])

    def distance(self, p: Floats) -> Floats:
        """Compute a bound of the signed distance [m] from the root.

        The bound is negative inside the root.

        Along x, the bound is equal to the distance. Along y, the bound is `flattening` times the
        distance.
        """
        across = np.sqrt((p[:, 0] - self.centre_x(p[:, 2])) ** 2 + (self.flattening * p[:, 1]) ** 2)
        return _round_cone(
            across,
            self.top - p[:, 2],
            self.radius,
            self.apex_radius,
            self.length - self.apex_radius,
        )

    def canal(self, p: Floats, *, radius: float, offset: tuple[float, float]) -> Floats:
        """Compute the distance [m] of points from a canal that follows the root's axis.

        `offset` contains two shifts [m] of the canal along y relative to the root's axis: at the
        top and at the apex.
        """
        depth = self.top + _CANAL_RISE_M - p[:, 2]
        u = np.clip(depth * (1.0 / self.length), 0.0, 1.0)
        y = p[:, 1] - (offset[0] + (offset[1] - offset[0]) * u)
        across = np.sqrt((p[:, 0] - self.centre_x(p[:, 2])) ** 2 + y * y)
        # A canal narrows to 0.4 of its width and ends 0.4 mm before the apex.
        return _round_cone(
            across, depth, radius, 0.4 * radius, self.length + _CANAL_RISE_M - 0.4e-3
        )


def mandibular_roots(crown: Crown, root_length: float) -> tuple[Root, Root]:
    """Build the mesial and the distal root.

    The two apices lie `root_length` below the buccal cervical line.
    """
    # The roots start inside the trunk. Radii, curvatures and positions [m] are for a crown of
    # 11.0 x 10.5 mm.
    top = crown.cervix - 1.5e-3
    length = root_length - 1.5e-3
    side = crown.half_width / 5.5e-3
    flat = (crown.half_width / 5.5e-3) / (crown.half_length / 5.25e-3)
    mesial = Root(
        top, length, (2.1e-3 * side, 2.3e-3, -1.7e-3), 1.95e-3 * side, 0.6e-3, 0.50 * flat
    )
    distal = Root(
        top, length, (-2.1e-3 * side, -1.9e-3, 0.6e-3), 1.85e-3 * side, 0.6e-3, 0.54 * flat
    )
    return mesial, distal


def tooth_distance(crown: Crown, roots: tuple[Root, Root], p: Floats, *, dentin: bool) -> Floats:
    """Compute the distance [m] of points from the tooth, or from the dentin and pulp if `dentin`.

    The distance is negative inside.
    """
    head = crown.outside_dentin(p) if dentin else crown.outside(p)
    furcation = (crown.cervix - _TRUNK_M) - p[:, 2]
    head = smooth_maximum(head, furcation, _TRUNK_BLEND_M)
    legs = smooth_minimum(roots[0].distance(p), roots[1].distance(p), 0.0)
    return smooth_minimum(head, legs, _TRUNK_BLEND_M)


def outer_shape(crown: Crown, roots: tuple[Root, Root]) -> Shape:
    """Build the outer surface of the tooth as a shape.

    The value of `tooth_distance` is divided by an upper bound of its slope. The magnitude of the
    result is therefore a lower bound of the true distance.
    """
    # A margin of a tenth includes the inclination of the crown, 7 % of its half length. A margin of
    # 2 % includes the tips.
    low = (-1.1 * crown.half_width, -1.1 * crown.half_length, roots[0].top - roots[0].length)
    high = (1.1 * crown.half_width, 1.1 * crown.half_length, 1.02 * crown.cusp_height)
    return Shape(
        lambda p: tooth_distance(crown, roots, p, dentin=False) * (1.0 / _STEEPEST), low, high
    )


def pulp_shape(crown: Crown, roots: tuple[Root, Root], roof: float) -> Shape:
    """Build the pulp as a signed distance function [m].

    The pulp has a chamber with a horn under each cusp, two canals in the mesial root and one canal
    in the distal root.

    Parameters
    ----------
    roof
        Depth [m] of the chamber's roof below the fossa.
    """
    # The height of the chamber is from the table. The other sizes and positions [m] are chosen by
    # eye, inside the dentin.
    height = 1.9e-3
    size = (0.40 * 2.0 * crown.half_width, 0.34 * 2.0 * crown.half_length, height)
    chamber = box(size, (0.0, 0.0, -roof - 0.5 * height), rounding_m=0.8e-3)
    for x, y, z in crown.cusp_tips.tolist():
        tip = (0.72 * x, 0.58 * y, -roof + 0.9e-3 * z / crown.cusp_height)
        horn = capsule(0.25e-3, (0.60 * x, 0.48 * y, -roof - 0.6e-3), tip)
        chamber = union(chamber, horn, blend_m=0.5e-3)
    mesial, distal = roots

    def canals(p: Floats) -> Floats:
        pair = np.minimum(
            mesial.canal(p, radius=0.42e-3, offset=(1.5e-3, 0.7e-3)),
            mesial.canal(p, radius=0.42e-3, offset=(-1.5e-3, -0.7e-3)),
        )
        return np.minimum(pair, distal.canal(p, radius=0.55e-3, offset=(0.0, 0.0)))

    return union(chamber, Shape(canals), blend_m=0.8e-3)


def _round_cone(
    across: Floats, along: Floats, radius: float, end_radius: float, length: float
) -> Floats:
    """Compute the distance [m] of points from the convex hull of two balls (I. Quilez).

    The centres of the balls lie on one axis, at the distance `length` [m]. `across` and `along` are
    the coordinates of the points perpendicular to the axis and along it, measured from the first
    centre.
    """
    sine = (radius - end_radius) / length
    cosine = float(np.sqrt(1.0 - sine * sine))
    span = cosine * along - sine * across
    first = np.sqrt(across**2 + along**2) - radius
    last = np.sqrt(across**2 + (along - length) ** 2) - end_radius
    side = across * cosine + along * sine - radius
    return np.where(span < 0.0, first, np.where(span > cosine * length, last, side))
