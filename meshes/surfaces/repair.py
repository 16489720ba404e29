"""Repair of a triangle surface so that it encloses a solid.

Vertices are merged, triangles are oriented consistently, and debris (small separate pieces) is
removed.

A surface is called closed if every directed edge occurs as often as the reversed edge. This
condition is weaker than the condition for a manifold, because it allows four triangles at an edge.
It is sufficient, because winding numbers are then defined.
"""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import (
    Array,
    Flags,
    Ints,
    Triangles,
    compact,
    cross_products,
    directed_edges,
    windings,
)


def merge_vertices(vertices: Array, faces: Ints, tolerance: float) -> Triangles:
    """Merge vertices whose coordinates are equal after rounding to multiples of `tolerance`.

    Unused vertices, degenerate triangles, duplicate triangles and pairs of opposite triangles are
    removed.
    """
    vertices, faces = compact(vertices, faces)
    keys = _lattice_keys(vertices, tolerance)
    _, first, where = np.unique(keys, return_index=True, return_inverse=True)
    faces = where[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    if not is_manifold(faces):
        faces = faces[_distinct(faces)]
    return compact(vertices[first], faces)


def _lattice_keys(vertices: Array, tolerance: float) -> Ints:
    """Compute an integer key of the lattice point nearest to each vertex, shape (n,).

    The order of the keys is the lexicographic order of the rounded coordinates.
    """
    keys = np.zeros(len(vertices), dtype=np.int64)
    for column in vertices.T:
        step = np.rint((column - column.min()) / tolerance).astype(np.int64)
        count = int(step.max()) + 1
        # The product would overflow 64 bits. After renumbering, there is at most one key per
        # vertex.
        if (int(keys.max()) + 1) * count >= 2**63:
            keys = np.unique(keys, return_inverse=True)[1]
        keys = keys * count + step
    return keys


def is_manifold(faces: Ints) -> bool:
    """Return whether every directed edge and its reverse occur exactly once.

    If the result is True, the surface is closed and consistently oriented, and every edge belongs
    to two triangles.
    """
    if len(faces) == 0:
        return False
    count = int(faces.max()) + 1
    start = faces.ravel()
    end = np.roll(faces, -1, axis=1).ravel()
    upward = start < end
    edges = np.sort(start[upward] * count + end[upward])
    if (edges[1:] == edges[:-1]).any():
        return False
    downward = ~upward
    return np.array_equal(edges, np.sort(end[downward] * count + start[downward]))


def drop_debris(vertices: Array, faces: Ints, least_area: float) -> tuple[Triangles, list[float]]:
    """Remove each connected body whose area is small compared with the largest body's area.

    Returns
    -------
    Remaining surface, and the longest bounding-box side of each removed body. A body is removed if
    its area is less than `least_area` times the largest area.
    """
    body = _bodies(len(vertices), faces)
    areas = np.bincount(body, weights=triangle_areas(vertices, faces))
    small = np.flatnonzero(areas < least_area * areas.max())
    sizes = [float(np.ptp(vertices[faces[body == k].ravel()], axis=0).max()) for k in small]
    return compact(vertices, faces[~np.isin(body, small)]), sizes


def orient(vertices: Array, faces: Ints) -> tuple[Ints, int, int, float]:
    """Orient all triangles of each body outward.

    The function uses a graph with two nodes per triangle, one for the given and one for the
    reversed winding. If two triangles share an edge, the graph connects each node of one triangle
    to the node of the other triangle with the matching winding. Each connected component of the
    graph is a consistent orientation of a set of triangles. If the total volume is negative, the
    whole surface is reversed. Then, each body whose volume is still negative is reversed. A body
    within the bounding box of another body is not reversed, because it may be a cavity.

    Returns
    -------
    Four values: the triangles, shape (m, 3); the number of triangles reversed to agree with their
    neighbours; the number of bodies that were inside out; and the enclosed volume in the cubed unit
    of the vertices.
    """
    faces = faces.copy()
    turned = np.zeros(len(faces), dtype=bool) if is_manifold(faces) else _disagreeing(faces)
    faces[turned] = faces[turned][:, ::-1]
    body = _bodies(len(vertices), faces)
    count = int(body.max()) + 1
    corners = vertices - vertices[0]
    heights = (corners[faces[:, 0]] * cross_products(corners, faces)).sum(axis=1)
    # Sum of tetrahedra between the first vertex and each triangle, a sixth of the triple product.
    volumes = np.bincount(body, weights=heights, minlength=count) / 6.0
    inside_out = 0
    # Most of the volume has inward normals, so reverse the whole surface. Cavities keep the
    # opposite orientation.
    if volumes.sum() < 0.0:
        volumes = -volumes
        inside_out = count
        faces = faces[:, ::-1].copy()
    boxes = [vertices[faces[body == k].ravel()] for k in range(count)]
    low = np.array([box.min(axis=0) for box in boxes])
    high = np.array([box.max(axis=0) for box in boxes])
    for k in np.flatnonzero(volumes < 0.0):
        if not ((low <= low[k]) & (high >= high[k])).all(axis=1)[volumes > 0.0].any():
            faces[body == k] = faces[body == k][:, ::-1]
            volumes[k] = -volumes[k]
            inside_out += 1
    return faces, int(turned.sum()), inside_out, float(volumes.sum())


def edge_counts(faces: Ints) -> tuple[int, int]:
    """Count the open edges (one triangle) and the non-manifold edges (more than two triangles)."""
    if is_manifold(faces):
        return 0, 0
    _, uses = np.unique(_edge_keys(directed_edges(faces)), return_counts=True)
    return int((uses == 1).sum()), int((uses > 2).sum())


def _distinct(faces: Ints) -> Ints:
    """Return the indices of the triangles to keep.

    Of several equal triangles, one is kept. Two triangles with the same vertices and opposite
    windings are both removed.
    """
    _, first, where = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_inverse=True
    )
    winding = windings(faces)
    net = np.bincount(where, weights=winding)
    wanted = np.sign(net)[where] == winding
    kept = np.full(len(first), len(faces))
    np.minimum.at(kept, where[wanted], np.flatnonzero(wanted))
    return np.sort(kept[net != 0])


