"""Bone whose bricks (blocks of voxels) are made when a tool first reaches them.

The method saves memory: a whole tibia would have 2e9 voxels of 0.1 mm.
"""

from collections.abc import Iterator

import numpy as np

from kernels.bricks import BRICK, LOST
from meshes.base.arrays import Array, Bytes, Flags, Ints
from meshes.base.errors import InputError
from meshes.shapes.anatomy import Anatomy
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import AROUND_VOXELS, voxelise
from tissue.models.bone.bricks import BYTES_PER_VOXEL, BrickGrid, BrickStore

Boxes = tuple[Array, Array]
"""Lowest corners and highest corners of boxes [m], each of shape (n, 3)."""
PATCH = 4
"""Number of bricks along each edge of a patch, the smallest block that is made; chosen.

A larger patch contains more bone that the tool does not reach. A smaller patch needs more work per
stored brick, because its margin is voxelised too: 6 x 6 x 6 bricks for 4 x 4 x 4 stored bricks.
"""
MARGIN = 1
"""Number of layers of bricks around a patch that are voxelised but not stored.

A voxel stores distances up to a limit. One brick is wider than this limit, so the stored distances
of the patch are correct.
"""
BYTES_WHILE_MADE = 3 * BYTES_PER_VOXEL
"""Memory per voxel while a patch (a block of bricks) is made [bytes].

The memory includes the stored voxel, unused capacity of the stored arrays, and temporary arrays.
"""
MOST_BRICKS = 2.5e8
"""Largest number of brick positions on the lattice; the table of positions then takes 1 GB."""


