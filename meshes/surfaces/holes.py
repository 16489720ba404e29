"""Closing the holes of a triangle surface by fans of triangles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.simplices import directed_edges
from meshes.surfaces.repair import Triangles, is_manifold, triangle_areas

__all__ = ["Holes", "fill_holes"]


@dataclass(frozen=True)
class Holes:
    """What `fill_holes` found: holes closed that are small and large, the fans' points of those that a plane need not
    fit, and the area of the largest."""

    filled: int
    large: int
    caps: tuple[NDArray[np.float64], ...]
    largest_area: float


def fill_holes(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], largest: float, *, least_cap: float = np.inf
) -> tuple[Triangles, Holes]:
    """Close each loop of unmatched edges by a fan of triangles about its mean point.

    A hole that takes more area than `largest` times the surface's counts as large. Its fan is a cap, as is one of more
    area than `least_cap` over more than a missing triangle, whatever its share of the surface.
    """
    if is_manifold(faces):
        return (vertices, faces), Holes(0, 0, (), 0.0)
    loops = _loops(_unmatched(len(vertices), faces))
    points, triangles, number = [vertices], [faces], len(vertices)
    limit, areas, caps = largest * float(triangle_areas(vertices, faces).sum()), [], []
    for loop in loops:
        middle = vertices[loop].mean(axis=0)
        spokes = vertices[loop] - middle
        areas.append(0.5 * float(np.linalg.norm(np.cross(spokes, np.roll(spokes, -1, axis=0)), axis=1).sum()))
        if areas[-1] > limit or (areas[-1] > least_cap and len(loop) > 3):
            caps.append(np.concatenate([vertices[loop], middle[None, :]]))
        if len(loop) > 2:
            points.append(middle[None, :])
            triangles.append(np.stack([np.roll(loop, -1), loop, np.full(len(loop), number)], axis=1))
            number += 1
    large = sum(area > limit for area in areas)
    holes = Holes(len(loops) - large, large, tuple(caps), max(areas, default=0.0))
    return (np.concatenate(points), np.concatenate(triangles)), holes


def _unmatched(vertex_count: int, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Directed edges without their reverse, repeated as often as it is missing, shape (n, 2)."""
    edges = directed_edges(faces)
    low, high = np.sort(edges, axis=1).T
    keys, where = np.unique(low * vertex_count + high, return_inverse=True)
    surplus = np.bincount(where, weights=np.where(edges[:, 0] < edges[:, 1], 1, -1)).astype(np.int64)
    pairs = np.stack([keys // vertex_count, keys % vertex_count], axis=1)
    pairs = np.where(surplus[:, None] > 0, pairs, pairs[:, ::-1])
    return np.repeat(pairs, np.abs(surplus), axis=0)


def _loops(edges: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Split balanced directed edges into loops that visit no vertex twice."""
    following: dict[int, list[int]] = {}
    for a, b in edges.tolist():
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
