"""Extraction of bones and other structures from a CT, by a label or by a threshold.

The results are smooth surfaces and the density of bone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from meshes.base.arrays import Array, Flags, Floats, Ints, Singles, box_of, enclosed_volume
from meshes.base.errors import InputError, counted
from meshes.images.bone_image import image_cuts, image_triangles
from meshes.images.frame import Image

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Corners of a box with the smallest and with the largest coordinates [mm, LPS]."""
MARGIN = 3
"""Margin around a bone [voxel], for soft tissue and for interpolation."""
KEPT_MARGIN = 4
"""Margin [voxel] around a piece of a structure that is smoothed.

The value is five times the standard deviation of the smoothing, `SMOOTH_VOXELS`.
"""
SMOOTH_VOXELS = 0.8
"""Standard deviation [voxel] with which a label is smoothed.

Smaller values do not remove the voxel steps of the label, and larger values remove thin parts. For
a bone, the unit is the largest of the three voxel sizes. For a structure that a tool must keep
clear of, the unit is the voxel size along each axis.
"""
NOISE_VOXELS = 0.5
"""Standard deviation [voxel] with which grey values are smoothed before a surface is extracted."""
CLOSED_MM = 1.5
"""Half the width of the widest gaps in a cortex that are closed [mm].

Such gaps are trabecular openings, vessels and partial-volume effects.
"""
SUB = 4
"""Number of points along each edge of a voxel at which the bone fraction is sampled."""
LEAST_SHARE = 0.5
"""Bone fraction above which the density is computed from the voxel's own grey value.

A voxel with a smaller bone fraction gets the density of the nearest voxel above this fraction.
"""
BEYOND_VOXELS = 3
"""Number of voxels by which the density is extended beyond the surface.

The density can then be interpolated up to the surface.
"""
_LISTED = 6
"""Largest number of pieces whose volumes a note lists. A label may have many more fragments."""


@dataclass(frozen=True, eq=False)
class BoneOfImage:
    """A bone in the frame of its CT.

    Attributes
    ----------
    image
        Part of the CT that contains the bone.
    field, level
        Array (field) with the shape of the image, and threshold (level). A voxel is bone if the
        value of the field is above the level.
    triangles
        Vertices [mm, LPS], shape (n, 3), and triangles, shape (m, 3).
    cuts
        Points [m] on the cuts, where the image ends inside the bone: one array, shape (k, 3), for
        each connected cut.
    notes
        Sentences for users.
    label_mm3
        Volume of the label's voxels [mm3]. If the bone was extracted by a threshold, this is the
        volume of the bone including the filled marrow space.
    """

    image: Image
    field: Singles
    level: float
    triangles: tuple[Array, Ints]
    cuts: tuple[Array, ...]
    notes: tuple[str, ...]
    label_mm3: float

    @property
    def volume_mm3(self) -> float:
        """Volume within the triangles [mm3]."""
        return enclosed_volume(*self.triangles)

    def density(self, law: Callable[[Floats], Singles]) -> Image:
        """Compute the apparent density [kg/m3] in and around the bone, and set it to 0 elsewhere.

        A voxel that the surface crosses contains bone and soft tissue. The grey value of such a
        voxel is the weighted mean of the values of bone and soft tissue. If at least half of the
        voxel is bone, the grey value of the bone alone is computed from this mean. Otherwise, the
        voxel gets the density of the nearest voxel that is at least half bone.
        """
        from scipy.ndimage import binary_dilation, distance_transform_edt

        share = self._share()
        # A single voxel slightly above the level may lie between the samples of `_share`.
        inside = (share > 0.0) | (self.field > self.level)
        # Use two voxels of soft tissue, because a single one may be a mixture with bone.
        around = binary_dilation(inside, iterations=2) & ~inside
        values = self.image.values.astype(np.float32)
        soft = np.float32(np.median(values[around])) if around.any() else np.float32(0.0)
        known = share >= LEAST_SHARE
        values[known] = soft + (values[known] - soft) / share[known]
        found = np.zeros(values.shape, dtype=np.float32)
        found[known] = law(values[known])
        away, nearest = distance_transform_edt(~known, return_indices=True)
        near = ~known & ((away <= BEYOND_VOXELS) | inside)
        found[near] = found[tuple(axis[near] for axis in nearest)]
        whole = np.rint(found).astype(np.uint16)
        return replace(self.image, values=whole, notes=())

    def _share(self) -> Singles:
        """Compute the bone fraction of each voxel.

        In a voxel that the surface may cross, the field is interpolated at `SUB`³ points.
        """
        from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

        above = self.field > self.level
        share = above.astype(np.float32)
        crossed = maximum_filter(above, 3) & ~minimum_filter(above, 3)
        at = np.argwhere(crossed)
        steps = (np.arange(SUB) + 0.5) / SUB - 0.5
        total = np.zeros(len(at), dtype=np.float32)
        for shift in product(steps, repeat=3):
            points = (at + np.array(shift)).T
            total += map_coordinates(self.field, points, order=1, mode="nearest") > self.level
        share[crossed] = total / SUB**3
        return share


