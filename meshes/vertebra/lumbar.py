"""Procedural lumbar vertebra (L4).

The vertebra has a body with endplates, pedicles, lamina, processes and a spinal canal.

In the table, the first letter states the source: R was read, and M is from memory of the
literature. The second letter is the confidence: high (H), medium (M) or low (L). Values are for L4
unless stated otherwise.

=============================  =============  ======================================================================
body width, depth, height      48, 34.5, 25   M, M: Panjabi 1992, means of upper and lower endplate; height posterior
body's waist                   8 %            M, L: narrower half way up, a prior
canal width, depth             25.4, 18.6 mm  M, M: Panjabi 1992; interpedicular 26 to 27 at L5 (Gujarat 2012, R)
pedicle width                  12.9 mm        M, M: Zindrick 1987, narrowest transverse
pedicle height                 14.8 mm        M, M: Zindrick 1987, narrowest sagittal
pedicle angle                  17.7 deg       M, M: Zindrick 1987, medially toward the front; 6 to 30 over L1 to L5
pedicle's centre               6 mm           M, L: above the middle of the body
cortex of the pedicle          1.0 mm         M, M: medial 1.2 to lateral 0.7, L1 to L5 (Kothe 1996, Hirano 1997)
cortex of the body, endplate   0.4, 0.6 mm    M, M: Silva 1994, Edwards 2001
spinous, transverse process    32, 21 mm      M, L: lengths; Panjabi 1992 gives 69 and 80 over all
trabecular density             180 kg/m3      M, M: Keaveny 2001, lumbar bodies 100 to 300; cortex 1800
=============================  =============  ======================================================================

Facets, accessory processes and the wedge shape of the body are not modelled."""  # noqa: E501 a table

import math
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Bytes, Floats
from meshes.base.errors import InputError, Ranged, ranged
from meshes.shapes.anatomy import Anatomy, Classify
from meshes.shapes.sdf import Shape, capsule, union

VERTEBRA_LAYERS = ("cortical", "endplate", "trabecular")
# Sizes and densities that the table above does not list are priors.
_ENDPLATE_KG_M3 = 1200.0
_WAIST = 0.08
_ENDPLATE_M = 0.6e-3
_BODY_CORTEX_M = 0.4e-3
_LAMINA_M = 7e-3  # thickness of the arch behind the canal
_RAISED_M = 6e-3  # height of the pedicle's centre above the middle of the body
_BLEND_M = 3e-3  # width of the blend between parts
_SPINOUS_M = 32e-3
_TRANSVERSE_M = 21e-3
_ISTHMUS_M = 4e-3
"""Distance [m] from the back wall of the body to the isthmus (narrowest part) of the pedicle."""
_ENTRY_M = 19e-3
"""Distance [m] along the pedicle axis from the body's back wall to the drill's entry point.

The distance includes the pedicle and the pars interarticularis. The value is an assumption.
"""
_REACH_M = 75e-3
"""Half side [m] of a box that contains the bone. The default spinous process ends at 71 mm."""


@dataclass(frozen=True)
class _HalfSizes:
    """Half of each size of a vertebra [m], and the pedicle angle [rad].

    The properties are points and directions in the frame of the vertebral body.

    In this frame, x points left, y back and z up. The origin is the centre of the body.
    """

    width: float
    depth: float
    height: float
    canal_width: float
    canal_depth: float
    pedicle_width: float
    pedicle_height: float
    angle: float

    @property
    def canal_y(self) -> float:
        """Distance [m] by which the canal's centre lies behind the centre of the vertebral body."""
        return self.depth + self.canal_depth

    @property
    def isthmus(self) -> Array:
        """Middle [m] of the narrowest part of the left pedicle.

        The point lies lateral to the spinal canal, in the middle between the pedicle's two
        cortices.
        """
        return np.array(
            [
                self.canal_width + self.pedicle_width / math.cos(self.angle),
                self.depth + _ISTHMUS_M,
                _RAISED_M,
            ]
        )

    @property
    def axis(self) -> Array:
        """Unit vector along the axis of the left pedicle that points backward and outward."""
        return np.array([math.sin(self.angle), math.cos(self.angle), 0.0])

    @property
    def entry(self) -> Array:
        """Entry point of a drill [m], on the axis of the left pedicle, near the surface."""
        return self.isthmus + (_ENTRY_M - _ISTHMUS_M) * self.axis


