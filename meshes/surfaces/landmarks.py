"""Search for a landmark on a bone surface: glenoid, femoral or humeral head, pedicle of a vertebra.

Searches do not depend on the position and orientation of the bone. All lengths are in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, in_brackets, require_vector
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

__all__ = ["SITE_KINDS", "FoundSite", "find_glenoid", "find_site"]

# Glenoid. Sizes follow the adult face, 24 to 30 x 33 to 38 mm (`meshes.surfaces.glenoid`).
#
# Tuned on two real scapulae. Each constant of score and face was changed by a fifth to a half: the
# centre found stays within 0.1 mm. Three changes lose one of the two scapulae: 4000 samples in
# place of 8000, half of `_THICK`, and 3 or 8 mm in place of the 5 mm in which thickness is sought.
_DISC = 10e-3  # radius of the disc that the face covers: inside the narrowest adult face
_RING = 20e-3  # radius beyond which the surface falls off: outside the longest adult face
_REACH = 26e-3  # largest distance of samples that count: half of the largest length, and 2 mm
_THICK = (6e-3, 18e-3)  # thickness of bone with the factors 0 and 1: blade, neck of the scapula
_CONVEX = 6.0  # curvature at which the score is halved [1/m]
_SECTORS = 24  # sectors of 15 degrees around the disc
# the adult range widened by a fifth to a quarter at both ends
_WIDTH = (18e-3, 36e-3)
_LENGTH = (26e-3, 48e-3)
# smallest ratio of length to width: glenoids have 1.2 to 1.5, the end of a round shaft 1
_ELONGATED = 1.1
# Joint heads. Diameters: femur 36 to 58 mm (Unnanuntana 2010), humerus 37 to 57 mm (Hertel 2002).
_RADII = np.arange(18e-3, 32.5e-3, 1e-3)
# Tuned on two real femurs and a synthetic femur and humerus. Changes of each constant of this
# search by a fifth to a factor of two move the site by at most 0.5 mm and 1.4 degrees.
_CELL = 4e-3  # edge of the cells in which votes for a centre are counted
_OFF = 0.03  # largest distance of a sample from the sphere over its radius: 0.7 mm at 24 mm
_DIRECTIONS = 600  # even directions on the sphere, 8 degrees apart
_ALIKE = 0.85  # ratio of the second score to the best from which two places are alike


@dataclass(frozen=True)
class _Head:
    """Joint head: name, range of sphere coverage, and whether it has a neck.

    The range holds the coverages at which the score is 0 and 1, and the largest coverage.
    """

    name: str
    none: float
    certain: float
    most: float
    neck: bool


# Measured coverage: heads of two femurs 0.76 and 0.77, of four humeri 0.46 to 0.56; other bone
# parts at most 0.32.
_HEADS = {
    "femoral-head": _Head("femoral head", 0.60, 0.75, 0.96, neck=True),
    "humeral-head": _Head("humeral head", 0.34, 0.42, 0.66, neck=False),
}
SITE_KINDS = ("glenoid", *_HEADS, *VERTEBRA)
"""Kinds of sites that `find_site` finds."""


def find_site(kind: str, surface: Surface) -> FoundSite:
    """Find a landmark on a bone.

    Parameters
    ----------
    kind
        ``glenoid``: middle of the socket of a scapula, z outward, y superior. ``femoral-head``,
        ``humeral-head``: exit of the axis of the neck or of the articular cap. ``vertebra:left``,
        ``vertebra:right``: posterior exit of the axis of that pedicle, z outward along it, y up;
        ``vertebra``: of the wider pedicle.
    surface
        One bone alone.

    Raises
    ------
    InputError
        If the kind is unknown, or the surface shows no such landmark or two equal ones.
    """
    if kind == "glenoid":
        return _search_glenoid(surface, None)
    if kind in _HEADS:
        return _search_head(surface, _HEADS[kind])
    if kind in VERTEBRA:
        return find_pedicle(surface, kind)
    raise InputError(
        "site", f"be one of {', '.join(SITE_KINDS)}", kind, "use one of them, or give a point"
    )


def find_glenoid(
    surface: Surface,
    *,
    centre_mm: Sequence[float] | None = None,
    along: Sequence[float] | None = None,
) -> Site:
    """Find the glenoid of a scapula, or the plane of the face around a given centre.

    Parameters
    ----------
    surface
        Scapula.
    centre_mm
        Centre [mm] in the frame of the file after scaling, moved along the normal onto the surface.
        None: searched.
    along
        Direction that becomes x, projected onto the face, any length. None: y is superior.

    Raises
    ------
    InputError
        If no glenoid is found, the centre is off the surface, or `along` is normal to the face.
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
    """Score samples by the disc around them, and extend the best one to its rim."""
    from scipy.spatial import cKDTree

    # With 4000 samples a real scapula is refused, with 16,000 nothing changes. Every fifth sample
    # is scored, one in 4 mm on a scapula, within the disc.
    samples = sample_surface(*surface.scanned, 8000)
    points = samples.points[::5]
    near = cKDTree(samples.points).query_ball_point(points, _REACH)
    seeds = [_glenoid_score(samples, 5 * k, np.array(each)) for k, each in enumerate(near)]
    scores = np.array([score for _, score in seeds])
    best = int(np.argmax(scores))
    # 30 mm: a face's length, so that the second best place is another one.
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
    # Real glenoids score 0.67 and 1.00; balls, boxes and shafts are refused.
    if score < 0.25 or not plausible:
        raise refusal(
            surface, "glenoid of about 28 x 37 mm", f"a face of {size} (score {score:.2f}) at best"
        )
    shape = "flat"
    # A radius above 200 mm is flat: its sagitta over half the face is below 1 mm.
    if abs(curvature) >= 5.0:
        shape = (
            f"{'concave' if curvature > 0.0 else 'convex'}, radius {1e3 / abs(curvature):.0f} mm"
        )
    note = f"found by search: face {size}, {shape}, score {score:.2f} of 1; check it in the picture"
    site = site_along(surface, centre, axes[2], note, along, axes[0])
    return FoundSite(
        site, score, float(apart[second]), 1e3 * points[second] if apart[second] else None
    )


