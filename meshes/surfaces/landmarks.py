"""Search for a landmark on a bone surface: glenoid, femoral or humeral head, pedicle of a vertebra.

Searches do not depend on the position and orientation of the bone. All lengths are in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, in_brackets, require_vector
from meshes.surfaces.site import (
    FACE_SAMPLES,
    FoundSite,
    Site,
    SurfaceSamples,
    across,
    axes_along,
    exits,
    refusal,
    sample_surface,
    site_along,
    spread,
)
from meshes.surfaces.surface import Surface
from meshes.voxels.mesh_sampling import inside_scattered, triangle_distance

__all__ = ["SITE_KINDS", "VERTEBRA", "FoundSite", "find_glenoid", "find_pedicle", "find_site"]

# Glenoid. Sizes follow the adult face, 24 to 30 x 33 to 38 mm (`meshes.surfaces.glenoid`).
_DISC = 10e-3
_RING = 20e-3
_REACH = 26e-3
_THICK = (6e-3, 18e-3)
_CONVEX = 6.0  # curvature at which the score is halved [1/m]
_SECTORS = 24
_WIDTH = (18e-3, 36e-3)
_LENGTH = (26e-3, 48e-3)
# smallest ratio of length to width: glenoids have 1.2 to 1.5, the end of a round shaft 1
_ELONGATED = 1.1
# Joint heads. Diameters: femur 36 to 58 mm (Unnanuntana 2010), humerus 37 to 57 mm (Hertel 2002).
_RADII = np.arange(18e-3, 32.5e-3, 1e-3)
_CELL = 4e-3
_OFF = 0.03  # largest distance of a sample from the sphere over its radius: 0.7 mm at 24 mm
_DIRECTIONS = 600
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
VERTEBRA = ("vertebra", "vertebra:left", "vertebra:right")
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

    samples = sample_surface(*surface.scanned, 8000)
    tree = cKDTree(samples.points)
    chosen = list(range(0, 8000, 5))
    seeds = [
        _glenoid_score(samples, k, np.array(tree.query_ball_point(samples.points[k], _REACH)))
        for k in chosen
    ]
    scores = np.array([score for _, score in seeds])
    points = samples.points[chosen]
    best = int(np.argmax(scores))
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
    if score < 0.25 or not plausible:
        raise refusal(
            surface, "glenoid of about 28 x 37 mm", f"a face of {size} (score {score:.2f}) at best"
        )
    shape = "flat"
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
    close = (np.linalg.norm(offset, axis=1) < 9e-3) & (normals @ samples.normals[number] > 0.5)
    normal = normals[close].sum(axis=0)
    normal /= np.linalg.norm(normal)
    height = offset @ normal
    radial = np.linalg.norm(offset - height[:, None] * normal, axis=1)
    facing = normals @ normal
    level = (facing > 0.6) & (np.abs(height) < 6e-3)
    covered = samples.area * np.count_nonzero(level & (radial < _DISC)) / (np.pi * _DISC**2)
    behind = height[(facing < 0.0) & (radial < 5e-3) & (height < -1.5e-3)]
    thickness = -behind.max(initial=-_REACH)
    thick = np.clip((thickness - _THICK[0]) / (_THICK[1] - _THICK[0]), 0.0, 1.0)
    if covered < 0.7 or thick == 0.0:
        return normal, 0.0
    u, v = across(normal)
    around = offset[(radial > _RING) & (height > -4e-3)]
    filled, _ = np.histogram(
        np.arctan2(around @ v, around @ u), bins=_SECTORS, range=(-np.pi, np.pi)
    )
    free = np.clip(2.5 * np.mean(filled == 0) - 1.0, 0.0, 1.0)
    convexity = max(-_curvature(offset[level & (radial < 1.3 * _DISC)], normal), 0.0)
    return normal, float(min(covered, 1.0) * free * thick / (1.0 + (convexity / _CONVEX) ** 2))


def _curvature(offset: Array, normal: Array) -> float:
    """Compute the curvature [1/m] of the paraboloid fitted to points around the origin.

    It is positive where concave.
    """
    height = offset @ normal
    radial = offset - height[:, None] * normal
    terms = np.column_stack([np.ones(len(offset)), radial, 0.5 * (radial**2).sum(axis=1)])
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

    for _ in range(8):
        offset = samples.points - centre
        height = offset @ normal
        radial = np.linalg.norm(offset - height[:, None] * normal, axis=1)
        chosen = np.flatnonzero(
            (samples.normals @ normal > 0.85) & (np.abs(height) < 8e-3) & (radial < _REACH)
        )
        if len(chosen) < 30:
            return centre, np.stack([*across(normal), normal]), np.zeros(2), 0.0
        tree = cKDTree(samples.points[chosen])
        _, label = connected_components(tree.sparse_distance_matrix(tree, 2e-3))
        face = samples.points[chosen[label == label[np.argmin(radial[chosen])]]]
        middle = face.mean(axis=0)
        axes = np.linalg.svd(face - middle, full_matrices=False)[2]
        normal = axes[2] * np.sign(axes[2] @ normal)
        along = (face - middle) @ axes.T
        box = 0.5 * (along.max(axis=0) + along.min(axis=0))
        centre = middle + box[:2] @ axes[:2]
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
    samples = sample_surface(*surface.scanned, 12000)
    caps = sorted(_caps(samples), key=lambda cap: -cap.score(kind))
    scores = [cap.score(kind) for cap in caps]
    if not caps or scores[0] < 0.2 or max(cap.coverage for cap in caps) > kind.most:
        got = f"at most {max((cap.coverage for cap in caps), default=0.0):.0%}"
        what = (
            f"{kind.name}, one cap of 18 to 32 mm radius over {kind.none:.0%} to {kind.most:.0%} "
            "of its sphere"
        )
        raise refusal(surface, what, got)
    best = caps[0]
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
    level = np.tile(np.arange(len(_RADII)) // 2, count)
    place = np.floor((votes - votes.min(axis=0)) / _CELL).astype(np.int64)
    shape = (*(place.max(axis=0) + 1).tolist(), len(_RADII))
    _, cell, counts = np.unique(
        np.ravel_multi_index((*place.T, level), shape), return_inverse=True, return_counts=True
    )
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

    for turn in range(15):
        offset = points - centre
        distance = np.linalg.norm(offset, axis=1)
        facing = (normals * offset).sum(axis=1) > 0.93 * distance
        on = facing & (np.abs(distance - radius) < max(_OFF, 0.12 - 0.02 * turn) * radius)
        if np.count_nonzero(on) < 30:
            return None
        terms = np.column_stack([2.0 * points[on], np.ones(np.count_nonzero(on))])
        solved = np.linalg.lstsq(terms, (points[on] ** 2).sum(axis=1), rcond=None)[0]
        centre = solved[:3]
        radius = float(np.sqrt(max(solved[3] + centre @ centre, 0.0)))
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
    compactness = min(length / max(len(covered) * (1.0 - share), 1.0), 1.0)
    misfit = float(np.sqrt(np.mean((distance - radius) ** 2)))
    return _Cap(centre, radius, total / max(length, 1e-12), share, misfit, compactness)


def _neck_axis(samples: SurfaceSamples, cap: _Cap) -> Array:
    """Return the direction from the middle of the neck to the centre.

    The neck is 1.1 to 1.5 radii below. Without a neck, return the cap's axis.
    """
    axis = cap.axis
    offset = (samples.points - cap.centre) / cap.radius
    for _ in range(5):
        below = -(offset @ axis)
        radial = np.linalg.norm(offset + below[:, None] * axis, axis=1)
        neck = offset[(below > 1.1) & (below < 1.5) & (radial < 1.15)]
        u, v = across(axis)
        sector = np.floor(np.arctan2(neck @ v, neck @ u) / (2.0 * np.pi) * 12.0)
        ring = [neck[sector == each].mean(axis=0) for each in np.unique(sector)]
        if len(neck) < 30 or len(ring) < 10:
            return cap.axis
        middle = np.mean(ring, axis=0)
        axis = -middle / np.linalg.norm(middle)
    return axis if axis @ cap.axis > 0.8 else cap.axis


_PIXEL = 1e-3
_STEP = 1e-3
# Canals have 150 to 450 mm2; 50 to 90 % of that is seen through 17 real vertebrae.
_CANAL_AREA = (40e-6, 900e-6)
_ALONG = np.arange(-4e-3, 14.5e-3, 1e-3)
_PEDICLE_RADIUS = (1.2e-3, 11e-3)  # pedicles are 4.5 to 18 mm wide (Zindrick 1987)
_RISING = 3.5e-3  # pedicle height over the middle of the body: 5.7 to 12 mm in 17 vertebrae


@dataclass(frozen=True, eq=False)
class _Hole:
    """Hole in the shadow of a bone: viewing direction, point on the hole's axis, and area."""

    axis: Array
    point: Array
    area: float