def _disagreeing(faces: Ints) -> Flags:
    """Return flags of the triangles that must be reversed so that neighbours agree in winding.

    For each connected piece, there are two solutions. The solution with fewer reversed triangles is
    used. In a piece without a solution, no triangle is reversed.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(faces)
    edges = directed_edges(faces)
    _, where, uses = np.unique(_edge_keys(edges), return_inverse=True, return_counts=True)
    order = np.argsort(where, kind="stable")
    order = order[uses[where[order]] == 2].reshape(-1, 2)
    f, g = order.T % count
    crossed = np.where((edges[order[:, 0]] == edges[order[:, 1]]).all(axis=1), count, 0)
    rows = np.concatenate([f, f + count])
    columns = np.concatenate([g + crossed, g + count - crossed])
    graph = coo_array(
        (np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * count, 2 * count)
    )
    _, label = connected_components(graph, directed=False)
    as_is, reverse = np.split(label, 2)
    votes = np.bincount(as_is, minlength=label.max() + 1)
    tied = (votes[as_is] == votes[reverse]) & (as_is > reverse)
    return (as_is != reverse) & ((votes[as_is] < votes[reverse]) | tied)


def _edge_keys(edges: Ints) -> Ints:
    """Compute a key, shape (n,), for each edge. The key does not depend on the edge's direction.

    The order of the keys is the lexicographic order of the edges' sorted vertex indices.
    """
    return edges.min(axis=1) * (int(edges.max()) + 1) + edges.max(axis=1)


def _bodies(vertex_count: int, faces: Ints) -> Ints:
    """Return the index of the connected body that each triangle belongs to, shape (m,)."""
    from trimesh.graph import connected_component_labels

    label = connected_component_labels(
        np.concatenate([faces[:, :2], faces[:, 1:]]), node_count=vertex_count
    )
    return np.unique(label[faces[:, 0]], return_inverse=True)[1]


def triangle_areas(vertices: Array, faces: Ints) -> Array:
    """Compute the area of each triangle, shape (m,), in squared units of the vertices."""
    return np.asarray(0.5 * np.linalg.norm(cross_products(vertices, faces), axis=1))


@dataclass(frozen=True)
class Holes:
    """Result of `fill_holes`.

    The attributes are the number of closed small holes, the number of closed large holes, the
    points of each cap, and the area of the largest hole. A cap is a reported face that closes a
    hole.
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
    """Close each loop of open edges by a fan of triangles around the mean point of the loop.

    A hole is large if its area is more than `largest` times the area of the surface. The points of
    some fans, called caps, are returned. The fan of a large hole is a cap. The fan of a small hole
    is a cap if the fan's area is more than `least_cap` and the hole has more than three edges.
    """
    if is_manifold(faces):
        return (vertices, faces), Holes(0, 0, (), 0.0)
    loops = open_loops(faces)
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
        # A loop of two edges encloses nothing.
        if len(loop) > 2:
            points.append(middle[None, :])
            triangles.append(
                np.stack([np.roll(loop, -1), loop, np.full(len(loop), number)], axis=1)
            )
            number += 1
    large = sum(area > limit for area in areas)
    holes = Holes(len(loops) - large, large, tuple(caps), max(areas, default=0.0))
    return (np.concatenate(points), np.concatenate(triangles)), holes


def open_loops(faces: Ints) -> list[Ints]:
    """Return loops of the directed edges whose reversed edges are missing in the triangles.

    A loop contains each vertex only once. Each edge of a loop has the direction that it has in the
    adjacent triangle. If the reversed edge is missing k times, the edge is used in k loops.
    """
    edges = directed_edges(faces)
    keys, where = np.unique(_edge_keys(edges), return_inverse=True)
    upward = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    surplus = np.bincount(where, weights=upward).astype(np.int64)
    pairs = np.stack(np.divmod(keys, int(edges.max()) + 1), axis=1)
    pairs = np.where(surplus[:, None] > 0, pairs, pairs[:, ::-1])
    following: dict[int, list[int]] = {}
    for a, b in np.repeat(pairs, np.abs(surplus), axis=0).tolist():
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
    """Connect open loops of two parts by ribbons of triangles, and fill all other open loops.

    Parameters
    ----------
    points
        Vertices, shape (n, 3).
    faces
        Triangles with outward normals, shape (m, 3).
    first_part
        Number of vertices of the first part. All other vertices belong to the second part.
    within
        Largest allowed mean distance between two loops that are connected by a ribbon.

    Returns
    -------
    Vertices, shape (n, 3), and triangles, shape (m, 3). Added vertices and triangles are at the end
    of the arrays.
    """
    loops = open_loops(faces)
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
    """Compute the mean distance between the points of two loops."""
    from scipy.spatial import cKDTree

    there = cKDTree(others).query(points)[0]
    back = cKDTree(points).query(others)[0]
    return float(max(there.mean(), back.mean()))


def _ribbon(points: Array, loop: Ints, other: Ints) -> Ints:
    """Return triangles between two loops that run in opposite directions.

    Each step adds one triangle, which advances along one of the two loops. The step chooses the
    loop for which the new edge is shorter.
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