@dataclass(frozen=True)
class VertebraSizes(Ranged):
    """Sizes of a lumbar vertebra.

    Attributes
    ----------
    body_width_mm, body_depth_mm, body_height_mm
        Width, depth and height of the body [mm].
    canal_width_mm, canal_depth_mm
        Width and depth of the elliptic spinal canal [mm].
    pedicle_width_mm, pedicle_height_mm
        Width and height of the elliptic pedicle [mm].
    pedicle_angle_deg
        Angle [degrees] between the pedicle's axis and the sagittal plane; the axes converge towards
        the front.
    pedicle_cortex_mm
        Thickness [mm] of the cortex of the pedicle and the arch. It must be less than a third of
        the pedicle's width.
    cortical_density_kg_m3
        Apparent density of the cortex [kg/m3].
    trabecular_density_kg_m3, pedicle_density_kg_m3
        Apparent densities [kg/m3] of trabecular bone. The first is for the body, the second for the
        pedicles and the arch.
    """

    body_width_mm: float = ranged(48.0, 36.0, 60.0)
    body_depth_mm: float = ranged(34.5, 26.0, 45.0)
    body_height_mm: float = ranged(25.0, 20.0, 34.0)
    canal_width_mm: float = ranged(25.4, 16.0, 32.0)
    canal_depth_mm: float = ranged(18.6, 11.0, 26.0)
    pedicle_width_mm: float = ranged(12.9, 5.0, 22.0)
    pedicle_height_mm: float = ranged(14.8, 8.0, 22.0)
    pedicle_angle_deg: float = ranged(17.7, 0.0, 35.0)
    pedicle_cortex_mm: float = ranged(1.0, 0.3, 3.0)
    cortical_density_kg_m3: float = ranged(1800.0, 200.0, 2200.0)
    trabecular_density_kg_m3: float = ranged(180.0, 50.0, 1200.0)
    pedicle_density_kg_m3: float = ranged(280.0, 50.0, 1200.0)


def lumbar_vertebra(**sizes: float) -> Anatomy:
    """Build a lumbar vertebra in the site frame of its left pedicle.

    The structure `canal` of the anatomy is the spinal canal.

    The origin is the posterior point where the axis of the left pedicle leaves the bone. z points
    backward out of the bone along this axis, y points upward, and x is perpendicular to y and z.
    The canal lies at positive x.

    Parameters
    ----------
    **sizes
        Sizes and densities, see `VertebraSizes`.

    Raises
    ------
    InputError
        If a size is not finite or out of range, or the cortex fills the pedicle.
    """
    given = VertebraSizes(**sizes)
    cortex = 1e-3 * given.pedicle_cortex_mm
    half = _HalfSizes(
        0.5e-3 * given.body_width_mm,
        0.5e-3 * given.body_depth_mm,
        0.5e-3 * given.body_height_mm,
        0.5e-3 * given.canal_width_mm,
        0.5e-3 * given.canal_depth_mm,
        0.5e-3 * given.pedicle_width_mm,
        0.5e-3 * given.pedicle_height_mm,
        math.radians(given.pedicle_angle_deg),
    )
    # 0.66 times the half width is a third of the width. At least a third of the pedicle is then
    # trabecular.
    if cortex > 0.66 * half.pedicle_width:
        raise InputError(
            "pedicle_cortex_mm",
            f"be less than a third of pedicle_width_mm ({given.pedicle_width_mm:g})",
            f"{given.pedicle_cortex_mm:g}",
            "use a value such as 1",
        )
    bone = _bone(half)
    canal = _canal(half)
    whole = Shape(
        lambda p: np.maximum(bone.distance(p), -canal.distance(p)), bone.lower_m, bone.upper_m
    )
    entry = half.entry
    # The axis leaves the bone between these distances from the entry. The point is found in steps
    # of 5 um.
    along = np.linspace(-5e-3, 25e-3, 6001)
    held = whole.distance(entry + along[:, None] * half.axis) < 0.0
    origin = entry + along[np.flatnonzero(held)[-1]] * half.axis
    x = np.array([-half.axis[1], half.axis[0], 0.0])
    z = half.axis
    turn = np.column_stack([x, np.cross(z, x), z])
    notes = {
        "body": f"{given.body_width_mm:g} x {given.body_depth_mm:g} x {given.body_height_mm:g} mm",
        "pedicle": f"{given.pedicle_width_mm:g} x {given.pedicle_height_mm:g} mm, "
        f"{given.pedicle_angle_deg:g} degrees; "
        "the left one",
        "canal": f"an ellipse of {given.canal_width_mm:g} x {given.canal_depth_mm:g} mm, straight",
        "cortex": (
            f"{given.pedicle_cortex_mm:g} mm around pedicle and arch, {1e3 * _BODY_CORTEX_M:g} "
            "around the body"
        ),
        "trabecular density": f"{given.trabecular_density_kg_m3:g} kg/m3, "
        f"{given.pedicle_density_kg_m3:g} in pedicle and arch: priors of low confidence",
        "facets": "not modelled",
    }
    return Anatomy(
        "procedural lumbar vertebra",
        _placed(whole, turn, origin),
        VERTEBRA_LAYERS,
        _layers(half, given, turn, origin),
        notes,
        structures={"canal": _placed(canal, turn, origin)},
    )