@dataclass(frozen=True, eq=False)
class _Frame:
    """Directions of a vertebra as columns (left, forward, up) and a point in its canal.

    The point is at the height of the body.
    """

    axes: Array
    origin: Array


def find_pedicle(surface: Surface, kind: str) -> FoundSite:
    """Find the canal and the bridge of bone on each side of it.

    The canal is the largest hole seen through the bone.
    """
    longest = max(surface.report.size_mm)
    points = _inner_points(surface)
    canal = (
        _canal(np.vstack([sample_surface(*surface.scanned, 15000).points, points]))
        if longest < 130.0
        else None
    )
    what = "vertebra, whose canal is a hole between a body and two pedicles"
    if canal is None:
        raise refusal(surface, what, f"no hole through a bone {longest:.0f} mm long")
    frame, problem = _vertebra_frame(surface, points, canal)
    if frame is None:
        raise refusal(surface, what, problem)
    found = {
        side: _pedicle(surface, frame, sign) for side, sign in (("left", 1.0), ("right", -1.0))
    }
    for side, (_, radius) in found.items():
        if not _PEDICLE_RADIUS[0] < radius < _PEDICLE_RADIUS[1]:
            raise refusal(surface, what, f"{2e3 * radius:.1f} mm of bone {side} of the hole")
    side = kind.partition(":")[2] or max(found, key=lambda each: found[each][1])
    other = "right" if side == "left" else "left"
    site, radius = found[side]
    second, second_radius = found[other]
    # Scores fall for canals below 60 mm2 and for pedicles with less than 6 mm of bone.
    certain = min(canal.area / 60e-6, 1.0)
    score = certain * min(radius / 3e-3, 1.0)
    note = (
        f"found by search: {side} pedicle, at least {2e3 * radius:.1f} mm of bone across its "
        f"axis, {other} one "
        f"{2e3 * second_radius:.1f} mm, score {score:.2f} of 1; check it in the picture"
    )
    site = replace(site, confidence=note)
    if kind != "vertebra":
        return FoundSite(site, score)
    return FoundSite(site, score, certain * min(second_radius / 3e-3, 1.0), 1e3 * second.centre_m)