def cropped(image: Image, box_mm: Box, *, stated_in: str = "LPS") -> Image:
    """Crop an image to the voxels whose centres lie in a box [mm, LPS].

    `stated_in` is the coordinate system in which the user stated the box, LPS or RAS. If the box
    lies in the image when it is read in the other system, the error suggests this system.

    Raises
    ------
    InputError
        If fewer than two voxels remain along an axis.
    """
    spacing = np.array(image.spacing_mm)
    origin = np.array(image.origin_mm)
    # The tolerance keeps voxels whose centres lie on a face of the box in spite of rounding errors.
    first = np.ceil((np.array(box_mm[0]) - origin) / spacing - 1e-6).astype(int).clip(0)
    last = np.floor((np.array(box_mm[1]) - origin) / spacing + 1e-6).astype(int) + 1
    last = np.minimum(last, image.values.shape)
    if (last - first < 2).any():
        low = origin - 0.5 * spacing
        high = low + spacing * image.values.shape
        remedy = "choose corners inside the image"
        # RAS and LPS have opposite signs of x and y
        other = np.sort(np.array(box_mm) * [-1.0, -1.0, 1.0], axis=0)
        if (other[0] >= low).all() and (other[1] <= high).all():
            system = "RAS" if stated_in == "LPS" else "LPS"
            remedy = f"give --coordinates {system} if the corners are in {system}, or {remedy}"
        raise InputError(
            "crop",
            "leave at least two voxels along each axis",
            (
                f"{box_mm[0]} to {box_mm[1]} mm, but {image.source} extends from "
                f"{np.round(low, 1).tolist()} to {np.round(high, 1).tolist()} mm (LPS)"
            ),
            remedy,
        )
    return image.part(tuple(map(slice, first.tolist(), last.tolist())))


def by_label(image: Image, mask: Flags) -> BoneOfImage:
    """Extract the bone that a label marks in an image.

    `mask` has the image's shape. Only the largest connected piece of the label is used.

    The staircase boundary of the label is smoothed. The surface is a level set of the smoothed
    label. The level is chosen so that the surface encloses as many voxel centres as the label has
    voxels. If voxels are small compared with the bone, the volume inside the triangles differs from
    the volume of the label by less than 1 %.
    """
    from scipy.ndimage import gaussian_filter

    marked = int(mask.sum())
    mask, other = largest_component(mask, image.source)
    part, mask = _around(image, mask)
    width_mm = SMOOTH_VOXELS * max(image.spacing_mm)
    sigmas = [width_mm / size for size in image.spacing_mm]
    field = gaussian_filter(mask.astype(np.float32), sigmas, mode="nearest")
    count = int(mask.sum())
    level = float(np.partition(field, field.size - count, axis=None)[field.size - count])
    bone = _bone_of_field(part, field, level, other, count)
    if marked == count:
        return bone
    left_ml = 1e-3 * (marked - count) * float(np.prod(part.spacing_mm))
    note = f"{left_ml:.2g} ml of the label lie in separate pieces and are left out."
    return replace(bone, notes=(*bone.notes, note))


