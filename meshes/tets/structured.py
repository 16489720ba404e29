"""Exact structured tetrahedral meshes: every cell of a grid cut into six tetrahedra.

A brick is cut along its diagonal from (0, 0, 0) to (1, 1, 1) into the six simplices of Kuhn (1960), the triangulation
of Freudenthal (1942). All bricks are cut alike and each face along its diagonal through its lowest corner, so
neighbours conform; a patch and its mirror image conform as well, which is how the round meshes here are made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import InputError, require_positive
from meshes.tets.tetrahedra import TetMesh

__all__ = ["box", "cylinder", "graded", "grid", "joined", "mapped", "sphere_shell"]

Map = Callable[[NDArray[np.float64]], NDArray[np.float64]]

_COINCIDENT = 1e-7


def grid(x_m: ArrayLike, y_m: ArrayLike, z_m: ArrayLike) -> TetMesh:
    """Bricks between the planes at `x_m`, `y_m` and `z_m` [m], each rising, shapes (n + 1,); six tetrahedra a brick.

    Raises
    ------
    InputError
        If an axis has fewer than two planes, or planes that do not rise.
    """
    axes = [np.asarray(axis, dtype=np.float64) for axis in (x_m, y_m, z_m)]
    for name, axis in zip(("x_m", "y_m", "z_m"), axes, strict=True):
        if axis.ndim != 1 or len(axis) < 2 or not (np.diff(axis) > 0.0).all():
            raise InputError(f"{name} must hold at least two rising positions, got {axis}: use np.linspace(0, 1, 5)")
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return TetMesh(nodes, _kuhn([len(axis) - 1 for axis in axes]))


def box(size_m: Sequence[float], cells: Sequence[int]) -> TetMesh:
    """Box from the origin to `size_m` [m], shape (3,), of `cells` bricks along each axis, six tetrahedra each."""
    x, y, z = (
        np.linspace(0.0, require_positive("size_m", s, "use about 0.05"), n + 1)
        for s, n in zip(size_m, _counts(cells), strict=True)
    )
    return grid(x, y, z)


def mapped(cells: Sequence[int], into: Map) -> TetMesh:
    """The unit cube, `cells` bricks along each axis, with its nodes moved by `into`.

    Parameters
    ----------
    cells
        Bricks along each axis, shape (3,).
    into
        Points of the unit cube, shape (n, 3), to positions [m], shape (n, 3). A mirroring map is allowed.

    Raises
    ------
    InputError
        If a tetrahedron comes out flat, or some are inverted and others not.
    """
    counts = _counts(cells)
    unit = np.stack(np.meshgrid(*(np.linspace(0.0, 1.0, n + 1) for n in counts), indexing="ij"), axis=-1)
    return _outward(np.asarray(into(unit.reshape(-1, 3)), dtype=np.float64), _kuhn(counts))


def joined(meshes: Sequence[TetMesh]) -> TetMesh:
    """Meshes that meet node on node made one; nodes closer than 1e-7 of the longest side are the same node."""
    nodes = np.concatenate([mesh.nodes_m for mesh in meshes])
    starts = np.cumsum([0] + [len(mesh.nodes_m) for mesh in meshes])
    cells = np.concatenate([mesh.cells + start for mesh, start in zip(meshes, starts, strict=False)])
    # Lattice keys alone would part two nodes that straddle a lattice plane.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(nodes).query_pairs(_COINCIDENT * float(np.ptp(nodes, axis=0).max()), output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(nodes), len(nodes)))
    _, label = connected_components(links, directed=False)
    _, first = np.unique(label, return_index=True)
    return TetMesh(nodes[first], label[cells].astype(np.int64))


def sphere_shell(inner_m: float, outer_m: float, cells: tuple[int, int], *, octants: int = 1) -> TetMesh:
    """Hollow sphere between two radii [m] about the origin: the octant of positive coordinates, or all eight.

    Parameters
    ----------
    inner_m, outer_m
        Radii [m]; layers between them are in geometric progression, as the stress of a pressed sphere wants.
    cells
        Bricks along half the edge of an octant, and through the wall.
    octants
        1 or 8.
    """
    inner = require_positive("inner_m", inner_m, "use about 0.01")
    outer = require_positive("outer_m", outer_m, "use about 0.02")
    if outer <= inner:
        raise InputError(f"outer_m must exceed inner_m {inner:g}, got {outer:g}: swap them")

    def patch(axis: int) -> Map:
        """Map of the unit cube onto the third of the octant around an axis."""

        def into(unit: NDArray[np.float64]) -> NDArray[np.float64]:
            across = np.tan(0.25 * np.pi * unit[:, :2])
            ray = np.roll(np.column_stack([np.ones(len(unit)), across]), axis, axis=1)
            radius = inner * (outer / inner) ** unit[:, 2]
            return ray * (radius / np.linalg.norm(ray, axis=1))[:, None]

        return into

    octant = joined([mapped((cells[0], cells[0], cells[1]), patch(axis)) for axis in range(3)])
    return octant if octants == 1 else _mirrored(octant, (0, 1, 2))


def cylinder(radius_m: float, height_m: float, cells: tuple[int, int]) -> TetMesh:
    """Cylinder about the z axis from z = 0 up.

    Parameters
    ----------
    radius_m, height_m
        Radius and height [m].
    cells
        Bricks from the axis to the rim, and along the height.
    """
    radius = require_positive("radius_m", radius_m, "use about 0.025")
    height = require_positive("height_m", height_m, "use about 0.03")

    def quarter(unit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the quarter [m], shape (n, 3), from those of the unit cube."""
        across = unit[:, :2]
        ring = across.max(axis=1, keepdims=True)
        long = np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        # Squares about the axis turn gradually into circles at the rim.
        disc = radius * ((1.0 - ring) * across + ring * (across / long * ring))
        return np.column_stack([disc, height * unit[:, 2]])

    return _mirrored(mapped((cells[0], cells[0], cells[1]), quarter), (0, 1))


