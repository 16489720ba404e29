"""Bone voxels from an image volume: CT or micro-CT grey values to fraction and density."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, require_positive, require_range
from meshes.base.placement import Placement
from meshes.images.frame import Image
from meshes.images.reading import read_image
from meshes.voxels.volume import FULL, VoxelVolume

__all__ = ["CT_DENSITY", "DensityLaw", "image_volume", "read_volume"]

Crop = tuple[tuple[int, int, int], tuple[int, int, int]]

_ISOTROPY = 1e-3
_MOST_VOXELS = 5e8
_UP = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(frozen=True)
class DensityLaw:
    """Apparent density [kg/m3] = slope · grey value + offset, held within limits.

    Attributes
    ----------
    slope_kg_m3, offset_kg_m3
        Density per grey value and at grey value 0 [kg/m3].
    lowest_kg_m3, highest_kg_m3
        Limits [kg/m3].
    """

    slope_kg_m3: float
    offset_kg_m3: float
    lowest_kg_m3: float = 50.0
    highest_kg_m3: float = 2000.0

    def __post_init__(self) -> None:
        require_range("slope_kg_m3", self.slope_kg_m3, -1e6, 1e6, "use about 1.48 for Hounsfield units")
        require_range("offset_kg_m3", self.offset_kg_m3, -1e6, 1e6, "use about 106 for Hounsfield units")
        require_range("highest_kg_m3", self.highest_kg_m3, 1.0, 20000.0, "use 2000")
        require_range("lowest_kg_m3", self.lowest_kg_m3, 0.0, self.highest_kg_m3, "use 50")

    def __call__(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Density [kg/m3] of grey values, same shape."""
        density = np.float32(self.slope_kg_m3) * values + np.float32(self.offset_kg_m3)
        return np.clip(density, self.lowest_kg_m3, self.highest_kg_m3).astype(np.float32)


CT_DENSITY = DensityLaw(0.887 / 0.6, 63.3 / 0.6)
"""Hounsfield units to apparent density: ash density 0.887 HU + 63.3 kg/m3 over ash to apparent 0.6, both specific to
scanner and site (the ratio from memory of the literature): calibrate before relying on it."""


def read_volume(
    path: str | Path,
    *,
    threshold: float,
    spacing_mm: float | None = None,
    full_value: float | None = None,
    density_kg_m3: float | DensityLaw = 1800.0,
    smooth_voxels: float = 0.0,
    crop: Crop | None = None,
    resample_mm: float | None = None,
    up: str = "+z",
    layer_name: str = "trabecular",
    array: str | None = None,
    remark: Callable[[str], None] | None = None,
) -> VoxelVolume:
    """Bone from an image file, see `meshes.images.reading.read_image` for the files and `image_volume` for the rest.

    Parameters
    ----------
    spacing_mm
        Voxel size [mm], instead of the file's; required for TIFF slices.
    remark
        Called with each sentence on what was assumed.
    """
    image = read_image(path, spacing_mm=spacing_mm, array=array)
    return image_volume(
        image,
        threshold=threshold,
        full_value=full_value,
        density_kg_m3=density_kg_m3,
        smooth_voxels=smooth_voxels,
        crop=crop,
        resample_mm=resample_mm,
        up=up,
        layer_name=layer_name,
        remark=remark,
    )


