"""Reading of a DICOM series as one image.

A file contains one or many slices. The slices are sorted by position and must be evenly spaced. The
stack may be sheared, as with a tilted gantry. Uncompressed pixels are read by pydicom, and
compressed pixels by GDCM. `meshes.images.dicom_files` reads the headers and keeps patient data
private.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Numbers
from meshes.base.errors import InputError, by, counted, enumerated
from meshes.base.file_limits import require_memory
from meshes.images.dicom_files import (
    Frame,
    damaged,
    dicom_files,
    frames_in,
    frames_of,
    read_dataset,
    reading,
    refused,
)
from meshes.images.dicom_slices import stacked
from meshes.images.frame import StoredImage

_INVERTED = "MONOCHROME1"
"""Photometric interpretation in which low values are displayed as white."""
_GREY = ("MONOCHROME2", _INVERTED)
_THICK_MM = 3.0
"""Slice thickness [mm] from which a note on overlapping slices is written.

Most cortices are thinner than this value.
"""
_THICKER = 1.05
"""Ratio of slice thickness to slice distance above which slices overlap.

The ratio is larger than 1, because values in headers are rounded.
"""
_AIR_HU = (-1100.0, -900.0)
"""Range of values of air. Noise and scatter change air's -1000 HU by less than 100 HU."""


def read_dicom(path: Path, *, series: int | None = None) -> StoredImage:
    """Read the series with the number `series`, or the only series in a folder and its subfolders.

    The path may also be a DICOMDIR file or a file with many frames. Each slice has its own slope
    and intercept. Padding voxels get the lowest value of the other voxels in their slice.

    Raises
    ------
    InputError
        If the folder contains no series, or contains several series and `series` is None. Also
        raised if a file is damaged, or if the slices are not evenly spaced grey images.
    """
    files, notes = dicom_files(path)
    source = path.parent.name if path.name.upper() == "DICOMDIR" else path.name
    frames, left_out = frames_of(files, source)
    frames, other_series = _of_one_series(frames, series, source)
    notes += [*left_out, *other_series]
    for frame in frames:
        _require_grey(frame)
    kinds = {frame.header["PhotometricInterpretation"] for frame in frames}
    if len(kinds) > 1:
        raise refused(
            "slices", "all have the same photometric interpretation", f"different ones in {source}"
        )
    bits = max(int(frame.header["BitsAllocated"] or 0) for frame in frames)
    require_memory(
        sum(int(np.prod(each.size, dtype=object)) for each in frames) * bits // 8,
        source,
        f"{by((*frames[0].size, len(frames)))} voxels",
    )
    slices, step, remarks = stacked(frames, source)
    stored = _stored_pixels(slices)
    if kinds == {_INVERTED}:
        stored, note = _upright(stored, slices, source)
        remarks.append(note)
    values, padded = _scaled(stored, slices)
    if padded:
        remarks.append(
            f"{padded} voxels of {source} are padding: they take the lowest value of their slice."
        )
    if any(frame.header["RescaleSlope"] is None for frame in frames):
        remarks.append(
            f"{source} states no rescale slope: its grey values are taken as they are stored."
        )
    first = slices[0]
    spacing = float(np.linalg.norm(step))
    thickness = first.number("SliceThickness", 0.0)
    if thickness >= _THICK_MM and thickness > _THICKER * spacing:
        remarks.append(
            f"The slices of {source} are {thickness:g} mm thick and {spacing:.3g} mm apart: "
            "thinner parts are blurred."
        )
    directions = np.column_stack([*first.axes, step / spacing])
    return StoredImage(
        values.T,
        (*first.pixel_mm.tolist(), spacing),
        directions,
        first.position_mm,
        (*notes, *remarks),
    )


def _require_grey(frame: Frame) -> None:
    """Raise an error for a frame without grey values, such as a colour picture."""
    kind = frame.header["PhotometricInterpretation"]
    if kind not in _GREY or frame.header["SamplesPerPixel"] != 1:
        raise InputError(
            "a DICOM slice",
            "contain grey values (MONOCHROME2 or MONOCHROME1)",
            f"other values in {frame.place}",
            "leave this slice out, or export grey values",
        )


def _of_one_series(
    frames: Sequence[Frame], series: int | None, source: str
) -> tuple[list[Frame], list[str]]:
    """Return the frames of the only series, or of the series with the number `series`, and notes.

    If a series has several slices, series with a single slice, such as a scout or a dose report,
    are ignored. Series are distinguished by identifier and number. To protect patient data,
    messages state only the series number and the number of slices.
    """
    names = [(str(frame.header["SeriesInstanceUID"]), _series_number(frame)) for frame in frames]
    counts = Counter(names)
    held = enumerated(
        f"number {name} with {counted(n, 'slice')}" for (_, name), n in sorted(counts.items())
    )
    stacks = {name for name, count in counts.items() if count > 1} or set(names)
    wanted = stacks if series is None else {name for name in counts if name[1] == str(series)}
    if not wanted:
        raise InputError(
            "series", f"be the number of a series in {source}", series, f"choose from {held}"
        )
    if len(wanted) > 1:
        raise InputError(
            "a DICOM folder",
            "contain one series",
            f"{len(counts)} in {source}: {held}",
            "choose one with `tissue import --series NUMBER`"
            if len({number for _, number in wanted}) > 1
            else "give the folder or the file of one series",
        )
    notes = []
    if series is None and len(counts) > 1:
        notes.append(f"Left out {len(counts) - 1} series of one slice in {source}.")
    return [frame for frame, name in zip(frames, names, strict=True) if name in wanted], notes


