"""Label volumes with the names of their labels.

A file contains labels as one volume, several overlapping layers, masks, or a DICOM object.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Flags, Numbers
from meshes.base.errors import InputError, by, enumerated, is_folder
from meshes.ct.dicom_labels import Masks, dicom_masks
from meshes.ct.label_names import (
    MOST_LABELS,
    Segment,
    apart,
    given_names,
    header_names,
    shared_names,
    slicer_segments,
)
from meshes.images.frame import Image, StoredImage, along_lps
from meshes.images.plane_files import plane_files
from meshes.images.reading import IMAGE_SUFFIXES, Spacing, read_image, stored_image

__all__ = ["Labels", "header_names", "on_grid_of", "read_labels"]

_MOST_DIFFERENT = 1000
"""Largest number of labels in a volume. An image with more values is not a segmentation."""
_ROUNDED = 0.01
"""Largest difference between a label and an integer.

Some programs store labels as scaled floats.
"""
_SAME_PLACE = 1e-2
"""Largest distance [voxel] between the voxel centres of two equal grids."""
_LOST = 0.05
"""Share of a label's voxels outside an image above which a note is written."""
_SHOWN_NAMES = 12
"""Largest number of names that an error message lists."""


def unnamed(number: int) -> str:
    """Return the name of a label for which the file states no name."""
    return f"label {number}"


@dataclass(frozen=True, eq=False)
class Labels:
    """Label volume in the patient frame LPS [mm], and the names of its labels.

    Attributes
    ----------
    image
        Label number of each voxel, shape (nx, ny, nz). The number 0 means no label.
    names
        Dictionary from the number of each label in the volume to its name.
    overlaps
        Dictionary from each number that stands for several labels to the numbers of these labels.
        For example, ``{9: (1, 4)}`` means that a voxel with the value 9 belongs to the labels 1 and
        4.
    """

    image: Image
    names: Mapping[int, str]
    overlaps: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    def number(self, name: str) -> int:
        """Return the number of a label. `name` may also be this number, as text.

        Raises
        ------
        InputError
            If no label has this name. The message lists the available names.
        """
        found = [
            number for number, each in self.names.items() if each == name or str(number) == name
        ]
        if not found:
            known = list(self.names.values())
            near = [each for each in known if name in each or each in name] or known
            shown = ", ".join(near[:_SHOWN_NAMES])
            more = f" and {len(near) - _SHOWN_NAMES} more" if len(near) > _SHOWN_NAMES else ""
            remedy = f"use {shown}" if len(near) == 1 else f"use one of {shown}{more}"
            # the file states no names
            if all(each == unnamed(number) for number, each in self.names.items()):
                remedy += ", or name the labels by --label-names"
            raise InputError("label", f"be a label of {self.image.source}", name, remedy)
        return found[0]

    def mask(self, name: str) -> Flags:
        """Return a mask of the voxels of all labels named `name`, with the shape of the image.

        This method raises the same errors as `number`.
        """
        one = self.number(name)
        alike = [number for number, each in self.names.items() if each == self.names[one]]
        alike += [each for each, held in self.overlaps.items() if not set(alike).isdisjoint(held)]
        # A comparison is several times faster than `isin`, and usually only one label has the name.
        found: Flags = (
            self.image.values == one if len(alike) == 1 else np.isin(self.image.values, alike)
        )
        return found

    def only(self, names: Iterable[str]) -> "Labels":
        """Return a copy that contains only the labels with the given names.

        A voxel with several labels gets the label that comes last in `names`.
        """
        values = np.zeros_like(self.image.values)
        kept = {}
        for name in names:
            number = self.number(name)
            values[self.mask(name)] = number
            kept[number] = self.names[number]
        return Labels(replace(self.image, values=values), kept)