def _inner_points(surface: Surface) -> Array:
    """Return points of a grid of 2 mm inside the bone, shape (n, 3)."""
    low = surface.vertices_m.min(axis=0)
    high = surface.vertices_m.max(axis=0)
    axes = [np.arange(a, b, max(2e-3, (b - a) / 100.0)) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[inside_scattered(surface.vertices_m, surface.faces, grid)]


def _canal(points: Array) -> _Hole | None:
    """Return the largest hole of plausible size seen through a bone, or None.

    It is seen along the mean of the directions that show it.
    """
    views = [_hole(points, axis) for axis in spread((np.arange(300) + 0.5) / 300.0, np.eye(3)[2])]
    views = [view for view in views if 0.0 < view.area < _CANAL_AREA[1]]
    if not views:
        return None
    best = max(views, key=lambda view: view.area)
    # Take the mean of the directions in which the hole is nearly as large: the largest one leans to
    # a side.
    for degrees in (12.0, 12.0, 6.0):
        cone = np.cos(np.radians(degrees) * np.sqrt((np.arange(60) + 0.5) / 60.0))
        around = [best, *(_hole(points, axis) for axis in spread(cone, best.axis))]
        most = max(view.area for view in around)
        axis = np.sum([view.axis for view in around if view.area > 0.9 * most], axis=0)
        best = _hole(points, axis / np.linalg.norm(axis))
    return best if _CANAL_AREA[0] < best.area < _CANAL_AREA[1] else None


def _hole(points: Array, axis: Array) -> _Hole:
    """Find the largest hole in the shadow of points along a direction."""
    from scipy.ndimage import binary_closing, binary_fill_holes, label

    u, v = across(axis)
    flat = np.column_stack([points @ u, points @ v])
    low = flat.min(axis=0) - 3.0 * _PIXEL
    pixels = np.floor((flat - low) / _PIXEL).astype(int)
    shadow = np.zeros(pixels.max(axis=0) + 4, dtype=bool)
    shadow[tuple(pixels.T)] = True
    shadow = binary_closing(shadow)
    holes, count = label(binary_fill_holes(shadow) & ~shadow)
    if count == 0:
        return _Hole(axis, points[0], 0.0)
    sizes = np.bincount(holes.ravel())[1:]
    middle = low + _PIXEL * (np.argwhere(holes == np.argmax(sizes) + 1).mean(axis=0) + 0.5)
    level = float(np.median(points @ axis))
    return _Hole(axis, middle[0] * u + middle[1] * v + level * axis, float(sizes.max()) * _PIXEL**2)


def _vertebra_frame(surface: Surface, inner: Array, canal: _Hole) -> tuple[_Frame | None, str]:
    """Return left, forward and up of a vertebra, or a reason why the bone is not a vertebra.

    The body is in front. The pedicles leave its upper half and the arch lies lower, which
    distinguishes up from down.
    """
    to_middle = inner.mean(axis=0) - canal.point
    forward = to_middle - (to_middle @ canal.axis) * canal.axis
    forward /= np.linalg.norm(forward)
    in_front = (inner - canal.point) @ forward
    height = (inner - canal.point) @ canal.axis
    edge = 0.5 * float(np.sqrt(canal.area))
    body = height[in_front > edge]
    arch = height[in_front < -edge]
    if len(body) < 0.35 * len(inner) or not len(arch):
        return None, f"{len(body) / len(inner):.0%} of the bone in front of the hole"
    origin = canal.point + body.mean() * canal.axis
    frame = _Frame(np.column_stack([np.cross(canal.axis, forward), forward, canal.axis]), origin)
    sides = [_sections(surface, frame, sign) for sign in (1.0, -1.0)]
    if not (len(sides[0]) and len(sides[1])):
        return None, "no bone on a side of the hole"
    narrowest = [side[np.argmin(side[:, 3]), 2] for side in sides]
    middle = 0.5 * (body.max() + body.min()) - body.mean()
    rising = np.mean(narrowest) - middle - (arch.mean() - body.mean())
    if abs(rising) < _RISING:
        return (
            None,
            (
                f"pedicles {1e3 * abs(rising):.1f} mm off the middle of the body, as where it is "
                "cut off"
            ),
        )
    return (frame if rising > 0.0 else _Frame(frame.axes * (-1.0, 1.0, -1.0), origin)), ""


def _sections(surface: Surface, frame: _Frame, sign: float) -> Array:
    """Compute centroid [m] and area [mm2] of the largest bone section next to the canal.

    There is one section for each mm forward, shape (n, 4).

    Sections that close the canal belong to the body or the arch and are left out.
    """
    from scipy.ndimage import label

    axes = (
        np.arange(0.5e-3, 25e-3, _STEP) * sign,
        np.arange(-6e-3, 12e-3, _STEP),
        np.arange(-25e-3, 25e-3, _STEP),
    )
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    there = grid.reshape(-1, 3) @ frame.axes.T + frame.origin
    bone = inside_scattered(surface.vertices_m, surface.faces, there).reshape(grid.shape[:3])
    found = []
    for k in range(len(axes[1])):
        pieces, count = label(bone[:, k])
        if count and not bone[:2, k].any():
            sizes = np.bincount(pieces.ravel())[1:]
            largest = pieces == np.argmax(sizes) + 1
            found.append(np.append(grid[:, k][largest].mean(axis=0), sizes.max()))
    return np.array(found).reshape(-1, 4)


def _pedicle(surface: Surface, frame: _Frame, sign: float) -> tuple[Site, float]:
    """Find the site where the axis of a pedicle leaves the bone at the back.

    Also return the smallest depth of bone around 18 mm of the axis.

    The axis is the line with the most bone around it, which a surgeon drills along.
    """
    from scipy.optimize import minimize

    sections = _sections(surface, frame, sign)
    start = sections[np.argmin(sections[:, 3]), :3]

    def line(numbers: Array) -> Array:
        """Return points of the line with an offset [mm] and slopes across the narrowest section."""
        place = start + 1e-3 * np.array([numbers[0], 0.0, numbers[1]])
        points = place + _ALONG[:, None] * np.array([numbers[2], 1.0, numbers[3]])
        return np.asarray(points @ frame.axes.T + frame.origin)

    def cost(numbers: Array) -> float:
        # Slopes above 0.7 leave the pedicle; the mean decides between lines of equal depth.
        steep = max(float(np.abs(numbers[2:]).max()) - 0.7, 0.0)
        outside = triangle_distance(surface.vertices_m, surface.faces, line(numbers))
        return 1e3 * float(outside.max() + 0.01 * outside.mean()) + 100.0 * steep

    tried = [
        minimize(cost, [0.0, 0.0, slope * sign, 0.0], method="Nelder-Mead") for slope in (0.0, -0.3)
    ]
    points = line(min(tried, key=lambda each: float(each.fun)).x)
    radius = -float(triangle_distance(surface.vertices_m, surface.faces, points).max())
    outward = points[0] - points[-1]
    outward /= np.linalg.norm(outward)
    rotation = axes_along(outward, np.cross(frame.axes[:, 2], outward).tolist())
    middle = points[np.argmin(np.abs(_ALONG))]
    height = exits(surface, middle, rotation)
    return Site(middle + height[height > 0.0].min(initial=np.inf) * outward, rotation, ""), radius
