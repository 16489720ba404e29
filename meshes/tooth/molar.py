"""Procedural lower first molar with ligament, bone socket and caries.

The tooth consists of enamel with cusps, of dentin, and of a pulp with horns and canals.

In the table, M at the start means from memory of the literature. The second letter is the
confidence: high (H), medium (M) or low (L).

=============================  =============  ======================================================================
crown, mesiodistal             11.0 mm        M, H: Nelson & Ash, mandibular first molar; 9.0 at the cervix
crown, buccolingual            10.5 mm        M, H: same; 9.0 at the cervix
crown height                   7.5 mm         M, H: same, buccal cervical line to cusp tip
root length                    14 mm          M, H: same
cervical line, mesial rise     0.9 mm         M, M: same gives 1.0 mesially, 0 distally
fossa to highest cusp          1.8 mm         M, L: cuspal inclines of about 25 degrees
enamel over cusps, fossa       2.2, 1.4 mm    M, M: 2 to 2.5 over cusps, thinner in fissures, none at the cervix
roof of the chamber            5.0 mm         M, M: below the fossa; cusp to roof 6.4 (Deutsch & Musikant 2004)
height of the chamber          1.9 mm         M, M: 1.6 (same)
root trunk                     3.2 mm         M, M: cervix to furcation, 3 buccally to 4 lingually
canals                         2 + 1          M, H: two mesial, one distal
ligament                       0.22 mm        M, H: 0.15 to 0.38
cervical line to bone          1.5 mm         M, H: 1 to 2 in health
=============================  =============  ======================================================================
"""  # noqa: E501 a table

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Bytes, Floats
from meshes.base.errors import InputError, Ranged, ranged
from meshes.shapes.anatomy import Anatomy, Classify
from meshes.shapes.sdf import Shape, box
from meshes.tooth.layers import (
    BONE,
    CARIES,
    DENTIN,
    ENAMEL,
    LAYER_DENSITY_KG_M3,
    LIGAMENT,
    PULP,
    TOOTH_LAYERS,
    caries_density,
    in_chunks,
)
from meshes.tooth.molar_parts import (
    Crown,
    Root,
    mandibular_roots,
    outer_shape,
    pulp_shape,
    tooth_distance,
)

_CREST_M = 1.5e-3
"""Distance [m] from the cervical line down to the bone crest, see the module docstring."""
_LEAST_OVER_PULP_M = 0.3e-3
"""Smallest thickness [m] of dentin between lesion and pulp.

The thickness is six voxels of the example scene ``caries``.
"""
_SHALLOWEST_LESION_M = 0.1e-3
"""Smallest depth [m] of a lesion: two voxels of the example scene ``caries``."""
_DENSITY = np.array([LAYER_DENSITY_KG_M3[name] for name in TOOTH_LAYERS], dtype=np.float32)


@dataclass(frozen=True)
class MolarSizes(Ranged):
    """Sizes of a lower first molar.

    Attributes
    ----------
    crown_width_mm, crown_length_mm
        Largest mesiodistal and buccolingual size of the crown [mm].
    crown_height_mm
        Height from the buccal cervical line to the highest cusp tip [mm].
    root_length_mm
        Length from the buccal cervical line to the apices [mm].
    enamel_thickness_mm
        Thickness of the enamel [mm], measured along z above the highest cusp. In the fossa, the
        thickness is 62 % of this value. At the cervical line, it is 0.
    cusp_height_mm
        Height from the central fossa to the highest cusp tip [mm].
    pulp_roof_mm
        Depth of the roof of the pulp chamber below the fossa [mm]. The horns extend 0.9 to 1.2 mm
        above the roof.
    ligament_thickness_mm
        Thickness of the periodontal ligament [mm].
    socket_mm
        Thickness [mm] of the bone around and below the roots. The bone is a block with a flat
        crest.
    caries_depth_mm
        Depth of a lesion under the fossa [mm]; 0 for no lesion. The depth of a lesion must be at
        least 0.1 mm. The lesion must end at least 0.3 mm above the roof of the pulp chamber. The
        boundary of the lesion is an ellipsoid that extends from the fossa down to this depth. The
        softness in the lesion is (1 - r²)², where r is 0 at the centre of the ellipsoid and 1 at
        its boundary. See `meshes.tooth.layers.caries_softness`.
    caries_diameter_mm
        Largest diameter of the lesion [mm].
    """

    crown_width_mm: float = ranged(11.0, 9.0, 13.0)
    crown_length_mm: float = ranged(10.5, 8.5, 12.5)
    crown_height_mm: float = ranged(7.5, 6.0, 9.5)
    root_length_mm: float = ranged(14.0, 8.0, 18.0)
    enamel_thickness_mm: float = ranged(2.2, 1.0, 3.0)
    cusp_height_mm: float = ranged(1.8, 0.8, 2.5)
    pulp_roof_mm: float = ranged(5.0, 3.5, 6.5)
    ligament_thickness_mm: float = ranged(0.22, 0.1, 0.5)
    socket_mm: float = ranged(2.5, 0.5, 10.0)
    caries_depth_mm: float = ranged(0.0, 0.0, 6.2, "use 0 for none, or about 3")
    caries_diameter_mm: float = ranged(3.0, 0.5, 6.0)


