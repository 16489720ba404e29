"""DICOM objects with labels: segmentations (SEG) and structure sets (RTSTRUCT)."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Flags, Numbers
from meshes.base.errors import InputError, by, is_file, is_folder
from meshes.base.file_limits import require_memory, require_regular
from meshes.ct.label_names import Segment, side_of
from meshes.images.dicom_files import (
    damaged,
    files_in,
    frames_in,
    is_dicom,
    modality_of,
    read_dataset,
)
from meshes.images.dicom_slices import Slice, even_row, fit_together, normal_of, slice_of
from meshes.images.frame import Image, StoredImage

__all__ = [
    "LabelObject",
    "Outlines",
    "Segmentation",
    "drawn",
    "label_object",
    "read_outlines",
    "read_segmentation",
]

_KINDS = ("SEG", "RTSTRUCT")
_VOLUMES = (".nii", ".nii.gz", ".nrrd", ".mha", ".mhd", ".raw", ".tif", ".tiff", ".bmp")
"""Suffixes of files that are not DICOM. Files with these suffixes are not opened."""
_SEGMENT_TAGS = ("SegmentSequence", "SegmentationType", "MaximumFractionalValue")
_OUTLINE_TAGS = ("StructureSetROISequence", "ROIContourSequence")
_CLOSED = ("CLOSED_PLANAR", "CLOSEDPLANAR_XOR", "INTERPOLATED_PLANAR")
_OFF_GRID = 0.05
"""Largest distance of a frame from its expected position in an evenly spaced stack.

Along the normal, the unit is the distance between planes. Perpendicular to the normal, the unit is
the pixel size. The value is not zero, because positions in headers are rounded.
"""
_OFF_STATED = 0.01
"""Largest relative difference between the measured and the stated distance of neighbouring planes.

