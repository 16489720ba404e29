"""Arrays with which the process of a run shares its tissue with the process of the window.

The arrays are in files. If the system supports it, the files exist only in memory. The update of
the arrays takes some microseconds per tick.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Flags
from meshes.voxels.volume import VoxelVolume
from tissue.simulation.bone_surface import bone_surface

if TYPE_CHECKING:
    import pyvista

    from tissue.models.bone.model import BoneModel
    from tissue.simulation.builders.parts import Parts

AnyArray = NDArray[Any]
Layout = dict[str, tuple[str, tuple[int, ...]]]
"""Type and shape of each array, keyed by the name of the array."""
MEMORY = Path("/dev/shm")
"""Folder on Linux whose files are kept in memory only.

On other systems the folder for temporary files is used.
"""
TRIES = 20
"""Number of attempts to read an array while the other process is writing it.

A write takes some microseconds. If all attempts fail, the writing process has probably ended.
"""
TURN_TICKS = 200
"""Number of ticks in which every brick (block of voxels) of a bone is copied once.

Each tick copies only 1/200 of the bricks, so the picture of the bone is updated five times per
second.
"""
MOVED_TICKS = 33
"""Ticks between two pictures of an organ's surface; a window draws 30 pictures per second."""
MOST_SHOWN = 600_000
"""Largest number of blocks of voxels that the window shows.

A block has 2 x 2 x 2 voxels. If a bone has more blocks, the window shows blocks of 4 x 4 x 4
voxels.

Computing the surface of 600,000 blocks takes 29 ms, less than the 33 ms between two pictures.
"""
Start = Mapping[str, NDArray[Any]]
FADES_MM = 20.0
"""Distance over which the displacement of a drawn organ decreases by a factor of e [mm].

The displacement is known only at some nodes of the surface. Elsewhere, the drawn displacement
decreases with the distance from these nodes. No force depends on this value.
"""


class SharedArrays:
    """Named arrays in memory-mapped files, which two processes use as NumPy arrays.

    Access to the arrays needs no system call.

    `write` and `read` protect an array from being read during a write: `read` tries again while a
    write is in progress. Only one of the processes may write an array.

    Parameters
    ----------
    folder
        Folder of the files, one for each array.
    layout
        Arrays to make, initially zero. The process that makes the files gives the layout. The other
        process passes None and opens all arrays in the folder.
    """

    def __init__(self, folder: Path, layout: Layout | None = None) -> None:
        for name, (dtype, shape) in (layout or {}).items():
            np.lib.format.open_memmap(folder / f"{name}.npy", "w+", dtype, shape)
        # Access to a plain array takes less time than access to a `numpy.memmap`.
        self._arrays: dict[str, AnyArray] = {
            file.stem: np.load(file, mmap_mode="r+").view(np.ndarray)
            for file in folder.glob("*.npy")
        }

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def __getitem__(self, name: str) -> AnyArray:
        """Return the shared array itself, not a copy."""
        return self._arrays[name]

    def write(self, name: str, values: AnyArray) -> None:
        """Write an array so that the other process cannot read a half-written array.

        A counter with the same name and the suffix ``_turn`` is odd while a write is in progress.
        """
        turn = self._arrays[f"{name}_turn"]
        turn[0] += 1
        self._arrays[name][:] = values
        turn[0] += 1

    def read(self, name: str) -> tuple[int, NDArray[Any]] | None:
        """Return the number of writes so far, and a copy of the array after a complete write.

        The result is None if the writer was busy or has ended during a write.
        """
        turn = self._arrays[f"{name}_turn"]
        values = self._arrays[name]
        for _ in range(TRIES):
            before = int(turn[0])
            copy = values.copy()
            # The counter is odd while a write is running.
            if before % 2 == 0 and int(turn[0]) == before:
                return before // 2, copy
        return None


class SharedTissue:
    """Shared arrays of a tissue.

    A tissue that can be drawn from scene and trace alone, such as a wall, has no shared arrays.

    Attributes
    ----------
    layout
        Arrays that change during the run.
    start
        Arrays that a window needs at its start.
    """

    layout: Layout
    start: dict[str, AnyArray]

    def __init__(self) -> None:
        self.layout = {}
        self.start = {}

    def publish(self, arrays: "SharedArrays", index: int) -> None:
        """Copy some data of the tissue into the shared arrays, at the end of a tick."""


