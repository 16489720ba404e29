"""Layers of a tooth: names, densities, softness of carious dentin, checks, and sites.

In the table, M at the start means from memory of the literature. The second letter is the
confidence: high (H), medium (M) or low (L).

=========  =================  ==========================================================================
enamel     2900 kg/m3         M, H: 2.8 to 3.0 (Weidmann 1967)
dentin     2100 kg/m3         M, H: 2.05 to 2.30 (Manly 1939)
pulp       1000 kg/m3         M, M: soft tissue, nearly water
caries     2100 to 1300       M, L: infected dentin keeps about a third of its mineral (after Angker 2004)
ligament   1100 kg/m3         M, M: fibrous soft tissue
bone       1800 kg/m3         M, H: alveolar bone taken as cortical throughout
=========  =================  ==========================================================================

The site of a tooth is determined by the long axis of the tooth or by a lesion. The long axis is a
principal axis of all points of the tooth. The principal axis with the smallest angle to the line
between the centres of dentin and enamel is chosen. If all three angles are larger than 25 degrees,
as in a crown without roots, the line itself is the long axis."""  # noqa: E501 a table

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Floats, Singles
from meshes.base.errors import InputError, enumerated
from meshes.surfaces.site import Site
from meshes.voxels.volume import FULL, VoxelVolume

Kind = TypeVar("Kind", bound=np.generic)

TOOTH_LAYERS = ("enamel", "dentin", "pulp", "caries", "ligament", "bone")
ENAMEL, DENTIN, PULP, CARIES, LIGAMENT, BONE = range(6)
LAYER_DENSITY_KG_M3 = {
    "enamel": 2900.0,
    "dentin": 2100.0,
    "pulp": 1000.0,
    "caries": 1700.0,
    "ligament": 1100.0,
    "bone": 1800.0,
}
"""Density of each layer [kg/m3].

The density of `caries` is used if the softness of a lesion is unknown. This density belongs to a
softness of one half.
"""

EMPTY = 255
"""Layer index outside the tooth."""
PRIORITY = ("caries", "pulp", "enamel", "dentin", "ligament", "bone")
"""Priority of layers. A point in several layers belongs to the layer that comes first."""

_SOUND_KG_M3 = 2100.0
_INFECTED_KG_M3 = 1300.0
"""Density [kg/m3] of dentin with a softness of 1. For `_SOUND_KG_M3`, the softness is 0."""
_POINTS_AT_ONCE = 1 << 17
"""Number of points evaluated at once. The coordinates take 3 MB, which fits in the cache."""
_SMALLEST_MM = 5.0
LARGEST_MM = 40.0
_TYPICAL_MM = 18.0
"""Longest side [mm] of a typical molar.

The limits of a valid longest side, `_SMALLEST_MM` and `LARGEST_MM`, correspond to a crown without
roots and to a canine with its root.
"""


def caries_density(softness: Floats) -> Floats:
    """Compute the density [kg/m3] of carious dentin from its softness.

    The density is a linear function of the softness. The softness is 0 for sound dentin and 1 for
    fully softened dentin.
    """
    return _SOUND_KG_M3 - (_SOUND_KG_M3 - _INFECTED_KG_M3) * softness


def caries_softness(density_kg_m3: Floats) -> Floats:
    """Compute the softness of the layer `caries` from its density [kg/m3].

    The softness is (2100 - density)/800, limited to 0 to 1.

    A softness of 0 means sound dentin, and a softness of 1 means fully softened, infected dentin.
    Use this function only for voxels of the layer `caries`, because sound tissues have other
    densities.
    """
    density = np.asarray(density_kg_m3)
    return np.clip((_SOUND_KG_M3 - density) / (_SOUND_KG_M3 - _INFECTED_KG_M3), 0.0, 1.0)


def in_chunks(function: Callable[[Floats], NDArray[Kind]], points: Floats) -> NDArray[Kind]:
    """Apply a function to points, shape (n, 3), in chunks that fit in the processor's cache."""
    if len(points) <= _POINTS_AT_ONCE:
        return function(points)
    starts = range(0, len(points), _POINTS_AT_ONCE)
    return np.concatenate(
        [function(np.asfortranarray(points[k : k + _POINTS_AT_ONCE])) for k in starts]
    )