def image_volume(
    image: Image,
    *,
    threshold: float,
    full_value: float | None = None,
    density_kg_m3: float | DensityLaw = 1800.0,
    smooth_voxels: float = 0.0,
    crop: Crop | None = None,
    resample_mm: float | None = None,
    up: str = "+z",
    layer_name: str = "trabecular",
    remark: Callable[[str], None] | None = None,
) -> VoxelVolume:
    """Bone voxels of one layer; the origin is the centre of the block's top face, +z upward, its place in LPS kept.

    Parameters
    ----------
    threshold
        Bone is what lies above this grey value.
    full_value
        Grey value of a voxel full of bone: the fraction rises linearly from 0 at 2·threshold - full_value through 1/2
        at the threshold to 1 (linear partial volume). None: all or nothing.
    density_kg_m3
        Density of the bone in a voxel: one value [kg/m3], or a law of the grey value.
    smooth_voxels
        Standard deviation of a Gaussian filter applied first [voxels], 0 to 10.
    crop
        First and past-the-last voxel to keep, along the image's axes (LPS).
    resample_mm
        New voxel size [mm]. Finer: grey values are interpolated first. Coarser: fractions are averaged, bone volume
        kept. None: the file's, or the finest of its three.
    up
        Axis of the image (LPS) that becomes +z: one of +x, -x, +y, -y, +z, -z.
    layer_name
        Name of the layer.

    Raises
    ------
    InputError
        If an option is out of range, or nothing lies above the threshold.
    """
    limit = require_range("anatomy.threshold", threshold, -1e9, 1e9, "use 63 for 8-bit micro-CT, about 200 for CT")
    if full_value is not None and not full_value > limit:
        raise InputError(
            f"full_value must exceed threshold ({limit:g}), got {full_value}: use the grey value of solid bone"
        )
    sigma = require_range("smooth_voxels", smooth_voxels, 0.0, 10.0, "use 0 to leave the image as it is, or 1")
    values = _cropped(image.values, crop)
    if sigma > 0.0:
        from scipy.ndimage import gaussian_filter

        values = gaussian_filter(values.astype(np.float32), sigma)
    spacing = min(image.spacing_mm) if resample_mm is None else require_positive("resample_mm", resample_mm, "use 0.1")
    notes = list(image.notes)
    if resample_mm is None and max(image.spacing_mm) > (1.0 + _ISOTROPY) * spacing:
        notes.append(f"The voxels of {image.source} are not cubes; resampled to {spacing:g} mm.")
    _require_size(values.shape, image.spacing_mm, spacing)
    values = _refined(values, image.spacing_mm, spacing)
    fraction = _fraction(values, limit, full_value)
    if not fraction.any():
        raise InputError(
            f"anatomy.threshold must leave bone, got {limit:g} where {image.source} holds "
            f"{values.min():g} to {values.max():g}: use a value between"
        )
    mass = fraction * (
        density_kg_m3(values)
        if isinstance(density_kg_m3, DensityLaw)
        else np.float32(require_range("density_kg_m3", density_kg_m3, 50.0, 20000.0, "use 1800"))
    )
    for axis, size in enumerate(image.spacing_mm):
        fraction, mass = (_averaged(a, axis, spacing / size) for a in (fraction, mass))
    for note in notes:
        if remark is not None:
            remark(note)
    first = np.array(crop[0] if crop is not None else (0, 0, 0)) - 0.5
    corner_mm = np.array(image.origin_mm) + first * image.spacing_mm
    return _placed(fraction, mass, spacing, corner_mm, up, layer_name)