def molar(**sizes_mm: float) -> Anatomy:
    """Build a lower first molar in its socket, in the site frame of teeth.

    The origin is the bottom of the central fossa on the enamel. A thin bur that moves down the
    tooth's long axis first touches the tooth at the origin. A ball burr that is wider than the
    fossa first touches the cusps, slightly above the origin. x points mesially, y buccally, and z
    out of the tooth.

    Parameters
    ----------
    **sizes_mm
        Sizes, see `MolarSizes`.

    Raises
    ------
    InputError
        If a size is not finite or out of range, or if the pulp chamber or the lesion does not fit
        into the tooth.
    """
    sizes = MolarSizes(**sizes_mm)
    depth = 1e-3 * sizes.caries_depth_mm
    roof = 1e-3 * sizes.pulp_roof_mm
    height = 1e-3 * sizes.crown_height_mm
    cusp = 1e-3 * sizes.cusp_height_mm
    ligament = 1e-3 * sizes.ligament_thickness_mm
    _require_fit(depth, roof, height - cusp)
    width = 1e-3 * sizes.crown_width_mm
    length = 1e-3 * sizes.crown_length_mm
    crown = Crown(0.5 * width, 0.5 * length, height, cusp, 1e-3 * sizes.enamel_thickness_mm)
    roots = mandibular_roots(crown, 1e-3 * sizes.root_length_mm)
    whole = outer_shape(crown, roots) | _socket(crown, roots, ligament + 1e-3 * sizes.socket_mm)
    lesion = (1e-3 * sizes.caries_diameter_mm, depth) if depth > 0.0 else None
    notes = {
        "crown": f"{sizes.crown_width_mm:g} x {sizes.crown_length_mm:g} x "
        f"{sizes.crown_height_mm:g} "
        "mm, roots "
        f"{sizes.root_length_mm:g} mm",
        "enamel": (
            f"{sizes.enamel_thickness_mm:g} mm over the cusps, {1e3 * crown.fossa_enamel:.2g} mm "
            "in the fossa"
        ),
        "pulp": (
            f"roof {sizes.pulp_roof_mm:g} mm below the fossa, with horns about 1 mm higher; "
            "chamber and canals of a young adult, a prior"
        ),
        "bone": (
            f"a block of one density, which reaches {sizes.socket_mm:g} mm beyond the roots; "
            "cortical plate and marrow are not distinguished"
        ),
        "caries": f"{sizes.caries_depth_mm:g} mm deep, {sizes.caries_diameter_mm:g} mm wide"
        if lesion
        else "none",
        "gum and cementum": "not modelled",
    }
    pulp = pulp_shape(crown, roots, roof)
    classify = _layers(crown, roots, pulp, ligament, lesion)
    return Anatomy(
        "procedural molar",
        whole,
        TOOTH_LAYERS,
        classify,
        notes,
        thin_layers=True,
        structures={"pulp": pulp},
    )


def _require_fit(depth: float, roof: float, line: float) -> None:
    """Raise an error for an impossible lesion, or for a pulp chamber that extends into the roots.

    A lesion must not be too shallow or too near to the pulp.

    Parameters
    ----------
    depth, roof, line
        Depths [m] below the fossa of the lesion, the chamber's roof and the cervical line.
    """
    if 0.0 < depth < _SHALLOWEST_LESION_M:
        raise InputError(
            "caries_depth_mm",
            f"be 0 or at least {1000.0 * _SHALLOWEST_LESION_M:g}",
            f"{1000.0 * depth:g}",
            "use 0 for none, or about 3",
        )
    if depth > roof - _LEAST_OVER_PULP_M:
        raise InputError(
            "caries_depth_mm",
            "leave at least 0.3 mm over the pulp",
            f"{1000.0 * depth:g} with the roof of the pulp chamber at {1000.0 * roof:g} mm",
            f"use at most {1000.0 * (roof - _LEAST_OVER_PULP_M):g}",
        )
    # The height of the chamber is 1.9 mm and that of the root trunk 3.2 mm. The lower end of the
    # chamber is then at least 0.5 mm inside the trunk.
    if roof > line + 0.8e-3:
        raise InputError(
            "pulp_roof_mm",
            "lie above the root trunk",
            f"{1000.0 * roof:g} with the cervical line {1000.0 * line:g} mm below the fossa",
            f"use at most {1000.0 * line + 0.8:g}",
        )


