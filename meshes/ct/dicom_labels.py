"""DICOM objects with labels: segmentations (SEG) and structure sets (RTSTRUCT)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Flags, Numbers
from meshes.base.errors import InputError, by, is_file, is_folder
from meshes.base.file_limits import require_memory, require_regular
from meshes.ct.label_names import Segment, side_of
from meshes.images.dicom_files import (
    Frame,
    files_in,
    frames_in,
    is_dicom,
    modality_of,
    read_dataset,
    reading,
)
from meshes.images.dicom_slices import even_row, fit_together, normal_of
from meshes.images.frame import Image, StoredImage

_VOLUMES = (".nii", ".nii.gz", ".nrrd", ".mha", ".mhd", ".raw", ".tif", ".tiff", ".bmp")
"""Suffixes of files that are not DICOM. Files with these suffixes are not opened."""
_SEGMENT_TAGS = ("SegmentSequence", "SegmentationType", "MaximumFractionalValue")
_OUTLINE_TAGS = ("StructureSetROISequence", "ROIContourSequence")
_CLOSED = ("CLOSED_PLANAR", "CLOSEDPLANAR_XOR", "INTERPOLATED_PLANAR")
_OFF_GRID = 0.05
"""Largest distance of an image plane (frame) from its expected position in an evenly spaced stack.

Along the normal, the unit is the distance between planes. Perpendicular to the normal, the unit is
the pixel size. The value is not zero, because positions in headers are rounded.
"""
_OFF_STATED = 0.01
"""Largest relative difference between measured and stated distance of neighbouring image planes.

For example, a header may state 0.67 mm for 2/3 mm.
"""
_FLAT_MM = 0.05
"""Largest height difference of points in one plane [mm]. Coordinates in files are rounded."""


@dataclass(frozen=True, eq=False)
class Masks:
    """Masks of segments on one grid. The masks of different segments may overlap.

    Attributes
    ----------
    grid
        Image that defines the grid of the masks. All its values are zero (uint16).
    segments
        Number and name of each segment.
    masks
        Tuples with three entries: segment number, plane index along the last axis, and mask of the
        segment in this plane. If the index is None, the mask has the shape of the grid.
    """

    grid: StoredImage | Image
    segments: Sequence[Segment]
    masks: Iterator[tuple[int, int | None, Flags]]


def dicom_masks(path: Path, image: Image | None) -> Masks | None:
    """Read the segmentation or structure set in a file, or the only such object in a folder.

    The outlines of a structure set are drawn on the voxels of `image`. The result is None if the
    path contains no such object.

    Raises
    ------
    InputError
        If a folder contains several such objects, or a structure set is read without `image`. Also
        raised if the object is damaged or its planes are not evenly spaced.
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
        if modality in ("SEG", "RTSTRUCT"):
            found.append((modality, file, dataset))
    if len(found) > 1:
        raise InputError(
            "labels",
            "be one DICOM object",
            f"{len(found)} objects in {path.name}",
            "give the file of one segmentation or structure set",
        )
    if not found:
        return None
    modality, file, dataset = found[0]
    with reading(path.name):
        if modality == "SEG":
            return _segmentation(file, dataset, path.name)
        return _structure_set(dataset, path.name, image)


def _segmentation(file: Path, dataset: Any, source: str) -> Masks:
    """Read a segmentation. Each frame of the file is one plane of one segment.

    In a label map, however, a frame is one plane with all segments. Files usually omit empty
    frames, so planes may be missing.
    """
    frames = frames_in(file, dataset, source)
    planes, step = _even_planes(frames)
    if step is None or not all(fit_together(frames[0], each) for each in frames):
        raise InputError(
            "a DICOM segmentation",
            "have its frames in one evenly spaced stack",
            f"frames in other positions in {source}",
            "export it again, or as .seg.nrrd",
        )
    first = frames[int(np.argmin(planes))]
    shape = *first.size, max(planes) + 1
    require_memory(2 * int(np.prod(shape, dtype=object)), source, f"{by(shape)} voxels")
    spacing = float(np.linalg.norm(step))
    directions = np.column_stack([*first.axes, step / spacing])
    notes = []
    if dataset.get("SegmentationType") == "FRACTIONAL":
        notes.append(f"{source} has fractions: voxels of at least one half are used.")
    across, down = first.pixel_mm.tolist()
    grid = StoredImage(
        np.zeros(shape, dtype=np.uint16),
        (across, down, spacing),
        directions,
        first.position_mm,
        tuple(notes),
    )
    segments: list[Segment] = []
    for each in dataset.get("SegmentSequence") or ():
        number = int(each.get("SegmentNumber", len(segments) + 1))
        name = str(each.get("SegmentLabel") or "").strip() or f"label {number}"
        segments.append(Segment(number, name, _side(each)))
    return Masks(grid, segments, _frame_masks(dataset, frames, planes))