class BoneShared(SharedTissue):
    """Shared arrays of a bone; each tick copies some bricks (blocks of 8 x 8 x 8 voxels).

    The copy of a brick is at most `TURN_TICKS` ticks old.

    Parameters
    ----------
    milling
        The bone.
    volume
        Voxels of the bone before the first cut.
    """

    def __init__(self, milling: "BoneModel", volume: VoxelVolume) -> None:
        from kernels.bricks import BRICK  # imports Warp, which a process for ROS 2 does not need

        store = milling.store
        self._remaining = store.remaining
        count = len(store.places)
        self._left: NDArray[np.uint16] | None = (
            store.remaining.numpy() if store.remaining.device.is_cpu else None
        )
        self._slice = -(-count // TURN_TICKS)
        self._count = count
        # A block of two by two by two voxels contains 8 voxels.
        block = 2 if np.prod(volume.shape, dtype=float) <= 8 * MOST_SHOWN else 4
        grid = store.brick_of.shape
        layer = np.zeros([n * BRICK // block for n in grid], dtype=np.uint8)
        some = volume.layer[block // 2 :: block, block // 2 :: block, block // 2 :: block]
        layer[tuple(slice(n) for n in some.shape)] = some
        self.layout = {"remaining": ("uint16", (count, BRICK**3))}
        self.start = {
            "places": store.places,
            "block": np.array(block),
            "layer": layer,
            "layer_names": np.array(volume.layer_names),
            "origin_m": np.asarray(volume.origin_m),
            "spacing_m": np.array(volume.spacing_m),
        }

    def publish(self, arrays: SharedArrays, index: int) -> None:
        """Copy the next part of the bricks; at tick 0, copy all bricks."""
        first = 0
        last = self._count
        if index > 0:
            first = self._slice * (index % TURN_TICKS)
            last = min(first + self._slice, self._count)
        if first < last:
            left = (
                self._remaining[first:last].numpy()
                if self._left is None
                else self._left[first:last]
            )
            arrays["remaining"][first:last] = left


class OrganShared(SharedTissue):
    """Shared arrays of a soft organ: displacement of the part of its surface that can be touched.

    Parameters
    ----------
    organ
        Organ with the attributes `fields` and `displacement_m`.
    """

    def __init__(self, organ: Any) -> None:
        self._organ = organ
        series = organ.fields
        touchable = series.node_sets["touchable"]
        self.layout = {"moved": ("float32", (len(touchable), 3)), "moved_turn": ("int64", (1,))}
        self.start = {
            "nodes_m": series.nodes_m,
            "cells": series.cells,
            "part": series.layer,
            "part_names": np.array(series.layer_names),
            "touchable": touchable,
        }

    def publish(self, arrays: SharedArrays, index: int) -> None:
        """Write the displacement every `MOVED_TICKS` ticks."""
        if index % MOVED_TICKS == 0:
            arrays.write("moved", self._organ.displacement_m()[: len(arrays["moved"])])


def shared_tissue(parts: "Parts") -> SharedTissue:
    """Return the shared arrays of the tissue of a run."""
    from tissue.models.bone.model import BoneModel  # as above

    tissue: Any = parts.tissue
    milling = getattr(tissue, "milling", tissue)
    if isinstance(milling, BoneModel) and parts.volume is not None:
        return BoneShared(milling, parts.volume)
    if hasattr(tissue, "displacement_m"):
        return OrganShared(tissue)
    return SharedTissue()


def tissue_surface(start: Start, arrays: SharedArrays) -> "BoneSurface | OrganSurface | None":
    """Return the surface of a shared tissue; None for a tissue without shared arrays."""
    kind = BoneSurface if "remaining" in arrays else OrganSurface if "moved" in arrays else None
    return None if kind is None else kind(start, arrays)


class BoneSurface:
    """Surface of a bone, computed from the bricks of voxels that a run copies to shared arrays.

    A brick is 8 x 8 x 8 voxels.

    Parameters
    ----------
    start, arrays
        `start` and the shared arrays of `tissue.simulation.live.shared.BoneShared`.

    Attributes
    ----------
    surface
        Surface [mm], with normals. It has no cells if no bone is left.
    volume
        Coarse volume in which each voxel (block) covers several voxels of the bone. `update` copies
        the bone of the run into the blocks.
    """

    def __init__(self, start: Start, arrays: SharedArrays) -> None:
        self._remaining = arrays["remaining"]
        self._places = start["places"].astype(np.intp)
        self._block = int(start["block"])
        self._seen = self._remaining.copy()
        layer = start["layer"].astype(np.uint8)
        names = tuple(str(name) for name in start["layer_names"])
        spacing = self._block * float(start["spacing_m"])
        self._fraction = np.zeros(layer.shape, dtype=np.uint8)
        density = np.zeros(layer.shape, dtype=np.uint16)
        self.volume = VoxelVolume(
            start["origin_m"].astype(np.float64), spacing, self._fraction, layer, density, names
        )
        self._fill(np.arange(len(self._places)))
        self.surface: pyvista.PolyData = bone_surface(self.volume, self._fraction)

    def update(self) -> bool:
        """Update the surface; return True if a brick has changed."""
        now = self._remaining.copy()
        rows = np.flatnonzero((now != self._seen).any(axis=1))
        if not rows.size:
            return False
        self._seen[rows] = now[rows]
        self._fill(rows)
        self.surface = bone_surface(self.volume, self._fraction)
        return True

    def _fill(self, rows: NDArray[np.intp]) -> None:
        """Update the content of the blocks in some bricks."""
        from kernels.bricks import BRICK

        block = self._block
        count = BRICK // block
        # A brick stores its 8 x 8 x 8 voxels as 4 x 4 x 4 blocks of 2 x 2 x 2 voxels.
        bricks = self._seen[rows].reshape(-1, 4, 4, 4, 2, 2, 2).transpose(0, 1, 4, 2, 5, 3, 6)
        parts = bricks.reshape(-1, count, block, count, block, count, block)
        # A full voxel has 65535 steps here and 255 in the picture: the ratio is 257.
        means = np.rint(parts.mean(axis=(2, 4, 6)) / 257.0).astype(np.uint8)
        offsets = np.arange(count)
        x, y, z = count * self._places[rows].T[:, :, None] + offsets
        self._fraction[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]] = means


class OrganSurface:
    """Surface of a soft organ, with its displacement.

    At nodes without a known displacement, the shown displacement decreases with the distance from
    the nodes with a known displacement.

    Parameters
    ----------
    start, arrays
        `start` and the shared arrays of `tissue.simulation.live.shared.OrganShared`.

    Attributes
    ----------
    surface
        Surface [mm], whose points move with the organ.
    touchable_mm
        Points of the undeformed surface that can be touched [mm], shape (n, 3).
    """

    def __init__(self, start: Start, arrays: SharedArrays) -> None:
        import pyvista

        self._arrays = arrays
        self._turn = 0
        cells = start["cells"]
        nodes = 1e3 * start["nodes_m"].astype(np.float64)
        grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells[:, :4]}, nodes)
        self.surface = grid.extract_surface(algorithm="dataset_surface")
        ids = np.asarray(self.surface.point_data["vtkOriginalPointIds"])
        place = np.full(len(nodes), -1)
        place[start["touchable"]] = np.arange(len(start["touchable"]))
        self._row = place[ids]  # index of each shown point among the touchable nodes, -1 for others
        self._rest = np.array(self.surface.points, dtype=np.float64)
        self.surface.clear_data()
        self._known: Flags | None = None
        self._nearest = np.zeros(0, dtype=np.intp)
        self._share = np.zeros(0)
        self.touchable_mm: Array = self._rest[self._row >= 0]

    def update(self) -> bool:
        """Update the surface; return True if the displacement has changed."""
        message = self._arrays.read("moved")
        if message is None or message[0] == self._turn:
            return False
        self._turn, moved = message
        known = (self._row >= 0) & np.isfinite(moved).all(axis=1)[self._row]
        if self._known is None or (known != self._known).any():
            self._spread(known)
        if not known.any():
            return False
        of_known = 1e3 * moved[self._row[known]].astype(np.float64)
        self.surface.points = self._rest + self._share[:, None] * of_known[self._nearest]
        return True

    def _spread(self, known: Flags) -> None:
        """Find, for each point of the surface, the nearest point with a known displacement.

        Also compute the share of this displacement that is drawn at the point.
        """
        from scipy.spatial import cKDTree

        self._known = known
        if known.any():
            away, self._nearest = cKDTree(self._rest[known]).query(self._rest)
            self._share = np.exp(-away / FADES_MM)