def _glenoid_score(samples: SurfaceSamples, number: int, near: Ints) -> tuple[Array, float]:
    """Compute the smoothed normal at a sample, and the likeness to a glenoid, 0 to 1.

    The likeness is of the surface around the sample.

    The likeness is high where surface that faces one direction covers a disc of 10 mm radius, the
    surface falls off beyond 20 mm, the bone behind is thick, and the disc is not convex.
    """
    offset = samples.points[near] - samples.points[number]
    normals = samples.normals[near]
    # The normal is a mean over a disc, because normals of voxels and small triangles scatter.
    # Samples that face 60 degrees off lie on another side of the bone.
    close = (np.linalg.norm(offset, axis=1) < 9e-3) & (normals @ samples.normals[number] > 0.5)
    normal = normals[close].sum(axis=0)
    normal /= np.linalg.norm(normal)
    height = offset @ normal
    radial = np.linalg.norm(offset - height[:, None] * normal, axis=1)
    facing = normals @ normal
    # within 53 degrees and 6 mm: the socket's hollow and rim, without the neck behind
    level = (facing > 0.6) & (np.abs(height) < 6e-3)
    covered = samples.area * np.count_nonzero(level & (radial < _DISC)) / (np.pi * _DISC**2)
    # Surface right behind that faces backwards. 1.5 mm excludes the other side of a thin rim.
    behind = height[(facing < 0.0) & (radial < 5e-3) & (height < -1.5e-3)]
    thickness = -behind.max(initial=-_REACH)
    thick = np.clip((thickness - _THICK[0]) / (_THICK[1] - _THICK[0]), 0.0, 1.0)
    # A face covers the disc: limits of 0.5 and 0.85 give the same sites.
    if covered < 0.7 or thick == 0.0:
        return normal, 0.0
    u, v = across(normal)
    # Surface that falls off by more than 4 mm counts as free.
    around = offset[(radial > _RING) & (height > -4e-3)]
    filled, _ = np.histogram(
        np.arctan2(around @ v, around @ u), bins=_SECTORS, range=(-np.pi, np.pi)
    )
    # 0 at 40 % of free sectors and 1 at 80 %: other parts of the scapula fill the rest.
    free = np.clip(2.5 * np.mean(filled == 0) - 1.0, 0.0, 1.0)
    # A concave disc is not penalised. The fit reaches a little beyond the disc, over which the
    # curvature shows.
    convexity = max(-_curvature(offset[level & (radial < 1.3 * _DISC)], normal), 0.0)
    return normal, float(min(covered, 1.0) * free * thick / (1.0 + (convexity / _CONVEX) ** 2))


def _curvature(offset: Array, normal: Array) -> float:
    """Compute the curvature [1/m] of the paraboloid fitted to points around the origin.

    It is positive where concave.
    """
    height = offset @ normal
    radial = offset - height[:, None] * normal
    terms = np.column_stack([np.ones(len(offset)), radial, 0.5 * (radial**2).sum(axis=1)])
    # The coefficients are height, slope (three) and curvature.
    return float(np.linalg.lstsq(terms, height, rcond=None)[0][4])


