"""Tetrahedral meshes of solids given by signed distances, made from a body-centred cubic lattice.

The method is isosurface stuffing (Labelle and Shewchuk, 2007). The surface crosses edges of the
lattice. A node close to such a crossing is moved onto the crossing. All other crossed edges are cut
at the crossing, and the resulting pieces of cells are filled with tetrahedra. Quadrilateral faces
between pieces are divided from the node with the lowest number (Dompierre et al., 1999), so
neighbouring cells conform. If the pieces on both sides of a surface are kept, the pieces inside the
surface become a separate part of the mesh.

Refinement bisects tetrahedra at their longest edges. If an edge is the longest edge of every
tetrahedron around it, the edge and these tetrahedra are bisected. The mesh therefore remains
conforming. If a tetrahedron has an edge to bisect but also a longer edge, the longer edge is
bisected first (Rivara 1997, Int. J. Numer. Methods Eng. 40:3313). The quality of the tetrahedra
remains bounded. By default, refinement does not change the shape of the mesh, so the distance
between the mesh and the true surface is not reduced. To reduce this distance, the surface nodes can
be moved onto the true surface. For example, without moves, a flat triangle of 20 mm remains up to
0.8 mm below a surface with a radius of 60 mm.
"""

import math
from collections.abc import Callable

import numpy as np

from meshes.base.arrays import Array, Flags, Floats, Ints, compact, lattice
from meshes.base.errors import InputError, require_length
from meshes.shapes.sdf import Shape
from meshes.surfaces.repair import triangle_areas
from meshes.tets.tetrahedra import EDGES, TetMesh, mean_ratio, outer_faces, signed_volumes
from meshes.voxels.mesh_sampling import triangle_distance

Move = Callable[[Array], Array]
"""Function that moves points: from positions [m], shape (n, 3), to new positions [m]."""
_MOST_BISECTED = 5_000_000
"""Largest number of tetrahedra after refinement.

For this number, the array of edges takes 0.5 GB, and sorting it takes several times as much memory.
"""
_LEAST_VOLUME = 0.5
"""Smallest accepted volume of a tetrahedron after a move of a node, relative to the volume before.

If the volume would become smaller, the node is not moved.
"""


def bisected(
    mesh: TetMesh,
    size_m: Callable[[Array], Array],
    *,
    onto: Move | None = None,
) -> TetMesh:
    """Refine a mesh until no edge is longer than the length allowed at the edge's middle.

    Nodes of the given mesh keep their numbers.

    Parameters
    ----------
    mesh
        Mesh to refine.
    size_m
        Function that takes points [m], shape (n, 3), and returns the largest allowed edge length
        there [m], shape (n,).
    onto
        Function that moves points onto the exact surface that the mesh approximates. All surface
        nodes are moved by this function. If None, the surface does not change shape.

    Raises
    ------
    InputError
        If a required edge is not positive, or the mesh would have more than five million
        tetrahedra.
    """
    nodes = mesh.nodes_m
    cells = mesh.cells
    part = mesh.part
    if onto is not None:
        nodes = _moved(nodes, cells, mesh.surface_nodes, onto)
    while True:
        ends = np.sort(cells[:, EDGES], axis=2)
        keys, edge = np.unique(ends.reshape(-1, 2) @ np.array([len(nodes), 1]), return_inverse=True)
        a = keys // len(nodes)
        b = keys % len(nodes)
        middle = 0.5 * (nodes[a] + nodes[b])
        length = np.linalg.norm(nodes[a] - nodes[b], axis=1)
        wanted = size_m(middle)
        if not (wanted > 0.0).all():
            raise InputError(
                "size_m",
                "be positive everywhere",
                f"{1e3 * wanted.min():.4g} mm",
                "use about a hundredth of the body's length",
            )
        rank = np.empty(len(keys), dtype=np.int64)
        # Ties are decided by node numbers, with the same result in every tetrahedron. Lengths that
        # are equal to 12 digits count as ties.
        rank[np.lexsort((keys, np.round(length / length.max(), 12)))] = np.arange(len(keys))
        edge = edge.reshape(-1, 6)
        place = rank[edge].argmax(axis=1)
        longest = np.take_along_axis(edge, place[:, None], axis=1)[:, 0]
        around = np.bincount(edge.ravel(), minlength=len(keys))
        marked = length > wanted
        while True:  # longer edges of the same tetrahedra are bisected first
            waiting = np.zeros(len(keys), dtype=bool)
            waiting[longest[marked[edge].any(axis=1)]] = True
            if not (waiting & ~marked).any():
                break
            marked |= waiting
        split = (np.bincount(longest, minlength=len(keys)) == around) & marked
        halved = np.flatnonzero(split[longest])
        if len(halved) == 0:
            return TetMesh(nodes, cells, part, mesh.part_names)
        if len(cells) + len(halved) > _MOST_BISECTED:
            raise InputError(
                "size_m",
                f"give at most {_MOST_BISECTED} tetrahedra",
                f"edges of {1e3 * wanted.min():.4g} mm",
                "use longer edges",
            )
        number = len(nodes) + np.cumsum(split) - 1
        nodes = np.concatenate([nodes, middle[split]])
        cells = np.concatenate([cells, cells[halved]])
        part = np.concatenate([part, part[halved]])
        first, second = EDGES[place[halved]].T
        copies = np.arange(len(cells) - len(halved), len(cells))
        cells[halved, second] = cells[copies, first] = number[longest[halved]]
        if onto is not None:
            outside = np.unique(outer_faces(cells))
            nodes = _moved(nodes, cells, outside[outside >= len(nodes) - split.sum()], onto)


