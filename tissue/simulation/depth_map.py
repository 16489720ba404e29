"""Depth of a run's cut, measured along the tool's axis."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from meshes.voxels.volume import FULL, VoxelVolume
from tissue.simulation.trace import Table

__all__ = ["HALF", "CarvedRun", "DepthMap", "depth_map", "facing", "tool_axes"]

HALF = (FULL + 1) // 2
"""Smallest filling of a voxel that counts as bone (255 = full)."""


class CarvedRun(Protocol):
    """Run of a tool through voxels, either just simulated or read back."""

    @property
    def volume(self) -> VoxelVolume:
        """The voxels before the first cut."""
        ...

    @property
    def remaining(self) -> NDArray[np.uint8]:
        """Bone left in every voxel, 255 = full."""
        ...

    @property
    def trace(self) -> Table:
        """Trace with one row a tick."""
        ...


@dataclass(frozen=True)
class DepthMap:
    """Columns of voxels along the world axis closest to the tool's axis.

    Attributes
    ----------
    axis, outward
        World axis closest to the tool's axis, 0 to 2, and the side that the tool comes from, +1 or
        -1.
    across
        The two other axes: first and second index of the arrays.
    extent_mm
        Lowest and highest coordinate along the two axes, (u0, u1, v0, v1) [mm].
    depth_mm
        Bone removed from each column, undercuts included [mm], shape (nu, nv).
    height_mm
        Coordinate along `axis` of the bone's face after the run, within its voxel [mm]; NaN where
        no bone is left.
    bone
        Columns that held bone before the run.
    exposed
        By layer, columns whose face shows that layer after the run and another one before.
    """

    axis: int
    outward: int
    across: tuple[int, int]
    extent_mm: tuple[float, float, float, float]
    depth_mm: NDArray[np.float64]
    height_mm: NDArray[np.float64]
    bone: NDArray[np.bool_]
    exposed: dict[str, NDArray[np.bool_]]


def depth_map(run: CarvedRun) -> DepthMap:
    """Return removed depth, face and newly exposed layers of a run."""
    from scipy.ndimage import binary_opening

    volume = run.volume
    remaining = run.remaining
    axis, outward = facing(run.trace)
    across = [a for a in range(3) if a != axis]
    spacing = volume.spacing_m * 1e3
    origin = volume.origin_m * 1e3
    start = origin[axis] if outward > 0 else origin[axis] + spacing * volume.shape[axis]
    removed = (volume.fraction - remaining).sum(axis=axis, dtype=np.int64)
    bone, _, before = _face(volume.fraction, volume.layer, axis, outward)
    left, at, after = _face(remaining, volume.layer, axis, outward)
    # Single columns at the edge of a hole change their layer when their last voxel is removed. They
    # are not exposed bone.
    exposed = [
        (name, binary_opening(left & (after == index) & (before != index), np.ones((3, 3))))
        for index, name in enumerate(volume.layer_names)
    ]
    ends = [(origin[a], origin[a] + spacing * volume.shape[a]) for a in across]
    return DepthMap(
        axis=axis,
        outward=outward,
        across=(across[0], across[1]),
        extent_mm=(*ends[0], *ends[1]),
        depth_mm=removed * (spacing / FULL),
        height_mm=np.where(left, start + outward * spacing * at, np.nan),
        bone=bone,
        exposed={name: mask for name, mask in exposed if mask.any()},
    )


def tool_axes(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return directions of the tool's axis, shape (n, 3).

    They are the third columns of the rotations (x, y, z, w).
    """
    x, y, z, w = quaternions.T
    return np.column_stack(
        [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)]
    )


def facing(trace: Table) -> tuple[int, int]:
    """Return the world axis closest to the tool's axis while it cut, and its sign."""
    rows = trace["contact_mm2"] > 0.0
    quaternions = np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"])
    mean = tool_axes(quaternions[rows] if rows.any() else quaternions).mean(axis=0)
    axis = int(np.abs(mean).argmax())
    return axis, 1 if mean[axis] >= 0.0 else -1


def _face(
    fraction: NDArray[np.uint8], layer: NDArray[np.uint8], axis: int, outward: int
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.uint8]]:
    """Return the face of each column: whether it holds bone, its height, and its layer.

    The height counts voxels above the far end. The face lies in the first voxel from outside that
    is half full, or in the one above, depending on their filling.
    """
    seen = np.flip(fraction, axis) if outward > 0 else fraction
    first = np.argmax(seen >= HALF, axis=axis)
    at = fraction.shape[axis] - 1 - first if outward > 0 else first
    index = np.expand_dims(at, axis)
    above = np.clip(index + outward, 0, fraction.shape[axis] - 1)
    full = np.take_along_axis(fraction, index, axis).squeeze(axis)
    partial = np.where(above == index, 0, np.take_along_axis(fraction, above, axis)).squeeze(axis)
    height = fraction.shape[axis] - 1 - first + (full + partial.astype(np.float64)) / FULL
    return full >= HALF, height, np.take_along_axis(layer, index, axis).squeeze(axis)