def _face(
    samples: SurfaceSamples, centre: Array, normal: Array
) -> tuple[Array, Array, Array, float]:
    """Find the articular face around a start.

    Return its centre, axes as rows (long, short, outward), two sides and curvature.

    The face is the connected region within 32 degrees of the normal of the plane through it. On two
    scapulae and a synthetic one, limits of 25 to 37 degrees leave the centre within 2 mm; larger
    limits leak into the coracoid.
    """
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    # Centre and normal settle within 4 turns, to 0.1 mm.
    for _ in range(8):
        offset = samples.points - centre
        height = offset @ normal
        radial = np.linalg.norm(offset - height[:, None] * normal, axis=1)
        chosen = np.flatnonzero(
            # 0.85 is cos 32 degrees. 5 and 12 mm in place of 8 give the same face.
            (samples.normals @ normal > 0.85) & (np.abs(height) < 8e-3) & (radial < _REACH)
        )
        # Too few samples for a plane and its sides: sides of 0 are never plausible.
        if len(chosen) < 30:
            return centre, np.stack([*across(normal), normal]), np.zeros(2), 0.0
        tree = cKDTree(samples.points[chosen])
        # 2 mm links neighbours, 0.9 mm apart on a scapula. 1.4 and 3 mm give the same centre within
        # 0.1 mm.
        _, label = connected_components(tree.sparse_distance_matrix(tree, 2e-3))
        face = samples.points[chosen[label == label[np.argmin(radial[chosen])]]]
        middle = face.mean(axis=0)
        axes = np.linalg.svd(face - middle, full_matrices=False)[2]
        normal = axes[2] * np.sign(axes[2] @ normal)
        along = (face - middle) @ axes.T
        box = 0.5 * (along.max(axis=0) + along.min(axis=0))
        centre = middle + box[:2] @ axes[:2]
    # The middle of the box may lie above a hollow face: the mean height of some samples there
    # brings it to the surface.
    nearest = np.argsort(np.linalg.norm(along[:, :2] - box[:2], axis=1))[:8]
    centre = centre + normal * float(along[nearest, 2].mean())
    sides = np.ptp(along, axis=0)[:2]
    return centre, np.stack([axes[0], axes[1], normal]), sides, _curvature(face - centre, normal)


@dataclass(frozen=True, eq=False)
class _Cap:
    """Spherical cap: sphere, direction to its middle, coverage, RMS misfit and roundness.

    The coverage is of the sphere; the roundness is of the cap's outline.
    """

    centre: Array
    radius: float
    axis: Array
    coverage: float
    misfit: float
    compactness: float

    def score(self, kind: _Head) -> float:
        covered = float(np.clip((self.coverage - kind.none) / (kind.certain - kind.none), 0.0, 1.0))
        return covered * self.compactness**2 * (1.0 - self.misfit / (2.0 * _OFF * self.radius))


def _search_head(surface: Surface, kind: _Head) -> FoundSite:
    """Find the spherical cap of 18 to 32 mm radius that covers most of its sphere."""
    # 6000 and 24,000 samples move the site by at most 0.4 mm.
    samples = sample_surface(*surface.scanned, 12000)
    caps = sorted(_caps(samples), key=lambda cap: -cap.score(kind))
    scores = [cap.score(kind) for cap in caps]
    # Real heads score 0.62; a score of 0.2 is a cap little above the coverage of other parts.
    if not caps or scores[0] < 0.2 or max(cap.coverage for cap in caps) > kind.most:
        got = f"at most {max((cap.coverage for cap in caps), default=0.0):.0%}"
        what = (
            f"{kind.name}, one cap of 18 to 32 mm radius over {kind.none:.0%} to {kind.most:.0%} "
            "of its sphere"
        )
        raise refusal(surface, what, got)
    best = caps[0]
    # A cap whose centre is nearer than its radius is the same head, fitted again.
    apart = [
        k for k, cap in enumerate(caps) if np.linalg.norm(cap.centre - best.centre) > best.radius
    ]
    second = apart[0] if apart and scores[apart[0]] > 0.0 else None
    if second is not None and scores[second] > _ALIKE * scores[0]:
        places = " and ".join(in_brackets(1e3 * cap.centre, ".4g") for cap in (best, caps[second]))
        raise refusal(surface, f"single {kind.name}", f"two places alike, about {places} mm")
    axis = _neck_axis(samples, best) if kind.neck else best.axis
    note = (
        f"found by search: {kind.name} of radius {1e3 * best.radius:.1f} mm over "
        f"{best.coverage:.0%} of its sphere, "
        f"{1e3 * best.misfit:.2f} mm off it, score {scores[0]:.2f} of 1; check it in the picture"
    )
    site = site_along(surface, best.centre + best.radius * axis, axis, note)
    if second is None:
        return FoundSite(site, scores[0])
    other = caps[second]
    return FoundSite(
        site, scores[0], scores[second], 1e3 * (other.centre + other.radius * other.axis)
    )


