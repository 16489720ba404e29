"""Class for bone in voxels, each with bone fraction, layer and density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.arrays import Array, Bytes, box_of
from meshes.base.errors import InputError, enumerated, require_positive, require_vector
from meshes.base.placement import Placement

DENSEST_KG_M3 = 2e4
"""Largest accepted density [kg/m3], the density of the densest implant metals.

A larger value indicates that the densities are in another unit.
"""
FULL = 255
"""Stored fraction of a voxel that is completely bone."""


@dataclass(frozen=True, eq=False)
class VoxelVolume:
    """Block of cubic voxels with the bone fraction of each voxel.

    Attributes
    ----------
    origin_m
        Lowest corner of voxel (0, 0, 0) [m], shape (3,), float64.
    spacing_m
        Edge of a voxel [m].
    fraction
        Bone fraction of each voxel, uint8, shape (nx, ny, nz). The value 255 means full.
    layer
        Index into `layer_names`, uint8, shape (nx, ny, nz). The index has no meaning in a voxel
        with a bone fraction of 0.
    density_kg_m3
        Apparent density of the bone in the voxel [kg/m3], uint16, shape (nx, ny, nz).
    layer_names
        Name of each layer.
    placement
        Placement of the volume's frame in the frame of the bone's file. It is None if the bone was
        not read from a file.
    surface_distance
        Signed distance from each voxel's centre to the bone's surface, uint8, shape (nx, ny, nz).
        For the encoding, see `meshes.voxels.distances`. If None, this distance is computed from the
        fractions when needed.
    layer_distance
        Distance from each voxel's centre to the nearest boundary between layers, uint8, shape (nx,
        ny, nz). If None, this distance is computed from the layers when needed.

    Raises
    ------
    InputError
        If arrays differ in shape or type, are not C-contiguous, or a layer has no name.
    """

    origin_m: Array
    spacing_m: float
    fraction: Bytes
    layer: Bytes
    density_kg_m3: NDArray[np.uint16]
    layer_names: tuple[str, ...]
    placement: Placement | None = None
    surface_distance: Bytes | None = None
    layer_distance: Bytes | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin_m", require_vector("origin_m", self.origin_m))
        require_positive("spacing_m", self.spacing_m, "use about 1e-4 (0.1 mm)")
        for name, kind in (
            ("fraction", np.uint8),
            ("layer", np.uint8),
            ("density_kg_m3", np.uint16),
        ):
            _require_array(name, getattr(self, name), kind, self.fraction.shape)
        highest = int(self.layer.max())
        if highest >= len(self.layer_names):
            raise InputError(
                "layer",
                "contain indices of layer_names",
                f"{highest} with {len(self.layer_names)} names",
                "name every layer",
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along x, y and z."""
        nx, ny, nz = self.fraction.shape
        return nx, ny, nz

    @property
    def voxel_volume_m3(self) -> float:
        """Volume of one full voxel [m3]."""
        return self.spacing_m**3

    @property
    def bounds_m(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates [m] of the voxel block, two arrays of shape (3,)."""
        return self.origin_m, self.origin_m + self.spacing_m * np.array(self.shape)

    @property
    def bone_bounds_m(self) -> tuple[Array, Array]:
        """Corners [m] of a box around the bone: lowest and highest coordinates, each shape (3,)."""
        box = box_of(self.fraction > 0)
        low = np.array([side.start for side in box])
        high = np.array([side.stop for side in box])
        return self.origin_m + self.spacing_m * low, self.origin_m + self.spacing_m * high

    def volume_m3(self, layer: str | None = None) -> float:
        """Compute the bone volume [m3] of one layer or of all layers.

        Raises
        ------
        InputError
            If the layer is unknown. The message lists the known layers.
        """
        if layer is not None and layer not in self.layer_names:
            raise InputError(
                "layer",
                f"be one of {enumerated(self.layer_names, 'or')}",
                layer,
                "use one of these names",
            )
        inside = True if layer is None else self.layer == self.layer_names.index(layer)
        return (
            float(np.sum(self.fraction, where=inside, dtype=np.int64)) / FULL * self.voxel_volume_m3
        )

    def centres_m(self, axis: int) -> Array:
        """Return the coordinates [m] of the voxel centres along one axis, shape (n_axis,)."""
        return self.origin_m[axis] + self.spacing_m * (np.arange(self.shape[axis]) + 0.5)


def _require_array(
    name: str, array: NDArray[np.generic], dtype: type, shape: tuple[int, ...]
) -> None:
    if array.ndim != 3 or 0 in array.shape or array.shape != shape:
        raise InputError(
            name,
            "have the shape (nx, ny, nz) of fraction, without a zero",
            array.shape,
            "give all three arrays the same shape",
        )
    if array.dtype != dtype or not array.flags.c_contiguous:
        raise InputError(
            name,
            f"be a C-contiguous {np.dtype(dtype)} array",
            array.dtype,
            f"use numpy.ascontiguousarray(array, dtype='{np.dtype(dtype)}')",
        )


def density_volume(
    density_kg_m3: ArrayLike,
    *,
    spacing_mm: float,
    origin_mm: ArrayLike = (0.0, 0.0, 0.0),
    layer: ArrayLike | None = None,
    layer_names: tuple[str, ...] = ("bone",),
    margin: int = 0,
) -> VoxelVolume:
    """Make a voxel volume from densities. Voxels with a density above 0 are completely bone.

    Parameters
    ----------
    density_kg_m3
        Apparent density of each voxel [kg/m3], shape (nx, ny, nz), 0 to 20000.
    spacing_mm
        Edge of a voxel [mm].
    origin_mm
        Corner of voxel (0, 0, 0) with the lowest coordinates [mm].
    layer
        Layer index of each voxel, same shape. Default: 0 for all voxels.
    layer_names
        Name of each layer.
    margin
        Number of empty voxels that are added on each side. If `margin` is 0, the force on a cutter
        is up to 3 % too low where bone extends to the edge of the array. The reason is that the
        bone's surface is interpolated between voxels inside and outside the bone, and there are no
        voxels outside the array.

    Raises
    ------
    InputError
        If an array has a wrong shape, is not finite, is out of range, or contains no bone.
    """
    density = np.asarray(density_kg_m3, dtype=np.float64)
    if density.ndim != 3 or 0 in density.shape:
        raise InputError(
            "density_kg_m3",
            "have the shape (nx, ny, nz)",
            density.shape,
            "give one value per voxel",
        )
    if not np.isfinite(density).all() or density.min() < 0.0 or density.max() > DENSEST_KG_M3:
        raise InputError(
            "density_kg_m3",
            f"be finite and from 0 to {DENSEST_KG_M3:g}",
            f"{density.min():g} to {density.max():g}",
            "use 0 for no bone and 1800 for cortical bone",
        )
    if not density.any():
        raise InputError(
            "density_kg_m3",
            "contain bone",
            "0 everywhere",
            "give a positive density where there is bone",
        )
    numbers = np.zeros(density.shape, dtype=np.uint8) if layer is None else np.asarray(layer)
    if numbers.shape != density.shape or numbers.min() < 0 or numbers.max() >= len(layer_names):
        raise InputError(
            "layer",
            f"have the shape {density.shape} with numbers from 0 to {len(layer_names) - 1}",
            f"shape {numbers.shape} with {numbers.min()} to {numbers.max()}",
            "name every layer in layer_names",
        )
    spacing_m = 1e-3 * require_positive("spacing_mm", spacing_mm, "use about 0.1")
    origin_m = 1e-3 * require_vector("origin_mm", origin_mm)
    density = np.pad(density, margin)
    numbers = np.pad(numbers, margin, mode="edge")
    return VoxelVolume(
        origin_m - margin * spacing_m,
        spacing_m,
        np.where(density > 0.0, np.uint8(FULL), np.uint8(0)),
        np.ascontiguousarray(numbers, dtype=np.uint8),
        np.rint(density).astype(np.uint16),
        tuple(layer_names),
    )
