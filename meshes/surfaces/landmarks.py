"""Search for landmarks on bone surfaces: glenoid, femoral or humeral head, pedicle of a vertebra.

The searches do not depend on the position and orientation of the bone. All lengths are in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, enumerated, in_brackets, require_vector
from meshes.surfaces.pedicles import VERTEBRA, find_pedicle
from meshes.surfaces.site import (
    FACE_SAMPLES,
    FoundSite,
    Site,
    SurfaceSamples,
    across,
    refusal,
    sample_surface,
    site_along,
    spread,
)
from meshes.surfaces.surface import Surface

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

__all__ = ["SITE_KINDS", "FoundSite", "find_glenoid", "find_site"]

# Glenoid. Sizes follow the adult face, 24 to 30 x 33 to 38 mm (`meshes.surfaces.glenoid`).
#
# The constants were tuned on two real scapulae. If a constant of the score or of the face is
# changed by a fifth to a half, the centre changes by at most 0.1 mm. With three changes, the
# glenoid of one of the two scapulae is not found: 4000 instead of 8000 samples, half of `_THICK`,
# and a range of 3 or 8 mm instead of 5 mm in the search for the thickness.
_DISC = 10e-3  # radius of the disc that the face must cover, within the narrowest adult face
_RING = 20e-3  # radius beyond which the surface must fall off, outside the longest adult face
_REACH = 26e-3  # largest distance of samples that are used: half of the largest length, plus 2 mm
_THICK = (6e-3, 18e-3)  # bone thickness with the factors 0 (blade) and 1 (neck of the scapula)
_CONVEX = 6.0  # curvature at which the score is halved [1/m]
_SECTORS = 24  # number of sectors (15 degrees) around the disc
# adult range, extended by a fifth to a quarter at each end
_WIDTH = (18e-3, 36e-3)
_LENGTH = (26e-3, 48e-3)
# smallest ratio of length to width; glenoids have 1.2 to 1.5, the end of a round shaft has 1
_ELONGATED = 1.1
# Joint heads. Diameters: femur 36 to 58 mm (Unnanuntana 2010), humerus 37 to 57 mm (Hertel 2002).
_RADII = np.arange(18e-3, 32.5e-3, 1e-3)
# The constants were tuned on two real femurs, a synthetic femur and a synthetic humerus. If a
# constant of this search is changed by a fifth to a factor of two, the site changes by at most 0.5
# mm and 1.4 degrees.
_CELL = 4e-3  # edge of the cells in which votes for a centre are counted
_OFF = 0.03  # largest distance of a sample from the sphere / radius: 0.7 mm at 24 mm
_DIRECTIONS = 600  # number of even directions on the sphere, 8 degrees apart
_ALIKE = 0.85  # ratio of second to best score above which the result is ambiguous


@dataclass(frozen=True)
class _Head:
    """Kind of joint head: name, limits of its coverage, and whether the head has a neck.

    Coverage is the share of a fitted sphere that lies on the bone surface. The limits are the
    coverage with the score 0, the coverage with the score 1, and the largest valid coverage.
    """

    name: str
    zero_score_coverage: float
    full_score_coverage: float
    largest_coverage: float
    neck: bool


# Measured coverages are 0.76 and 0.77 for the heads of two femurs, and 0.46 to 0.56 for four
# humeri. Other parts of bones have at most 0.32.
_HEADS = {
    "femoral-head": _Head("femoral head", 0.60, 0.75, 0.96, neck=True),
    "humeral-head": _Head("humeral head", 0.34, 0.42, 0.66, neck=False),
}
SITE_KINDS = ("glenoid", *_HEADS, *VERTEBRA)
"""Kinds of sites that `find_site` can find."""


def find_site(kind: str, surface: Surface) -> FoundSite:
    """Find a landmark on a bone.

    Parameters
    ----------
    kind
        ``glenoid``: centre of the shoulder socket of a scapula. z points outward, and y is
        superior. ``femoral-head``: point at which the axis of the neck leaves the bone.
        ``humeral-head``: point at which the axis of the articular cap leaves the bone.
        ``vertebra:left``, ``vertebra:right``: posterior point at which the axis of the left or
        right pedicle leaves the bone. z points outward along this axis, and y points up.
        ``vertebra``: the corresponding point of the wider pedicle.
    surface
        Surface of a single bone.

    Raises
    ------
    InputError
        If the kind is unknown, or the surface has no such landmark or two equally good landmarks.
    """
    if kind == "glenoid":
        return _search_glenoid(surface, None)
    if kind in _HEADS:
        return _search_head(surface, _HEADS[kind])
    if kind in VERTEBRA:
        return find_pedicle(surface, kind)
    raise InputError(
        "site",
        f"be one of {enumerated(SITE_KINDS, 'or')}",
        kind,
        "use one of them, or give a point",
    )


def find_glenoid(
    surface: Surface,
    *,
    centre_mm: Sequence[float] | None = None,
    along: Sequence[float] | None = None,
) -> Site:
    """Find the glenoid of a scapula. If the centre is given, find only the articular plane.

    Parameters
    ----------
    surface
        Scapula.
    centre_mm
        Centre [mm] in the frame of the file, after scaling to mm. The centre is moved onto the
        surface along the normal of the articular plane. If None, the function searches for the
        glenoid.
    along
        Vector in the direction of the site's x axis, with any length. The vector is projected onto
        the articular face. If None, the axes are chosen such that the site's y axis points in the
        superior direction.

    Raises
    ------
    InputError
        If no glenoid is found, the centre is not on the surface, or `along` is normal to the
        articular face.
    """
    if centre_mm is None:
        return _search_glenoid(surface, along).site
    samples = sample_surface(*surface.scanned, FACE_SAMPLES)
    centre = require_vector("anatomy.centre_mm", centre_mm) * 1e-3
    near = int(np.argmin(np.linalg.norm(samples.points - centre, axis=1)))
    _, axes, _, _ = _face(samples, samples.points[near], samples.normals[near])
    return site_along(
        surface, centre, axes[2], "centre as given, normal of the face around it", along
    )


def _search_glenoid(surface: Surface, along: Sequence[float] | None) -> FoundSite:
    """Score the surface around each sample point, and find the articular face at the best point."""
    from scipy.spatial import cKDTree

    # With 4000 samples, a real scapula is not accepted. With 16,000 samples, the results do not
    # change. Every fifth sample is scored. On a scapula, scored samples are 4 mm apart, less than
    # the radius of the disc.
    samples = sample_surface(*surface.scanned, 8000)
    points = samples.points[::5]
    tree = cKDTree(samples.points)
    seeds = [_glenoid_score(samples, 5 * k, tree) for k in range(len(points))]
    scores = np.array([score for _, score in seeds])
    best = int(np.argmax(scores))
    # 30 mm is the length of a face, so the second-best place is a different place.
    apart = np.where(np.linalg.norm(points - points[best], axis=1) > 30e-3, scores, 0.0)
    second = int(np.argmax(apart))
    centre, axes, (length, width), curvature = _face(
        sample_surface(*surface.scanned, FACE_SAMPLES), points[best], seeds[best][0]
    )
    size = f"{1e3 * width:.1f} x {1e3 * length:.1f} mm"
    plausible = (
        _WIDTH[0] <= width <= _WIDTH[1]
        and _LENGTH[0] <= length <= _LENGTH[1]
        and length > _ELONGATED * width
    )
    score = float(scores[best])
    # Two real glenoids have scores of 0.67 and 1.00. Balls, boxes and shafts are not accepted.
    if score < 0.25 or not plausible:
        raise refusal(
            surface, "glenoid of about 28 x 37 mm", f"a face of {size} at best (score {score:.2f})"
        )
    shape = "flat"
    # A radius above 200 mm counts as flat, because the sagitta over half the face is below 1 mm.
    if abs(curvature) >= 5.0:
        shape = (
            f"{'concave' if curvature > 0.0 else 'convex'}, radius {1e3 / abs(curvature):.0f} mm"
        )
    note = f"found by search: face {size}, {shape}, score {score:.2f} of 1; check it in the picture"
    site = site_along(surface, centre, axes[2], note, along, axes[0])
    return FoundSite(
        site, score, float(apart[second]), 1e3 * points[second] if apart[second] else None
    )


def _glenoid_score(samples: SurfaceSamples, number: int, tree: "cKDTree") -> tuple[Array, float]:
    """Compute the smoothed normal at a sample point, and the similarity to a glenoid, 0 to 1.

    The similarity is high if four conditions hold around the sample point. The surface covers a
    disc with a radius of 10 mm and has similar normals there. Beyond a radius of 20 mm, the surface
    lies more than 4 mm below the disc in most directions. The bone behind the disc is thick. The
    disc is not convex.
    """
    point = samples.points[number]
    near = tree.query_ball_point(point, _REACH)
    offset = samples.points[near] - point
    normals = samples.normals[near]
    # The normal is a mean over a disc, because the normals of voxel surfaces and small triangles
    # vary. Samples whose normals differ by 60 degrees lie on another side of the bone.
    close = (np.linalg.norm(offset, axis=1) < 9e-3) & (normals @ samples.normals[number] > 0.5)
    normal = normals[close].sum(axis=0)
    normal /= np.linalg.norm(normal)
    height = offset @ normal
    radial = np.linalg.norm(offset - height[:, None] * normal, axis=1)
    facing = normals @ normal
    # within 53 degrees and 6 mm: the hollow and the rim of the socket, without the neck behind it
    level = (facing > 0.6) & (np.abs(height) < 6e-3)
    covered = samples.area * np.count_nonzero(level & (radial < _DISC)) / (np.pi * _DISC**2)
    # A face covers the disc. With limits of 0.5 and 0.85, the sites are the same.
    if covered < 0.7:
        return normal, 0.0
    # Surface directly behind the sample that faces backwards. The limit of 1.5 mm excludes the
    # other side of a thin rim.
    behind = height[(facing < 0.0) & (radial < 5e-3) & (height < -1.5e-3)]
    thickness = -behind.max(initial=-_REACH)
    thick = np.clip((thickness - _THICK[0]) / (_THICK[1] - _THICK[0]), 0.0, 1.0)
    if thick == 0.0:
        return normal, 0.0
    u, v = across(normal)
    # Surface that falls off by more than 4 mm counts as free.
    around = offset[(radial > _RING) & (height > -4e-3)]
    filled, _ = np.histogram(
        np.arctan2(around @ v, around @ u), bins=_SECTORS, range=(-np.pi, np.pi)
    )
    # The factor is 0 for 40 % of free sectors and 1 for 80 %. Other parts of the scapula occupy the
    # remaining sectors.
    free = np.clip(2.5 * np.mean(filled == 0) - 1.0, 0.0, 1.0)
    # A concave disc is not penalised. The fit extends slightly beyond the disc, because the
    # curvature is not visible in a smaller area.
    convexity = max(-_curvature(offset[level & (radial < 1.3 * _DISC)], normal), 0.0)
    return normal, float(min(covered, 1.0) * free * thick / (1.0 + (convexity / _CONVEX) ** 2))


def _curvature(offset: Array, normal: Array) -> float:
    """Compute the curvature [1/m] of a paraboloid of revolution fitted to points around the origin.

    The curvature is positive if the surface is concave.
    """
    height = offset @ normal
    radial = offset - height[:, None] * normal
    terms = np.column_stack([np.ones(len(offset)), radial, 0.5 * (radial**2).sum(axis=1)])
    # The coefficients are the height, three slopes and the curvature.
    return float(np.linalg.lstsq(terms, height, rcond=None)[0][4])


def _face(
    samples: SurfaceSamples, centre: Array, normal: Array
) -> tuple[Array, Array, Array, float]:
    """Find the articular face around a starting point.

    Return the centre of the face, the axes of the face as rows (long, short, outward), two side
    lengths and the curvature.

    The face is the connected region in which all normals are within 32 degrees of the normal of the
    region's mean plane. With limits from 25 to 37 degrees, the centre changes by at most 2 mm on
    two real scapulae and a synthetic scapula. With larger limits, the region extends into the
    coracoid.
    """
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    # Centre and normal converge to 0.1 mm in 4 iterations.
    for _ in range(8):
        offset = samples.points - centre
        height = offset @ normal
        radial = np.linalg.norm(offset - height[:, None] * normal, axis=1)
        chosen = np.flatnonzero(
            # 0.85 is cos 32 degrees. With 5 and 12 mm instead of 8 mm, the face is the same.
            (samples.normals @ normal > 0.85) & (np.abs(height) < 8e-3) & (radial < _REACH)
        )
        # There are too few samples for a plane and its sides. Sides of 0 are never plausible.
        if len(chosen) < 30:
            return centre, np.stack([*across(normal), normal]), np.zeros(2), 0.0
        tree = cKDTree(samples.points[chosen])
        # A distance of 2 mm connects neighbouring samples, which are 0.9 mm apart on a scapula.
        # With 1.4 and 3 mm, the centre differs by at most 0.1 mm.
        _, label = connected_components(tree.sparse_distance_matrix(tree, 2e-3))
        face = samples.points[chosen[label == label[np.argmin(radial[chosen])]]]
        middle = face.mean(axis=0)
        axes = np.linalg.svd(face - middle, full_matrices=False)[2]
        normal = axes[2] * np.sign(axes[2] @ normal)
        offsets = (face - middle) @ axes.T
        box = 0.5 * (offsets.max(axis=0) + offsets.min(axis=0))
        centre = middle + box[:2] @ axes[:2]
    # The middle of the box may lie above a hollow face. The mean height of nearby samples moves it
    # to the surface.
    nearest = np.argsort(np.linalg.norm(offsets[:, :2] - box[:2], axis=1))[:8]
    centre = centre + normal * float(offsets[nearest, 2].mean())
    sides = np.ptp(offsets, axis=0)[:2]
    return centre, np.stack([axes[0], axes[1], normal]), sides, _curvature(face - centre, normal)


@dataclass(frozen=True, eq=False)
class _Cap:
    """Spherical cap: sphere, direction from centre to cap, coverage, RMS misfit and roundness.

    The coverage is the share of the sphere that the cap covers. The roundness states how circular
    the outline of the cap is.
    """

    centre: Array
    radius: float
    axis: Array
    coverage: float
    misfit: float
    roundness: float

    def score(self, kind: _Head) -> float:
        start = kind.zero_score_coverage
        end = kind.full_score_coverage
        covered = float(np.clip((self.coverage - start) / (end - start), 0.0, 1.0))
        return covered * self.roundness**2 * (1.0 - self.misfit / (2.0 * _OFF * self.radius))


def _search_head(surface: Surface, kind: _Head) -> FoundSite:
    """Find the best spherical cap with a radius of 18 to 32 mm, and the site on this cap."""
    # With 6000 and 24,000 samples, the site changes by at most 0.4 mm.
    samples = sample_surface(*surface.scanned, 12000)
    caps = sorted(_caps(samples), key=lambda cap: -cap.score(kind))
    scores = [cap.score(kind) for cap in caps]
    # Real heads have scores of 0.62. A score of 0.2 corresponds to a coverage slightly above that
    # of other parts.
    if not caps or scores[0] < 0.2 or max(cap.coverage for cap in caps) > kind.largest_coverage:
        covered = max((cap.coverage for cap in caps), default=0.0)
        got = f"a surface whose roundest part covers {covered:.0%} of a sphere"
        what = (
            f"{kind.name} (a rounded part with a radius of 18 to 32 mm that covers "
            f"{kind.zero_score_coverage:.0%} to {kind.largest_coverage:.0%} of a sphere)"
        )
        raise refusal(surface, what, got)
    best = caps[0]
    # A cap whose centre is closer than its radius is another fit of the same head.
    apart = [
        k for k, cap in enumerate(caps) if np.linalg.norm(cap.centre - best.centre) > best.radius
    ]
    second = apart[0] if apart and scores[apart[0]] > 0.0 else None
    if second is not None and scores[second] > _ALIKE * scores[0]:
        places = " and ".join(in_brackets(1e3 * cap.centre, ".4g") for cap in (best, caps[second]))
        raise refusal(surface, f"single {kind.name}", f"two similar places, near {places} mm")
    axis = _neck_axis(samples, best) if kind.neck else best.axis
    note = (
        f"found by search: {kind.name} of radius {1e3 * best.radius:.1f} mm over "
        f"{best.coverage:.0%} of its sphere, "
        f"RMS distance from the sphere {1e3 * best.misfit:.2f} mm, score {scores[0]:.2f} of 1; "
        "check it in the picture"
    )
    site = site_along(surface, best.centre + best.radius * axis, axis, note)
    if second is None:
        return FoundSite(site, scores[0])
    other = caps[second]
    return FoundSite(
        site, scores[0], scores[second], 1e3 * (other.centre + other.radius * other.axis)
    )


def _caps(samples: SurfaceSamples) -> list[_Cap]:
    """Fit spherical caps to a surface. A Hough transform gives the starting values.

    Each sample point votes for possible sphere centres along the normal at the point, one centre
    for each radius. Fits start from the centres and radii with the most votes.
    """
    from scipy.sparse import coo_array
    from scipy.spatial import cKDTree

    # The normals of voxel surfaces and of large triangles change in steps, so use their mean over 3
    # mm.
    one, other = cKDTree(samples.points).query_pairs(3e-3, output_type="ndarray").T
    facing = (samples.normals[one] * samples.normals[other]).sum(axis=1) > 0.0
    count = len(samples.points)
    links = coo_array(
        (np.ones(np.count_nonzero(facing)), (one[facing], other[facing])), shape=(count, count)
    ).tocsr()
    normals = samples.normals + links @ samples.normals + links.T @ samples.normals
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    votes = (samples.points[:, None] - _RADII[:, None] * normals[:, None]).reshape(-1, 3)
    radius = np.tile(_RADII, count)
    # The votes of two neighbouring radii are added, because their centres are 1 mm apart.
    level = np.tile(np.arange(len(_RADII)) // 2, count)
    place = np.floor((votes - votes.min(axis=0)) / _CELL).astype(np.int64)
    shape = (*(place.max(axis=0) + 1).tolist(), len(_RADII))
    _, cell, counts = np.unique(
        np.ravel_multi_index((*place.T, level), shape), return_inverse=True, return_counts=True
    )
    # Cells with many votes lie next to each other, so every tenth of the best 400 cells is used.
    # With every tenth of the best 100 cells, the same caps are found.
    starts = np.argsort(-counts, kind="stable")[:400:10]
    fitted = [
        _fitted(samples.points, normals, votes[cell == k].mean(axis=0), radius[cell == k].mean())
        for k in starts
    ]
    return [cap for cap in fitted if cap is not None]


def _fitted(points: Array, normals: Array, centre: Array, radius: float) -> _Cap | None:
    """Fit a sphere to samples of a surface whose normals point outward.

    Return None if too few points lie on the sphere, or if the radius is outside the range of joint
    heads.
    """
    from scipy.spatial import cKDTree

    # With 8 iterations, the spheres are the same. In the first five iterations, the tolerance
    # around the sphere decreases from 12 % to 3 % of the radius, because a start is only the mean
    # of a cell of 4 mm.
    for turn in range(15):
        offset = points - centre
        distance = np.linalg.norm(offset, axis=1)
        # 0.93 is cos 22 degrees. Neighbouring surfaces, such as the neck, have other normals.
        facing = (normals * offset).sum(axis=1) > 0.93 * distance
        on = facing & (np.abs(distance - radius) < max(_OFF, 0.12 - 0.02 * turn) * radius)
        # There are too few samples for a sphere. With limits of 10 and 100, the sites are the same.
        if np.count_nonzero(on) < 30:
            return None
        terms = np.column_stack([2.0 * points[on], np.ones(np.count_nonzero(on))])
        solved = np.linalg.lstsq(terms, (points[on] ** 2).sum(axis=1), rcond=None)[0]
        centre = solved[:3]
        radius = float(np.sqrt(max(solved[3] + centre @ centre, 0.0)))
        # 1 mm: during the iteration, the radius may be slightly outside its range.
        if not _RADII[0] - 1e-3 < radius < _RADII[-1] + 1e-3:
            return None
    if not _RADII[0] <= radius <= _RADII[-1]:
        return None
    offset = points[on] - centre
    distance = np.linalg.norm(offset, axis=1)
    even = spread(1.0 - (2.0 * np.arange(_DIRECTIONS) + 1.0) / _DIRECTIONS, np.eye(3)[2])
    # within 8 degrees of a sample
    covered = even[cKDTree(offset / distance[:, None]).query(even)[0] < 0.14]
    total = covered.sum(axis=0)
    length = float(np.linalg.norm(total))
    share = len(covered) / _DIRECTIONS
    # The mean direction of a single round cap has the length 1 - share. `max` and 1e-12 are for
    # caps that cover no direction or all directions.
    roundness = min(length / max(len(covered) * (1.0 - share), 1.0), 1.0)
    misfit = float(np.sqrt(np.mean((distance - radius) ** 2)))
    return _Cap(centre, radius, total / max(length, 1e-12), share, misfit, roundness)


def _neck_axis(samples: SurfaceSamples, cap: _Cap) -> Array:
    """Return the direction from the middle of the neck to the centre of the head.

    The neck is searched 1.1 to 1.5 head radii below the centre of the head. If no neck is found,
    the axis of the cap is returned.
    """
    axis = cap.axis
    offset = (samples.points - cap.centre) / cap.radius
    # After 2 iterations, the error of the axis is up to 9 degrees. With 12 iterations, the axis
    # changes by less than 2 degrees.
    for _ in range(5):
        below = -(offset @ axis)
        radial = np.linalg.norm(offset + below[:, None] * axis, axis=1)
        # The neck is narrower than the head. With limits of 1.0 and 1.4, the axis changes by up to
        # 4.4 degrees.
        neck = offset[(below > 1.1) & (below < 1.5) & (radial < 1.15)]
        u, v = across(axis)
        # With sectors, all sides of the neck have the same weight, independent of the density of
        # samples.
        sector = np.floor(np.arctan2(neck @ v, neck @ u) / (2.0 * np.pi) * 12.0)
        ring = [neck[sector == each].mean(axis=0) for each in np.unique(sector)]
        # A neck is a ring, but the trochanter may hide one or two of the 12 sectors. If all sectors
        # were required, the neck of a real femur would not be found.
        if len(neck) < 30 or len(ring) < 10:
            return cap.axis
        middle = np.mean(ring, axis=0)
        axis = -middle / np.linalg.norm(middle)
    # If the direction is more than 37 degrees from the cap's axis, the ring is not a neck.
    return axis if axis @ cap.axis > 0.8 else cap.axis