def graded(start_m: float, end_m: float, first_m: float, growth: float) -> NDArray[np.float64]:
    """Positions [m] from `start_m` to `end_m`, the first step about `first_m` and each `growth` times the one before.

    The last steps are stretched alike so that the end is met exactly. Two of them back to back grade towards a centre.

    Raises
    ------
    InputError
        If the first step is not positive or longer than the distance, or the growth is below 1.
    """
    distance = abs(end_m - start_m)
    if not 0.0 < first_m <= distance:
        raise InputError(f"first_m must be in (0, {distance:g}], got {first_m}: use a tenth of the distance")
    if not growth >= 1.0:
        raise InputError(f"growth must be at least 1, got {growth}: use 1.2")
    steps = [first_m]
    while sum(steps) < distance * (1.0 - 1e-12):
        steps.append(steps[-1] * growth)
    at = np.concatenate([[0.0], np.cumsum(steps)])
    at *= (end_m - start_m) / at[-1]
    at[-1] = end_m - start_m
    return start_m + at


def _mirrored(mesh: TetMesh, axes: Sequence[int]) -> TetMesh:
    """The mesh and its images in the planes through the origin normal to `axes`."""
    for axis in axes:
        turned = mesh.nodes_m.copy()
        turned[:, axis] *= -1.0
        mesh = joined([mesh, TetMesh(turned, mesh.cells[:, [0, 2, 1, 3]])])
    return mesh


def _outward(nodes: NDArray[np.float64], cells: NDArray[np.int64]) -> TetMesh:
    """Cells turned over together where the map mirrors."""
    a, b, c, d = (nodes[cells[:, i]] for i in range(4))
    if np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)).sum() < 0.0:
        cells = cells[:, [0, 2, 1, 3]]
    return TetMesh(nodes, cells)


def _kuhn(counts: Sequence[int]) -> NDArray[np.int64]:
    """Cells of a grid with `counts` bricks an axis, nodes numbered with z fastest, shape (6 bricks, 4)."""
    stride = np.array([(counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1])
    bricks = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    tets = []
    for order in permutations(range(3)):
        path = np.concatenate([[0], np.cumsum(stride[list(order)])])
        odd = np.linalg.det(np.eye(3)[list(order)]) < 0.0
        tets.append(path[[0, 2, 1, 3]] if odd else path)
    return ((bricks @ stride)[:, None, None] + np.array(tets)[None]).reshape(-1, 4).astype(np.int64)


def _counts(cells: Sequence[int]) -> list[int]:
    counts = [int(n) for n in cells]
    if len(counts) != 3 or min(counts) < 1:
        raise InputError(f"cells must be three numbers of at least 1, got {tuple(cells)}: use (4, 4, 4)")
    return counts