class BricksOnDemand:
    """Bricks of an anatomy that are made patch by patch when a tool first reaches them.

    Parameters
    ----------
    anatomy
        The bone.
    spacing_m
        Edge length of a voxel [m].

    Attributes
    ----------
    store
        The bricks made so far.

    Raises
    ------
    InputError
        If the table of brick positions would be too large, see `MOST_BRICKS`.
    """

    def __init__(self, anatomy: Anatomy, *, spacing_m: float) -> None:
        self.anatomy = anatomy
        self._brick_m = BRICK * spacing_m
        around = AROUND_VOXELS * spacing_m
        low = np.floor((np.array(anatomy.shape.lower_m) - around) / self._brick_m)
        high = np.ceil((np.array(anatomy.shape.upper_m) + around) / self._brick_m)
        self._first = low.astype(np.int64)
        self._patches = -(-(high - low).astype(np.int64) // PATCH)
        share = float(np.prod(high - low)) / MOST_BRICKS
        if np.prod(PATCH * self._patches) > MOST_BRICKS:
            raise _too_fine(spacing_m, share, f"give at most {MOST_BRICKS:g} blocks of voxels")
        x, y, z = (PATCH * self._patches).tolist()
        grid = BrickGrid(low * self._brick_m, spacing_m, (x, y, z), anatomy.layer_names)
        self.store = BrickStore(grid, device="cpu")
        self._made = np.zeros(self._patches, bool)

    def make(self, boxes: Boxes) -> bool:
        """Make all bricks that the boxes touch.

        Parameters
        ----------
        boxes
            Lowest and highest corners in the anatomy's frame [m], each of shape (n, 3).

        Returns
        -------
        True if the device arrays were replaced. The caller must then record the kernel launches
        again.
        """
        wanted = self._wanted(boxes)
        self._require_memory(int(wanted.sum()))
        grown = False
        while wanted.any():
            first, last = _box_of(wanted)
            wanted[tuple(map(slice, first, last))] = False
            self._made[tuple(map(slice, first, last))] = True
            low = PATCH * first - MARGIN
            high = PATCH * last + MARGIN
            volume = self._voxels(low, high)
            x, y, z = low.tolist()
            grown |= self.store.add(volume, at=(x, y, z), margin=MARGIN)
        return grown

    def _require_memory(self, patches: int) -> None:
        """Raise an error if the given number of patches does not fit into the free memory.

        A patch is a block of bricks.
        """
        if patches == 0:
            return
        import psutil

        free = psutil.virtual_memory().available
        needed = patches * (PATCH * BRICK) ** 3 * BYTES_WHILE_MADE
        # A tenth of the free memory is kept for the rest of the run. The suggested spacing keeps a
        # fifth.
        if needed > 0.9 * free:
            raise _too_fine(
                self.store.grid.spacing_m,
                needed / (0.8 * free),
                (f"fit the bone in reach of the tool into the free memory of {1e-9 * free:.1f} GB"),
            )

    def has(self, low_m: Array, high_m: Array) -> bool:
        """Return True if all bricks that a box touches are made.

        The corners of the box [m] have shape (3,).
        """
        patch_m = PATCH * self._brick_m
        low = np.floor(low_m / patch_m - self._first / PATCH).astype(np.int64).clip(0)
        high = np.floor(high_m / patch_m - self._first / PATCH).astype(np.int64) + 1
        return bool(self._made[low[0] : high[0], low[1] : high[1], low[2] : high[2]].all())

    def cut_parts(self) -> Iterator[tuple[VoxelVolume, Bytes]]:
        """Yield voxels before any cut and their remaining fractions for each part that was cut.

        A fraction of 255 means a full voxel. The parts are boxes. Neighbouring boxes share one
        layer of voxels, so an isosurface has no gap between them.
        """
        lost = self.store.touched.numpy()[: len(self.store.places)] & LOST
        at = self.store.places[np.flatnonzero(lost)]
        wanted = np.zeros_like(self._made)
        # The surface may continue into the patch of a neighbouring brick.
        for shift in np.ndindex(3, 3, 3):
            near = ((at + np.array(shift) - 1) // PATCH).clip(0, np.array(wanted.shape) - 1)
            wanted[tuple(near.T)] = True
        while wanted.any():
            first, last = _box_of(wanted)
            wanted[tuple(map(slice, first, last))] = False
            low = PATCH * first
            high = PATCH * last
            before = self._voxels(low - MARGIN, high + MARGIN)
            # + 1: the layer of voxels that is shared with the next part.
            kept = tuple(
                slice(MARGIN * BRICK, MARGIN * BRICK + n + 1)
                for n in (BRICK * (high - low)).tolist()
            )
            volume = VoxelVolume(
                before.origin_m + MARGIN * self._brick_m,
                before.spacing_m,
                np.ascontiguousarray(before.fraction[kept]),
                np.ascontiguousarray(before.layer[kept]),
                np.ascontiguousarray(before.density_kg_m3[kept]),
                before.layer_names,
            )
            above = np.minimum(high + 1, self.store.grid.counts)
            stored = self.store.brick_of.numpy()[tuple(map(slice, low, above))] >= 0
            known = np.repeat(np.repeat(np.repeat(stored, BRICK, 0), BRICK, 1), BRICK, 2)
            left = volume.fraction.copy()
            there = tuple(slice(min(n, m)) for n, m in zip(left.shape, known.shape, strict=True))
            now = self.store.part(tuple(low.tolist()), tuple(above.tolist()))[there]
            left[there] = np.where(known[there], now, left[there])
            yield volume, left

    def _voxels(self, low: Ints, high: Ints) -> VoxelVolume:
        """Return the voxels, before any cut, of the bricks between two positions on the lattice."""
        corners: Array = (self._first + np.stack([low, high])) * np.float64(self._brick_m)
        region = corners[0], corners[1]
        spacing_m = self.store.grid.spacing_m
        return voxelise(self.anatomy, spacing_m=spacing_m, region_m=region)

    def _wanted(self, boxes: Boxes) -> Flags:
        """Return a mask of the patches that boxes touch and that are not made yet.

        A patch is a block of bricks.
        """
        patch_m = PATCH * self._brick_m
        low, high = (
            np.floor(corner / patch_m - self._first / PATCH).astype(np.int64) for corner in boxes
        )
        ranges = np.unique(np.hstack([low.clip(0), np.minimum(high + 1, self._patches)]), axis=0)
        wanted = np.zeros_like(self._made)
        for row in ranges[(ranges[:, :3] < ranges[:, 3:]).all(axis=1)].tolist():
            wanted[row[0] : row[3], row[1] : row[4], row[2] : row[5]] = True
        return wanted & ~self._made


def _too_fine(spacing_m: float, share: float, requirement: str) -> InputError:
    """Return the error for a spacing that gives `share` times the allowed number of voxels."""
    # The suggestion is a tenth coarser than the largest number of voxels requires, rounded up to
    # 0.01 mm.
    fits_mm = np.ceil(1.1e5 * spacing_m * share ** (1.0 / 3.0)) / 100.0
    return InputError(
        "spacing_mm", requirement, f"{1e3 * spacing_m:g}", f"use a spacing such as {fits_mm:g}"
    )


def _box_of(wanted: Flags) -> tuple[Ints, Ints]:
    """Return the lowest and highest position of a box that contains only wanted patches.

    The highest position is exclusive. The box is grown from the first wanted patch along z, then y,
    then x.
    """
    first = np.argwhere(wanted)[0]
    last = first + 1
    for axis in (2, 1, 0):
        while last[axis] < wanted.shape[axis]:
            more = [slice(a, b) for a, b in zip(first, last, strict=True)]
            more[axis] = slice(last[axis], last[axis] + 1)
            if not wanted[tuple(more)].all():
                break
            last[axis] += 1
    return first, last
