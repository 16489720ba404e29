"""A bone out of a CT: its smooth surface, and its density up to the surface, by a label or by a threshold."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, counted
from meshes.base.simplices import enclosed_volume
from meshes.ct.threshold import filled, largest_component
from meshes.images.frame import Image, box_of, part_of
from meshes.images.threshold_surface import image_cuts, image_triangles

__all__ = ["BoneOfImage", "by_label", "by_threshold", "cropped"]

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lowest and highest corner [mm, LPS]."""
MARGIN = 3
"""Voxels around the bone that are kept: its soft tissue, and what interpolation needs."""
SMOOTH_VOXELS = 0.8
"""Width (sd) of the smoothing of a label, in its coarsest voxels: less leaves its steps, more takes thin parts away."""
NOISE_VOXELS = 0.5
"""Width (sd) of the smoothing of grey values before a surface is laid through them, in voxels."""
SUB = 4
"""Points along each edge of a voxel at which it is asked what of it is bone."""
LEAST_SHARE = 0.5
"""Of a voxel that must be bone for its own value to count; others take that of the nearest such voxel."""
BEYOND_VOXELS = 3
"""Voxels outside the surface into which the density goes on, so that it can be interpolated up to it."""


@dataclass(frozen=True, eq=False)
class BoneOfImage:
    """A bone in the frame of its CT.

    Attributes
    ----------
    image
        The part of the CT that holds it.
    field, level
        What is bone: where the field, of the image's shape, is above the level.
    triangles
        Vertices [mm, LPS], shape (n, 3), and triangles, shape (m, 3).
    cuts
        Points [m] of each face at which the edge of the image cuts it off.
    notes
        A sentence each.
    label_mm3
        Volume of the voxels of the label or of what lies above the threshold [mm3].
    """

    image: Image
    field: NDArray[np.float32]
    level: float
    triangles: tuple[NDArray[np.float64], NDArray[np.int64]]
    cuts: tuple[NDArray[np.float64], ...]
    notes: tuple[str, ...]
    label_mm3: float

    @property
    def volume_mm3(self) -> float:
        """Volume that the triangles enclose [mm3]."""
        return enclosed_volume(*self.triangles)

    def density(self, law: Callable[[NDArray[np.floating]], NDArray[np.float32]]) -> Image:
        """Apparent density [kg/m3] of the bone and of some voxels around it, 0 elsewhere.

        A voxel that the surface crosses holds bone and soft tissue: its grey value is that of both by their shares, so
        the bone's is had from it where at least half is bone, and from the nearest such voxel elsewhere.
        """
        from scipy.ndimage import binary_dilation, distance_transform_edt

        share = self._share()
        inside = share > 0.0
        around = binary_dilation(inside, iterations=2) & ~inside
        values = self.image.values.astype(np.float32)
        soft = np.float32(np.median(values[around])) if around.any() else np.float32(0.0)
        known = share >= LEAST_SHARE
        values[known] = soft + (values[known] - soft) / share[known]
        found = np.zeros(values.shape, dtype=np.float32)
        found[known] = law(values[known])
        away, nearest = distance_transform_edt(~known, return_indices=True)
        near = ~known & (away <= BEYOND_VOXELS)
        found[near] = found[tuple(axis[near] for axis in nearest)]
        whole = np.rint(found).astype(np.uint16)
        return replace(self.image, values=whole, notes=())

    def _share(self) -> NDArray[np.float32]:
        """Share of each voxel that is bone, the field interpolated within those that the surface crosses."""
        from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

        above = self.field > self.level
        share = above.astype(np.float32)
        crossed = maximum_filter(above, 3) & ~minimum_filter(above, 3)
        at = np.argwhere(crossed)
        steps = (np.arange(SUB) + 0.5) / SUB - 0.5
        total = np.zeros(len(at), dtype=np.float32)
        for dx in steps:
            for dy in steps:
                for dz in steps:
                    points = (at + np.array([dx, dy, dz])).T
                    total += map_coordinates(self.field, points, order=1, mode="nearest") > self.level
        share[crossed] = total / SUB**3
        return share


