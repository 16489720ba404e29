"""Reading of image volumes.

This module reads NIfTI and VTK files, and calls other modules for all other formats.

nibabel reads the header of a NIfTI image. All numbers that determine the position or the scale of
the voxels are checked or applied.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array, Numbers
from meshes.base.errors import InputError, by, is_file, is_folder, require_positive
from meshes.base.file_limits import require_regular
from meshes.base.isolated_parser import Answer, parse_isolated
from meshes.images.data import first_bytes, is_gzip, read_voxels, scaled
from meshes.images.dicom import read_dicom
from meshes.images.dicom_files import is_dicom
from meshes.images.frame import Image, StoredImage, along_lps
from meshes.images.plane_files import PLANE_SUFFIXES, plane_files
from meshes.images.planes import read_planes
from meshes.images.text_headers import read_metaimage, read_nrrd

__all__ = [
    "IMAGE_SUFFIXES",
    "Image",
    "Spacing",
    "read_image",
    "read_nifti",
    "require_image_name",
    "stored_image",
    "vtk_voxels",
]

Spacing = float | Sequence[float] | Array
"""Distance between neighbouring voxels [mm], in all directions or along each axis."""

Header = Any
"""Header from nibabel, a mapping from field names to values."""

_TO_LPS = np.array([-1.0, -1.0, 1.0])
"""Signs that convert NIfTI axes (+x right, +y front, +z up) to LPS."""
_UNITS_MM = {0: 1.0, 1: 1000.0, 2: 1.0, 3: 1e-3}
"""Length [mm] of each NIfTI unit, by unit code. Codes 0 to 3 mean: not stated, m, mm and um."""
_AGREE = 1e-3
"""Relative difference up to which two voxel spacings count as equal.

