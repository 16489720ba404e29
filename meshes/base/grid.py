"""Grids of voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Ints, lattice

BLOCK = 8
"""Number of voxels along the edge of a block.

`kernels.bricks.BRICK` has the same value. The two packages do not import each other, so a test
compares the two values.
"""


@dataclass(frozen=True)
class Grid:
    """Grid of voxels whose indices are counted from the origin of a coordinate frame.

    Along each axis, the voxel with index i extends from ``i * spacing_m`` to ``(i + 1) *
    spacing_m``.

    Attributes
    ----------
    spacing_m
        Edge of a voxel [m].
    first
        Lowest voxel index along x, y and z; negative for voxels below the origin.
    shape
        Number of voxels along x, y and z.
    """

    spacing_m: float
    first: tuple[int, int, int]
    shape: tuple[int, int, int]

    @property
    def last(self) -> tuple[int, int, int]:
        """Highest voxel index along x, y and z, plus one."""
        return (
            self.first[0] + self.shape[0],
            self.first[1] + self.shape[1],
            self.first[2] + self.shape[2],
        )

    @property
    def origin_m(self) -> Array:
        """Lowest corner [m] of the grid, shape (3,)."""
        return np.array(self.first) * self.spacing_m

    def blocked(self) -> Grid:
        """Return the smallest grid of whole blocks that contains this grid.

        The blocks of 8 x 8 x 8 voxels are aligned with the frame's origin.
        """
        low = [f // BLOCK * BLOCK for f in self.first]
        high = [-(-e // BLOCK) * BLOCK for e in self.last]
        return Grid(
            self.spacing_m,
            (low[0], low[1], low[2]),
            (high[0] - low[0], high[1] - low[1], high[2] - low[2]),
        )

    def slab(self, start: int, stop: int) -> Grid:
        """Return the part of the grid with x indices from `start` to `stop` - 1.

        `start` and `stop` are counted from the grid's first voxel.
        """
        return Grid(
            self.spacing_m,
            (self.first[0] + start, *self.first[1:]),
            (stop - start, *self.shape[1:]),
        )

    def block_firsts(self) -> Ints:
        """Return the lowest voxel indices, shape (n, 3), of the blocks of 8 x 8 x 8 voxels.

        The grid must consist of whole blocks. The blocks are listed in C order.
        """
        axes = [np.arange(f, e, BLOCK) for f, e in zip(self.first, self.last, strict=True)]
        firsts: Ints = lattice(*axes)
        return firsts
