"""The entries to a vertebra's two pedicles: where the axis with the most bone around it comes out of the arch behind.

A pedicle joins the body to the arch beside the canal. Its narrowest section across the canal's front-to-back direction
is where the line starts that is then moved and turned until the least depth of bone around it, over 18 mm, is greatest:
the line that a surgeon drills along.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.surfaces.glenoid_search import sample_surface
from meshes.surfaces.site import FoundSite, Site
from meshes.surfaces.surface import Surface
from meshes.surfaces.vertebra_canal import Canal, canals
from meshes.voxels.column_crossings import column_crossings, inside_scattered
from meshes.voxels.mesh_sampling import triangle_distance

__all__ = ["VERTEBRA", "find_pedicle"]

VERTEBRA = ("vertebra", "vertebra:left", "vertebra:right")
_SAMPLES, _GRID_M, _STEP_M = 15000, 2e-3, 1e-3
_LONGEST_M = 0.13
_SIDES = ("left", "right")
_SECTION_M = 25e-3
_ALONG_M = np.arange(-4e-3, 14.5e-3, 1e-3)
_REACH_M = (12e-3, 20e-3, 12e-3)
_STEEPEST = 0.7
_RADIUS_M = (1.2e-3, 11e-3)
"""Half of the least width of pedicles: 4.5 mm in the chest to 18 mm in the loins (Zindrick 1987), with a margin."""
_BODY_SHARE = 0.35
_RISING_M = 3.5e-3
"""How much higher the pedicles leave the body than its middle, and the arch hangs, together: 5.7 to 12 mm in 17 real
vertebrae; with less it stays open which end is up, and so which side is left."""
_WIDE_M2, _WIDE_M = 60e-6, 3e-3
"""Hole and depth around the line from which a score is no longer lowered."""


@dataclass(frozen=True, eq=False)
class _Frame:
    """A vertebra's directions as columns (to its left, forward, up), a point of its canal at the height of the body
    [m], and the middle of the narrowest section left and right of it, in these directions from that point [m]."""

    axes: NDArray[np.float64]
    origin_m: NDArray[np.float64]
    narrowest_m: tuple[NDArray[np.float64], ...]


@dataclass(frozen=True, eq=False)
class _Pedicle:
    """A pedicle: its site, and the least depth of bone around its axis [m]."""

    site: Site
    radius_m: float


def find_pedicle(surface: Surface, kind: str) -> FoundSite:
    """Find a vertebra's pedicle: the site is where its axis comes out behind, z out along it, y up, x to the right.

    Parameters
    ----------
    surface
        One vertebra alone, its canal a hole through it.
    kind
        ``vertebra:left`` or ``vertebra:right``, of the patient; ``vertebra`` is the wider of the two, with the other as
        its second best place.

    Raises
    ------
    InputError
        If the surface has no such hole, or what lies around it is no vertebra.
    """
    samples = sample_surface(*surface.scanned, _SAMPLES)
    inner = _inner_points(surface)
    longest = max(surface.report.size_mm)
    found = canals(np.vstack([samples.points, inner])) if longest < 1e3 * _LONGEST_M else []
    if not found:
        raise _refused(surface, f"no hole through a bone {longest:.0f} mm long")
    frame = _directions(surface, inner, found[0])
    pedicles = {side: _pedicle(surface, frame, number) for number, side in enumerate(_SIDES)}
    for side, pedicle in pedicles.items():
        if not _RADIUS_M[0] < pedicle.radius_m < _RADIUS_M[1]:
            raise _refused(surface, f"{2e3 * pedicle.radius_m:.1f} mm of bone {side} of the hole")
    side = kind.partition(":")[2] or max(pedicles, key=lambda each: pedicles[each].radius_m)
    other = next(each for each in _SIDES if each != side)
    score, second = (_score(found[0], pedicles[each]) for each in (side, other))
    best = pedicles[side]
    note = (
        f"found by search: {side} pedicle, at least {2e3 * best.radius_m:.1f} mm of bone across its axis, "
        f"{other} one {2e3 * pedicles[other].radius_m:.1f} mm, score {score:.2f} of 1; check it in the picture"
    )
    site = Site(best.site.centre_m, best.site.rotation, note)
    if kind == "vertebra":
        return FoundSite(site, score, second, 1e3 * pedicles[other].site.centre_m)
    if len(found) == 1:
        return FoundSite(site, score, 0.0, None)
    return FoundSite(site, score, score * found[1].area_m2 / found[0].area_m2, 1e3 * found[1].point_m)


def _score(canal: Canal, pedicle: _Pedicle) -> float:
    return min(canal.area_m2 / _WIDE_M2, 1.0) * min(pedicle.radius_m / _WIDE_M, 1.0)


def _refused(surface: Surface, got: str) -> InputError:
    return InputError(
        f"file must show a vertebra, whose canal is a hole between a body and two pedicles, got {got} in "
        f"{surface.report.source}: check anatomy.scale_mm and that it is one bone, or give anatomy.centre_mm and "
        "anatomy.normal"
    )


def _inner_points(surface: Surface) -> NDArray[np.float64]:
    """Points of a grid of 2 mm within the bone [m], shape (n, 3)."""
    low, high = surface.vertices_m.min(axis=0), surface.vertices_m.max(axis=0)
    axes = [np.arange(a, b, max(_GRID_M, (b - a) / 100.0)) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[inside_scattered(surface.vertices_m, surface.faces, grid)]


def _directions(surface: Surface, inner: NDArray[np.float64], canal: Canal) -> _Frame:
    """Left, forward and up: most of the bone lies in front; the pedicles leave the body's upper half, the arch hangs.

    Raises
    ------
    InputError
        If there is no body in front, or no bone on a side.
    """
    to_middle = inner.mean(axis=0) - canal.point_m
    forward = to_middle - (to_middle @ canal.axis) * canal.axis
    forward /= np.linalg.norm(forward)
    local = (inner - canal.point_m) @ np.column_stack([forward, canal.axis])
    edge = 0.5 * float(np.sqrt(canal.area_m2))
    body, arch = local[local[:, 0] > edge, 1], local[local[:, 0] < -edge, 1]
    if len(body) < _BODY_SHARE * len(inner) or not len(arch):
        raise _refused(surface, f"{len(body) / len(inner):.0%} of the bone in front of the hole")
    origin = canal.point_m + float(body.mean()) * canal.axis
    axes = np.column_stack([np.cross(forward, -canal.axis), forward, canal.axis])
    starts = [_isthmus(surface, _Frame(axes, origin, ()), sign) for sign in (1.0, -1.0)]
    if starts[0] is None or starts[1] is None:
        raise _refused(surface, "no bone on a side of the hole")
    middle = 0.5 * float(body.max() + body.min()) - float(body.mean())
    rising = 0.5 * float(starts[0][2] + starts[1][2]) - middle - float(arch.mean() - body.mean())
    if abs(rising) < _RISING_M:
        raise _refused(
            surface, f"pedicles {1e3 * abs(rising):.1f} mm off the middle of the body, as where it is cut off"
        )
    if rising > 0.0:
        return _Frame(axes, origin, (starts[0], starts[1]))
    turned = np.array([-1.0, 1.0, -1.0])
    return _Frame(axes * turned, origin, (starts[1] * turned, starts[0] * turned))


def _pedicle(surface: Surface, frame: _Frame, side: int) -> _Pedicle:
    """The left pedicle (0) or the right one (1)."""
    from scipy.ndimage import map_coordinates
    from scipy.optimize import minimize

    start, outside = frame.narrowest_m[side], 1.0 - 2.0 * side
    axes = [centre + np.arange(-reach, reach + 1e-9, _STEP_M) for centre, reach in zip(start, _REACH_M, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    there = grid.reshape(-1, 3) @ frame.axes.T + frame.origin_m
    depth = -triangle_distance(surface.vertices_m, surface.faces, there).reshape(grid.shape[:3])

    def line(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of a line by its place across the isthmus [mm] and its slopes, in the vertebra's directions."""
        place = np.array([1e-3 * numbers[0], 0.0, 1e-3 * numbers[1]]) + start
        return np.asarray(place + _ALONG_M[:, None] * np.array([numbers[2], 1.0, numbers[3]]))

    def around(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        at = (line(numbers) - [axis[0] for axis in axes]) / _STEP_M
        return np.asarray(map_coordinates(depth, at.T, order=1, mode="nearest"))

    def shallow(numbers: NDArray[np.float64]) -> float:
        found = around(numbers)
        steep = max(float(np.abs(numbers[2:]).max()) - _STEEPEST, 0.0)
        return -1e3 * float(found.min() + 0.01 * found.mean()) + 100.0 * steep

    starts = ([0.0, 0.0, lean * outside, 0.0] for lean in (0.0, -0.3))
    found = min((minimize(shallow, each, method="Nelder-Mead") for each in starts), key=lambda each: float(each.fun))
    numbers = np.asarray(found.x)
    inward = frame.axes @ np.array([numbers[2], 1.0, numbers[3]])
    inward /= np.linalg.norm(inward)
    middle = frame.axes @ line(numbers)[np.argmin(np.abs(_ALONG_M))] + frame.origin_m
    radius = float(around(numbers).min())
    return _Pedicle(_entry(surface, middle, -inward, frame.axes[:, 2]), radius)


def _isthmus(surface: Surface, frame: _Frame, sign: float) -> NDArray[np.float64] | None:
    """Middle of the smallest section of bone beside the canal, in the vertebra's directions [m]; None without bone."""
    from scipy.ndimage import label

    left, front = np.arange(0.5e-3, _SECTION_M, _STEP_M) * sign, np.arange(-6e-3, 12e-3, _STEP_M)
    up = np.arange(-25e-3, 25e-3, _STEP_M)
    grid = np.stack(np.meshgrid(left, front, up, indexing="ij"), axis=-1).reshape(-1, 3)
    there = grid @ frame.axes.T + frame.origin_m
    bone = inside_scattered(surface.vertices_m, surface.faces, there).reshape(len(left), len(front), len(up))
    best: tuple[float, NDArray[np.float64]] | None = None
    for index in range(len(front)):
        section = bone[:, index]
        if section[:2].any():
            continue  # the body or the arch closes the canal there: no pedicle alone
        pieces, count = label(section)
        if count == 0:
            continue
        sizes = np.bincount(pieces.ravel())[1:]
        number = int(np.argmax(sizes)) + 1
        at = np.argwhere(pieces == number).mean(axis=0)
        place = np.array([np.interp(at[0], np.arange(len(left)), left), front[index], up[0] + _STEP_M * at[1]])
        if best is None or sizes[number - 1] < best[0]:
            best = (float(sizes[number - 1]), place)
    return None if best is None else best[1]


def _entry(
    surface: Surface, middle: NDArray[np.float64], outward: NDArray[np.float64], up: NDArray[np.float64]
) -> Site:
    """Site where the line from within a pedicle outward first leaves the bone."""
    y = up - (up @ outward) * outward
    y /= np.linalg.norm(y)
    rotation = np.column_stack([np.cross(y, outward), y, outward])
    found = column_crossings(
        (surface.vertices_m - middle) @ rotation, surface.faces, np.array([1e-9]), np.array([1e-9])
    )
    leaving = found.height[(found.entering < 0) & (found.height > 0.0)]
    height = float(leaving.min()) if len(leaving) else 0.0
    return Site(middle + height * outward, rotation, "")
