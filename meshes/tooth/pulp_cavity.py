"""Search for the pulp of a scanned tooth without a pulp label: the cavity in the dentin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from meshes.base.arrays import Array, Bytes, Flags, Singles
from meshes.tooth.layers import DENTIN, ENAMEL, LAYER_DENSITY_KG_M3, PULP
from meshes.voxels.volume import FULL, VoxelVolume

_WIDEST_OPENING_M = 0.8e-3
"""Diameter [m] of the widest opening of a pulp cavity.

The major foramina of molars and premolars are about 0.4 to 0.7 mm wide (Green 1960, Oral Surg
13:728).
"""
_LARGEST_MOUTH_M2 = 1.0e-6
"""Largest area [m2] of one opening in the roots.

A round opening with a diameter of 0.8 mm has an area of 0.5 mm2. The area of the voxel faces in
such an opening is up to twice as large.
"""
_CROWN_LEAK_M2 = 0.05e-6
"""Largest area of openings in the crown [m2].

The value allows small errors of the segmentation, with an area of five voxel faces.
"""
_VOLUME_M3 = (1e-9, 200e-9)
"""Limits of the volume of a pulp cavity [m3].

Mean pulp volumes range from 6 mm3 in lower incisors to 68 mm3 in upper first molars (Fanibunda
1986, Int Endod J 19:194). Pulps of old patients are several times smaller, and pulps of teeth with
open roots are several times larger.
"""
_LEAST_DENTIN = 0.5
"""Smallest share of dentin in the wall of the cavity.

The rest of the wall may be caries, or enamel if the crown is worn.
"""
_ENAMEL_PERCENT = 2.0
"""Percentage of the enamel voxels that may lie below the neck of a tooth, due to mislabelling."""


@dataclass(frozen=True, eq=False)
class PulpCavity:
    """Void in the dentin of a whole tooth that is assumed to be the tooth's pulp.

    A void is the pulp cavity if it has a plausible volume, lies in dentin, and is closed except for
    apical foramina. "Closed" means that a ball wider than 0.8 mm cannot enter the void. It also
    means that all openings lie in the roots and that each has an area of at most 1 mm2. Openings in
    the crown of up to 0.05 mm2 in total are ignored. Fissures, grooves and clefts between roots are
    not pulp cavities, because they are open along their length.

    Attributes
    ----------
    tooth
        Voxels of the whole tooth in which the cavity was found.
    inside
        Mask of the cavity, a bool array with the shape of the voxels of `tooth`.
    away_m
        Distance [m] of each voxel from the set of positions that a ball's centre can reach from
        outside the tooth. The ball has a diameter of 0.8 mm. The array has the shape of the voxels
        of `tooth`.
    """

    tooth: VoxelVolume
    inside: Flags
    away_m: Singles

    @classmethod
    def of(cls, tooth: VoxelVolume) -> PulpCavity | None:
        """Find the cavity of a whole tooth whose crown points along +z, or return None."""
        from scipy.ndimage import distance_transform_edt, find_objects, label

        # Such a ball fits between the tooth and the border, so the border is connected.
        margin = int(np.ceil(_WIDEST_OPENING_M / tooth.spacing_m)) + 1
        empty = np.pad(tooth.fraction < FULL / 2, margin, constant_values=True)
        layer = np.pad(tooth.layer, margin)
        radius = 0.5 * _WIDEST_OPENING_M / tooth.spacing_m
        passages, _ = label(distance_transform_edt(empty) > radius)
        outside = passages == passages[0, 0, 0]
        away = distance_transform_edt(~outside)
        pieces, _ = label(empty & (away > radius))
        sizes = np.bincount(pieces.ravel())
        sizes[0] = 0
        low, high = (volume / tooth.voxel_volume_m3 for volume in _VOLUME_M3)
        candidates = [int(k) for k in np.argsort(sizes)[::-1] if low <= sizes[k] <= high]
        heights = np.nonzero((layer == ENAMEL) & ~empty)[2]
        neck = float(np.percentile(heights, _ENAMEL_PERCENT)) if len(heights) else np.inf
        boxes = find_objects(pieces)
        for number in candidates:
            box = tuple(slice(side.start - 1, side.stop + 1) for side in boxes[number - 1])
            piece = pieces[box] == number
            if _is_closed(piece, empty[box], neck - box[2].start, tooth.spacing_m) and _in_dentin(
                piece, empty[box], layer[box]
            ):
                inner = tuple(slice(margin, -margin) for _ in range(3))
                return cls(
                    tooth,
                    pieces[inner] == number,
                    (tooth.spacing_m * away[inner]).astype(np.float32),
                )
        return None

    @property
    def volume_m3(self) -> float:
        """Volume of the cavity [m3]."""
        return float(np.count_nonzero(self.inside)) * self.tooth.voxel_volume_m3

    def voxels(self, volume: VoxelVolume) -> Flags:
        """Return a mask of the cavity in another voxel volume of the same tooth.

        The voxels of `volume` may have any size. The mask is a bool array with the shape of these
        voxels.
        """
        index = np.nonzero(volume.fraction < FULL / 2)
        cavity = np.zeros(volume.shape, dtype=bool)
        cavity[index] = self.contains(
            np.stack([volume.centres_m(axis)[k] for axis, k in enumerate(index)])
        )
        return cavity

    def contains(self, points_m: Array) -> Flags:
        """Return flags, shape (n,), of the points that lie in the cavity.

        The points [m], shape (3, n), must be outside all layers.
        """
        from scipy.ndimage import map_coordinates

        at = (points_m - self.tooth.origin_m[:, None]) / self.tooth.spacing_m - 0.5
        nearest = np.rint(at).astype(np.int64)
        held = np.asarray(
            ((nearest >= 0) & (nearest < np.array(self.inside.shape)[:, None])).all(axis=0)
        )
        held[held] = self._near[tuple(nearest[:, held])]
        away = map_coordinates(self.away_m, at[:, held], order=1, mode="nearest")
        held[held] = away > 0.5 * _WIDEST_OPENING_M
        return held

    @cached_property
    def _near(self) -> Flags:
        """Mask of the cavity's voxels and of their face neighbours."""
        from scipy.ndimage import binary_dilation

        return np.asarray(binary_dilation(self.inside))


