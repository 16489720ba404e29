"""Structured tetrahedral meshes: every cell of a grid is divided into six tetrahedra.

A cuboid cell is divided along its diagonal from (0, 0, 0) to (1, 1, 1) into the six simplices of
Kuhn (1960). This is the triangulation of Freudenthal (1942). All cells are divided in the same
pattern. Each face is divided along the diagonal through the corner with the lowest coordinates, so
neighbouring cells conform.
"""

import math
from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Ints, lattice
from meshes.base.errors import InputError, require_length
from meshes.tets.tetrahedra import TetMesh


def grid(x_m: ArrayLike, y_m: ArrayLike, z_m: ArrayLike) -> TetMesh:
    """Build a mesh of cuboids, each divided into six tetrahedra.

    The cuboids lie between planes at the positions `x_m`, `y_m` and `z_m` [m]. Each of the three
    arrays is ascending. For k cuboids along an axis, the array has k + 1 entries.

    Raises
    ------
    InputError
        If an axis has fewer than two planes, or the positions are not ascending.
    """
    axes = [np.asarray(axis, dtype=np.float64) for axis in (x_m, y_m, z_m)]
    for name, axis in zip(("x_m", "y_m", "z_m"), axes, strict=True):
        if axis.ndim != 1 or len(axis) < 2 or not (np.diff(axis) > 0.0).all():
            raise InputError(
                name, "contain at least two increasing positions", axis, "use np.linspace(0, 1, 5)"
            )
    return TetMesh(lattice(*axes), _kuhn([len(axis) - 1 for axis in axes]))


def box(size_m: Sequence[float], cells: Sequence[int]) -> TetMesh:
    """Build a box with one corner at the origin and the opposite corner at `size_m` [m].

    `cells` states the number of cuboids along each axis. Each cuboid is divided into six
    tetrahedra.
    """
    if len(cells) != 3 or min(cells) < 1:
        raise InputError("cells", "be three numbers of at least 1", tuple(cells), "use (4, 4, 4)")
    sides = [require_length("size_m", side, 0.0, math.inf, 0.05) for side in size_m]
    return grid(
        *(np.linspace(0.0, side, count + 1) for side, count in zip(sides, cells, strict=True))
    )


def graded(start_m: float, end_m: float, first_m: float, growth: float) -> Array:
    """Return positions [m] from `start_m` to `end_m` with increasing steps.

    The first step is about `first_m`, and each further step is `growth` times as long as the step
    before.

    All steps are scaled by the same factor so that the last position is exactly `end_m`. To refine
    a grid towards its centre, use two such series, one of them reversed.

    Raises
    ------
    InputError
        If the first step is not positive, the first step is longer than the distance from start to
        end, or the growth is below 1.
    """
    distance = abs(end_m - start_m)
    if not 0.0 < first_m <= distance:
        raise InputError(
            "first_m", f"be in (0, {distance:g}]", first_m, "use a tenth of the distance"
        )
    if not growth >= 1.0:
        raise InputError("growth", "be at least 1", growth, "use a value such as 1.2")
    steps = [first_m]
    # The tolerance avoids an additional step because of rounding errors of the sum.
    while sum(steps) < distance * (1.0 - 1e-12):
        steps.append(steps[-1] * growth)
    at = np.concatenate([[0.0], np.cumsum(steps)])
    at *= (end_m - start_m) / at[-1]
    at[-1] = end_m - start_m
    return start_m + at


def _kuhn(counts: Sequence[int]) -> Ints:
    """Return the tetrahedra, shape (6 * cuboids, 4), of a grid with `counts` cuboids per axis.

    Nodes are numbered such that the index along z varies fastest.
    """
    stride = np.array([(counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1])
    bricks = lattice(*map(np.arange, counts))
    tets = []
    for order in permutations(range(3)):
        path = np.concatenate([[0], np.cumsum(stride[list(order)])])
        odd = np.linalg.det(np.eye(3)[list(order)]) < 0.0
        # An odd permutation mirrors the tetrahedron. Exchange two corners so that its volume is
        # positive.
        tets.append(path[[0, 2, 1, 3]] if odd else path)
    return ((bricks @ stride)[:, None, None] + np.array(tets)[None]).reshape(-1, 4).astype(np.int64)
