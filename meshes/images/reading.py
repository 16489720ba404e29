"""Image volumes from files: the reader of each format, and checks common to all formats."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError, by, is_file, is_folder, require_positive
from meshes.base.isolated_parser import Answer, parse_isolated
from meshes.images.dicom import read_dicom
from meshes.images.frame import Image, StoredImage, along_lps
from meshes.images.nifti import read_nifti
from meshes.images.text_headers import read_metaimage, read_nrrd
from meshes.images.tiff import read_tiff_slices, tiff_slices

__all__ = ["Image", "read_image", "require_image_name", "vtk_voxels"]


def read_vtk_image(path: Path) -> StoredImage:
    """Read the active array of a `.vti` image.

    VTK states no frame of a patient, so its axes are taken as LPS.
    """
    facts, arrays = parse_isolated(
        "meshes.images.reading:vtk_voxels", path, what="image volume", remedy="export it again"
    )
    values = arrays["values"]
    frame = arrays["frame"].astype(np.float64)
    x, y, z = frame[3].tolist()
    return StoredImage(values.reshape(facts["shape"], order="F"), (x, y, z), frame[:3], frame[4])


def vtk_voxels(file: Path) -> Answer:
    """Return the array of an image file, first index fastest, with its shape and its frame.

    The rows of the frame are three directions, spacing, and the centre of the first voxel.

    Raises
    ------
    InputError
        If it holds no image of one number a voxel.
    """
    import pyvista

    from meshes.surfaces.vtk_reading import read_vtk

    data = read_vtk(file)
    if not isinstance(data, pyvista.ImageData) or not data.array_names:
        raise InputError(
            "file",
            "hold an image volume",
            f"{type(data).__name__} without voxels in {file.name}",
            "export it again",
        )
    name = data.active_scalars_name or data.array_names[0]
    by_cell = name in data.cell_data
    shape = [n - 1 if by_cell else n for n in data.dimensions]
    values = np.asarray(data.cell_data[name] if by_cell else data.point_data[name])
    if values.ndim != 1 or 0 in shape or values.size != int(np.prod(shape)):
        raise InputError(
            "file",
            "hold one number per voxel",
            f"an array of shape {values.shape} in {file.name}",
            "export grey values",
        )
    directions = np.asarray(data.direction_matrix, dtype=np.float64)
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
_REMEDY = (
    "use a .nii.gz, .nrrd, .mhd or .vti image, a DICOM folder, or a folder or pattern of TIFF "
    "slices"
)


def read_image(
    path: str | Path,
    *,
    spacing_mm: float | None = None,
    labels: bool = False,
    series: int | None = None,
) -> Image:
    """Read an image volume into LPS [mm], for any order and direction of the axes in its file.

    Origin, directions, units, slope and intercept are read from the file. If the file does not
    state one, a note states the assumption. Axes along LPS in any order are turned exactly, oblique
    ones resampled: `meshes.images.frame.along_lps`.

    Parameters
    ----------
    path
        Image file; folder with a DICOM series or TIFF slices; or a pattern of TIFF slices
        (`slices/*.tif`). TIFF slices count upward in z in the order of the numbers in their names.
    spacing_mm
        Distance between neighbours [mm] in all directions; None: read from the file. TIFF files
        state no distance.
    labels
        Whether the values are labels, which are not interpolated.
    series
        Number of the series of a DICOM folder that holds several.

    Raises
    ------
    InputError
        If the file is missing, empty, cut off, not readable, not an image of one number a voxel, or
        states values that cannot be applied.
    """
    given = (
        None
        if spacing_mm is None
        else require_positive("anatomy.spacing_mm", spacing_mm, "use the scanner's value")
    )
    path = Path(path)
    slices = tiff_slices(path)
    source = path.name
    if slices and given is None:
        raise InputError(
            "anatomy.spacing_mm",
            "be given for TIFF slices, which do not hold it",
            f"none for {source}",
            "use the scanner's value, for example 0.0195",
        )
    stored = (
        read_tiff_slices(slices, given, labels=labels)
        if slices and given is not None
        else _stored(path, series)
    )
    if given is None and stored.spacing_mm == (1.0, 1.0, 1.0):
        note = (
            f"The spacing in {source} is exactly 1 mm, often a placeholder: set "
            "anatomy.spacing_mm to be sure."
        )
        stored = replace(stored, notes=(*stored.notes, note))
    elif given is not None and stored.spacing_mm != (given,) * 3:
        note = (
            f"The spacing in {source} is {by(stored.spacing_mm)} mm; {given:g} mm is used, as "
            "given."
        )
        stored = replace(stored, spacing_mm=(given,) * 3, notes=(*stored.notes, note))
    values = stored.values
    if values.ndim != 3 or values.size == 0 or not np.issubdtype(values.dtype, np.number):
        raise InputError(
            "file",
            "hold one number per voxel",
            f"an array of shape {values.shape} in {source}",
            _REMEDY,
        )
    if np.issubdtype(values.dtype, np.floating) and not np.isfinite(values).all():
        count = int((~np.isfinite(values)).sum())
        raise InputError(
            "voxels",
            "be finite",
            f"{count} of {values.size} that are not in {source}",
            "mask them first",
        )
    return along_lps(stored, source, labels=labels)


def _stored(path: Path, series: int | None) -> StoredImage:
    """Return the image of a file or DICOM folder, as stored."""
    if is_folder(path):
        return read_dicom(path, series=series)
    if series is not None:
        raise InputError(
            "series", "be left out for a file", f"{series} for {path.name}", "it holds one image"
        )
    require_image_name(path)
    return next(read for suffix, read in _READERS.items() if path.name.lower().endswith(suffix))(
        path
    )


def require_image_name(path: Path) -> None:
    """Refuse a file whose name does not end like an image volume's.

    Folders and patterns are left to their readers.

    Raises
    ------
    InputError
        If the name does not fit; the message lists the formats.
    """
    known = (*_READERS, ".tif", ".tiff")
    if is_file(path) and not path.name.lower().endswith(known):
        raise InputError("file", "be an image volume of a known format", path.name, _REMEDY)