def _caps(samples: SurfaceSamples) -> list[_Cap]:
    """Fit caps from the centres and radii that most samples vote for along their normals."""
    from scipy.sparse import coo_array
    from scipy.spatial import cKDTree

    # Normals of voxels and of few large triangles are steps: take the mean over 3 mm.
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
    # Votes of two neighbouring radii count together, because their centres are 1 mm apart.
    level = np.tile(np.arange(len(_RADII)) // 2, count)
    place = np.floor((votes - votes.min(axis=0)) / _CELL).astype(np.int64)
    shape = (*(place.max(axis=0) + 1).tolist(), len(_RADII))
    _, cell, counts = np.unique(
        np.ravel_multi_index((*place.T, level), shape), return_inverse=True, return_counts=True
    )
    # Cells with many votes lie next to each other: every tenth of the best 400 gives other starts.
    # With every tenth of 100, the same caps are found.
    starts = np.argsort(-counts, kind="stable")[:400:10]
    fitted = [
        _fitted(samples.points, normals, votes[cell == k].mean(axis=0), radius[cell == k].mean())
        for k in starts
    ]
    return [cap for cap in fitted if cap is not None]


def _fitted(points: Array, normals: Array, centre: Array, radius: float) -> _Cap | None:
    """Fit a sphere to the samples that lie on it and face outward.

    Return None if it leaves the range of radii.
    """
    from scipy.spatial import cKDTree

    # 8 turns give the same spheres. The band around the sphere narrows from 12 % to 3 % of the
    # radius over the first five turns, because a start is the mean of a cell of 4 mm.
    for turn in range(15):
        offset = points - centre
        distance = np.linalg.norm(offset, axis=1)
        # 0.93 is cos 22 degrees: neighbouring surfaces, such as the neck, face another direction.
        facing = (normals * offset).sum(axis=1) > 0.93 * distance
        on = facing & (np.abs(distance - radius) < max(_OFF, 0.12 - 0.02 * turn) * radius)
        # Too few samples for a sphere; 10 and 100 give the same sites.
        if np.count_nonzero(on) < 30:
            return None
        terms = np.column_stack([2.0 * points[on], np.ones(np.count_nonzero(on))])
        solved = np.linalg.lstsq(terms, (points[on] ** 2).sum(axis=1), rcond=None)[0]
        centre = solved[:3]
        radius = float(np.sqrt(max(solved[3] + centre @ centre, 0.0)))
        # 1 mm: the radius may leave the range during the iteration and return.
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
    # The mean direction of one round cap is 1 - share long.
    # `max` and 1e-12 stand for caps without a covered direction, or with all of them.
    compactness = min(length / max(len(covered) * (1.0 - share), 1.0), 1.0)
    misfit = float(np.sqrt(np.mean((distance - radius) ** 2)))
    return _Cap(centre, radius, total / max(length, 1e-12), share, misfit, compactness)


def _neck_axis(samples: SurfaceSamples, cap: _Cap) -> Array:
    """Return the direction from the middle of the neck to the centre.

    The neck is 1.1 to 1.5 radii below. Without a neck, return the cap's axis.
    """
    axis = cap.axis
    offset = (samples.points - cap.centre) / cap.radius
    # After 2 turns the axis is up to 9 degrees off, after 12 it moves by less than 2 degrees.
    for _ in range(5):
        below = -(offset @ axis)
        radial = np.linalg.norm(offset + below[:, None] * axis, axis=1)
        # The neck is narrower than the head. Limits of 1.0 and 1.4 turn
        # the axis by up to 4.4 degrees.
        neck = offset[(below > 1.1) & (below < 1.5) & (radial < 1.15)]
        u, v = across(axis)
        # Sectors weigh all sides of the neck alike, whatever the density of its samples.
        sector = np.floor(np.arctan2(neck @ v, neck @ u) / (2.0 * np.pi) * 12.0)
        ring = [neck[sector == each].mean(axis=0) for each in np.unique(sector)]
        # A neck is a ring; the trochanter may hide one or two of the 12 sectors. Asking for all of
        # them loses the neck of a real femur.
        if len(neck) < 30 or len(ring) < 10:
            return cap.axis
        middle = np.mean(ring, axis=0)
        axis = -middle / np.linalg.norm(middle)
    # Beyond 37 degrees from the cap's axis the ring was not a neck.
    return axis if axis @ cap.axis > 0.8 else cap.axis