def read_labels(
    path: str | Path,
    *,
    names: str | Path | None = None,
    spacing_mm: Spacing | None = None,
    image: Image | None = None,
) -> Labels:
    """Read labels and their names from a file or folder.

    Parameters
    ----------
    path
        One of: an image whose values are labels (such as a `.seg.nrrd` or `.nii.gz` file), a folder
        of TIFF or PNG slices, a DICOM segmentation or structure set, or a folder of masks. Each
        mask is a file with the name of its label.
    names
        Name of a set from `meshes.ct.label_names.label_sets`, or a TOML file whose table
        ``[labels]`` assigns a number to each name. If None, the names in the file's header are
        used, or ``label 1`` and so on if the header has no names.
    spacing_mm
        Distance between neighbouring voxels [mm], one number or one per axis. It is needed only if
        the file does not state the distance.
    image
        CT to which the labels belong. The outlines of a structure set are drawn on the voxels of
        the CT. Oblique labels are resampled at the voxel centres of the CT.

    Raises
    ------
    InputError
        If a file cannot be read, values are not labels, masks lie on different grids, or a label
        has no name.
    """
    path = Path(path)
    found = dicom_masks(path, image)
    if found is not None:
        labels = _overlaid(found, path.name, image)
        stated = {} if names is None else given_names(names)
        named = {number: stated.get(number, name) for number, name in labels.names.items()}
        return replace(labels, names=named)
    if is_folder(path) and not plane_files(path):
        if names is not None:
            raise InputError(
                "names",
                "be left out for a folder of masks, because the file names are the names",
                names,
                "rename the files instead",
            )
        return _of_masks(path)
    labels = _of_volume(path, spacing_mm, image)
    if names is not None:
        stated = given_names(names)
        if unknown := [number for number in labels.names if number not in stated]:
            raise InputError(
                "names",
                f"name every label of {path.name}",
                f"no name for {enumerated(unknown[:5])}",
                f"add the missing names to {names}",
            )
        labels = replace(labels, names={number: stated[number] for number in labels.names})
    notes = (*labels.image.notes, *shared_names(labels.names, labels.image.source))
    return replace(labels, image=replace(labels.image, notes=notes))


def _of_volume(path: Path, spacing_mm: Spacing | None, image: Image | None) -> Labels:
    """Read a label volume with one layer, or with several overlapping layers."""
    stored = stored_image(path, spacing_mm=spacing_mm, labels=True)
    if stored.values.ndim == 4:
        return _of_layers(stored, path, image)
    values, notes = _whole(stored.values, path.name)
    held = [int(number) for number in np.unique(values) if number]
    if not held:
        raise InputError(
            "labels",
            "mark at least one voxel",
            f"0 everywhere in {path.name}",
            "export the segmentation",
        )
    placed = replace(stored, values=values, notes=(*stored.notes, *notes))
    stated = {**stored.names, **header_names(path)}
    names = {number: stated.get(number, unnamed(number)) for number in held}
    return Labels(along_lps(placed, path.name, labels=True, lattice=image), names)


def _of_layers(stored: StoredImage, path: Path, image: Image | None) -> Labels:
    """Return the segments of a file with several layers.

    An error is raised if the header lists no segments, or if the segments have no voxels.
    """
    segments = slicer_segments(path)
    layers = stored.values
    masks = (
        (each.number, None, layers[each.layer] == each.value)
        for each in segments
        if each.layer < len(layers)
    )
    grid = replace(stored, values=np.zeros(layers.shape[1:], dtype=np.uint16))
    return _overlaid(Masks(grid, segments, masks), path.name, image)


def _overlaid(found: Masks, source: str, lattice: Image | None = None) -> Labels:
    """Combine masks, which may overlap, into one label volume in the patient frame LPS.

    Each combination of labels that occurs in a voxel has its own number. The argument `lattice` is
    described in `meshes.images.frame.along_lps`.

    Raises
    ------
    InputError
        If no voxel is marked, or too many combinations occur.
    """
    values = found.grid.values
    number_of = {(each.number,): each.number for each in found.segments}
    labels_of = {number: labels for labels, number in number_of.items()}
    for number, plane, inside in found.masks:
        part = values if plane is None else values[..., plane]
        held = part[inside]
        for before in np.unique(held).tolist():
            labels = tuple(sorted({*labels_of.get(before, ()), number}))
            after = number_of.setdefault(labels, max(labels_of, default=0) + 1)
            if after > np.iinfo(np.uint16).max:
                raise InputError(
                    "labels",
                    f"have at most {np.iinfo(np.uint16).max} combinations of overlapping segments",
                    "more",
                    "give fewer segments",
                )
            labels_of[after] = labels
            held[held == before] = after
        part[inside] = held
    marked = {each: labels_of[each] for each in np.unique(values).tolist() if each}
    held_labels = {each for labels in marked.values() for each in labels}
    kept = [each for each in found.segments if each.number in held_labels]
    if not kept:
        raise InputError(
            "labels", "mark at least one voxel", f"none in {source}", "export the segmentation"
        )
    names = apart(kept)
    overlaps = {number: labels for number, labels in marked.items() if len(labels) > 1}
    notes = [*found.grid.notes]
    if overlaps:
        count = int(np.count_nonzero(np.isin(values, list(overlaps))))
        notes.append(f"{count} voxels of {source} lie in several labels, and count for each.")
    grid = replace(found.grid, notes=(*notes, *shared_names(names, source)))
    if isinstance(grid, StoredImage):
        grid = along_lps(grid, source, labels=True, lattice=lattice)
    return Labels(grid, names, overlaps)


