"""Search for the pedicles of a vertebra. All lengths are in metres."""

from dataclasses import dataclass, replace

import numpy as np

from meshes.base.arrays import Array, lattice
from meshes.surfaces.site import (
    FoundSite,
    Site,
    across,
    axes_along,
    exits,
    refusal,
    sample_surface,
    spread,
)
from meshes.surfaces.surface import Surface
from meshes.voxels.mesh_sampling import inside_scattered, surface_distance

VERTEBRA = ("vertebra", "vertebra:left", "vertebra:right")
_WHAT = "vertebra, whose canal is a hole between a body and two pedicles"
# If a constant of the search is changed by a fifth to a factor of ten, the site on the synthetic
# vertebra changes by at most 1.1 mm and 8 degrees. On vertebrae of a CT with voxels of 3 mm, the
# site changes by up to 9 mm. Pixel size of a shadow (projection), and distance between sections. It
# is half of the diameter of the smallest accepted pedicle.
_PIXEL = 1e-3
_STEP = 1e-3
# Canals have 150 to 450 mm2. In projections of 17 real vertebrae, 50 to 90 % of this area is open.
_CANAL_AREA = (40e-6, 900e-6)
# Points of the axis [m], from 4 mm behind the narrowest section to 14 mm in front of it, in the
# body.
_ALONG = np.arange(-4e-3, 14.5e-3, 1e-3)
_PEDICLE_RADIUS = (1.2e-3, 11e-3)  # pedicles are 4.5 to 18 mm wide (Zindrick 1987)
_RISING = 3.5e-3  # height of the pedicle above the middle of the body: 5.7 to 12 mm in 17 vertebrae


@dataclass(frozen=True, eq=False)
class _Hole:
    """Hole in the projection of a bone: viewing direction, point on the hole's axis, and area."""

    axis: Array
    point: Array
    area: float


@dataclass(frozen=True, eq=False)
class _Frame:
    """Anatomical directions of a vertebra (left, forward, up), and a point in the spinal canal.

    The directions are columns of a matrix. The point lies at the height of the vertebral body.
    """

    axes: Array
    origin: Array


def find_pedicle(surface: Surface, kind: str) -> FoundSite:
    """Find the spinal canal of a vertebra, and the site at a pedicle next to the canal.

    The canal is the largest hole in a projection of the bone.
    """
    # Vertebrae are shorter than 130 mm. With 7000 and 30,000 instead of 15,000 samples, the site
    # changes by at most 0.5 mm.
    longest = max(surface.report.size_mm)
    points = _inner_points(surface)
    canal = (
        _canal(np.vstack([sample_surface(*surface.scanned, 15000).points, points]))
        if longest < 130.0
        else None
    )
    if canal is None:
        raise refusal(surface, _WHAT, f"no hole through a bone {longest:.0f} mm long")
    frame = _vertebra_frame(surface, points, canal)
    found = {
        side: _pedicle(surface, frame, sign) for side, sign in (("left", 1.0), ("right", -1.0))
    }
    for side, (_, radius) in found.items():
        if not _PEDICLE_RADIUS[0] < radius < _PEDICLE_RADIUS[1]:
            raise refusal(surface, _WHAT, f"{2e3 * radius:.1f} mm of bone {side} of the hole")
    side = kind.partition(":")[2] or max(found, key=lambda each: found[each][1])
    other = "right" if side == "left" else "left"
    site, radius = found[side]
    second, second_radius = found[other]
    # The score decreases for canals below 60 mm2 and for pedicles with less than 6 mm of bone.
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
    """Return points inside the bone on a grid with a spacing of 2 mm, shape (n, 3)."""
    low = surface.vertices_m.min(axis=0)
    high = surface.vertices_m.max(axis=0)
    # The limit of a hundred steps bounds the number of points. With 1.5 and 3 mm instead of 2 mm,
    # the site changes by at most 0.5 mm.
    axes = [np.arange(a, b, max(2e-3, (b - a) / 100.0)) for a, b in zip(low, high, strict=True)]
    grid = lattice(*axes)
    return grid[inside_scattered(surface.vertices_m, surface.faces, grid)]


