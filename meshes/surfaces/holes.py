"""Filling of holes in triangle surfaces, and joining of two surfaces whose edges nearly meet."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.simplices import directed_edges
from meshes.surfaces.repair import Triangles, is_manifold, triangle_areas

__all__ = ["Holes", "close_seams", "fill_holes", "open_loops"]


@dataclass(frozen=True)
class Holes:
    """Result of `fill_holes`.

    It holds the number of small and large holes closed, the points of the fans that a plane need
    not fit, and the area of the largest hole.
    """

    filled: int
    large: int
    caps: tuple[Array, ...]
    largest_area: float


def fill_holes(
    vertices: Array,
    faces: Ints,
    largest: float,
    *,
    least_cap: float = np.inf,
) -> tuple[Triangles, Holes]:
    """Close each loop of unmatched edges by a fan of triangles about its mean point.

    A hole that takes more area than `largest` times the surface's counts as large. Its fan is a
    cap. The fan of any other hole is also a cap if it has more area than `least_cap` and more than
    one triangle is missing.
    """
    if is_manifold(faces):
        return (vertices, faces), Holes(0, 0, (), 0.0)
    loops = open_loops(len(vertices), faces)
    points = [vertices]
    triangles = [faces]
    number = len(vertices)
    limit = largest * float(triangle_areas(vertices, faces).sum())
    areas: list[float] = []
    caps = []
    for loop in loops:
        middle = vertices[loop].mean(axis=0)
        spokes = vertices[loop] - middle
        areas.append(
            0.5 * float(np.linalg.norm(np.cross(spokes, np.roll(spokes, -1, axis=0)), axis=1).sum())
        )
        if areas[-1] > limit or (areas[-1] > least_cap and len(loop) > 3):
            caps.append(np.concatenate([vertices[loop], middle[None, :]]))
        if len(loop) > 2:
            points.append(middle[None, :])
            triangles.append(
                np.stack([np.roll(loop, -1), loop, np.full(len(loop), number)], axis=1)
            )
            number += 1
    large = sum(area > limit for area in areas)
    holes = Holes(len(loops) - large, large, tuple(caps), max(areas, default=0.0))
    return (np.concatenate(points), np.concatenate(triangles)), holes


def _unmatched(vertex_count: int, faces: Ints) -> Ints:
    """Return directed edges without their reverse, shape (n, 2).

    An edge is repeated as often as its reverse is missing.
    """
    edges = directed_edges(faces)
    low, high = np.sort(edges, axis=1).T
    keys, where = np.unique(low * vertex_count + high, return_inverse=True)
    surplus = np.bincount(where, weights=np.where(edges[:, 0] < edges[:, 1], 1, -1)).astype(
        np.int64
    )
    pairs = np.stack([keys // vertex_count, keys % vertex_count], axis=1)
    pairs = np.where(surplus[:, None] > 0, pairs, pairs[:, ::-1])
    return np.repeat(pairs, np.abs(surplus), axis=0)


def open_loops(vertex_count: int, faces: Ints) -> list[Ints]:
    """Return loops of unmatched edges that visit no vertex twice.

    The loops run in the direction of their triangles.
    """
    following: dict[int, list[int]] = {}
    for a, b in _unmatched(vertex_count, faces).tolist():
        following.setdefault(a, []).append(b)
    loops = []
    for start in following:
        path: list[int] = [start]
        while following[path[-1]]:
            step = following[path[-1]].pop()
            if step in path:
                begin = path.index(step)
                loops.append(np.array(path[begin:], dtype=np.int64))
                del path[begin + 1 :]
            else:
                path.append(step)
    return loops


def close_seams(
    points: Array, faces: Ints, *, first_part: int, within: float
) -> tuple[Array, Ints]:
    """Join the open loops of two parts by ribbons of triangles, and fill every other open loop.

    Parameters
    ----------
    points
        Vertices, shape (n, 3).
    faces
        Triangles wound outward, shape (m, 3).
    first_part
        Number of vertices that belong to the first part; all others belong to the second.
    within
        Largest mean distance between two loops that belong together.

    Returns
    -------
    Vertices and triangles; added ones come last.
    """
    loops = open_loops(len(points), faces)
    theirs = [loop for loop in loops if loop[0] >= first_part]
    joined = [faces]
    for loop in loops:
        apart = (
            [_apart(points[loop], points[other]) for other in theirs]
            if loop[0] < first_part
            else []
        )
        if apart and min(apart) < within:
            joined.append(_ribbon(points, loop, theirs.pop(int(np.argmin(apart)))))
    return fill_holes(points, np.concatenate(joined), np.inf)[0]


def _apart(points: Array, others: Array) -> float:
    """Compute the mean distance of the points of two loops from each other."""
    from scipy.spatial import cKDTree

    there = cKDTree(others).query(points)[0]
    back = cKDTree(points).query(others)[0]
    return float(max(there.mean(), back.mean()))


def _ribbon(points: Array, loop: Ints, other: Ints) -> Ints:
    """Return triangles between two loops that run in opposite directions.

    Every step takes the shorter diagonal.
    """
    along = other[::-1]
    nearest = int(np.linalg.norm(points[along] - points[loop[0]], axis=1).argmin())
    first = np.append(loop, loop[0])
    second = np.roll(along, -nearest)
    second = np.append(second, second[0])
    i = 0
    j = 0
    triangles = []
    while i < len(loop) or j < len(other):
        forward = (
            np.inf if i == len(loop) else np.linalg.norm(points[first[i + 1]] - points[second[j]])
        )
        aside = (
            np.inf if j == len(other) else np.linalg.norm(points[first[i]] - points[second[j + 1]])
        )
        if forward <= aside:
            triangles.append((first[i + 1], first[i], second[j]))
            i += 1
        else:
            triangles.append((second[j], second[j + 1], first[i]))
            j += 1
    return np.array(triangles, dtype=np.int64)