def on_grid_of(labels: Labels, image: Image) -> Labels:
    """Transfer labels to the voxel grid of another image.

    Labels on the same grid are returned unchanged. If the voxel centres of the labels and the image
    coincide, the labels are cropped or padded. Otherwise, each voxel of the image gets the nearest
    label, and a note is added. If all labels lie outside the image, an InputError is raised.
    """
    from scipy.ndimage import affine_transform

    one = labels.image
    other = image
    scale = np.array(other.spacing_mm) / one.spacing_mm
    shift = (np.array(other.origin_mm) - one.origin_mm) / one.spacing_mm
    whole_shift = np.rint(shift)
    # The errors of the spacing add up over the grid.
    is_same_lattice = (
        np.abs(shift - whole_shift).max() < _SAME_PLACE
        and (np.abs(scale - 1.0) * one.values.shape).max() < _SAME_PLACE
    )
    if is_same_lattice and not whole_shift.any() and one.values.shape == other.values.shape:
        return labels
    # Beyond the outermost voxel centres, a label extends to the face of its voxel.
    values = affine_transform(
        one.values, scale, shift, other.values.shape, order=0, mode="grid-constant", cval=0
    )
    if one.values.any() and not values.any():
        raise InputError(
            "labels",
            "overlap the image",
            f"{one.source} outside {other.source}",
            "give the labels of this image",
        )
    notes = []
    if not is_same_lattice:
        notes.append(
            f"{one.source} has {by(one.values.shape)} voxels of {by(one.spacing_mm, '.4g')} mm: "
            f"each voxel of {other.source} takes the nearest label."
        )
    before = np.count_nonzero(one.values) * one.voxel_mm3
    left = np.count_nonzero(values) * other.voxel_mm3
    if left < (1.0 - _LOST) * before:
        lost = 1.0 - left / before
        notes.append(f"{lost:.0%} of the labels of {one.source} lie outside {other.source}.")
    held = set(np.unique(values).tolist())
    held = held.union(*(each for number, each in labels.overlaps.items() if number in held))
    names = {number: name for number, name in labels.names.items() if number in held}
    placed = replace(other, values=values, source=one.source, notes=(*one.notes, *notes))
    return Labels(placed, names, labels.overlaps)


def _of_masks(folder: Path) -> Labels:
    """Read a folder of mask files. The name of each file is the name of the label."""
    masks = sorted(
        file
        for file in folder.iterdir()
        if file.name.lower().endswith(IMAGE_SUFFIXES) and not file.name.startswith(".")
    )
    if not masks:
        raise InputError(
            "labels",
            "be a file or a folder of masks",
            f"the folder {folder.name} without .nii.gz or .nrrd files",
            "give the folder that TotalSegmentator wrote",
        )
    first = read_image(masks[0], labels=True)
    segments = []
    for number, file in enumerate(masks, start=1):
        ending = next(each for each in IMAGE_SUFFIXES if file.name.lower().endswith(each))
        segments.append(Segment(number, file.name[: -len(ending)].removesuffix(".seg")))
    values = np.zeros(first.values.shape, dtype=np.uint16)
    grid = replace(first, values=values, source=folder.name, notes=())
    read = ((number, None, _mask(file, first)) for number, file in enumerate(masks, start=1))
    return _overlaid(Masks(grid, segments, read), folder.name)


def _mask(file: Path, first: Image) -> Flags:
    """Read a mask, and raise an error if its grid differs from the grid of the first mask."""
    image = read_image(file, labels=True)
    # 1e-3 mm: spacing and origin are rounded in headers.
    if image.values.shape != first.values.shape or not np.allclose(
        [*image.spacing_mm, *image.origin_mm], [*first.spacing_mm, *first.origin_mm], atol=1e-3
    ):
        raise InputError(
            "masks",
            "all have the same voxel grid",
            f"a different grid in {file.name} of {file.parent.name}",
            "export all masks together",
        )
    return image.values > 0


def _whole(values: Numbers, source: str) -> tuple[NDArray[np.integer], list[str]]:
    """Convert the values to integers, and return a note if they were rounded."""
    low = float(values.min())
    high = float(values.max())
    whole = values
    if not np.issubdtype(values.dtype, np.integer):
        whole = np.rint(values)
    away = float(np.abs(values - whole).max()) if whole is not values else 0.0
    is_whole = low > -_ROUNDED and high <= MOST_LABELS and away <= _ROUNDED
    if not is_whole or len(np.unique(whole)) > _MOST_DIFFERENT:
        raise InputError(
            "labels",
            f"be at most {_MOST_DIFFERENT} different whole numbers from 0 to {MOST_LABELS}",
            f"{len(np.unique(values))} different values from {low:g} to {high:g} in {source}",
            "give the segmentation, not the image or a map of probabilities",
        )
    notes = [f"The labels of {source} are up to {away:.2g} off whole numbers: they are rounded."]
    return whole.astype(np.min_scalar_type(round(high))), notes if away > 0.0 else []