For example, a header may state 0.67 mm for 2/3 mm.
"""
_FLAT_MM = 0.05
"""Largest height difference of points in one plane [mm]. Coordinates in files are rounded."""


@dataclass(frozen=True, eq=False)
class LabelObject:
    """DICOM file with labels: kind (SEG or RTSTRUCT), name and dataset."""

    kind: str
    file: Path
    source: str
    dataset: Any


def label_object(path: Path) -> LabelObject | None:
    """Return the DICOM object with labels in a file, or the only such object in a folder.

    The result is None for all other files and folders.

    Raises
    ------
    InputError
        If a folder contains several DICOM objects with labels.
    """
    files = [path]
    if is_folder(path):
        files = [file for file in files_in(path) if not file.name.lower().endswith(_VOLUMES)]
    found = []
    for file in files:
        if not is_file(file) or not is_dicom(require_regular(file)):
            continue
        dataset = read_dataset(file, path.name, (*_SEGMENT_TAGS, *_OUTLINE_TAGS))
        modality = modality_of(dataset, path.name)
        if modality in _KINDS:
            found.append(LabelObject(modality, file, path.name, dataset))
    if len(found) > 1:
        raise InputError(
            "labels",
            "be one DICOM object",
            f"{len(found)} in {path.name}",
            "give the file of one segmentation or structure set",
        )
    return found[0] if found else None


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Frames (image planes) of a DICOM segmentation.

    Each frame is one plane of one segment. In a label map, each frame is one plane with all
    segments.

    Attributes
    ----------
    object
        DICOM file of the segmentation.
    segments
        Segments that the file lists.
    frames
        Positions of the frames.
    planes_at
        Index of each frame's plane along the normal.
    step
        Vector from a plane to the next plane [mm, LPS].
    """

    object: LabelObject
    segments: list[Segment]
    frames: list[Slice]
    planes_at: list[int]
    step: Array

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of columns, rows and planes."""
        return (*self.frames[0].size, max(self.planes_at) + 1)

    @property
    def numbers(self) -> list[int]:
        """Label numbers of the segments."""
        return [each.number for each in self.segments]

    def stored(self) -> StoredImage:
        """Return the grid of the segmentation, without values."""
        first = self.frames[int(np.argmin(self.planes_at))]
        spacing = float(np.linalg.norm(self.step))
        directions = np.column_stack([first.row, first.column, self.step / spacing])
        notes = []
        if self.object.dataset.get("SegmentationType") == "FRACTIONAL":
            notes.append(f"{self.object.source} holds fractions: half of a voxel or more counts.")
        empty = np.zeros((0, 0, 0), dtype=np.uint8)
        grid = (*first.pixel_mm, spacing)
        return StoredImage(empty, grid, directions, first.position_mm, tuple(notes))

    def planes(self) -> Iterator[tuple[int, int, Flags]]:
        """Yield the segment number, plane index and mask of each frame.

        The mask has the shape (columns, rows).
        """
        kind = str(self.object.dataset.get("SegmentationType", "BINARY"))
        full = int(self.object.dataset.get("MaximumFractionalValue") or 255)
        least = 0.5 * full if kind == "FRACTIONAL" else 0.5
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                pixels = self._pixels()
                for each, plane, values in zip(self.frames, self.planes_at, pixels, strict=True):
                    if kind == "LABELMAP":
                        for number in np.unique(values[values > 0]).tolist():
                            yield number, plane, number == values.T
                        continue
                    number = int(each.frame.header["ReferencedSegmentNumber"])
                    yield number, plane, least <= values.T
        except InputError:
            raise
        except Exception as problem:  # damaged pixels raise many types of errors
            raise damaged(self.object.source) from problem

    def _pixels(self) -> Iterator[Numbers]:
        """Yield the values of each frame, shape (rows, columns)."""
        from pydicom.pixels.utils import iter_pixels

        header = self.frames[0].frame.header
        is_compressed = self.object.dataset.file_meta.TransferSyntaxUID.is_compressed
        if int(header["BitsAllocated"]) > 1 or is_compressed:
            yield from iter_pixels(self.object.file, raw=True)
            return
        # Frames of packed bits may begin within a byte. pydicom 3.0 raises an error for such
        # frames.
        size = self.frames[0].size
        packed = np.frombuffer(self.object.dataset.PixelData, dtype=np.uint8)
        for start in range(0, len(self.frames) * size[0] * size[1], size[0] * size[1]):
            end = start + size[0] * size[1]
            bits = np.unpackbits(packed[start // 8 : -(-end // 8)], bitorder="little")
            yield bits[start % 8 :][: end - start].reshape(size[::-1])


def read_segmentation(found: LabelObject) -> Segmentation:
    """Read the segments of a segmentation and the positions of its frames.

    Files usually omit empty frames, so planes may be missing.

    Raises
    ------
    InputError
        If the file is damaged, or if its frames do not lie in evenly spaced planes.
    """
    frames = [
        slice_of(frame, labels=True) for frame in frames_in(found.file, found.dataset, found.source)
    ]
    first = frames[0]
    planes, step = _even_planes(frames)
    if step is None or not all(fit_together(first, each) for each in frames):
        raise InputError(
            "a DICOM segmentation",
            "have its frames in one evenly spaced stack",
            f"other frames in {found.source}",
            "export it again, or as .seg.nrrd",
        )
    needed = 2 * int(np.prod(first.size, dtype=object)) * (max(planes) + 1)
    require_memory(needed, found.source, f"{by((*first.size, max(planes) + 1))} voxels")
    return Segmentation(found, _segments(found), frames, planes, step)


def _even_planes(frames: Sequence[Slice]) -> tuple[list[int], Array | None]:
    """Return the plane index of each frame, and the step between planes [mm, LPS].

    The step is None if the frames do not lie in evenly spaced planes. The step need not be normal
    to the planes: if a CT with a tilted gantry is sheared, its segmentation is sheared too.
    """
    normal = normal_of(frames[0])
    stated = frames[0].frame.header
    positions = np.array([each.position_mm for each in frames])
    heights, plane_of = np.unique(np.round(positions @ normal, 3), return_inverse=True)
    if len(heights) == 1:
        return [0] * len(frames), float(stated["SliceThickness"] or 1.0) * normal
    gaps = np.diff(heights)
    gap = float(gaps.min())
    # If only every second plane has segments, the computed distance would be twice the true
    # distance.
    between = abs(float(stated["SpacingBetweenSlices"] or 0.0))
    if 0.0 < between < gap:
        gap = between
    # Each distance between planes is rounded separately, because the errors of rounded distances
    # add up over many planes.
    index_of = np.concatenate([[0], np.cumsum(np.rint(gaps / gap).astype(int))])
    planes = index_of[plane_of]
    start, step = even_row(positions, planes)
    away = positions - start - planes[:, None] * step
    along = away @ normal
    across = np.abs(away - along[:, None] * normal).max()
    rounding = min(each.rounding_mm for each in frames)
    is_even = np.abs(along).max() <= _OFF_GRID * gap
    is_as_stated = abs(float(step @ normal) / gap - 1.0) <= _OFF_STATED
    is_in_line = across <= max(_OFF_GRID * min(frames[0].pixel_mm), rounding)
    return planes.tolist(), step if is_even and is_as_stated and is_in_line else None


def _segments(found: LabelObject) -> list[Segment]:
    """Return the segments of a file, each with the body side that the segment's type states."""
    segments: list[Segment] = []
    try:
        for each in found.dataset.get("SegmentSequence") or ():
            number = int(each.get("SegmentNumber", len(segments) + 1))
            name = str(each.get("SegmentLabel") or "").strip() or f"label {number}"
            segments.append(Segment(number, name, _side(each)))
    except Exception as problem:  # damaged headers raise many kinds
        raise damaged(found.source) from problem
    return segments