def _moved(nodes: Array, cells: Ints, chosen: Ints, onto: Move) -> Array:
    """Move the chosen nodes by the function `onto`, which returns points on a surface.

    A node is not moved if the move would flatten a tetrahedron.
    """
    moved = nodes.copy()
    before = signed_volumes(nodes, cells)
    moved[chosen] = onto(nodes[chosen])
    while (flat := signed_volumes(moved, cells) < _LEAST_VOLUME * before).any():
        back = np.unique(cells[flat])
        moved[back] = nodes[back]
    return moved


Distance = Callable[[Array], Floats]
Cells = Ints
Points = Array
_SNAP = 0.3
"""Largest distance from a node to a crossing at which the node is moved, relative to the edge.

A crossing is the point where the surface crosses an edge. With the value 0.3, the worst mean ratios
in meshes of a ball, the liver and a box are 0.41, 0.24 and 0.79. With 0.2, the worst mean ratios
are 0.28, 0.24 and 0.79. With 0.4, they are 0.47, 0.16 and 0.27.
"""
_LEAST_QUALITY = 0.15
"""Smallest accepted mean ratio (quality measure) of a cell after nodes are moved.

For values from 0.1 to 0.2, test meshes of a ball, the liver and a box are the same. With 0.05, the
worst mean ratio in the liver mesh is 0.08.
"""
_STEPS = 6
"""Number of steps in the search for the point where the surface crosses an edge.

For test meshes of a ball, the liver and a box, the error of this point is at most 0.04 um. With 4
steps, the error is at most 0.7 um.
"""
_MOST_CELLS = 20_000_000
"""Largest number of lattice cells. This number of cells takes 0.6 GB."""
EDGE_GROWTH = 0.5
"""Increase of the edge length per distance from a fine region, equal to the scenes' default."""
_EDGES = 3.0
"""Number of tetrahedron edges across an inclusion that is a ball.

The edge length is computed from the ratio of volume to area, see `with_inclusion`. A tube therefore
gets two edges across. Two are enough for elements with quadratic edges, which follow a curved
surface.
"""
_TRIES = 4
_CLOSE = 0.01
"""Number of meshes that are tried for an inclusion (`_TRIES`), and accepted volume error.

The error is relative to the inclusion's volume. Of the meshes within this error, the mesh whose
worst cell has the best quality is used. If no mesh is within the error, the mesh with the smallest
error is used.
"""