def cropped(image: Image, box_mm: Box) -> Image:
    """The voxels of an image whose centres lie in a box [mm, LPS].

    Raises
    ------
    InputError
        If none do.
    """
    spacing, origin = np.array(image.spacing_mm), np.array(image.origin_mm)
    first = np.ceil((np.array(box_mm[0]) - origin) / spacing - 1e-6).astype(int).clip(0)
    last = np.floor((np.array(box_mm[1]) - origin) / spacing + 1e-6).astype(int) + 1
    last = np.minimum(last, image.values.shape)
    if (last - first < 2).any():
        low, high = origin - 0.5 * spacing, origin + spacing * (np.array(image.values.shape) - 0.5)
        raise InputError(
            f"crop must leave two voxels or more along each axis, got {box_mm[0]} to {box_mm[1]} mm where "
            f"{image.source} reaches from {np.round(low, 1).tolist()} to {np.round(high, 1).tolist()} mm (LPS): choose "
            "corners inside"
        )
    return part_of(image, tuple(map(slice, first.tolist(), last.tolist())))


def by_label(image: Image, mask: NDArray[np.bool_]) -> BoneOfImage:
    """The bone that a label marks; `mask` has the image's shape.

    The steps of the label are smoothed away. The level of the surface leaves as many voxels above it as the label has;
    the volume within the triangles differs from the label's by under 1 % where voxels are small against the bone.
    """
    from scipy.ndimage import gaussian_filter

    mask, other = largest_component(mask, image.source)
    part, mask = _around(image, mask)
    width_mm = SMOOTH_VOXELS * max(image.spacing_mm)
    sigmas = [width_mm / size for size in image.spacing_mm]
    field = gaussian_filter(mask.astype(np.float32), sigmas, mode="nearest")
    count = int(mask.sum())
    level = float(np.partition(field, field.size - count, axis=None)[field.size - count])
    return _laid(part, field, level, _of_pieces(other), count)


def by_threshold(image: Image, threshold: float) -> BoneOfImage:
    """The largest piece of what lies above a grey value, its marrow filled."""
    from scipy.ndimage import binary_dilation, gaussian_filter

    above = image.values > threshold
    piece, other = largest_component(above, image.source)
    part, piece = _around(image, piece)
    whole = filled(piece, part)
    field = gaussian_filter(part.values.astype(np.float32), NOISE_VOXELS, mode="nearest")
    # Inside, marrow below the threshold is bone; outside, what touches no voxel of the piece is not this bone.
    step = max(0.1 * abs(threshold), 1.0)
    field[whole & (field <= threshold) & ~(binary_dilation(~whole) & ~piece)] = threshold + step
    field[~binary_dilation(whole)] = np.minimum(field, threshold - step)[~binary_dilation(whole)]
    return _laid(part, field, threshold, _of_pieces(other), int(whole.sum()))


def _of_pieces(other: float) -> list[str]:
    """What a person should know of pieces that were left out."""
    if other < 0.1:
        return []
    return [f"The next piece has {other:.0%} of the size of the one that was taken: crop to the bone that is meant."]


def _laid(part: Image, field: NDArray[np.float32], level: float, notes: list[str], voxels: int) -> BoneOfImage:
    """The bone where a field is above a level, which a label or threshold marks in so many voxels."""
    imaged = replace(part, values=field)
    triangles = image_triangles(imaged, threshold=level)
    cuts = image_cuts(imaged, threshold=level)
    if cuts:
        notes.append(f"The bone is cut off at {counted(len(cuts), 'place')} by the edge of the image or of the crop.")
    marked_mm3 = voxels * float(np.prod(part.spacing_mm))
    return BoneOfImage(part, field, level, triangles, cuts, tuple(notes), marked_mm3)


def _around(image: Image, mask: NDArray[np.bool_]) -> tuple[Image, NDArray[np.bool_]]:
    """The part of an image around a mask, and the mask there."""
    box = box_of(mask, MARGIN)
    return part_of(image, box), np.ascontiguousarray(mask[box])