def _bone(sizes: _HalfSizes) -> Shape:
    """Return the outer surface of the vertebra with the canal filled, in the frame of the body."""
    pedicles = Shape(lambda p: _pedicles(sizes, p))
    body = Shape(lambda p: _body(sizes, p))
    back = sizes.canal_y + sizes.canal_depth
    # The spinous process consists of two rods, and each transverse process of one rod. Radii and
    # positions [m] are chosen by eye.
    tip = (0.0, back + _SPINOUS_M, -6e-3)
    spinous = capsule(3.5e-3, (0.0, back, 2e-3), tip) | capsule(
        3.5e-3, (0.0, back, -6e-3), (0.0, tip[1], -12e-3)
    )
    x, y, _ = sizes.entry.tolist()
    sides = [
        capsule(
            4e-3, (side * (x - 3e-3), y - 5e-3, 4e-3), (side * (x + _TRANSVERSE_M), y + 1e-3, 6e-3)
        )
        for side in (-1.0, 1.0)
    ]
    bone = union(
        body, union(pedicles, Shape(lambda p: _arch(sizes, p)), blend_m=_BLEND_M), blend_m=_BLEND_M
    )
    for process in (spinous, *sides):
        bone = union(bone, process, blend_m=_BLEND_M)
    reach = (_REACH_M,) * 3
    return Shape(bone.distance, tuple(-r for r in reach), reach)


def _body(sizes: _HalfSizes, p: Floats) -> Floats:
    """Compute the distance [m] of points from the body, an elliptic column with a waist."""
    share = np.clip(p[:, 2] / sizes.height, -1.0, 1.0)
    narrowed = 1.0 - _WAIST * (1.0 - share**2)
    column = _ellipse(p[:, 0], p[:, 1], sizes.width * narrowed, sizes.depth * narrowed)
    # The slope of the waist is at most 0.2, so the value of the column is too large by up to 2 %.
    # With the factor of 0.9, the value is a bound.
    return np.asarray(0.9 * np.maximum(column, np.abs(p[:, 2]) - sizes.height))


def _pedicles(sizes: _HalfSizes, p: Floats) -> Floats:
    """Compute the distance [m] of points from elliptic columns along the two pedicle axes.

    The columns extend from inside the vertebral body to the entry points behind the pedicles.
    """
    centre = sizes.isthmus.astype(p.dtype)
    axis = sizes.axis.astype(p.dtype)
    x = np.abs(p[:, 0]) - centre[0]
    y = p[:, 1] - centre[1]
    z = p[:, 2] - centre[2]
    along = x * axis[0] + y * axis[1]
    across = x * axis[1] - y * axis[0]
    column = _ellipse(across, z, sizes.pedicle_width, sizes.pedicle_height)
    # A column extends along the axis from 14 mm in front of the isthmus, inside the body, to the
    # entry. The isthmus lies 4 mm behind the body's back wall.
    ends = np.abs(along - 0.5 * (_ENTRY_M - 4e-3 - 14e-3)) - 0.5 * (_ENTRY_M - 4e-3 + 14e-3)
    return np.asarray(np.maximum(column, ends))


def _arch(sizes: _HalfSizes, p: Floats) -> Floats:
    """Compute the distance [m] of points from the lamina.

    The lamina is a wall around the canal behind the middle of the pedicles.
    """
    y = p[:, 1] - sizes.canal_y
    outer = _ellipse(p[:, 0], y, sizes.canal_width + _LAMINA_M, sizes.canal_depth + _LAMINA_M)
    # The lamina is 6 mm lower than the body in height and lies 1 mm deeper (chosen by eye).
    tall = np.abs(p[:, 2] + 1e-3) - (sizes.height - 3e-3)
    return np.asarray(np.maximum.reduce([outer, tall, -y]))