def stuffed(shape: Shape, spacing_m: float) -> TetMesh:
    """Fill a bounded shape with tetrahedra of even size.

    Parameters
    ----------
    shape
        Solid with finite bounds. Details smaller than the spacing are lost.
    spacing_m
        Side [m] of the cubes of the lattice. There are twelve tetrahedra per cube. The edges of a
        tetrahedron are 0.87 or 1 times as long as the side.

    Raises
    ------
    InputError
        If the shape is unbounded, or if the spacing leads to no tetrahedra or to too many
        tetrahedra.
    """
    longest = max(np.subtract(shape.upper_m, shape.lower_m))
    # Twenty cubes along the body. An unbounded body raises an error below.
    advised = longest / 20.0 if math.isfinite(longest) else 1e-3
    spacing = require_length("spacing_m", spacing_m, 0.0, math.inf, advised)
    lower = np.array(shape.lower_m)
    upper = np.array(shape.upper_m)
    if not (np.isfinite(lower).all() and np.isfinite(upper).all()):
        raise InputError(
            "shape",
            "be bounded in every direction",
            "an unbounded shape",
            "intersect the shape with a box",
        )
    if 12.0 * np.prod((upper - lower) / spacing + 2.0) > _MOST_CELLS:
        # Twelve tetrahedra per cube, plus a tenth for the cubes around the body.
        possible = 1.1 * float(12.0 * np.prod(upper - lower) / _MOST_CELLS) ** (1.0 / 3.0)
        raise InputError(
            "spacing_m",
            f"give at most {_MOST_CELLS} tetrahedra",
            f"{1e3 * spacing:.4g} mm",
            f"use {1e3 * possible:.2g} mm or more",
        )
    # The factor of 1.01 moves nodes away from flat faces at multiples of the side, because
    # otherwise rounding errors would decide on which side the nodes lie. With 1 and 1.01, boxes
    # have the same number of cells and a worst mean ratio of 0.8.
    nodes, cells = _lattice(lower - 1.01 * spacing, upper + spacing, spacing)
    # All nodes of a cell that the surface crosses are within one edge of the surface, at most a
    # cube's side.
    near = shape.distance(nodes) < 1.5 * spacing
    nodes, cells = compact(nodes, cells[near[cells].all(axis=1)])
    nodes, cells, within, _ = cut_by(nodes, cells, shape.distance)
    if not within.any():
        raise InputError(
            "spacing_m",
            "be below the size of the shape",
            f"{1e3 * spacing:.4g} mm",
            f"use {1e3 * advised:.2g} mm or less",
        )
    return TetMesh(*compact(nodes, cells[within]))


def with_part(mesh: TetMesh, shape: Shape, name: str) -> TetMesh:
    """Make the cells inside a shape a new part of the mesh.

    Only cells of the mesh's first part are changed. Cells are cut at the shape's surface, so that
    cell faces on this surface bound the new part.

    Raises
    ------
    InputError
        If no cell is inside the shape, because the shape lies outside the mesh or is smaller than
        the cells.
    """
    nodes, cells, within, came = cut_by(mesh.nodes_m, mesh.cells, shape.distance)
    within &= mesh.part[came] == 0
    if not within.any():
        raise InputError(
            name,
            "contain cells of the mesh",
            "none",
            "use a finer mesh, or move the shape into the mesh",
        )
    part = np.where(within, len(mesh.part_names), mesh.part[came]).astype(np.uint8)
    return TetMesh(nodes, cells, part, (*mesh.part_names, name))


def cut_by(nodes: Points, cells: Cells, distance: Distance) -> tuple[Points, Cells, Flags, Cells]:
    """Cut tetrahedra along the zero level of a signed distance, and keep the pieces on both sides.

    Returns
    -------
    Nodes, shape (n, 3); cells, shape (m, 4); whether each cell is on the negative side, shape (m,);
    index of the original cell from which each cell was cut, shape (m,).
    """
    value = np.asarray(distance(nodes), dtype=np.float64)
    nodes, value = _snapped(nodes, cells, value, distance)
    side = np.sign(value).astype(np.int64)
    crossed, pairs = _crossed_edges(cells, side)
    whole = cells[~crossed]
    number = {(int(a), int(b)): len(nodes) + k for k, (a, b) in enumerate(pairs)}
    pieces = [
        [*tet, sign, k]
        for k in np.flatnonzero(crossed)
        for sign in (-1, 1)
        for tet in _filled(cells[k], side[cells[k]] * sign, number)
    ]
    made = np.array(pieces, dtype=np.int64).reshape(-1, 6)
    all_nodes = np.concatenate([nodes, _crossings(nodes, value, pairs, distance)])
    # If all corners of a cell lie on the surface, the sign at its centre decides.
    level = side[whole].sum(axis=1).astype(np.float64)
    level[level == 0.0] = distance(nodes[whole[level == 0.0]].mean(axis=1))
    within = np.concatenate([level < 0.0, made[:, 4] < 0])
    came = np.concatenate([np.flatnonzero(~crossed), made[:, 5]])
    return all_nodes, np.concatenate([whole, _turned(all_nodes, made[:, :4])]), within, came


def _crossed_edges(cells: Cells, side: Cells) -> tuple[Flags, Cells]:
    """Return flags of the cells with nodes on both sides of the surface, and the crossed edges.

    The edges, shape (k, 2), are listed once each.
    """
    crossed = (side[cells].min(axis=1) < 0) & (side[cells].max(axis=1) > 0)
    pairs = np.unique(np.sort(cells[crossed][:, EDGES].reshape(-1, 2), axis=1), axis=0)
    return crossed, pairs[side[pairs].prod(axis=1) < 0]