def _canal(points: Array) -> _Hole | None:
    """Return the largest hole of plausible size in projections of a bone; None without such a hole.

    The returned direction of the hole is the mean of all projection directions in which the hole is
    nearly as large as in the best direction.
    """
    # 300 directions on a half sphere are 8 degrees apart. A canal is open in a cone of this width.
    views = [_hole(points, axis) for axis in spread((np.arange(300) + 0.5) / 300.0, np.eye(3)[2])]
    views = [view for view in views if 0.0 < view.area < _CANAL_AREA[1]]
    if not views:
        return None
    best = max(views, key=lambda view: view.area)
    # Use the mean of the directions in which the hole is nearly as large, because the direction
    # with the largest hole is inclined to one side. Search in cones around the best direction. The
    # first cone is wider than the distance between the 300 directions.
    for degrees in (12.0, 12.0, 6.0):
        cone = np.cos(np.radians(degrees) * np.sqrt((np.arange(60) + 0.5) / 60.0))
        around = [best, *(_hole(points, axis) for axis in spread(cone, best.axis))]
        most = max(view.area for view in around)
        axis = np.sum([view.axis for view in around if view.area > 0.9 * most], axis=0)
        best = _hole(points, axis / np.linalg.norm(axis))
    return best if _CANAL_AREA[0] < best.area < _CANAL_AREA[1] else None


def _hole(points: Array, axis: Array) -> _Hole:
    """Find the largest hole in the projection of points along a direction."""
    from scipy.ndimage import binary_closing, binary_fill_holes, label

    u, v = across(axis)
    flat = np.column_stack([points @ u, points @ v])
    # Add an empty border, so that the outside is one region and `binary_closing` does not change
    # the edge.
    low = flat.min(axis=0) - 3.0 * _PIXEL
    pixels = np.floor((flat - low) / _PIXEL).astype(int)
    shadow = np.zeros(pixels.max(axis=0) + 4, dtype=bool)
    shadow[tuple(pixels.T)] = True
    # Between samples, single pixels of the bone are empty.
    shadow = binary_closing(shadow)
    holes, count = label(binary_fill_holes(shadow) & ~shadow)
    if count == 0:
        return _Hole(axis, points[0], 0.0)
    sizes = np.bincount(holes.ravel())[1:]
    middle = low + _PIXEL * (np.argwhere(holes == np.argmax(sizes) + 1).mean(axis=0) + 0.5)
    level = float(np.median(points @ axis))
    return _Hole(axis, middle[0] * u + middle[1] * v + level * axis, float(sizes.max()) * _PIXEL**2)


def _vertebra_frame(surface: Surface, inner: Array, canal: _Hole) -> _Frame:
    """Return the directions left, forward and up of a vertebra.

    If the bone is not a vertebra, raise an error.

    The body lies in front of the canal. The direction up follows from the heights: the pedicles
    start at the upper half of the body, and the arch lies lower.
    """
    to_middle = inner.mean(axis=0) - canal.point
    forward = to_middle - (to_middle @ canal.axis) * canal.axis
    forward /= np.linalg.norm(forward)
    in_front = (inner - canal.point) @ forward
    height = (inner - canal.point) @ canal.axis
    # half the side of a square with the area of the canal: distance at which body and arch begin
    edge = 0.5 * float(np.sqrt(canal.area))
    body = height[in_front > edge]
    arch = height[in_front < -edge]
    # With limits of 0.2 and 0.5, the same bones are accepted.
    if len(body) < 0.35 * len(inner) or not len(arch):
        got = f"{len(body) / len(inner):.0%} of the bone in front of the hole"
        raise refusal(surface, _WHAT, got)
    origin = canal.point + body.mean() * canal.axis
    frame = _Frame(np.column_stack([np.cross(canal.axis, forward), forward, canal.axis]), origin)
    sides = [_sections(surface, frame, sign) for sign in (1.0, -1.0)]
    if not (len(sides[0]) and len(sides[1])):
        raise refusal(surface, _WHAT, "no bone on a side of the hole")
    narrowest = [side[np.argmin(side[:, 3]), 2] for side in sides]
    middle = 0.5 * (body.max() + body.min()) - body.mean()
    rising = np.mean(narrowest) - middle - (arch.mean() - body.mean())
    # If `frame` is upside down, `rising` is negative.
    if abs(rising) < _RISING:
        got = (
            f"pedicles {1e3 * abs(rising):.1f} mm off the middle of the body, as in a bone "
            "that is cut off"
        )
        raise refusal(surface, _WHAT, got)
    return frame if rising > 0.0 else _Frame(frame.axes * (-1.0, 1.0, -1.0), origin)