def _side(segment: Any) -> str:
    """Return the body side of a segment from the modifier of its type or of its region."""
    for key in ("SegmentedPropertyTypeCodeSequence", "AnatomicRegionSequence"):
        for code in segment.get(key) or ():
            modifiers = (
                code.get("SegmentedPropertyTypeModifierCodeSequence")
                or code.get("AnatomicRegionModifierSequence")
                or ()
            )
            for modifier in modifiers:
                if side := side_of(str(modifier.get("CodeMeaning", ""))):
                    return side
    return ""


@dataclass(frozen=True, eq=False)
class Outlines:
    """Closed outlines of a structure set.

    Attributes
    ----------
    source
        File name.
    segments
        Structures that have outlines.
    polygons
        Dictionary from the number of a structure to the points [mm, LPS] of each outline, shape (n,
        3).
    """

    source: str
    segments: list[Segment]
    polygons: Mapping[int, Sequence[Array]]


def read_outlines(found: LabelObject) -> Outlines:
    """Read the closed outlines of a structure set. Points and open lines are omitted.

    Raises
    ------
    InputError
        If the file is damaged, or if an outline does not lie in a plane normal to z.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            names, polygons = _structures(found.dataset)
    except Exception as problem:  # damaged headers raise many kinds
        raise damaged(found.source) from problem
    if any(np.ptp(each[:, 2]) > _FLAT_MM for held in polygons.values() for each in held):
        raise InputError(
            "outlines",
            "lie in planes across the patient's long axis",
            f"other planes in {found.source}",
            "export them as a segmentation (SEG or .seg.nrrd)",
        )
    segments = [
        Segment(number, names.get(number) or f"label {number}") for number in sorted(polygons)
    ]
    return Outlines(found.source, segments, polygons)


def _structures(dataset: Any) -> tuple[dict[int, str], dict[int, list[Array]]]:
    """Return the names and the closed outlines of the structures of a set, by number."""
    rois = dataset.get("StructureSetROISequence") or ()
    names = {int(each.ROINumber): str(each.get("ROIName", "")).strip() for each in rois}
    polygons: dict[int, list[Array]] = {}
    for roi in dataset.get("ROIContourSequence") or ():
        for contour in roi.get("ContourSequence") or ():
            if str(contour.get("ContourGeometricType", "")).upper() not in _CLOSED:
                continue
            points = np.array(contour.ContourData, dtype=np.float64).reshape(-1, 3)
            if len(points) > 2 and np.isfinite(points).all():
                polygons.setdefault(int(roi.ReferencedROINumber), []).append(points)
    return names, polygons


def drawn(outlines: Outlines, image: Image) -> Iterator[tuple[int, int, Flags]]:
    """Yield structure number, index of an image plane, and mask of the structure, shape (nx, ny).

    A voxel belongs to a structure if the voxel's centre lies within an odd number of the
    structure's outlines. An outline within another outline is therefore a hole. Each plane of the
    image uses the outlines of the nearest plane that has outlines. An image plane that is farther
    away than half the distance between planes with outlines is empty.
    """
    spacing = np.array(image.spacing_mm)
    origin = np.array(image.origin_mm)
    columns, rows, planes_of_image = image.values.shape
    shape = columns, rows
    centres = origin[2] + spacing[2] * np.arange(planes_of_image)
    for number, polygons in outlines.polygons.items():
        heights = np.array([each[:, 2].mean() for each in polygons])
        places, member = _planes_of(heights)
        gap = float(np.median(np.diff(places))) if len(places) > 1 else float(spacing[2])
        reach = 0.5 * max(gap, float(spacing[2])) + _FLAT_MM
        for k, centre in enumerate(centres):
            nearest = int(np.abs(places - centre).argmin())
            if abs(places[nearest] - centre) > reach:
                continue
            inside = np.zeros(shape, dtype=bool)
            for index in np.flatnonzero(member == nearest).tolist():
                inside ^= _within(polygons[index][:, :2], origin[:2], spacing[:2], shape)
            if inside.any():
                yield number, k, inside


def _planes_of(heights: Array) -> tuple[Array, NDArray[np.integer]]:
    """Group outlines by plane, and return the planes' heights [mm] and each outline's plane index.

    Outlines lie in the same plane if the difference between neighbouring heights is at most
    `_FLAT_MM`.
    """
    order = np.argsort(heights)
    is_next = np.diff(heights[order]) > _FLAT_MM
    member = np.zeros(len(heights), dtype=np.int64)
    member[order[1:]] = np.cumsum(is_next)
    return np.bincount(member, weights=heights) / np.bincount(member), member


def _within(points: Array, origin: Array, spacing: Array, shape: tuple[int, int]) -> Flags:
    """Return a mask of the voxels whose centres lie in a polygon of points [mm], shape (n, 2)."""
    from skimage.draw import polygon2mask

    inside: Flags = polygon2mask(shape, (points - origin) / spacing)
    return inside
