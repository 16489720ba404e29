"""Making a triangle surface enclose a solid: merged vertices, one winding, no debris, no holes.

A surface is called closed when every directed edge is matched by its reverse as often as it occurs. That is weaker than
manifold (four triangles may meet in an edge) and exactly what a winding number needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Holes",
    "Triangles",
    "drop_debris",
    "edge_counts",
    "fill_holes",
    "is_manifold",
    "merge_vertices",
    "orient",
    "signed_volume",
    "vertex_bodies",
]

Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Vertices, shape (n, 3), and the vertex numbers of the triangles, shape (m, 3)."""


@dataclass(frozen=True)
class Holes:
    """What `fill_holes` found: holes closed that are small and large, the fans' points of those that a plane need not
    fit, and the area of the largest."""

    filled: int
    large: int
    caps: tuple[NDArray[np.float64], ...]
    largest_area: float


def merge_vertices(vertices: NDArray[Any], faces: NDArray[np.int64], tolerance: float) -> Triangles:
    """Join vertices on one point of a lattice of pitch `tolerance`; drop triangles that collapse, repeat or cancel."""
    keys = _lattice_keys(vertices, tolerance)
    _, first, where = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces = where.reshape(-1)[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    if not is_manifold(faces):
        faces = faces[_distinct(faces)]
    return _compact(vertices[first].astype(np.float64), faces)


def _lattice_keys(vertices: NDArray[Any], tolerance: float) -> NDArray[np.int64]:
    """The point of a lattice that each vertex is nearest to: one number, or three where one would overflow."""
    keys = np.round((vertices - vertices.min(axis=0)) / tolerance).astype(np.int64)
    high = keys.max(axis=0) + 1
    if float(high[0]) * float(high[1]) * float(high[2]) < 2.0**63:
        keys = (keys[:, 0] * high[1] + keys[:, 1]) * high[2] + keys[:, 2]  # sorts as rows do, twenty times as quick
    return keys


def is_manifold(faces: NDArray[np.int64]) -> bool:
    """Whether every directed edge is there once, and its reverse: closed, of one winding, two triangles an edge."""
    if len(faces) == 0:
        return False
    count = int(faces.max()) + 1
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edges = np.sort(start * count + end)
    if (edges[1:] == edges[:-1]).any():
        return False
    return bool(np.array_equal(edges, np.sort(end * count + start)))


def drop_debris(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], least_area: float
) -> tuple[Triangles, list[float]]:
    """Drop bodies whose area is below `least_area` times the largest body's.

    Returns
    -------
    What is left, and the longest bounding-box side of each body dropped.
    """
    body = _bodies(len(vertices), faces)
    areas = np.bincount(body, weights=_areas(vertices, faces))
    small = np.flatnonzero(areas < least_area * areas.max())
    sizes = [float(np.ptp(vertices[faces[body == k].ravel()], axis=0).max()) for k in small]
    return _compact(vertices, faces[~np.isin(body, small)]), sizes


def orient(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], int, int]:
    """Give all triangles of a body one winding, outward.

    Each triangle is a node twice, as it is and turned; neighbours across an edge of two triangles are linked in the
    states that agree. A component of that graph is a consistent choice. A body with negative volume is turned, unless
    it lies within the box of another body, where it is a cavity.

    Returns
    -------
    Triangles, shape (m, 3); how many were turned to agree with their neighbours; how many bodies were inside out.
    """
    faces = faces.copy()
    turned = np.zeros(len(faces), dtype=bool) if is_manifold(faces) else _disagreeing(faces)
    faces[turned] = faces[turned][:, ::-1]
    body = _bodies(len(vertices), faces)
    count = int(body.max()) + 1
    volumes = np.bincount(body, weights=_volumes(vertices, faces), minlength=count)
    if volumes.sum() < 0.0:
        volumes, inside_out, faces = -volumes, count, faces[:, ::-1].copy()
    else:
        inside_out = 0
    boxes = [_box(vertices, faces[body == k]) for k in range(count)] if count > 1 else []
    for k in np.flatnonzero(volumes < 0.0) if count > 1 else ():
        low, high = boxes[k]
        within = any(
            (boxes[j][0] <= low).all() and (boxes[j][1] >= high).all() for j in range(count) if volumes[j] > 0.0
        )
        if not within:
            faces[body == k] = faces[body == k][:, ::-1]
            inside_out += 1
    return faces, int(turned.sum()), inside_out


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
    limit, areas, caps = largest * float(_areas(vertices, faces).sum()), [], []
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