def by_threshold(image: Image, threshold: float) -> BoneOfImage:
    """Extract the largest connected set of voxels above a grey value, and fill its marrow."""
    from scipy.ndimage import binary_dilation, gaussian_filter

    above = image.values > threshold
    piece, other = largest_component(above, image.source)
    part, piece = _around(image, piece)
    whole = filled(piece, part)
    field = gaussian_filter(part.values.astype(np.float32), NOISE_VOXELS, mode="nearest")
    # Marrow inside the piece is set to bone, although it is below the threshold. Voxels outside
    # that do not touch the piece do not belong to this bone. The values of such voxels are moved
    # away from the threshold by a step. With steps of 2 to 50 % of the threshold, the volume of a
    # synthetic humerus changes by 0.1 %.
    step = max(0.1 * abs(threshold), 1.0)
    field[whole & (field <= threshold) & ~(binary_dilation(~whole) & ~piece)] = threshold + step
    apart = ~binary_dilation(whole)
    field[apart] = np.minimum(field[apart], threshold - step)
    return _bone_of_field(part, field, threshold, other, int(whole.sum()))


def _bone_of_field(
    part: Image, field: Singles, level: float, other: float, voxels: int
) -> BoneOfImage:
    """Build the bone that consists of the voxels in which a field is above a level.

    `other` is the size of the second-largest piece, relative to the largest.
    """
    imaged = replace(part, values=field)
    cuts = image_cuts(imaged, threshold=level)
    notes = []
    # A smaller piece is probably not the bone that the user wants.
    if other >= 0.1:
        notes.append(
            f"Only the largest piece is used. The second largest has {other:.0%} of its size: crop "
            "the image to the bone that you want."
        )
    if cuts:
        notes.append(
            f"The bone is cut off at {counted(len(cuts), 'place')} by the edge of the image "
            "or of the crop."
        )
    marked_mm3 = voxels * part.voxel_mm3
    return BoneOfImage(
        part, field, level, image_triangles(imaged, threshold=level), cuts, tuple(notes), marked_mm3
    )


def _around(image: Image, mask: Flags) -> tuple[Image, Flags]:
    """Return the part of an image around a mask, and the corresponding part of the mask."""
    box = box_of(mask, MARGIN)
    return image.part(box), np.ascontiguousarray(mask[box])


def largest_component(mask: Flags, source: str) -> tuple[Flags, float]:
    """Return a mask's largest piece, and the ratio of the second-largest to the largest size.

    Raises
    ------
    InputError
        If the mask is empty.
    """
    from scipy.ndimage import label

    pieces, count = label(mask)
    if count == 0:
        raise InputError(
            "threshold",
            "leave bone",
            f"no voxel above it in {source}",
            "use a lower threshold or another crop",
        )
    sizes = np.bincount(pieces.ravel())[1:]
    largest = int(np.argmax(sizes))
    others = np.delete(sizes, largest)
    return pieces == largest + 1, float(others.max() / sizes[largest]) if len(others) else 0.0


def filled(mask: Flags, image: Image) -> Flags:
    """Fill the marrow space and the pores in a mask of bone.

    Gaps of the cortex are closed first. Then, in each plane normal to an image axis, the regions
    that the mask encloses are filled.

    If the image ends inside a bone, the marrow is enclosed only in planes normal to certain image
    axes. Planes normal to all three image axes are therefore used.
    """
    from scipy.ndimage import binary_fill_holes, distance_transform_edt

    margin = [int(np.ceil(CLOSED_MM / size)) + 1 for size in image.spacing_mm]
    padded = np.pad(mask, [(m, m) for m in margin])
    grown = distance_transform_edt(~padded, sampling=image.spacing_mm) <= CLOSED_MM
    for axis in range(3):
        for k in range(padded.shape[axis]):
            plane = tuple(slice(None) if a != axis else k for a in range(3))
            if grown[plane].any():
                grown[plane] = binary_fill_holes(grown[plane])
    closed = distance_transform_edt(grown, sampling=image.spacing_mm) > CLOSED_MM
    inner = tuple(slice(m, -m) for m in margin)
    kept: Flags = (closed | padded)[inner]
    return kept