def _frame_masks(
    dataset: Any, frames: Sequence[Frame], planes: Sequence[int]
) -> Iterator[tuple[int, int, Flags]]:
    """Yield the segment number, plane index and mask, shape (columns, rows), of each frame."""
    kind = str(dataset.get("SegmentationType", "BINARY"))
    full = int(dataset.get("MaximumFractionalValue") or 255)
    least = 0.5 * full if kind == "FRACTIONAL" else 0.5
    with reading(frames[0].place):
        for each, plane, values in zip(frames, planes, _pixels(dataset, frames), strict=True):
            if kind == "LABELMAP":
                for number in np.unique(values[values > 0]).tolist():
                    yield number, plane, number == values.T
                continue
            yield int(each.header["ReferencedSegmentNumber"]), plane, least <= values.T


def _pixels(dataset: Any, frames: Sequence[Frame]) -> Iterator[Numbers]:
    """Yield the values of each frame, shape (rows, columns)."""
    from pydicom.pixels.utils import iter_pixels

    first = frames[0]
    is_compressed = dataset.file_meta.TransferSyntaxUID.is_compressed
    if int(first.header["BitsAllocated"]) > 1 or is_compressed:
        yield from iter_pixels(first.file, raw=True)
        return
    # Frames of packed bits may begin within a byte. pydicom 3.0 raises an error for such frames.
    packed = np.frombuffer(dataset.PixelData, dtype=np.uint8)
    columns, rows = first.size
    for start in range(0, len(frames) * columns * rows, columns * rows):
        end = start + columns * rows
        bits = np.unpackbits(packed[start // 8 : -(-end // 8)], bitorder="little")
        yield bits[start % 8 :][: end - start].reshape(rows, columns)


def _even_planes(frames: Sequence[Frame]) -> tuple[list[int], Array | None]:
    """Return the plane index of each frame, and the step between planes [mm, LPS].

    The step is None if the frames do not lie in evenly spaced planes. The step need not be normal
    to the planes: if a CT with a tilted gantry is sheared, its segmentation is sheared too.
    """
    normal = normal_of(frames[0])
    stated = frames[0].header
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
    is_in_line = across <= max(_OFF_GRID * frames[0].pixel_mm.min(), rounding)
    return planes.tolist(), step if is_even and is_as_stated and is_in_line else None


def _side(segment: Any) -> str:
    """Return the body side that a segment's type modifier or region modifier states."""
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


def _structure_set(dataset: Any, source: str, image: Image | None) -> Masks:
    """Draw the closed outlines of a structure set on an image; points and lines are ignored."""
    if image is None:
        raise InputError(
            "labels",
            "consist of voxels",
            f"the outlines in the structure set {source}",
            "also give the CT image on which the outlines were drawn",
        )
    names, polygons = _structures(dataset)
    if any(np.ptp(each[:, 2]) > _FLAT_MM for held in polygons.values() for each in held):
        raise InputError(
            "outlines",
            "lie in planes perpendicular to the patient's long axis",
            f"outlines in other planes in {source}",
            "export them as a segmentation (SEG or .seg.nrrd)",
        )
    segments = [
        Segment(number, names.get(number) or f"label {number}") for number in sorted(polygons)
    ]
    values = np.zeros(image.values.shape, dtype=np.uint16)
    grid = replace(image, values=values, source=source, notes=())
    return Masks(grid, segments, _drawn(polygons, image))


def _structures(dataset: Any) -> tuple[dict[int, str], dict[int, list[Array]]]:
    """Return names and closed outlines of a structure set: two dictionaries by structure number."""
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


def _drawn(
    polygons_of: Mapping[int, Sequence[Array]], image: Image
) -> Iterator[tuple[int, int, Flags]]:
    """Yield structure number, index of an image plane, and mask of the structure, shape (nx, ny).

    A voxel belongs to a structure if the voxel's centre lies within an odd number of the
    structure's outlines. An outline within another outline is therefore a hole. Each plane of the
    image uses the outlines of the nearest plane that has outlines. If this plane is farther away
    than half the distance between planes with outlines, the image plane is empty.
    """
    from skimage.draw import polygon2mask

    spacing = np.array(image.spacing_mm)
    origin = np.array(image.origin_mm)
    shape = image.values.shape[:2]
    centres = origin[2] + spacing[2] * np.arange(image.values.shape[2])
    for number, polygons in polygons_of.items():
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
                points = polygons[index][:, :2] - origin[:2]
                inside ^= polygon2mask(shape, points / spacing[:2])
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
