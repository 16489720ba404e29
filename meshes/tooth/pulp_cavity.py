"""The pulp of a scanned tooth without one: the cavity in its dentin, filled."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from meshes.tooth.layers import LAYER_DENSITY_KG_M3, PULP
from meshes.voxels.volume import FULL, VoxelVolume

__all__ = ["PulpCavity", "with_pulp"]

_WIDEST_OPENING_M = 0.8e-3


@dataclass(frozen=True, eq=False)
class PulpCavity:
    """The largest cavity of a whole tooth that a ball wider than 0.8 mm cannot enter from outside.

    Such a ball passes no root canal's mouth, and stays out of the narrow clefts between roots, which are apart from the
    chamber.

    Attributes
    ----------
    tooth
        Voxels of the whole tooth that it was found in.
    inside
        Its voxels, bool, shape of the tooth.
    away_m
        Distance of each voxel from where such a ball can be [m], shape of the tooth.
    """

    tooth: VoxelVolume
    inside: NDArray[np.bool_]
    away_m: NDArray[np.float32]

    @classmethod
    def of(cls, tooth: VoxelVolume) -> PulpCavity | None:
        """Find the cavity of a whole tooth; None where there is none."""
        from scipy.ndimage import distance_transform_edt, label

        margin = int(np.ceil(_WIDEST_OPENING_M / tooth.spacing_m)) + 1
        empty = np.pad(tooth.fraction < FULL / 2, margin, constant_values=True)
        radius = 0.5 * _WIDEST_OPENING_M / tooth.spacing_m
        passages, _ = label(distance_transform_edt(empty) > radius)
        outside = passages == passages[0, 0, 0]
        away = distance_transform_edt(~outside)
        pieces, count = label(empty & (away > radius))
        if count == 0:
            return None
        sizes = np.bincount(pieces.ravel())
        sizes[0] = 0
        inner = tuple(slice(margin, -margin) for _ in range(3))
        inside = pieces[inner] == np.argmax(sizes)
        return cls(tooth, inside, (tooth.spacing_m * away[inner]).astype(np.float32))

    @property
    def volume_m3(self) -> float:
        """Its volume [m3]."""
        return float(np.count_nonzero(self.inside)) * self.tooth.voxel_volume_m3

    def voxels(self, volume: VoxelVolume) -> NDArray[np.bool_]:
        """Voxels of the same tooth, of any size, that lie in the cavity: bool, shape of the volume."""
        index = np.nonzero(volume.fraction < FULL / 2)
        cavity = np.zeros(volume.shape, dtype=bool)
        cavity[index] = self.holds(np.stack([volume.centres_m(axis)[k] for axis, k in enumerate(index)]))
        return cavity

    def holds(self, empty_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points outside all layers [m], shape (3, n), lie in the cavity, shape (n,)."""
        from scipy.ndimage import map_coordinates

        at = (empty_m - self.tooth.origin_m[:, None]) / self.tooth.spacing_m - 0.5
        nearest = np.rint(at).astype(np.int64)
        held = np.asarray(((nearest >= 0) & (nearest < np.array(self.inside.shape)[:, None])).all(axis=0))
        held[held] = self._near[tuple(nearest[:, held])]
        away = map_coordinates(self.away_m, at[:, held], order=1, mode="nearest")
        held[held] = away > 0.5 * _WIDEST_OPENING_M
        return held

    @cached_property
    def _near(self) -> NDArray[np.bool_]:
        """Its voxels and those that touch them by a face."""
        from scipy.ndimage import binary_dilation

        return np.asarray(binary_dilation(self.inside))


def with_pulp(volume: VoxelVolume, cavity: NDArray[np.bool_]) -> VoxelVolume:
    """The volume with its cavity filled by pulp, and the voxels along the cavity's wall filled up as what they are."""
    from scipy.ndimage import binary_dilation

    fraction, layer, density = volume.fraction.copy(), volume.layer.copy(), volume.density_kg_m3.copy()
    fraction[binary_dilation(cavity) & (fraction > 0)] = FULL
    fraction[cavity], layer[cavity] = FULL, PULP
    density[cavity] = round(LAYER_DENSITY_KG_M3["pulp"])
    return replace(volume, fraction=fraction, layer=layer, density_kg_m3=density)