def _series_number(frame: Frame) -> str:
    """Return the number of a series, or "?" if the header does not contain a short integer.

    The number is shown in messages, and messages must not contain other data from a header.
    """
    try:
        number = int(frame.header["SeriesNumber"])
    except (TypeError, ValueError):
        return "?"
    return str(number) if abs(number) < 1_000_000 else "?"


def _stored_pixels(slices: Sequence[Frame]) -> Numbers:
    """Decode the stored values of slices, shape (slices, rows, columns)."""
    files: dict[Path, Numbers] = {}
    for each in slices:
        if each.file not in files:
            with reading(each.place):
                pixels = _decoded(each)
            if pixels.shape[1:] != each.size[::-1] or each.index >= len(pixels):
                raise damaged(each.place)
            files[each.file] = pixels
    return np.stack([files[each.file][each.index] for each in slices])


def _decoded(frame: Frame) -> Numbers:
    """Return the stored values of all frames of a file, shape (frames, rows, columns)."""
    from pydicom.uid import (
        ExplicitVRBigEndian,
        ExplicitVRLittleEndian,
        ImplicitVRLittleEndian,
    )

    dataset = read_dataset(frame.file, frame.place)
    syntax = dataset.file_meta.get("TransferSyntaxUID")
    if syntax is not None and syntax.is_compressed:
        return _decompressed(frame, dataset)
    if syntax is None:  # a file without the group that states the syntax
        is_implicit, is_little = dataset.original_encoding
        explicit = ExplicitVRLittleEndian if is_little else ExplicitVRBigEndian
        dataset.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian if is_implicit else explicit
    pixels: Numbers = np.asarray(dataset.pixel_array)
    return pixels.reshape(-1, *pixels.shape[-2:])


def _decompressed(frame: Frame, dataset: Any) -> Numbers:
    """Decode a compressed file with GDCM and return the stored values.

    GDCM inverts MONOCHROME1, then applies slope and intercept of the first frame to all frames.
    This function reverses both operations.
    """
    import SimpleITK

    # Warnings of GDCM may contain header content, which must not be printed.
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    image = SimpleITK.ReadImage(str(frame.file), imageIO="GDCMImageIO")
    scale = frames_in(frame.file, dataset, frame.place)[0]
    values = SimpleITK.GetArrayFromImage(image)
    stored = np.rint((values - scale.intercept) / scale.slope).astype(np.int32)
    if frame.header["PhotometricInterpretation"] == _INVERTED:
        stored = _ends(frame) - stored
    return stored


def _ends(each: Frame) -> int:
    """Return the sum of the lowest and the highest storable value of a slice.

    To invert a stored value, subtract the value from this sum.
    """
    bits = int(each.number("BitsStored", 16.0))
    is_signed = int(each.number("PixelRepresentation", 0.0)) == 1
    return -1 if is_signed else 2**bits - 1


def _scaled(stored: Numbers, slices: Sequence[Frame]) -> tuple[Numbers, int]:
    """Apply the scale of each slice, and return grey values and the number of padding voxels.

    Voxels with the padding value get the lowest of the other values in their slice.
    """
    whole = all(each.slope == 1.0 and each.intercept.is_integer() for each in slices)
    values = np.empty(stored.shape, dtype=np.int32 if whole else np.float32)
    padded = 0
    for plane, found, each in zip(stored, values, slices, strict=True):
        found[:] = each.slope * plane.astype(np.float64) + each.intercept
        if each.header["PixelPaddingValue"] in (None, ""):
            continue
        first = each.number("PixelPaddingValue", 0.0)
        low, high = sorted((first, each.number("PixelPaddingRangeLimit", first)))
        padding = (plane >= low) & (plane <= high)
        if padding.any() and not padding.all():
            found[padding] = found[~padding].min()
            padded += int(np.count_nonzero(padding))
    return values, padded


def _upright(stored: Numbers, slices: Sequence[Frame], source: str) -> tuple[Numbers, str]:
    """Invert MONOCHROME1 values if needed, and return the values and a note.

    Slope and intercept convert stored values to Hounsfield units, independent of the display (DICOM
    PS3.3, C.11.1). Some programs invert the stored values without changing slope and intercept. The
    stored values are therefore inverted again if more voxels then have the value of air.
    """
    ends = np.array([_ends(each) for each in slices], dtype=np.int32)
    inverted = ends[:, None, None] - stored.astype(np.int32)
    low, high = _AIR_HU

    def air(values: Numbers) -> int:
        """Count the voxels with a value of air."""
        count = 0
        for plane, each in zip(values, slices, strict=True):
            grey = each.slope * plane + each.intercept
            count += int(np.count_nonzero((grey > low) & (grey < high)))
        return count

    has_slope = slices[0].header["RescaleSlope"] not in (None, "")
    as_stated = air(stored)
    as_inverted = air(inverted)
    if has_slope and (
        as_stated > as_inverted or (as_stated == as_inverted and slices[0].slope < 0.0)
    ):
        note = (
            "displays low values as white (MONOCHROME1): its rescale slope and intercept "
            "already give grey values."
        )
        return stored, f"{source} {note}"
    if has_slope and as_stated == as_inverted:
        raise InputError(
            f"an image of type {_INVERTED}",
            "contain air, which shows whether its values are inverted",
            f"slices without air in {source}",
            "export the image as MONOCHROME2",
        )
    note = "are stored inverted (MONOCHROME1): they are inverted back."
    return inverted, f"The grey values of {source} {note}"
