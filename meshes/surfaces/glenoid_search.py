"""Finding the glenoid on a scapula: a thick-backed, flat to concave, oval face that ends at a rim.

Surface samples are scored by four measures of the disc around them, all in millimetres: how fully a disc of radius 10
facing one direction is covered, in how many the surface has dropped away 20 to 26 from its middle, how thick the
bone behind is, and that the disc is not convex. The sizes follow the adult glenoid
(24-30 x 33-38 mm, see `meshes.surfaces.glenoid`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.simplices import cross_products
from meshes.surfaces.repair import triangle_areas

__all__ = ["Face", "Seed", "SurfaceSamples", "best_seeds", "grow_face", "sample_surface"]

_DISC, _RING, _REACH = 10e-3, 20e-3, 26e-3
_THICK = (6e-3, 18e-3)
_CONVEX = 6.0
_SEEDS = 1500
_APART = 30e-3
_SECTORS, _REFINEMENTS = 24, 8
_INNER, _RING_WIDTH, _LEANING = 7e-3, 1e-3, 0.4


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points spread evenly over a surface.

    Attributes
    ----------
    points, normals
        Positions [m] and outward unit normals, shape (n, 3).
    area
        Surface area that each point stands for [m2].
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    area: float


@dataclass(frozen=True, eq=False)
class Face:
    """The face found.

    Attributes
    ----------
    centre_m, normal
        Middle of its bounding box in its plane [m], and outward unit normal, shape (3,).
    long_axis
        Unit vector along its longer side, sign arbitrary, shape (3,).
    width_m, length_m
        Its shorter and longer side [m].
    curvature_radius_m
        Radius of the sphere that fits it [m], positive where concave; infinite where flat.
    """

    centre_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    long_axis: NDArray[np.float64]
    width_m: float
    length_m: float
    curvature_radius_m: float


@dataclass(frozen=True, eq=False)
class Seed:
    """A sample of a surface and how much the surface around it looks like a glenoid.

    Attributes
    ----------
    point_m, normal
        Position [m] and smoothed outward unit normal, shape (3,).
    score
        Likeness, 0 to 1.
    """

    point_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    score: float


def sample_surface(vertices: NDArray[np.float64], faces: NDArray[np.int64], count: int) -> SurfaceSamples:
    """Spread `count` points evenly by area, the same ones every time (Kronecker sequence within the triangles)."""
    total = np.cumsum(triangle_areas(vertices, faces))
    chosen = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    chosen = np.minimum(chosen, len(faces) - 1)
    u, v = np.modf(np.arange(count)[:, None] * np.array([0.7548776662466927, 0.5698402909980532]))[0].T
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    a, b, c = (vertices[faces[chosen, k]] for k in range(3))
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    cross = cross_products(vertices, faces[chosen])
    return SurfaceSamples(points, cross / np.linalg.norm(cross, axis=1)[:, None], float(total[-1]) / count)


def best_seeds(samples: SurfaceSamples) -> tuple[Seed, Seed]:
    """Sample that looks most like the middle of a glenoid, and the one that does so 30 mm or more away from it."""
    from scipy.spatial import cKDTree

    tree = cKDTree(samples.points)
    numbers = np.arange(0, len(samples.points), max(len(samples.points) // _SEEDS, 1)).tolist()
    seeds = []
    for number in numbers:
        near = np.array(tree.query_ball_point(samples.points[number], _REACH))
        normal, score = _score(samples, samples.points[number], samples.normals[number], near)
        seeds.append(Seed(samples.points[number], normal, score))
    best = max(seeds, key=lambda seed: seed.score)
    apart = [seed for seed in seeds if np.linalg.norm(seed.point_m - best.point_m) > _APART]
    return best, max(apart, key=lambda seed: seed.score, default=Seed(best.point_m, best.normal, 0.0))


def grow_face(samples: SurfaceSamples, centre_m: NDArray[np.float64], normal: NDArray[np.float64]) -> Face:
    """Face around `centre_m` [m] as far as its rim, its middle and normal refined from the rim eight times.

    The rim in each of 24 directions is where the surface first leans outward by more than 24 degrees. The normal is
    that of the plane through the rim.
    """
    rim = np.zeros((0, 3))
    for _ in range(_REFINEMENTS):
        rim = _rim(samples, centre_m, normal)
        if len(rim) < _SECTORS // 2:
            return Face(centre_m, normal, np.zeros(3), 0.0, 0.0, np.inf)
        middle = rim.mean(axis=0)
        axes = np.linalg.svd(rim - middle)[2]
        normal = axes[2] * np.sign(axes[2] @ normal)
        along = (rim - middle) @ axes.T
        middle = middle + 0.5 * (along.max(axis=0) + along.min(axis=0))[:2] @ axes[:2]
        offset = samples.points - middle
        height = offset @ normal
        face = (samples.normals @ normal > 0.5) & (np.abs(height) < 8e-3)
        across = np.where(face, np.einsum("ij,ij->i", offset, offset) - height**2, np.inf)
        centre_m = middle + normal * float(height[np.argsort(across)[:8]].mean())
    sides = np.ptp(along, axis=0)
    inner = offset[face & (across < (0.4 * sides[1]) ** 2)]
    curvature = _curvature(inner, normal)
    radius = 1.0 / curvature if abs(curvature) > 1e-3 else np.inf
    return Face(centre_m, normal, axes[0], float(sides[1]), float(sides[0]), radius)


def _rim(samples: SurfaceSamples, centre_m: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of the rim [m], shape (n, 3), n at most 24; each radius is the median of five neighbours'."""
    offset = samples.points - centre_m
    near = np.einsum("ij,ij->i", offset, offset) < _REACH**2
    offset, normals = offset[near], samples.normals[near]
    height = offset @ normal
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    u, v = offset @ first, offset @ np.cross(normal, first)
    across = np.hypot(u, v)
    leaning = (normals @ first * u + normals @ np.cross(normal, first) * v) / np.maximum(across, 1e-9)
    shown = (normals @ normal > 0.1) & (np.abs(height) < 9e-3) & (across > _INNER)
    sector = np.floor((np.arctan2(v, u) / (2.0 * np.pi) + 0.5) * _SECTORS).astype(np.int64) % _SECTORS
    ring = np.floor(across / _RING_WIDTH).astype(np.int64)
    rings = int(_REACH / _RING_WIDTH) + 1
    cell = (sector * rings + ring)[shown]
    counts = np.bincount(cell, minlength=_SECTORS * rings).reshape(_SECTORS, rings)
    lean = np.bincount(cell, weights=leaning[shown], minlength=_SECTORS * rings).reshape(_SECTORS, rings)
    level = np.bincount(cell, weights=height[shown], minlength=_SECTORS * rings).reshape(_SECTORS, rings)
    beyond = lean > _LEANING * np.maximum(counts, 1)
    beyond[:, -1] = True
    edge = beyond.argmax(axis=1)
    edge = np.median([np.roll(edge, shift) for shift in (-2, -1, 0, 1, 2)], axis=0).astype(np.int64)
    chosen = (np.arange(_SECTORS), np.maximum(edge - 1, 0))
    found = counts[chosen] > 0
    angle = 2.0 * np.pi * ((np.arange(_SECTORS) + 0.5) / _SECTORS - 0.5)
    flat = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(normal, first))
    rise = level[chosen] / np.maximum(counts[chosen], 1)
    return (centre_m + (edge * _RING_WIDTH)[:, None] * flat + rise[:, None] * normal)[found]