Spacings are stored in single precision.
"""
_SINGLE_FILE = (b"n+1", b"n+2")


def read_nifti(path: Path) -> StoredImage:
    """Read a NIfTI-1 or -2 image (`.nii`, `.nii.gz`), its slope, intercept, units and position.

    The position is read from the header's sform if the sform's code is above 0, else from the
    qform. If both codes are 0, the array axes are assumed to be LPS axes with the origin (0, 0, 0).

    Raises
    ------
    InputError
        If the file is truncated, does not contain one real number per voxel in three dimensions, or
        has a contradictory header.
    """
    header = _header(path)
    dim = [int(n) for n in header["dim"]]
    sizes = dim[1 : dim[0] + 1]
    # NIfTI has at most seven axes. Time and channels come after the three spatial axes.
    if not 3 <= dim[0] <= 7 or min(sizes) < 1 or any(n != 1 for n in sizes[3:]):
        raise _fault(path, "dim", "be the sizes of exactly three axes, all above 0", by(sizes))
    dtype = _dtype(header, path)
    offset = float(header["vox_offset"])
    # The header is followed by four bytes that state whether there are extensions.
    least = int(header["sizeof_hdr"]) + 4
    if not (offset >= least and offset == int(offset)):
        raise _fault(path, "vox_offset", f"be at least {least}", offset)
    shape = (sizes[0], sizes[1], sizes[2])
    values = read_voxels(path, dtype, shape, skip=int(offset), compressed=is_gzip(path))
    notes: list[str] = []
    affine = _affine(header, path, notes)
    # The lowest three bits are the unit of length, and the other bits are the unit of time.
    unit = int(header["xyzt_units"]) & 7
    if unit not in _UNITS_MM:
        raise _fault(path, "xyzt_units", "be 1 (m), 2 (mm) or 3 (µm)", unit)
    if unit == 0:
        notes.append(f"{path.name} states no unit of length: taken as mm.")
    affine = affine[:3] * _UNITS_MM[unit] * _TO_LPS[:, None]
    spacing = np.linalg.norm(affine[:, :3], axis=0)
    x, y, z = spacing.tolist()
    with np.errstate(divide="ignore", invalid="ignore"):
        directions = affine[:, :3] / spacing
    slope = float(header["scl_slope"])
    intercept = float(header["scl_inter"])
    # a slope of 0 or NaN means no scaling
    if slope != 0.0 and not (np.isnan(slope) and (np.isnan(intercept) or intercept == 0.0)):
        if not np.isfinite([slope, intercept]).all():
            found = f"{slope:g} and {intercept:g}"
            raise _fault(path, "scl_slope and scl_inter", "be finite", found)
        values = scaled(values, slope, intercept)
    return StoredImage(values, (x, y, z), directions, affine[:, 3], tuple(notes))


def _header(path: Path) -> Header:
    """Read the header as a mapping from field names to values."""
    from io import BytesIO

    from nibabel import Nifti1Header, Nifti2Header
    from nibabel.spatialimages import HeaderDataError
    from nibabel.wrapstruct import WrapStructError

    # A NIfTI-2 header has 540 bytes and starts with this number, in either byte order. A NIfTI-1
    # header has 348 bytes.
    first = first_bytes(path, 540)
    kind = Nifti2Header if first[:4] in (b"\x1c\x02\0\0", b"\0\0\x02\x1c") else Nifti1Header
    with suppress(HeaderDataError, WrapStructError, ValueError):
        header = kind.from_fileobj(BytesIO(first[: kind.sizeof_hdr]), check=False)
        is_single = bytes(header["magic"].item())[:3] in _SINGLE_FILE
        if is_single and int(header["sizeof_hdr"]) in (348, 540):
            return header
    raise InputError(
        "file",
        "be a NIfTI image",
        f"{path.name}, which does not begin with a NIfTI header",
        "export it again",
    )


def _fault(path: Path, field: str, requirement: str, found: object) -> InputError:
    return InputError(
        f"{field} in the header", requirement, f"{found} in {path.name}", "export it again"
    )


def _dtype(header: Header, path: Path) -> np.dtype[np.number]:
    from nibabel.spatialimages import HeaderDataError

    try:
        dtype: np.dtype[np.number] = np.dtype(header.get_data_dtype())
    except (HeaderDataError, KeyError) as problem:
        raise _fault(path, "datatype", "be a NIfTI code", int(header["datatype"])) from problem
    # Complex numbers and colours are not grey values. The layout of float128 depends on the
    # machine.
    if dtype.kind not in "iuf" or not 0 < dtype.itemsize <= 8:
        raise _fault(path, "datatype", "be one real number per voxel", dtype)
    if int(header["bitpix"]) != 8 * dtype.itemsize:
        raise _fault(path, "bitpix", f"match the data type {dtype}", int(header["bitpix"]))
    return dtype


def _affine(header: Header, path: Path, notes: list[str]) -> Array:
    """Return the matrix from voxel indices to coordinates, in the header's unit and frame (RAS)."""
    from nibabel.spatialimages import HeaderDataError

    spacing = np.array(header["pixdim"][1:4], dtype=np.float64)
    if not (np.isfinite(spacing).all() and (spacing > 0.0).all()):
        raise _fault(path, "pixdim", "be positive", by(spacing))
    qform: Array | None = None
    if int(header["qform_code"]) > 0:
        try:
            qform = np.asarray(header.get_qform(), dtype=np.float64)
        except (HeaderDataError, ValueError) as problem:
            raise _fault(
                path, "the quaternion", "have a norm of 1", "a different norm"
            ) from problem
    if int(header["sform_code"]) <= 0:
        if qform is not None:
            return qform
        notes.append(
            f"{path.name} has no axis directions: its axes are taken as left, back and head."
        )
        return np.diag([*(spacing * _TO_LPS), 1.0])
    sform: Array = np.asarray(header.get_sform(), dtype=np.float64)
    if not np.isfinite(sform).all():
        raise _fault(path, "sform", "be finite", "numbers that are not finite")
    stated = np.linalg.norm(sform[:3, :3], axis=0)
    if not np.allclose(stated, spacing, rtol=_AGREE, atol=0.0):
        notes.append(
            f"{path.name} states voxels of {by(spacing, '.4g')} in pixdim and of "
            f"{by(stated, '.4g')} in the sform: the sform is used."
        )
    if qform is not None:
        corner = np.array([*(int(n) for n in header["dim"][1:4]), 0.0])
        apart = np.abs((sform - qform) @ corner)[:3].max() + np.abs(sform - qform)[:3, 3].max()
        # Rounding errors of the quaternion move voxels by far less than half a voxel.
        if apart > 0.5 * stated.min():
            notes.append(
                f"The sform and the qform of {path.name} place it differently: the sform is used."
            )
    return sform


def read_vtk_image(path: Path) -> StoredImage:
    """Read the active array of a `.vti` image.

    VTK files do not state a patient frame, so the array axes are assumed to be LPS axes.
    """
    facts, arrays = parse_isolated(
        "meshes.images.reading:vtk_voxels", path, what="image volume", remedy="export it again"
    )
    values = arrays["values"]
    frame = arrays["frame"].astype(np.float64)
    x, y, z = frame[3].tolist()
    return StoredImage(values.reshape(facts["shape"], order="F"), (x, y, z), frame[:3], frame[4])