def with_pulp(volume: VoxelVolume, cavity: Flags) -> VoxelVolume:
    """Fill the cavity of a tooth, given as voxels, with pulp.

    Partly filled voxels at the wall of the cavity become full, and keep their layers.
    """
    from scipy.ndimage import binary_dilation

    fraction = volume.fraction.copy()
    layer = volume.layer.copy()
    density = volume.density_kg_m3.copy()
    fraction[binary_dilation(cavity) & (fraction > 0)] = FULL
    fraction[cavity] = FULL
    layer[cavity] = PULP
    density[cavity] = round(LAYER_DENSITY_KG_M3["pulp"])
    return replace(volume, fraction=fraction, layer=layer, density_kg_m3=density)


def _is_closed(piece: Flags, empty: Flags, neck: float, spacing_m: float) -> bool:
    """Return whether all openings of a void lie in the roots and are as small as foramina.

    Parameters
    ----------
    piece
        Mask of the void, with a margin of at least one voxel.
    empty
        Mask of voxels without tissue, same shape as `piece`.
    neck
        Index along z of the neck of the tooth. The crown lies above the neck.
    spacing_m
        Edge of a voxel [m].
    """
    from scipy.ndimage import label

    around = empty & ~piece
    faces = np.zeros(piece.shape, dtype=np.int64)
    for axis in range(3):
        for step in (1, -1):
            faces += piece & np.roll(around, step, axis)
    mouths, count = label(faces > 0, np.ones((3, 3, 3)))
    areas = spacing_m**2 * np.bincount(mouths.ravel(), faces.ravel(), minlength=count + 1)[1:]
    in_crown = spacing_m**2 * float(faces[:, :, np.arange(piece.shape[2]) >= neck].sum())
    return in_crown <= _CROWN_LEAK_M2 and bool((areas <= _LARGEST_MOUTH_M2).all())


def _in_dentin(piece: Flags, empty: Flags, layer: Bytes) -> bool:
    """Return whether most of the wall of a void is dentin."""
    from scipy.ndimage import binary_dilation

    wall = layer[binary_dilation(piece) & ~empty]
    return len(wall) > 0 and float(np.mean(wall == DENTIN)) >= _LEAST_DENTIN