def _turned(nodes: Points, cells: Cells) -> Cells:
    """Reverse the orientation of cells with negative volume."""
    return np.where((signed_volumes(nodes, cells) < 0.0)[:, None], cells[:, [0, 2, 1, 3]], cells)


def _filled(corners: Cells, side: Cells, number: dict[tuple[int, int], int]) -> list[list[int]]:
    """Return tetrahedra that fill the part of a cell in which `side` is not negative.

    `side` must be positive at one corner of the cell at least.
    """
    plus, zero, minus = (corners[side == sign].tolist() for sign in (1, 0, -1))

    def at(a: int, b: int) -> int:
        return number[(a, b) if a < b else (b, a)]

    # If one corner is on this side, the piece is a tetrahedron. The rest of the cell is a prism or
    # pyramid.
    if len(plus) == 1:
        return [[plus[0], *zero, *(at(plus[0], m) for m in minus)]]
    if len(plus) == 2 and len(minus) == 2:
        return _prism(
            [plus[0], at(plus[0], minus[0]), at(plus[0], minus[1])],
            [plus[1], at(plus[1], minus[0]), at(plus[1], minus[1])],
        )
    if len(plus) == 3:
        return _prism(plus, [at(p, minus[0]) for p in plus])
    # Two corners are on this side, one is on the surface and one on the other side. The piece is a
    # pyramid, which is halved like the faces of prisms.
    p, q = plus
    cp = at(p, minus[0])
    cq = at(q, minus[0])
    if min(p, cq) < min(q, cp):
        return [[p, q, cq, zero[0]], [p, cq, cp, zero[0]]]
    return [[q, cq, cp, zero[0]], [q, cp, p, zero[0]]]


def _prism(bottom: list[int], top: list[int]) -> list[list[int]]:
    """Divide a prism into three tetrahedra.

    Every quadrilateral face is divided by the diagonal through the face's lowest node number.
    """
    if min(top) < min(bottom):
        bottom, top = top, bottom
    k = bottom.index(min(bottom))
    a, b, c = bottom[k:] + bottom[:k]
    d, e, f = top[k:] + top[:k]
    if min(b, f) < min(c, e):
        return [[a, d, e, f], [a, b, c, f], [a, b, f, e]]
    return [[a, d, e, f], [a, b, c, e], [a, c, f, e]]


def _snapped(nodes: Points, cells: Cells, value: Array, distance: Distance) -> tuple[Points, Array]:
    """Move nodes near the surface onto the nearest crossing if all cells keep enough quality.

    A node is near if its distance from the crossing is less than `_SNAP` times the length of the
    crossed edge.
    """
    _, pairs = _crossed_edges(cells, np.sign(value).astype(np.int64))
    node = pairs.T.ravel()
    point = np.tile(_crossings(nodes, value, pairs, distance), (2, 1))
    length = np.tile(np.linalg.norm(nodes[pairs[:, 1]] - nodes[pairs[:, 0]], axis=1), 2)
    away = np.linalg.norm(point - nodes[node], axis=1)
    nearest = np.argsort(away, kind="stable")
    nearest = nearest[(away < _SNAP * length)[nearest]]
    chosen, first = np.unique(node[nearest], return_index=True)
    moved = nodes.copy()
    value = value.copy()
    moved[chosen] = point[nearest[first]]
    # If several moves together spoil a cell, the longest move is undone, because a node that
    # remains near the surface causes slivers.
    moved_by = np.linalg.norm(moved - nodes, axis=1)
    touched = cells[np.isin(cells, chosen).any(axis=1)]
    while len(spoiled := touched[mean_ratio(moved, touched) < _LEAST_QUALITY]):
        far = np.take_along_axis(spoiled, moved_by[spoiled].argmax(axis=1)[:, None], axis=1)[:, 0]
        back = far[moved_by[far] > 0.0]
        if len(back) == 0:
            break
        moved[back] = nodes[back]
        moved_by[back] = 0.0
        chosen = np.setdiff1d(chosen, back)
    value[chosen] = 0.0
    return moved, value


