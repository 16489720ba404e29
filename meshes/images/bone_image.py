"""Bone voxels from an image volume: CT or micro-CT grey values to fraction and density."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, require_positive, require_range
from meshes.base.placement import Placement
from meshes.images.frame import Image
from meshes.voxels.volume import FULL, VoxelVolume

__all__ = ["image_volume"]

Density = Callable[[NDArray[np.number]], NDArray[np.float32]]
"""Density [kg/m3] of grey values, same shape, such as a `meshes.ct.density.DensityLaw`."""

_ISOTROPY = 1e-3
_MOST_VOXELS = 5e8


def image_volume(
    image: Image,
    *,
    threshold: float,
    density_kg_m3: float | Density = 1800.0,
    resample_mm: float | None = None,
    remark: Callable[[str], None] | None = None,
) -> VoxelVolume:
    """Convert an image to bone voxels of one layer.

    The origin is the centre of the block's top face, with +z upward. The block's place in LPS is
    kept.

    Parameters
    ----------
    threshold
        Grey value above which a voxel is bone.
    density_kg_m3
        Density of the bone in a voxel: one value [kg/m3], or a law of the grey value.
    resample_mm
        New voxel size [mm]. Finer: grey values are interpolated first. Coarser: fractions are
        averaged, bone volume kept. None: the file's, or the finest of its three.
    remark
        Called with each sentence on an assumption.

    Raises
    ------
    InputError
        If an option is out of range, or no voxel lies above the threshold.
    """
    limit = require_range(
        "anatomy.threshold", threshold, -1e9, 1e9, "use 63 for 8-bit micro-CT, about 200 for CT"
    )
    spacing = (
        min(image.spacing_mm)
        if resample_mm is None
        else require_positive("resample_mm", resample_mm, "use 0.1")
    )
    notes = list(image.notes)
    if resample_mm is None and max(image.spacing_mm) > (1.0 + _ISOTROPY) * spacing:
        notes.append(f"The voxels of {image.source} are not cubes; resampled to {spacing:g} mm.")
    _require_size(image.values.shape, image.spacing_mm, spacing)
    values = _refined(image.values, image.spacing_mm, spacing)
    fraction = (values > limit).astype(np.float32)
    if not fraction.any():
        raise InputError(
            "anatomy.threshold",
            "leave bone",
            f"{limit:g} where {image.source} holds {values.min():g} to {values.max():g}",
            "use a value between",
        )
    mass = fraction * (
        density_kg_m3(values)
        if callable(density_kg_m3)
        else np.float32(require_range("density_kg_m3", density_kg_m3, 50.0, 20000.0, "use 1800"))
    )
    for axis, size in enumerate(image.spacing_mm):
        fraction, mass = (_averaged(a, axis, spacing / size) for a in (fraction, mass))
    if remark is not None:
        for note in notes:
            remark(note)
    density = np.divide(mass, fraction, out=np.zeros_like(mass), where=fraction > 0.25 / FULL)
    nx, ny, nz = fraction.shape
    origin = -1e-3 * spacing * np.array([nx // 2, ny // 2, nz], dtype=np.float64)
    corner_mm = np.array(image.origin_mm) - 0.5 * np.array(image.spacing_mm)
    return VoxelVolume(
        origin,
        1e-3 * spacing,
        np.ascontiguousarray(np.rint(fraction * FULL), dtype=np.uint8),
        np.zeros(fraction.shape, np.uint8),
        np.ascontiguousarray(np.rint(density), dtype=np.uint16),
        ("trabecular",),
        Placement(corner_mm - 1e3 * origin, np.eye(3)),
    )


def _require_size(
    shape: tuple[int, ...], from_mm: tuple[float, float, float], to_mm: float
) -> None:
    """Refuse a resampling that would take more voxels than are workable."""
    count = math.prod(n * max(size / to_mm, 1.0) for n, size in zip(shape, from_mm, strict=True))
    if count > _MOST_VOXELS:
        fitting = to_mm * (count / _MOST_VOXELS) ** (1.0 / 3.0)
        raise InputError(
            "resample_mm",
            f"leave at most {_MOST_VOXELS:.0e} voxels",
            f"{to_mm:g} which makes {count:.2g}",
            f"crop the image, or use {fitting:.2g} or more",
        )


def _refined(
    values: NDArray[np.number], from_mm: tuple[float, float, float], to_mm: float
) -> NDArray[np.number]:
    """Interpolate linearly to `to_mm` along the axes with coarser spacing; keep the other axes."""
    for axis, size in enumerate(from_mm):
        if size <= (1.0 + _ISOTROPY) * to_mm:
            continue
        count = values.shape[axis]
        position = (np.arange(math.floor(count * size / to_mm + 1e-6)) + 0.5) * (to_mm / size) - 0.5
        position = np.clip(position, 0.0, count - 1.0)
        low = np.minimum(position.astype(np.int64), max(count - 2, 0))
        part = (
            (position - low).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        )
        below = np.take(values, low, axis=axis).astype(np.float32)
        above = np.take(values, np.minimum(low + 1, count - 1), axis=axis).astype(np.float32)
        values = below + (above - below) * part
    return values


def _averaged(values: NDArray[np.float32], axis: int, ratio: float) -> NDArray[np.float32]:
    """Average runs of `ratio` > 1 voxels along an axis; parts of voxels count as parts.

    A remainder is dropped.
    """
    if ratio <= 1.0 + _ISOTROPY:
        return values
    count = values.shape[axis]
    edges = np.arange(math.floor(count / ratio + 1e-6) + 1) * ratio
    if len(edges) < 2:
        raise InputError(
            "resample_mm",
            "leave a voxel along every axis",
            f"{ratio:g} voxels of {count}",
            "use a finer one",
        )
    before = [(1, 0) if k == axis else (0, 0) for k in range(3)]
    running = np.pad(np.cumsum(values, axis=axis, dtype=np.float64), before)
    low = np.minimum(edges.astype(np.int64), count - 1)
    part = (edges - low).reshape([-1 if k == axis else 1 for k in range(3)])
    below = np.take(running, low, axis=axis)
    above = np.take(running, low + 1, axis=axis)
    return (np.diff(below + (above - below) * part, axis=axis) / ratio).astype(np.float32)