def _score(
    samples: SurfaceSamples, point: NDArray[np.float64], normal: NDArray[np.float64], near: NDArray[np.int64]
) -> tuple[NDArray[np.float64], float]:
    """Smoothed normal and likeness to a glenoid, 0 to 1, of the surface around one sample."""
    offset, normals = samples.points[near] - point, samples.normals[near]
    close = (np.einsum("ij,ij->i", offset, offset) < 81e-6) & (normals @ normal > 0.5)
    normal = normals[close].sum(axis=0)
    normal /= np.linalg.norm(normal)
    height = offset @ normal
    across = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - height**2, 0.0))
    facing = normals @ normal
    level = (facing > 0.6) & (np.abs(height) < 6e-3)
    covered = samples.area * float((level & (across < _DISC)).sum()) / (np.pi * _DISC**2)
    around = offset[(across > _RING) & (height > -4e-3)]
    free = 1.0 - _share_of_sectors(around, normal)
    behind = height[(facing < 0.0) & (across < 5e-3) & (height < -1.5e-3)]
    thickness = float(-behind.max()) if len(behind) else _REACH
    thick = np.clip((thickness - _THICK[0]) / (_THICK[1] - _THICK[0]), 0.0, 1.0)
    if covered < 0.7 or thick == 0.0:
        return normal, 0.0
    disc = level & (across < 1.3 * _DISC)
    convexity = max(-_curvature(offset[disc], normal), 0.0)
    flat = 1.0 / (1.0 + (convexity / _CONVEX) ** 2)
    return normal, float(min(covered, 1.0) * np.clip(2.5 * free - 1.0, 0.0, 1.0) * thick * flat)


def _share_of_sectors(offset: NDArray[np.float64], normal: NDArray[np.float64]) -> float:
    """Share of 24 directions around `normal` in which any of the points lie."""
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    angle = np.arctan2(offset @ np.cross(normal, first), offset @ first)
    return len(np.unique(np.floor((angle / (2.0 * np.pi) + 0.5) * _SECTORS))) / _SECTORS


def _curvature(offset: NDArray[np.float64], normal: NDArray[np.float64]) -> float:
    """Curvature [1/m] of the paraboloid that fits points about the origin, positive where concave."""
    height = offset @ normal
    across = offset - height[:, None] * normal
    terms = np.column_stack([np.ones(len(offset)), across, 0.5 * np.einsum("ij,ij->i", across, across)])
    return float(np.linalg.lstsq(terms, height, rcond=None)[0][4])
