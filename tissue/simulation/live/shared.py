"""Arrays shared by two processes, in a file that stays in memory where the system supports it.

The ticks update the arrays of a tissue at a cost of some microseconds a tick, and a window draws
them.
"""

import json
import mmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.voxels.volume import VoxelVolume

if TYPE_CHECKING:
    from tissue.models.bone.model import BoneModel
    from tissue.simulation.builders.parts import Parts

__all__ = [
    "MEMORY",
    "AnyArray",
    "BoneShared",
    "Layout",
    "OrganShared",
    "SharedArrays",
    "SharedTissue",
    "shared_tissue",
]

AnyArray = NDArray[Any]
Layout = dict[str, tuple[str, tuple[int, ...]]]
"""Type and shape of each array, by its name."""
MEMORY = Path("/dev/shm")
"""Folder on Linux whose files never reach a disk.

On other systems the folder for temporary files is used.
"""
TRIES = 20
"""Number of attempts to read an array."""
ALIGNED = 64
"""Alignment of every array [bytes]: one cache line."""
TURN_TICKS = 200
"""Ticks in which every brick of a bone is copied once."""
MOVED_TICKS = 33
"""Ticks between two pictures of an organ's surface."""
MOST_SHOWN = 600_000
"""Number of voxels above which the window shows larger blocks.

The blocks then have four by four by four voxels instead of two by two by two.
"""


class SharedArrays:
    """Named arrays in one mapped file, used as NumPy arrays by two processes.

    Reading and writing them needs no system call.

    Values that must be read as a whole use `write` and `read`: the reader tries again while a write
    is running. Each array has one writer.

    Parameters
    ----------
    folder
        Folder of the file. The side that makes the file gives ``layout``; the other side finds it
        there.
    layout
        The arrays to make, all zero.
    """

    def __init__(self, folder: Path, layout: Layout | None = None) -> None:
        if layout is not None:
            (folder / "layout.json").write_text(json.dumps(layout), "utf-8")
        table: Layout = json.loads((folder / "layout.json").read_text("utf-8"))
        places = {}
        end = 0
        for name, (dtype, shape) in table.items():
            size = int(np.prod(shape)) * np.dtype(dtype).itemsize
            places[name] = (end, dtype, tuple(shape))
            end += -(-size // ALIGNED) * ALIGNED
        file = folder / "arrays.bin"
        if layout is not None:
            with file.open("wb") as made:
                made.truncate(max(end, 1))
        with file.open("r+b") as opened:
            self._map = mmap.mmap(opened.fileno(), 0)
        self._arrays: dict[str, AnyArray] = {
            name: np.ndarray(shape, dtype, buffer=self._map, offset=first)
            for name, (first, dtype, shape) in places.items()
        }

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def __getitem__(self, name: str) -> AnyArray:
        """Return the array itself."""
        return self._arrays[name]

    def write(self, name: str, values: AnyArray) -> None:
        """Write an array as a whole.

        The array named with the suffix ``_turn`` is its counter, which is odd while a write is
        running.
        """
        turn = self._arrays[f"{name}_turn"]
        turn[0] += 1
        self._arrays[name][:] = values
        turn[0] += 1

    def read(self, name: str) -> tuple[int, NDArray[Any]] | None:
        """Return the number of an array's writes and a whole copy of the array.

        None is returned if a writer was busy or died.
        """
        turn = self._arrays[f"{name}_turn"]
        values = self._arrays[name]
        for _ in range(TRIES):
            before = int(turn[0])
            copy = values.copy()
            if before % 2 == 0 and int(turn[0]) == before:
                return before // 2, copy
        return None


class SharedTissue:
    """Shared arrays of a tissue.

    A tissue that its scene and the trace describe, such as a wall, has no shared arrays.

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
        """Update a part of the arrays at the end of each tick."""


class BoneShared(SharedTissue):
    """Bricks of a bone, copied one slice per tick.

    Every brick is at most `TURN_TICKS` ticks old.

    Parameters
    ----------
    milling
        The bone.
    volume
        Its voxels before the first cut.
    """

    def __init__(self, milling: "BoneModel", volume: VoxelVolume) -> None:
        from kernels.bricks import BRICK  # imports Warp, which a reading process does not need

        store = milling.store
        self._remaining = store.remaining
        count = len(store.places)
        self._left: NDArray[np.uint16] | None = (
            store.remaining.numpy() if store.remaining.device.is_cpu else None
        )
        self._slice = -(-count // TURN_TICKS)
        self._count = count
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
        """Copy the next slice; at tick 0 copy all slices."""
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
    """Displacement of the touchable surface of a soft organ.

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
    """Return the shared arrays of a run's tissue."""
    from tissue.models.bone.model import BoneModel  # as above

    tissue: Any = parts.tissue
    milling = getattr(tissue, "milling", tissue)
    if isinstance(milling, BoneModel) and parts.volume is not None:
        return BoneShared(milling, parts.volume)
    if hasattr(tissue, "displacement_m"):
        return OrganShared(tissue)
    return SharedTissue()