def edge_counts(faces: NDArray[np.int64]) -> tuple[int, int]:
    """Edges that one triangle uses (open) and that more than two use (non-manifold)."""
    if is_manifold(faces):
        return 0, 0
    _, uses = np.unique(_edge_keys(_directed(faces)), return_counts=True)
    return int((uses == 1).sum()), int((uses > 2).sum())


def signed_volume(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> float:
    """Volume by the divergence theorem, positive for outward winding, in cubed units of the vertices."""
    return float(_volumes(vertices, faces).sum())


def _distinct(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of the triangles to keep: one of several alike, none of a pair with opposite winding."""
    _, first, where = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_inverse=True)
    where = where.reshape(-1)
    a, b, c = faces.T
    winding = np.sign(b - a) * np.sign(c - b) * np.sign(a - c)
    net = np.bincount(where, weights=winding)
    wanted = np.sign(net)[where] == winding
    kept = np.full(len(first), len(faces))
    np.minimum.at(kept, where[wanted], np.flatnonzero(wanted))
    return np.sort(kept[net != 0])


def _disagreeing(faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Triangles to turn so that neighbours agree, the fewer of the two choices in each piece; none if no choice is."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(faces)
    edges = _directed(faces)
    _, where, uses = np.unique(_edge_keys(edges), return_inverse=True, return_counts=True)
    order = np.argsort(where.reshape(-1), kind="stable")
    order = order[uses[where.reshape(-1)[order]] == 2].reshape(-1, 2)
    f, g = order.T % count
    crossed = np.where((edges[order[:, 0]] == edges[order[:, 1]]).all(axis=1), count, 0)
    rows = np.concatenate([f, f + count])
    columns = np.concatenate([g + crossed, g + count - crossed])
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    _, label = connected_components(graph, directed=False)
    as_is, reverse = label[:count], label[count:]
    votes = np.bincount(as_is, minlength=label.max() + 1)
    tied = (votes[as_is] == votes[reverse]) & (as_is > reverse)
    return (as_is != reverse) & ((votes[as_is] < votes[reverse]) | tied)


def _unmatched(vertex_count: int, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Directed edges without their reverse, repeated as often as it is missing, shape (n, 2)."""
    edges = _directed(faces)
    low, high = np.sort(edges, axis=1).T
    keys, where = np.unique(low * vertex_count + high, return_inverse=True)
    surplus = np.bincount(where.reshape(-1), weights=np.where(edges[:, 0] < edges[:, 1], 1, -1)).astype(np.int64)
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


def _directed(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _edge_keys(edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number for each edge, whatever its direction, that sorts as its vertices do, shape (n,)."""
    return edges.min(axis=1) * (int(edges.max()) + 1) + edges.max(axis=1)


def vertex_bodies(vertices: NDArray[Any], faces: NDArray[np.int64], tolerance: float) -> NDArray[np.int64]:
    """Number of the connected body of each vertex, where vertices within `tolerance` are one, shape (n,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    where = np.unique(_lattice_keys(vertices, tolerance), axis=0, return_inverse=True)[1].reshape(-1)
    a, b, c = where[faces].T
    rows, columns = np.concatenate([a, b]), np.concatenate([b, c])
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(int(where.max()) + 1,) * 2)
    return np.asarray(connected_components(graph, directed=False)[1][where], dtype=np.int64)


def _bodies(vertex_count: int, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the connected body of each triangle, shape (m,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = _directed(faces)
    graph = coo_array((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(vertex_count,) * 2)
    _, label = connected_components(graph, directed=False)
    _, body = np.unique(label[faces[:, 0]], return_inverse=True)
    return body.reshape(-1)


def _areas(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _volumes(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = (vertices[faces[:, k]] - vertices[0] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0


def _box(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = vertices[faces.ravel()]
    return points.min(axis=0), points.max(axis=0)


def _compact(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Triangles:
    """Drop vertices that no triangle uses."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    if used.all():
        return vertices, faces
    return vertices[used], (np.cumsum(used) - 1)[faces]