def _sections(surface: Surface, frame: _Frame, sign: float) -> Array:
    """Compute centroid [m] and area [mm2] of the bone in sections next to the spinal canal.

    The sections are normal to the forward direction and 1 mm apart. In each section, the largest
    piece of bone is used. The result, shape (n, 4), has one row per section.

    Sections in which bone closes the canal belong to the body or the arch and are omitted.
    """
    from scipy.ndimage import label

    axes = (
        # Range relative to the middle of the canal: 25 mm to the side, up and down contain the
        # pedicle of any vertebra; -6 to 12 mm forward contain the canal and the start of the body.
        np.arange(0.5e-3, 25e-3, _STEP) * sign,
        np.arange(-6e-3, 12e-3, _STEP),
        np.arange(-25e-3, 25e-3, _STEP),
    )
    grid = lattice(*axes).reshape(*map(len, axes), 3)
    there = grid.reshape(-1, 3) @ frame.axes.T + frame.origin
    bone = inside_scattered(surface.vertices_m, surface.faces, there).reshape(grid.shape[:3])
    found = []
    for k in range(len(axes[1])):
        pieces, count = label(bone[:, k])
        # Bone in the middle of the canal, which is the first two columns.
        if count and not bone[:2, k].any():
            sizes = np.bincount(pieces.ravel())[1:]
            largest = pieces == np.argmax(sizes) + 1
            found.append(np.append(grid[:, k][largest].mean(axis=0), sizes.max()))
    return np.array(found).reshape(-1, 4)


def _pedicle(surface: Surface, frame: _Frame, sign: float) -> tuple[Site, float]:
    """Find the site at which the axis of a pedicle leaves the back of the bone.

    Also return the smallest depth below the bone surface along 18 mm of the axis.

    The axis is the line with the most bone around it. This is the line along which a surgeon
    drills.
    """
    from scipy.optimize import minimize

    sections = _sections(surface, frame, sign)
    start = sections[np.argmin(sections[:, 3]), :3]
    distance = surface_distance(surface.vertices_m, surface.faces)

    def line(numbers: Array) -> Array:
        """Return points of a line with an offset [mm] and slopes at the narrowest section."""
        place = start + 1e-3 * np.array([numbers[0], 0.0, numbers[1]])
        points = place + _ALONG[:, None] * np.array([numbers[2], 1.0, numbers[3]])
        return np.asarray(points @ frame.axes.T + frame.origin)

    def cost(numbers: Array) -> float:
        # Lines with slopes above 0.7 leave the pedicle. For lines with equal smallest depth, the
        # mean depth decides.
        steep = max(float(np.abs(numbers[2:]).max()) - 0.7, 0.0)
        outside = distance(line(numbers))
        return 1e3 * float(outside.max() + 0.01 * outside.mean()) + 100.0 * steep

    # Nelder-Mead ends in the nearest minimum, so start with 0 and 17 degrees inward. Pedicles point
    # -4 to 30 degrees inward (Zindrick 1987).
    tried = [
        minimize(cost, [0.0, 0.0, slope * sign, 0.0], method="Nelder-Mead") for slope in (0.0, -0.3)
    ]
    points = line(min(tried, key=lambda each: float(each.fun)).x)
    radius = -float(distance(points).max())
    outward = points[0] - points[-1]
    outward /= np.linalg.norm(outward)
    rotation = axes_along(outward, np.cross(frame.axes[:, 2], outward).tolist())
    middle = points[np.argmin(np.abs(_ALONG))]
    height = exits(surface, middle, rotation)
    return Site(middle + height[height > 0.0].min(initial=np.inf) * outward, rotation, ""), radius