def vtk_voxels(file: Path) -> Answer:
    """Return the voxel values of a VTK image file, the image's shape, and the image's frame.

    In the array, the first index varies fastest.

    The frame is an array with five rows: the directions of the three axes, the spacing, and the
    centre of the first voxel.

    Raises
    ------
    InputError
        If the file does not contain an image with one number per voxel.
    """
    import pyvista

    from meshes.surfaces.vtk_files import read_vtk

    data = read_vtk(file)
    if not isinstance(data, pyvista.ImageData) or not data.array_names:
        raise InputError(
            "file",
            "contain an image volume",
            f"a VTK dataset ({type(data).__name__}) without voxels in {file.name}",
            "export it again",
        )
    name = data.active_scalars_name or data.array_names[0]
    by_cell = name in data.cell_data
    shape = [n - 1 if by_cell else n for n in data.dimensions]
    values = np.asarray(data.cell_data[name] if by_cell else data.point_data[name])
    if values.ndim != 1 or 0 in shape or values.size != int(np.prod(shape)):
        raise InputError(
            "file",
            "contain one number per voxel",
            f"an array of shape {values.shape} in {file.name}",
            "export grey values",
        )
    directions = np.asarray(data.direction_matrix, dtype=np.float64)
    # If values are stored at cells, the first point of the grid is the corner of the first voxel.
    origin = np.array(data.GetPoint(0)) + (0.5 * directions @ data.spacing if by_cell else 0.0)
    return {"shape": shape}, {
        "values": values,
        "frame": np.stack([*directions, data.spacing, origin]),
    }


_READERS = {
    ".nii": read_nifti,
    ".nii.gz": read_nifti,
    ".nrrd": read_nrrd,
    ".nhdr": read_nrrd,
    ".mhd": read_metaimage,
    ".mha": read_metaimage,
    ".vti": read_vtk_image,
}
IMAGE_SUFFIXES = (".nii.gz", *(each for each in _READERS if each != ".nii.gz"))
"""Suffixes of image volumes, longest first."""
_REMEDY = (
    "use a .nii.gz, .nrrd, .mhd or .vti image, a DICOM folder, or a folder or pattern of TIFF, "
    "PNG or BMP slices"
)
_SHORTEST_MM = 0.5
"""Length [mm] of an image's longest side below which the header is probably in metres.

If a header in metres is read in mm, a bone of 0.5 m has a length of 0.5 mm.
"""


def read_image(
    path: str | Path,
    *,
    spacing_mm: Spacing | None = None,
    labels: bool = False,
    series: int | None = None,
) -> Image:
    """Read an image volume and convert it to LPS axes, in mm.

    Origin, directions, units, slope and intercept are read from the file. If the file does not
    state one of these values, a note reports the assumed value. An image whose axes are parallel to
    the LPS axes is reordered without interpolation. Oblique images are resampled, see
    `meshes.images.frame.along_lps`.

    Parameters
    ----------
    path
        One of: an image file; a folder with a DICOM series, or its DICOMDIR; a DICOM file with many
        frames; a folder with TIFF, PNG or BMP slices; or a file pattern such as `slices/*.tif`.
        Slices are stacked along +z in the order of the numbers in their names.
    spacing_mm
        Distance between neighbouring voxels [mm], one number or one number per axis of the array.
        If None, the distance stated in the file is used. TIFF, PNG and BMP slices do not state a
        distance.
    labels
        Whether the values are labels. Labels are not interpolated.
    series
        Number of the series, for a DICOM folder with several series.

    Raises
    ------
    InputError
        If the file is missing, empty, truncated, not readable or not an image with one number per
        voxel, or if its header contains invalid values.
    """
    path = Path(path)
    stored = stored_image(path, spacing_mm=spacing_mm, labels=labels, series=series)
    if stored.values.ndim != 3:
        raise InputError(
            "file",
            "contain one number per voxel",
            f"an array of shape {stored.values.shape} in {path.name}",
            _REMEDY,
        )
    return along_lps(stored, path.name, labels=labels)