def kept_label(image: Image, mask: Flags, name: str) -> tuple[tuple[Array, Ints], tuple[str, ...]]:
    """Return the surface of a structure that a tool must avoid, and notes for the user.

    The surface consists of vertices [mm, LPS], shape (n, 3), and triangles, shape (m, 3).

    Each connected piece of the structure is smoothed separately without changing its volume. Parts
    that are so thin that smoothing would remove them are not smoothed.

    Parameters
    ----------
    image
        Image with the grid of the mask. Its values are not used.
    mask
        Mask of the label's voxels, same shape as the image.
    name
        Name of the label.

    Raises
    ------
    InputError
        If the mask is empty.
    """
    from scipy.ndimage import find_objects, label

    if not mask.any():
        raise InputError(
            "keep_clear",
            "be a label in the cropped image",
            f"{name}, which has no voxels there",
            "widen the crop, or leave this label out",
        )
    box = box_of(mask, KEPT_MARGIN)
    part = replace(image, values=mask.view(np.uint8)).part(box)
    mask = mask[box]
    pieces, count = label(mask, np.ones((3, 3, 3)))
    field = np.full(mask.shape, -1.0, dtype=np.float32)
    for number, around in enumerate(find_objects(pieces), start=1):
        near = tuple(
            slice(max(each.start - KEPT_MARGIN, 0), min(each.stop + KEPT_MARGIN, n))
            for each, n in zip(around, mask.shape, strict=True)
        )
        np.maximum(field[near], _smoothed(pieces[near] == number), out=field[near])
    smooth = replace(part, values=field)
    notes = []
    if count > 1:
        voxel_ml = 1e-3 * image.voxel_mm3
        sizes = voxel_ml * np.sort(np.bincount(pieces.ravel())[1:])[::-1]
        listed = ", ".join(f"{size:.3g}" for size in sizes[:_LISTED])
        more = "" if count <= _LISTED else f" and {counted(count - _LISTED, 'smaller one')}"
        notes.append(
            f"{name}: {count} pieces of {listed} ml{more}, all of them structures to keep clear of"
        )
    cuts = len(image_cuts(smooth, threshold=0.0))
    if cuts:
        places = counted(cuts, "place")
        notes.append(
            f"{name}: it is cut off at {places} by the edge of the image or of the crop, and is "
            "unknown beyond this edge"
        )
    return image_triangles(smooth, threshold=0.0), tuple(notes)


def _smoothed(piece: Flags) -> Singles:
    """Smooth a mask, and return a field whose number of positive voxels equals that of the mask.

    Near every voxel of the mask, the field has a positive value.
    """
    from scipy.ndimage import binary_dilation, gaussian_filter

    field = gaussian_filter(piece.astype(np.float32), SMOOTH_VOXELS, mode="nearest")
    outside = field.size - int(np.count_nonzero(piece))
    below, above = (
        np.partition(field, (outside - 1, outside), axis=None)[[outside - 1, outside]]
        if outside
        # If the piece fills its whole box, the level 0.5 places the surface at the faces of the
        # box.
        else (0, 1)
    )
    field -= np.float32(0.5 * (below + above))
    lost = piece & ~binary_dilation(field > 0.0, np.ones((3, 3, 3)))
    # With half the value of a full voxel, the surface encloses the voxel without smoothing.
    field[lost] = 0.5
    return field