def _socket(crown: Crown, roots: tuple[Root, Root], margin: float) -> Shape:
    """Return the block of bone around the roots, with a flat crest below the cervical line."""
    crest = crown.cervix - _CREST_M
    bottom = roots[0].top - roots[0].length - margin
    width = 2.0 * (max(root.reach_x for root in roots) + margin)
    length = 2.0 * (max(root.radius / root.flattening for root in roots) + margin)
    return box((width, length, crest - bottom), (0.0, 0.0, 0.5 * (crest + bottom)))


def _layers(
    crown: Crown,
    roots: tuple[Root, Root],
    pulp: Shape,
    ligament: float,
    lesion: tuple[float, float] | None,
) -> Classify:
    """Return a function that computes the layer and density of points.

    From inside to outside, the layers are pulp, dentin and enamel. Ligament and bone lie around the
    roots.
    """
    crest = crown.cervix - _CREST_M

    def dentin_distance(points: Floats) -> Floats:
        return tooth_distance(crown, roots, points, dentin=True)

    def around(points: Floats, distance: Floats) -> Bytes:
        """Return the layer, ligament or bone, of points outside the roots."""
        layer = np.full(len(points), BONE, dtype=np.uint8)
        near = np.flatnonzero(distance < 2.0 * ligament)
        layer[near[_true_distance(dentin_distance, points[near], distance[near]) < ligament]] = (
            LIGAMENT
        )
        return layer

    def layer_of(points: Floats) -> Bytes:
        """Return the layer, shape (n,), of points [m], shape (n, 3)."""
        distance = dentin_distance(points)
        layer = np.full(len(points), DENTIN, dtype=np.uint8)
        outside = distance >= 0.0
        crowned = points[:, 2] > crown.cervical_line(points[:, 0])
        layer[outside & crowned] = ENAMEL
        # The centre of a voxel at the crest may lie in the air above the crest. Points that are
        # nearer to the crest are bone.
        embedded = np.flatnonzero(outside & ~crowned & (points[:, 2] - crest < distance))
        layer[embedded] = around(points[embedded], distance[embedded])
        inside = np.flatnonzero(~outside)
        layer[inside[pulp.distance(points[inside]) < 0.0]] = PULP
        return layer

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        """Return layer and density [kg/m3], shape (n,), of points at any depth.

        The points [m] have the shape (n, 3).
        """
        layer = in_chunks(layer_of, points)
        density = _DENSITY[layer]
        if lesion is not None:
            softness = _softness(points, *lesion)
            carious = np.flatnonzero((softness > 0.0) & ((layer == ENAMEL) | (layer == DENTIN)))
            layer[carious] = CARIES
            density[carious] = caries_density(softness[carious])
        return layer, density

    return classify


def _softness(points: Floats, diameter: float, depth: float) -> Floats:
    """Compute the softness of the lesion, which is an ellipsoid.

    The softness is (1 - r²)², where r is 0 at the centre and 1 on the ellipsoid. Outside, the
    softness is 0. The ellipsoid extends from the fossa down.
    """
    across = (points[:, 0] ** 2 + points[:, 1] ** 2) * (4.0 / diameter**2)
    along = (points[:, 2] + 0.5 * depth) ** 2 * (4.0 / depth**2)
    return np.maximum(1.0 - across - along, 0.0) ** 2


def _true_distance(
    function: Callable[[Floats], Floats],
    points: Floats,
    value: Floats,
) -> Floats:
    """Compute the distance [m] of points from a surface, to first order near the surface.

    The surface is the set of points at which `function` is zero. The distance is `value`, the
    function's value at the points, divided by the slope of the function. The slope is computed by
    finite differences over 20 µm.
    """
    # 20 um: single precision resolves 1e-9 m here, and the curvature of the shapes is negligible
    # within 20 um.
    step = points.dtype.type(20e-6)
    slopes = []
    for axis in range(3):
        shift = step * np.eye(3, dtype=points.dtype)[axis]
        slopes.append((function(points + shift) - function(points - shift)) / (2.0 * step))
    # The slope is about 1. The limit of 0.1 bounds the quotient where the slopes of blended
    # surfaces cancel.
    return value / np.maximum(np.sqrt(sum(s * s for s in slopes)), 0.1)
