"""Voxels of an array of densities."""

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.errors import InputError, require_positive, require_vector
from meshes.voxels.volume import FULL, VoxelVolume

__all__ = ["density_volume"]

DENSEST_KG_M3 = 2e4


def density_volume(
    density_kg_m3: ArrayLike,
    *,
    spacing_mm: float,
    origin_mm: ArrayLike = (0.0, 0.0, 0.0),
    layer: ArrayLike | None = None,
    layer_names: tuple[str, ...] = ("bone",),
    margin: int = 0,
) -> VoxelVolume:
    """Voxels that are bone throughout where the density is not 0.

    Parameters
    ----------
    density_kg_m3
        Apparent density of each voxel [kg/m3], shape (nx, ny, nz), 0 to 20000.
    spacing_mm
        Edge of a voxel [mm].
    origin_mm
        Corner of the first voxel with the lowest coordinates [mm].
    layer
        Number of each voxel's layer, same shape; default all 0.
    layer_names
        Name of each layer.
    margin
        Empty voxels added on each side. Without any, the force on a cutter at bone that fills the array to its edge
        is up to 3 % low, because the surface is interpolated between voxels on both sides of it.

    Raises
    ------
    InputError
        If an array has another shape, is not finite or out of range, or holds no bone.
    """
    density = np.asarray(density_kg_m3, dtype=np.float64)
    if density.ndim != 3 or 0 in density.shape:
        raise InputError(f"density_kg_m3 must have the shape (nx, ny, nz), got {density.shape}: give one value a voxel")
    if not np.isfinite(density).all() or density.min() < 0.0 or density.max() > DENSEST_KG_M3:
        raise InputError(
            f"density_kg_m3 must be finite from 0 to {DENSEST_KG_M3:g}, got {density.min():g} to {density.max():g}: 0 "
            "is no bone, 1800 is cortical bone"
        )
    if not density.any():
        raise InputError("density_kg_m3 must hold bone, got 0 everywhere: give its density where there is bone")
    numbers = np.zeros(density.shape, dtype=np.uint8) if layer is None else np.asarray(layer)
    if numbers.shape != density.shape or numbers.min() < 0 or numbers.max() >= len(layer_names):
        raise InputError(
            f"layer must have the shape {density.shape} with numbers from 0 to {len(layer_names) - 1}, got shape "
            f"{numbers.shape} with {numbers.min()} to {numbers.max()}: name every layer in layer_names"
        )
    spacing_m = 1e-3 * require_positive("spacing_mm", spacing_mm, "use about 0.1")
    origin_m = 1e-3 * require_vector("origin_mm", np.asarray(origin_mm, dtype=np.float64))
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