def _crossings(nodes: Points, value: Array, pairs: Cells, distance: Distance) -> Points:
    """Find the points where the surface crosses the edges `pairs`, shape (k, 3).

    The method is regula falsi (Illinois).
    """
    a = nodes[pairs[:, 0]]
    b = nodes[pairs[:, 1]]
    low = np.zeros(len(pairs))
    high = np.ones(len(pairs))
    at_low = value[pairs[:, 0]].copy()
    at_high = value[pairs[:, 1]].copy()
    t = low
    last = np.zeros(len(pairs))
    for _ in range(_STEPS):
        slope = at_high - at_low
        t = low - at_low * (high - low) / np.where(slope == 0.0, 1.0, slope)
        here = np.asarray(distance(a + t[:, None] * (b - a)), dtype=np.float64)
        moved = np.where(here * at_low > 0.0, 1.0, -1.0)
        # The value at an end that is kept a second time is halved, because this end would otherwise
        # never move.
        again = np.where(moved == last, 0.5, 1.0)
        at_high = np.where(moved > 0.0, at_high * again, here)
        at_low = np.where(moved > 0.0, here, at_low * again)
        low = np.where(moved > 0.0, t, low)
        high = np.where(moved > 0.0, high, t)
        last = moved
    return np.asarray(a + t[:, None] * (b - a))


def _lattice(lower: Points, upper: Points, spacing: float) -> tuple[Points, Cells]:
    """Build a body-centred cubic lattice.

    A tetrahedron connects the centres of two neighbouring cubes with an edge of their common face.
    """
    count = np.ceil((upper - lower) / spacing).astype(np.int64)
    corners = np.arange(np.prod(count + 1)).reshape(count + 1)
    middles = corners.size + np.arange(np.prod(count)).reshape(count)
    nodes = np.concatenate(
        [lattice(*map(np.arange, count + 1)), lattice(*map(np.arange, count)) + 0.5]
    )
    tets = []
    for axis in range(3):
        face = np.moveaxis(corners, axis, 0)[1:-1]
        middle = np.moveaxis(middles, axis, 0)
        ring = [face[:, :-1, :-1], face[:, 1:, :-1], face[:, 1:, 1:], face[:, :-1, 1:]]
        for edge in zip(ring, [*ring[1:], ring[0]], strict=True):
            tets.append(np.stack([middle[:-1], middle[1:], *edge], axis=-1).reshape(-1, 4))
    nodes = lower + spacing * nodes
    return nodes, _turned(nodes, np.concatenate(tets))


def with_inclusion(
    mesh: TetMesh,
    name: str,
    vertices_m: Array,
    triangles: Ints,
    *,
    volume_m3: float,
    onto: Move | None = None,
) -> tuple[TetMesh, str]:
    """Make the region inside a closed surface a new part of the mesh.

    Return the mesh, and a note on the volume of the part.

    Mesh edges on the surface are at most 2 V / A long, where V is the enclosed volume and A the
    area of the surface. For a ball, this length is a third of the diameter. Cells of an earlier
    part are not changed.

    Parameters
    ----------
    mesh, name
        Mesh to which the part is added, and name of the part.
    vertices_m, triangles
        Surface of the part [m] with outward normals. It may extend outside the mesh.
    volume_m3
        Volume of the part inside the mesh [m3].
    onto
        Function that moves points onto the exact surface that the mesh approximates. The surface
        nodes of the mesh are moved by this function. If None, they are not moved.

    Raises
    ------
    InputError
        If the surface lies outside the mesh.
    """

    def distance(points: Floats) -> Array:
        return triangle_distance(vertices_m, triangles, points)

    area_m2 = float(triangle_areas(vertices_m, triangles).sum())
    # 6 V / A is the diameter of a ball.
    edge_m = 6.0 / _EDGES * volume_m3 / area_m2
    fine = bisected(mesh, lambda points: edge_m + EDGE_GROWTH * np.abs(distance(points)), onto=onto)
    # A polyhedron with corners on a round surface has a smaller volume, so the surface is placed
    # outside to match the volume.
    laid_m = 0.0
    made = fine
    share = 1.0
    best = (np.inf, 0.0)
    for _ in range(_TRIES):
        tried = with_part(fine, Shape(lambda points: distance(points) - laid_m), name)  # noqa: B023
        missing_m3 = volume_m3 - float(
            tried.volumes_m3[tried.part == len(tried.part_names) - 1].sum()
        )
        off = abs(missing_m3) / volume_m3
        score = max(off, _CLOSE), -float(mean_ratio(tried.nodes_m, tried.cells).min())
        if score < best:
            made = tried
            share = off
            best = score
        laid_m += missing_m3 / area_m2
    size = f"{1e6 * volume_m3:.3g} ml (volume of the mesh: within {share:.1%})"
    return made, f"{size}, edges of at most {1e3 * edge_m:.2g} mm"
