"""Smooth surface of a label, without voxel steps and with the volume of its voxels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.simplices import enclosed_volume
from meshes.images.bone_image import spread_labels
from meshes.images.frame import box_of

__all__ = ["LabelGrid", "label_triangles"]

Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]
_PER_RADIUS = 1.0 / 3.0
"""Deviation of the smoothing over the label's radius.

On ellipsoids, smaller values leave steps and larger ones round them off.
"""
_DEVIATIONS = (1.0, 2.0)
"""Bounds of the deviation [voxel].

Beyond 2, the thin edge of an organ of ordinary voxels is lost.
"""
_REACH = 4.0
"""Deviations around a label that its share depends on."""
_LEVELS = (0.25, 0.75)
"""Bounds of the level that encloses the volume of the voxels."""
_SLOPE = -1.0
"""First guess of how the volume's share falls with the level; later ones are secants."""
_TRIES = 6
_CLOSE = 2e-4
"""Largest number of meshes in the search for the level, and the accepted volume error.

The volume error is a share of the volume.
"""


@dataclass(frozen=True)
class LabelGrid:
    """Position of the voxels of a label image.

    Attributes
    ----------
    spacing_mm
        Distance between neighbours along x, y and z [mm].
    origin_mm
        Centre of voxel (0, 0, 0) [mm].
    """

    spacing_mm: tuple[float, float, float]
    origin_mm: tuple[float, float, float]

    @property
    def voxel_mm3(self) -> float:
        """Volume of a voxel [mm3]."""
        return float(np.prod(self.spacing_mm))

    def within(self, first: tuple[int, ...]) -> "LabelGrid":
        """Return the same grid starting at another first voxel."""
        x, y, z = (
            start + side * index
            for start, side, index in zip(self.origin_mm, self.spacing_mm, first, strict=True)
        )
        return LabelGrid(self.spacing_mm, (x, y, z))


def label_triangles(mask: NDArray[np.bool_], grid: LabelGrid) -> Triangles | None:
    """Return the smooth closed surface of a label, wound outward.

    It consists of vertices [m], shape (n, 3), and triangles, shape (m, 3).

    The label is spread by a kernel that keeps curved surfaces in place, two voxels or a third of
    the label's radius wide. The surface is the level that encloses the volume of the voxels. At the
    end of the image the label ends.

    Parameters
    ----------
    mask
        Voxels of the label.
    grid
        Place of the voxels.

    Returns
    -------
    None if the label has too few voxels for a surface.
    """
    from scipy.ndimage import distance_transform_edt

    pad = int(np.ceil(_REACH * _DEVIATIONS[1])) + 2
    crop = box_of(mask)
    padded = np.pad(mask[crop], pad)
    radius = float(distance_transform_edt(padded).max())
    deviation = float(np.clip(_PER_RADIUS * radius, *_DEVIATIONS))
    share = spread_labels(padded.astype(np.float32), deviation)
    place = grid.within(tuple(each.start - pad for each in crop))
    wanted_m3 = 1e-9 * grid.voxel_mm3 * float(np.count_nonzero(mask))
    low = _LEVELS[0]
    high = min(_LEVELS[1], float(share.max()))
    if low >= high:
        return None
    level = min(0.5, 0.5 * (low + high))
    before = (0.0, 0.0)
    for attempt in range(_TRIES):
        found = _level(share, level, place)
        off = enclosed_volume(*found) / wanted_m3 - 1.0
        if abs(off) < _CLOSE:
            break
        slope = (off - before[0]) / (level - before[1]) if attempt else _SLOPE
        before = off, level
        level = float(np.clip(level - off / min(slope, _SLOPE / 10.0), low, high - 1e-3))
    return found


def _level(share: NDArray[np.float32], level: float, grid: LabelGrid) -> Triangles:
    from skimage.measure import marching_cubes

    vertices, faces, _, _ = marching_cubes(share, level, spacing=grid.spacing_mm)
    vertices = 1e-3 * (vertices.astype(np.float64) + grid.origin_mm)
    return vertices, faces[:, ::-1].astype(np.int64)