def _placed(
    fraction: NDArray[np.float32],
    mass: NDArray[np.float32],
    spacing_mm: float,
    corner_mm: NDArray[np.float64],
    up: str,
    layer_name: str,
) -> VoxelVolume:
    """Volume with the axis `up` of the arrays along +z and the centre of its top face at the origin.

    `corner_mm` is the lowest corner of the arrays in the image's frame.
    """
    spacing_m, shape = 1e-3 * spacing_mm, np.array(fraction.shape)
    fraction, mass = _upright(fraction, up), _upright(mass, up)
    rotation = _upright_axes(up)
    far_mm = corner_mm + spacing_mm * shape * (rotation.sum(axis=1) < 0)
    density = np.divide(mass, fraction, out=np.zeros_like(mass), where=fraction > 0.25 / FULL)
    nx, ny, nz = fraction.shape
    origin = -spacing_m * np.array([nx // 2, ny // 2, nz], dtype=np.float64)
    return VoxelVolume(
        origin,
        spacing_m,
        np.ascontiguousarray(np.rint(fraction * FULL), dtype=np.uint8),
        np.zeros(fraction.shape, np.uint8),
        np.ascontiguousarray(np.rint(density), dtype=np.uint16),
        (layer_name,),
        Placement(far_mm - 1e3 * rotation @ origin, rotation),
    )


def _cropped(values: NDArray[Any], crop: Crop | None) -> NDArray[Any]:
    if crop is None:
        return values
    first, last = (tuple(int(i) for i in corner) for corner in crop)
    if (
        len(first) != 3
        or len(last) != 3
        or not all(0 <= a < b <= n for a, b, n in zip(first, last, values.shape, strict=True))
    ):
        raise InputError(
            f"crop must be two corners within the image of {values.shape} voxels, got {crop}: "
            f"use for example ((0, 0, 0), {values.shape})"
        )
    return values[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]


def _require_size(shape: tuple[int, ...], from_mm: tuple[float, float, float], to_mm: float) -> None:
    """Refuse a resampling that would take more voxels than are workable."""
    count = math.prod(n * max(size / to_mm, 1.0) for n, size in zip(shape, from_mm, strict=True))
    if count > _MOST_VOXELS:
        fitting = to_mm * (count / _MOST_VOXELS) ** (1.0 / 3.0)
        raise InputError(
            f"resample_mm must leave at most {_MOST_VOXELS:.0e} voxels, got {to_mm:g} which makes "
            f"{count:.2g}: "
            f"crop the image, or use {fitting:.2g} or more"
        )


def _fraction(values: NDArray[Any], threshold: float, full_value: float | None) -> NDArray[np.float32]:
    if full_value is None:
        return (values > threshold).astype(np.float32)
    ramp = 0.5 + (values.astype(np.float32) - threshold) / (2.0 * (full_value - threshold))
    return np.clip(ramp, 0.0, 1.0).astype(np.float32)


def _refined(values: NDArray[Any], from_mm: tuple[float, float, float], to_mm: float) -> NDArray[Any]:
    """Interpolate linearly to `to_mm` along the axes whose spacing is coarser; the others stay."""
    for axis, size in enumerate(from_mm):
        if size <= (1.0 + _ISOTROPY) * to_mm:
            continue
        count = values.shape[axis]
        position = (np.arange(math.floor(count * size / to_mm + 1e-6)) + 0.5) * (to_mm / size) - 0.5
        position = np.clip(position, 0.0, count - 1.0)
        low = np.minimum(position.astype(np.int64), max(count - 2, 0))
        part = (position - low).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        below = np.take(values, low, axis=axis).astype(np.float32)
        above = np.take(values, np.minimum(low + 1, count - 1), axis=axis).astype(np.float32)
        values = below + (above - below) * part
    return values


def _averaged(values: NDArray[np.float32], axis: int, ratio: float) -> NDArray[np.float32]:
    """Mean over runs of `ratio` > 1 voxels along an axis, parts of voxels counted as parts; a rest is dropped."""
    if ratio <= 1.0 + _ISOTROPY:
        return values
    count = values.shape[axis]
    edges = np.arange(math.floor(count / ratio + 1e-6) + 1) * ratio
    if len(edges) < 2:
        raise InputError(
            f"resample_mm must leave a voxel along every axis, got {ratio:g} voxels of {count}: use a finer one"
        )
    running = np.concatenate(
        [
            np.zeros_like(np.take(values, [0], axis=axis), dtype=np.float64),
            np.cumsum(values, axis=axis, dtype=np.float64),
        ],
        axis=axis,
    )
    low = np.minimum(edges.astype(np.int64), count - 1)
    part = (edges - low).reshape([-1 if k == axis else 1 for k in range(3)])
    below, above = np.take(running, low, axis=axis), np.take(running, low + 1, axis=axis)
    return (np.diff(below + (above - below) * part, axis=axis) / ratio).astype(np.float32)


def _upright_axes(up: str) -> NDArray[np.float64]:
    """Axes as columns, in the image's frame, of what `_upright` makes of it."""
    axis, sign = "xyz".index(up[1]), 1.0 if up[0] == "+" else -1.0
    axes = np.zeros((3, 3))
    axes[(axis + 1) % 3, 0], axes[(axis + 2) % 3, 1], axes[axis, 2] = sign, 1.0, sign
    return axes


def _upright(values: NDArray[Any], up: str) -> NDArray[Any]:
    """Turn, without mirroring, so that the axis `up` points along +z."""
    if up not in _UP:
        raise InputError(f"up must be one of {', '.join(_UP)}, got {up}: use +z to keep the file's axes")
    axis = "xyz".index(up[1])
    turned = np.transpose(values, [(axis + 1) % 3, (axis + 2) % 3, axis])
    return turned if up[0] == "+" else turned[::-1, :, ::-1]