def require_known(names: Iterable[str], argument: str) -> None:
    """Raise an error for unknown layer names, and for a tooth without enamel or dentin."""
    given = list(names)
    for name in given:
        if name not in TOOTH_LAYERS:
            raise InputError(
                argument,
                f"contain only the layers {enumerated(TOOTH_LAYERS)}",
                name,
                "rename this layer",
            )
    for name in ("enamel", "dentin"):
        if name not in given:
            raise InputError(
                argument,
                "contain enamel and dentin",
                enumerated(given) or "neither",
                f"add the {name}",
            )


def require_tooth_size(size_mm: float, argument: str, given: str, per_unit: float) -> None:
    """Raise an error if the longest side [mm] is not plausible for a tooth.

    The message suggests a value for the argument that determines the size.

    Parameters
    ----------
    argument, given
        Name of the user's argument that determines the size of the tooth, and the given value as
        text.
    per_unit
        Longest side of the tooth [mm] divided by the user's value. This is the number of voxels
        along the side, or the length of the side in units of the file.
    """
    if _SMALLEST_MM <= size_mm <= LARGEST_MM:
        return
    raise InputError(
        argument,
        f"make the tooth {_SMALLEST_MM:g} to {LARGEST_MM:g} mm long",
        f"{given}, which makes it {size_mm:.3g} mm long",
        f"use the scanner's value, about {_TYPICAL_MM / per_unit:.1g}",
    )


_LEAST_RISE_M = 0.4e-3
"""Smallest distance [m] between the centres of enamel and dentin in a valid tooth.

For comparison, the distance is 6.3 mm in the procedural molar, and 2.2 mm if the roots of this
molar are removed.
"""
_MOST_LEANING = math.cos(math.radians(25.0))
"""Cosine of the angle up to which a principal axis counts as the tooth's long axis.

For comparison, the angle to the nearest principal axis is 0 degrees in the procedural molar, and 5
degrees if the roots of this molar are removed.
"""
_SMOOTH_M = 0.3e-3
_AROUND_M = 0.5e-3
"""Radius [m] for averaging normals. The surface is first smoothed over `_SMOOTH_M`.

For comparison, the voxel size is 0.1 to 0.15 mm.
"""
_BEYOND_M = 1.0e-3
"""Distance [m] beyond the nearest surface point at which the search for a site's origin ends."""
_UPRIGHT = 0.7
"""Cosine of 45 degrees, a limit for the angle between a site's normal and the tooth's axis.

At larger angles, the site's y axis points to the crown. At smaller angles, the direction to the
crown is too close to the normal.
"""


@dataclass(frozen=True, eq=False)
class ToothAxes:
    """Orientation of a tooth, found from points of the tooth.

    Attributes
    ----------
    rotation
        Axes of the site as columns, shape (3, 3), in the frame of the points. The axes are
        right-handed. z points from the roots to the crown. x is the direction in which the lower
        half is widest, with arbitrary sign. If there are two roots, this direction is mesiodistal.
    middle_m
        Centre of the enamel [m], shape (3,). The site's origin lies on the line through this point
        along z.
    note
        Sentence on the method that found the long axis.
    """

    rotation: Array
    middle_m: Array
    note: str


def tooth_axes(enamel_m: Array, body_m: Array) -> ToothAxes:
    """Find the orientation of a tooth from points of its enamel and points of its other layers.

    The points must be distributed evenly.

    Parameters
    ----------
    enamel_m, body_m
        Points [m] of the enamel, shape (n, 3), and points [m] of dentin, pulp and ligament, shape
        (m, 3).

    Raises
    ------
    InputError
        If the enamel does not lie on one side of the other layers.
    """
    middle = enamel_m.mean(axis=0)
    rise = middle - body_m.mean(axis=0)
    height = float(np.linalg.norm(rise))
    if height < _LEAST_RISE_M:
        raise InputError(
            "layers",
            "have the enamel to one side of the dentin",
            f"centres only {1e3 * height:.2g} mm apart",
            "check which layer is which",
        )
    line = rise / height
    whole = np.concatenate([enamel_m, body_m])
    principal = np.linalg.eigh(np.cov(whole.T))[1]
    cosines = principal.T @ line
    chosen = int(np.argmax(np.abs(cosines)))
    leaning = math.degrees(math.acos(min(abs(float(cosines[chosen])), 1.0)))
    if abs(cosines[chosen]) > _MOST_LEANING:
        up = principal[:, chosen] * np.sign(cosines[chosen])
        note = (
            f"principal axis, {leaning:.0f} degrees from the line between the middles of dentin "
            "and enamel"
        )
    else:
        up = line
        note = (
            "line between the middles of dentin and enamel; the principal axes lean "
            f"{leaning:.0f} degrees or more"
        )
    x = _widest(body_m, up)
    return ToothAxes(np.column_stack([x, np.cross(up, x), up]), middle, note)


