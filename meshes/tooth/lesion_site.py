"""The site over a lesion of a tooth: straight in from the nearest point of the tooth's outer surface."""

import numpy as np

from meshes.base.arrays import Array, Singles
from meshes.base.errors import InputError
from meshes.surfaces.site import Site
from meshes.tooth.layers import CARIES
from meshes.voxels.volume import FULL, VoxelVolume

__all__ = ["lesion_site"]

_SMOOTH_M = 0.3e-3
_AROUND_M = 0.5e-3
_BEYOND_M = 1.0e-3
_UPRIGHT = 0.7


def lesion_site(tooth: VoxelVolume) -> Site:
    """Site over the middle of a tooth's largest lesion.

    The outward normal is that of the outer surface, smoothed over 0.3 mm, at its point nearest to the lesion's middle;
    the origin is where the line along it through the middle leaves the tooth. Where the normal leans far from the
    tooth's axis y points to the crown, else x lies as in the tooth's frame.

    Parameters
    ----------
    tooth
        Voxels of the whole tooth in its own frame, z from the roots to the crown, its pulp filled.

    Raises
    ------
    InputError
        If the tooth has no lesion.
    """
    from scipy.ndimage import binary_fill_holes, gaussian_filter, label

    lesion = (tooth.layer == CARIES) & (tooth.fraction >= FULL // 2)
    if not lesion.any():
        raise InputError("site must not be caries for a tooth without a lesion, got caries: use enamel")
    pieces, _ = label(lesion)
    largest = np.argmax(np.bincount(pieces.ravel())[1:]) + 1
    middle = np.argwhere(pieces == largest).mean(axis=0)
    pad = int(np.ceil(3.0 * _SMOOTH_M / tooth.spacing_m))
    solid = binary_fill_holes(np.pad(tooth.fraction >= FULL // 2, pad))
    smooth = gaussian_filter(solid.astype(np.float32), _SMOOTH_M / tooth.spacing_m)
    normal, surface = _outward(smooth, middle + pad, tooth.spacing_m)
    reach = float(np.linalg.norm(surface - middle - pad)) * tooth.spacing_m + _BEYOND_M
    steps = np.arange(0.0, reach / tooth.spacing_m, 0.1)
    line = np.rint(middle + pad + steps[:, None] * normal).astype(int)
    line = np.clip(line, 0, np.array(solid.shape) - 1)
    filled = np.flatnonzero(solid[tuple(line.T)])
    end = steps[filled[-1]] if len(filled) else 0.0
    centre = tooth.origin_m + tooth.spacing_m * (middle + end * normal + 0.5)
    first = np.array([1.0, 0.0, 0.0]) if abs(normal[2]) > _UPRIGHT else np.cross([0.0, 0.0, 1.0], normal)
    x = first - (first @ normal) * normal
    x /= np.linalg.norm(x)
    depth_mm = 1e3 * tooth.spacing_m * float(end)
    note = f"over the caries, whose middle lies {depth_mm:.2g} mm below along the normal of the surface"
    return Site(centre, np.column_stack([x, np.cross(normal, x), normal]), note)


def _outward(smooth: Singles, middle: Array, spacing: float) -> tuple[Array, Array]:
    """Mean outward normal around the point of the surface nearest to the middle, and that point [voxels]."""
    shell = np.argwhere((smooth > 0.3) & (smooth < 0.7)).astype(np.float64)
    nearest = shell[np.argmin(np.linalg.norm(shell - middle, axis=1))]
    around = shell[np.linalg.norm(shell - nearest, axis=1) * spacing < _AROUND_M].astype(int)
    slopes = [np.gradient(smooth, axis=axis)[tuple(around.T)].sum() for axis in range(3)]
    normal = -np.array(slopes, dtype=np.float64)
    return normal / np.linalg.norm(normal), nearest