def stored_image(
    path: Path,
    *,
    spacing_mm: Spacing | None = None,
    labels: bool = False,
    series: int | None = None,
) -> StoredImage:
    """Read an image volume along the axes of its file, see `read_image`.

    For files with several label layers, the first index of the result's array is the layer.
    """
    given = None if spacing_mm is None else _given_spacing(spacing_mm)
    planes = plane_files(path)
    source = path.name
    if planes and given is None:
        raise InputError(
            "anatomy.spacing_mm",
            f"be given for the slices {source}, because their files do not state it",
            "none",
            "use the scanner's value, for example 0.0195",
        )
    stored = (
        read_planes(planes, given, labels=labels)
        if planes and given is not None
        else _stored(path, series)
    )
    notes = [*stored.notes]
    if given is None and stored.spacing_mm == (1.0, 1.0, 1.0):
        notes.append(
            f"The spacing in {source} is exactly 1 mm, often a placeholder: set "
            "anatomy.spacing_mm to be sure."
        )
    elif given is not None and stored.spacing_mm != given:
        used = f"{given[0]:g}" if len(set(given)) == 1 else by(given)
        notes.append(
            f"The spacing in {source} is {by(stored.spacing_mm)} mm; {used} mm is used, as given."
        )
    spacing = given or stored.spacing_mm
    values = stored.values
    if values.size == 0 or not np.issubdtype(values.dtype, np.number):
        raise InputError(
            "file",
            "contain one number per voxel",
            f"an array of shape {values.shape} in {source}",
            _REMEDY,
        )
    if np.issubdtype(values.dtype, np.floating) and not np.isfinite(values).all():
        values, note = _without_nan(values, source, labels)
        notes.append(note)
    longest = max(np.multiply(values.shape[-3:], spacing))
    if longest < _SHORTEST_MM and given is None:
        notes.append(
            f"{source} is {longest:.3g} mm long in all, as if its header were in "
            "metres: give the spacing in mm if this is so."
        )
    return replace(stored, values=values, spacing_mm=spacing, notes=tuple(notes))


def _without_nan(values: Numbers, source: str, labels: bool) -> tuple[Numbers, str]:
    """Replace NaN values, which mark voxels outside the scan, and return a note on the replacement.

    In grey images, NaN is replaced by the lowest value. In label images, NaN is replaced by 0.
    """
    missing = np.isnan(values)
    if missing.all() or not np.isfinite(values[~missing]).all():
        count = int((~np.isfinite(values)).sum())
        raise InputError(
            "voxels",
            "be finite",
            f"{count} of {values.size} voxels without a finite value in {source}",
            "replace these values first",
        )
    filled = np.where(missing, 0 if labels else values[~missing].min(), values)
    what = "have no label" if labels else "take the lowest value"
    note = f"{missing.mean():.1%} of the voxels of {source} are not a number: they {what}."
    return filled.astype(values.dtype), note


def _given_spacing(spacing_mm: Spacing) -> tuple[float, float, float]:
    """Convert a spacing to one number per axis."""
    is_one = isinstance(spacing_mm, int | float | np.number)
    each: list[Any] = [spacing_mm] * 3 if is_one else list(spacing_mm)  # type: ignore[arg-type]
    if len(each) != 3:
        raise InputError(
            "anatomy.spacing_mm", "be one number or three", each, "give 0.5 or 0.5,0.5,1"
        )
    x, y, z = (
        require_positive("anatomy.spacing_mm", number, "use the scanner's value") for number in each
    )
    return x, y, z


def _stored(path: Path, series: int | None) -> StoredImage:
    """Read the image of a file or DICOM folder in its stored axes."""
    if is_folder(path) or _is_dicom_file(path):
        return read_dicom(path, series=series)
    if series is not None:
        raise InputError(
            "series",
            f"be left out for {path.name}, because a file contains only one image",
            series,
            "leave series out, or give a DICOM folder",
        )
    require_image_name(path)
    return next(read for suffix, read in _READERS.items() if path.name.lower().endswith(suffix))(
        path
    )


def _is_dicom_file(path: Path) -> bool:
    """Return whether a file is the index of a DICOM folder (DICOMDIR) or a DICOM file."""
    if path.name.lower().endswith((*_READERS, *PLANE_SUFFIXES)):
        return False
    require_regular(path)
    return path.name.upper() == "DICOMDIR" or is_dicom(path)


def require_image_name(path: Path) -> None:
    """Raise an error if a file name does not have the suffix of an image volume.

    Folders and patterns are not checked here.

    Raises
    ------
    InputError
        If the suffix is not known. The message lists the formats.
    """
    known = path.name.lower().endswith((*_READERS, *PLANE_SUFFIXES))
    if is_file(path) and not known and not _is_dicom_file(path):
        raise InputError("file", "be an image volume of a known format", path.name, _REMEDY)