def _canal(sizes: _HalfSizes) -> Shape:
    """Return the spinal canal, an elliptic column through the vertebra."""
    return Shape(
        lambda p: _ellipse(p[:, 0], p[:, 1] - sizes.canal_y, sizes.canal_width, sizes.canal_depth),
        (-sizes.canal_width, sizes.canal_y - sizes.canal_depth, -math.inf),
        (sizes.canal_width, sizes.canal_y + sizes.canal_depth, math.inf),
    )


def _ellipse(x: Floats, y: Floats, a: float | Floats, b: float | Floats) -> Floats:
    """Compute the signed distance [m] of points from an ellipse with the half axes `a` and `b` [m].

    The nearest point of the ellipse is computed in steps. Each step replaces the ellipse by the
    circle of curvature at the last approximation (A. Nash, "Computing the distance between a point
    and an ellipse"). The first approximation is the ellipse point in the direction of 45 degrees.
    After three steps, the error is 1e-5 of the size of the ellipse.
    """
    px = np.abs(x)
    py = np.abs(y)
    tx = ty = np.full_like(px, math.sqrt(0.5))
    for _ in range(4):
        ex = (a * a - b * b) * tx**3 / a
        ey = (b * b - a * a) * ty**3 / b
        r = np.hypot(a * tx - ex, b * ty - ey)
        # 1e-12 m avoids a division by zero at the centre of curvature and (below) at the centre of
        # the ellipse.
        q = np.maximum(np.hypot(px - ex, py - ey), 1e-12)
        tx = np.clip(((px - ex) * r / q + ex) / a, 0.0, 1.0)
        ty = np.clip(((py - ey) * r / q + ey) / b, 0.0, 1.0)
        size = np.maximum(np.hypot(tx, ty), 1e-12)
        tx = tx / size
        ty = ty / size
    away = np.hypot(px - a * tx, py - b * ty)
    return np.asarray(np.where((px / a) ** 2 + (py / b) ** 2 < 1.0, -away, away).astype(x.dtype))


def _layers(sizes: _HalfSizes, given: VertebraSizes, turn: Array, origin: Array) -> Classify:
    """Return a function that computes the layer and density of points from their depths.

    The body has a thin cortical shell and endplates. All other parts of the vertebra have a thicker
    cortex.
    """

    cortex = 1e-3 * given.pedicle_cortex_mm

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        """Return layer and density [kg/m3], shape (n,), of points [m], shape (n, 3).

        The depths below the surface have the unit m.
        """
        p = points @ turn.T.astype(points.dtype) + origin.astype(points.dtype)
        # Cortex thickness and density change continuously from body to pedicle within the last 4 mm
        # of the body.
        behind = np.clip((p[:, 1] - sizes.depth + 4e-3) / 4e-3, 0.0, 1.0)
        shell = _BODY_CORTEX_M + (cortex - _BODY_CORTEX_M) * behind
        plate = (sizes.height - np.abs(p[:, 2]) < _ENDPLATE_M) & (behind < 1.0)
        layer = np.where(plate, 1, np.where(depth < shell, 0, 2)).astype(np.uint8)
        deep = given.trabecular_density_kg_m3
        sparse = deep + (given.pedicle_density_kg_m3 - deep) * behind
        plate_density = np.where(layer == 1, _ENDPLATE_KG_M3, sparse)
        density = np.where(layer == 0, given.cortical_density_kg_m3, plate_density)
        return layer, density.astype(points.dtype)

    return classify


def _placed(shape: Shape, turn: Array, origin: Array) -> Shape:
    """Convert a shape from the body's frame to the site frame.

    The columns of `turn` are the axes of the site frame.
    """
    corners = np.array(
        np.meshgrid(*np.clip(np.array([shape.lower_m, shape.upper_m]), -_REACH_M, _REACH_M).T)
    )
    seen = (corners.reshape(3, -1).T - origin) @ turn
    return Shape(
        lambda p: shape.distance(p @ turn.T.astype(p.dtype) + origin.astype(p.dtype)),
        tuple(seen.min(axis=0).tolist()),
        tuple(seen.max(axis=0).tolist()),
    )
