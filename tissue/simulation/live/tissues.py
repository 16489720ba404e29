"""What a window is shown of a tissue while it is simulated, at a cost of some microseconds a tick."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from kernels.bricks import BRICK
from meshes.voxels.volume import VoxelVolume
from tissue.builders.parts import Parts
from tissue.models.bone.model import BoneModel
from tissue.simulation.live.shared import AnyArray, Layout, SharedArrays

__all__ = ["BoneShared", "NothingShared", "OrganShared", "TissueShared", "shared_tissue"]

TURN_TICKS = 200
"""Ticks in which every brick of a bone is copied once."""
MOVED_TICKS = 33
"""Ticks between two pictures of an organ's surface."""
MOST_SHOWN = 600_000
"""Voxels from which the window shows blocks of four by four by four instead of two by two by two."""


class TissueShared(Protocol):
    """What is shared of a tissue.

    Attributes
    ----------
    layout
        Arrays that change while it runs.
    start
        Arrays that a window needs to begin with.
    """

    layout: Layout
    start: dict[str, AnyArray]

    def publish(self, arrays: SharedArrays, index: int) -> None:
        """Bring the arrays up to date at the end of a tick, a part at a time."""
        ...


class NothingShared:
    """A tissue that its scene and the trace describe, such as a wall."""

    def __init__(self) -> None:
        self.layout: Layout = {}
        self.start: dict[str, AnyArray] = {}

    def publish(self, arrays: SharedArrays, index: int) -> None:
        """There is nothing to bring up to date."""


class BoneShared:
    """The bricks of a bone, copied a slice a tick, so that every brick is at most `TURN_TICKS` ticks old.

    Parameters
    ----------
    milling
        The bone.
    volume
        Its voxels before the first cut.
    """

    def __init__(self, milling: BoneModel, volume: VoxelVolume) -> None:
        store = milling.store
        self._remaining, count = store.remaining, len(store.places)
        self._left: NDArray[np.uint16] | None = store.remaining.numpy() if store.remaining.device.is_cpu else None
        self._slice = -(-count // TURN_TICKS)
        self._count = count
        block = 2 if np.prod(volume.shape, dtype=float) <= 8 * MOST_SHOWN else 4
        grid = store.brick_of.shape
        layer = np.zeros([n * BRICK // block for n in grid], dtype=np.uint8)
        some = volume.layer[block // 2 :: block, block // 2 :: block, block // 2 :: block]
        layer[tuple(slice(n) for n in some.shape)] = some
        self.layout: Layout = {"remaining": ("uint16", (count, BRICK**3))}
        self.start: dict[str, AnyArray] = {
            "places": store.places,
            "block": np.array(block),
            "layer": layer,
            "layer_names": np.array(volume.layer_names),
            "origin_m": np.asarray(volume.origin_m),
            "spacing_m": np.array(volume.spacing_m),
        }

    def publish(self, arrays: SharedArrays, index: int) -> None:
        """Copy the next slice; at first all of them."""
        first, last = 0, self._count
        if index > 0:
            first = self._slice * (index % TURN_TICKS)
            last = min(first + self._slice, self._count)
        if first < last:
            left = self._remaining[first:last].numpy() if self._left is None else self._left[first:last]
            arrays["remaining"][first:last] = left


class OrganShared:
    """The surface of a soft organ that can be touched, as far as it has moved.

    Parameters
    ----------
    organ
        The organ; it holds `fields` and `displacement_m`.
    """

    def __init__(self, organ: Any) -> None:
        self._organ, series = organ, organ.fields
        touchable = series.node_sets["touchable"]
        self.layout: Layout = {"moved": ("float32", (len(touchable), 3)), "moved_turn": ("int64", (1,))}
        self.start: dict[str, AnyArray] = {
            "nodes_m": series.nodes_m,
            "cells": series.cells,
            "part": series.layer,
            "part_names": np.array(series.layer_names),
            "touchable": touchable,
        }

    def publish(self, arrays: SharedArrays, index: int) -> None:
        """Write the displacement where it is time."""
        if index % MOVED_TICKS == 0:
            arrays.write("moved", self._organ.displacement_m()[: len(arrays["moved"])])


def shared_tissue(parts: Parts) -> TissueShared:
    """What can be shared of a run's tissue."""
    tissue: Any = parts.tissue
    milling = getattr(tissue, "milling", tissue)
    if isinstance(milling, BoneModel) and parts.volume is not None:
        return BoneShared(milling, parts.volume)
    if hasattr(tissue, "displacement_m"):
        return OrganShared(tissue)
    return NothingShared()
