"""The pulp of a scanned tooth without one: the cavity in its dentin, filled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from meshes.tooth_layers import LAYER_DENSITY_KG_M3, PULP
from meshes.volume import FULL, VoxelVolume

__all__ = ["pulp_cavity", "with_pulp"]

_WIDEST_OPENING_M = 0.8e-3


def pulp_cavity(volume: VoxelVolume) -> NDArray[np.bool_]:
    """Voxels less than half full of the largest cavity that a ball wider than 0.8 mm cannot enter from outside.

    Such a ball passes no root canal's mouth, and stays out of the narrow clefts between roots, which are apart from the
    chamber.

    Returns
    -------
    Flags, shape of the volume; none set where there is no cavity.
    """
    from scipy.ndimage import distance_transform_edt, label

    margin = int(np.ceil(_WIDEST_OPENING_M / volume.spacing_m)) + 1
    empty = np.pad(volume.fraction < FULL / 2, margin, constant_values=True)
    radius = 0.5 * _WIDEST_OPENING_M / volume.spacing_m
    ways, _ = label(distance_transform_edt(empty) > radius)
    outside = ways == ways[0, 0, 0]
    enclosed = empty & (distance_transform_edt(~outside) > radius)
    pieces, count = label(enclosed)
    inner = tuple(slice(margin, -margin) for _ in range(3))
    if count == 0:
        return np.zeros(volume.shape, dtype=bool)
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    return pieces[inner] == np.argmax(sizes)


def with_pulp(volume: VoxelVolume, cavity: NDArray[np.bool_]) -> VoxelVolume:
    """The volume with its cavity filled by pulp, and the voxels along the cavity's wall filled up as what they are."""
    from scipy.ndimage import binary_dilation

    fraction, layer, density = volume.fraction.copy(), volume.layer.copy(), volume.density_kg_m3.copy()
    fraction[binary_dilation(cavity) & (fraction > 0)] = FULL
    fraction[cavity], layer[cavity] = FULL, PULP
    density[cavity] = round(LAYER_DENSITY_KG_M3["pulp"])
    return VoxelVolume(volume.origin_m, volume.spacing_m, fraction, layer, density, volume.layer_names)