def _widest(points: Array, up: Array) -> Array:
    """Return the direction in which the lower half of the points is widest.

    The direction is a unit vector perpendicular to `up`.
    """
    offset = points - points.mean(axis=0)
    lower = offset[offset @ up < 0.0]
    across = lower - np.outer(lower @ up, up)
    direction = np.linalg.eigh(np.cov(across.T))[1][:, 2]
    direction = direction - (direction @ up) * up
    direction /= np.linalg.norm(direction)
    # The sign of an eigenvector is arbitrary. Make the largest component positive.
    return direction * (1.0 if direction[int(np.argmax(np.abs(direction)))] > 0.0 else -1.0)


def lesion_site(tooth: VoxelVolume) -> Site:
    """Find the site above the centre of a tooth's largest lesion.

    The outward normal is taken from the smoothed outer surface at the point nearest to the centre
    of the lesion. The origin is the point at which a line from the centre of the lesion along the
    normal leaves the tooth. If the angle between the normal and the tooth's axis is larger than 45
    degrees, y points to the crown. Otherwise, x points approximately along the x axis of the
    tooth's frame.

    Parameters
    ----------
    tooth
        Voxels of the whole tooth, including the voxels of the pulp. The z axis of the voxels points
        from the roots to the crown.

    Raises
    ------
    InputError
        If the tooth has no lesion.
    """
    from scipy.ndimage import binary_fill_holes, gaussian_filter, label

    lesion = (tooth.layer == CARIES) & (tooth.fraction >= FULL // 2)
    if not lesion.any():
        raise InputError(
            "site", "not be caries for a tooth without a lesion", "caries", "use enamel"
        )
    pieces, _ = label(lesion)
    largest = np.argmax(np.bincount(pieces.ravel())[1:]) + 1
    middle = np.argwhere(pieces == largest).mean(axis=0)
    pad = int(np.ceil(3.0 * _SMOOTH_M / tooth.spacing_m))
    solid = binary_fill_holes(np.pad(tooth.fraction >= FULL // 2, pad))
    smooth = gaussian_filter(solid.astype(np.float32), _SMOOTH_M / tooth.spacing_m)
    normal, surface = _outward(smooth, middle + pad, tooth.spacing_m)
    reach = float(np.linalg.norm(surface - middle - pad)) * tooth.spacing_m + _BEYOND_M
    # Steps of a tenth of a voxel, so that no voxel on the line is missed.
    steps = np.arange(0.0, reach / tooth.spacing_m, 0.1)
    line = np.rint(middle + pad + steps[:, None] * normal).astype(int)
    line = np.clip(line, 0, np.array(solid.shape) - 1)
    filled = np.flatnonzero(solid[tuple(line.T)])
    end = steps[filled[-1]] if len(filled) else 0.0
    centre = tooth.origin_m + tooth.spacing_m * (middle + end * normal + 0.5)
    first = (
        np.array([1.0, 0.0, 0.0])
        if abs(normal[2]) > _UPRIGHT
        else np.cross([0.0, 0.0, 1.0], normal)
    )
    x = first - (first @ normal) * normal
    x /= np.linalg.norm(x)
    depth_mm = 1e3 * tooth.spacing_m * float(end)
    note = (
        f"over the caries, whose middle lies {depth_mm:.2g} mm below along the normal of the "
        "surface"
    )
    return Site(centre, np.column_stack([x, np.cross(normal, x), normal]), note)


def _outward(smooth: Singles, middle: Array, spacing: float) -> tuple[Array, Array]:
    """Return the mean outward normal around the surface point nearest to `middle`.

    Also return the surface point nearest to `middle` [voxel].
    """
    # The smoothed surface lies at the value 0.5. The values 0.3 and 0.7 lie 0.16 mm on either side
    # of it, a voxel or more.
    shell = np.argwhere((smooth > 0.3) & (smooth < 0.7)).astype(np.float64)
    nearest = shell[np.argmin(np.linalg.norm(shell - middle, axis=1))]
    around = shell[np.linalg.norm(shell - nearest, axis=1) * spacing < _AROUND_M].astype(int)
    slopes = [np.gradient(smooth, axis=axis)[tuple(around.T)].sum() for axis in range(3)]
    normal = -np.array(slopes, dtype=np.float64)
    return normal / np.linalg.norm(normal), nearest
