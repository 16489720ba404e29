"""Image volumes from files: anything pyvista reads, and slices stored as TIFF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.dicom import require_uncompressed
from meshes.errors import InputError, require_positive

__all__ = ["Image", "read_image"]

_TIFF = (".tif", ".tiff")
_REMEDY = "use a .vti, .nii.gz, .mhd or .nrrd image, a DICOM folder, or a folder or pattern of TIFF slices"


@dataclass(frozen=True, eq=False)
class Image:
    """Grey values on a regular grid.

    Attributes
    ----------
    values
        Grey values, shape (nx, ny, nz), any real type.
    spacing_mm
        Distance between neighbours along x, y and z [mm].
    source
        File or folder name.
    notes
        What was assumed, a sentence each.
    """

    values: NDArray[Any]
    spacing_mm: tuple[float, float, float]
    source: str
    notes: tuple[str, ...]


def read_image(path: str | Path, *, spacing_mm: float | None = None, array: str | None = None) -> Image:
    """Read an image volume.

    Parameters
    ----------
    path
        Image file; folder with DICOM files or TIFF slices; or a pattern (`slices/*.tif`). Slices count upward in z in
        the order of their names.
    spacing_mm
        Distance between neighbours [mm] in all directions; None: what the file says. TIFF files say nothing.
    array
        Name of the array, where the file holds several; None: the active one.

    Raises
    ------
    InputError
        If the file is missing, empty, not readable, not an image, or has no usable spacing or values.
    """
    given = None
    if spacing_mm is not None:
        given = require_positive("anatomy.spacing_mm", spacing_mm, "use the scanner's value")
    slices, source = _tiff_slices(Path(path)), Path(path).name
    if slices:
        if given is None:
            raise InputError(
                f"anatomy.spacing_mm must be given for TIFF slices, which do not hold it, got none for "
                f"{source}: use the scanner's value, for example 0.0195"
            )
        values, file_spacing = _read_slices(slices), (given, given, given)
    else:
        values, file_spacing = _read_with_pyvista(Path(path), array)
    notes = []
    if given is None and file_spacing == (1.0, 1.0, 1.0):
        notes.append(
            f"The spacing in {source} is exactly 1 mm, often a placeholder: set anatomy.spacing_mm to be sure."
        )
    if given is not None and not slices and file_spacing != (given,) * 3:
        notes.append(f"The spacing in {source} is {_by(file_spacing)} mm; {given:g} mm is used, as told.")
    if values.ndim != 3 or values.size == 0 or not np.issubdtype(values.dtype, np.number):
        raise InputError(
            f"file must hold one number per voxel, got an array of shape {values.shape} in {source}: {_REMEDY}"
        )
    if np.issubdtype(values.dtype, np.floating) and not np.isfinite(values).all():
        count = int((~np.isfinite(values)).sum())
        raise InputError(
            f"voxels must be finite, got {count} of {values.size} that are not in {source}: mask them first"
        )
    return Image(values, (given,) * 3 if given is not None else file_spacing, source, tuple(notes))


def _tiff_slices(path: Path) -> list[Path]:
    """TIFF files meant by a path: the file, the slices in the folder, or those that match the pattern."""
    if any(mark in path.name for mark in "*?["):
        found = sorted(path.parent.glob(path.name))
        if not found:
            raise InputError(f"file must exist, got {path}, which matches nothing: check the folder and the pattern")
        return found
    if path.is_dir():
        return sorted(file for file in path.iterdir() if file.suffix.lower() in _TIFF)
    if not path.exists():
        raise InputError(f"file must exist, got {path}: check the path, which is taken from the working directory")
    if path.is_file() and path.stat().st_size == 0:
        raise InputError(f"file must hold an image, got the empty file {path.name}: export it again")
    return [path] if path.suffix.lower() in _TIFF else []


def _read_slices(files: Sequence[Path]) -> NDArray[Any]:
    """Grey values of TIFF slices, shape (columns, rows, slices)."""
    from skimage.io import imread

    planes = []
    for file in files:
        try:
            planes.append(np.atleast_3d(imread(file).T))
        except Exception as problem:  # the readers raise many kinds, none documented
            raise InputError(
                f"file must be a readable TIFF slice, got {file.name} ({type(problem).__name__}): export it again"
            ) from problem
        if planes[-1].shape[:2] != planes[0].shape[:2]:
            raise InputError(
                f"slices must all have the same size, got {_by(planes[-1].shape[:2])} in {file.name} "
                f"after {_by(planes[0].shape[:2])}: keep other images out of the folder"
            )
    return np.concatenate(planes, axis=2)


def _read_with_pyvista(path: Path, array: str | None) -> tuple[NDArray[Any], tuple[float, float, float]]:
    """Grey values, shape (nx, ny, nz), and spacing [mm] of an image file or DICOM folder."""
    import pyvista
    import vtk

    if path.is_dir():
        require_uncompressed(path)
    shown = vtk.vtkObject.GetGlobalWarningDisplay()
    vtk.vtkObject.SetGlobalWarningDisplay(0)
    try:
        data: Any = pyvista.read(path)
    except Exception as problem:  # the readers raise many kinds, none documented
        raise InputError(
            f"file must be a readable image volume, got {path.name} ({type(problem).__name__}): {_REMEDY}"
        ) from problem
    finally:
        vtk.vtkObject.SetGlobalWarningDisplay(shown)
    if not isinstance(data, pyvista.ImageData) or not data.array_names:
        raise InputError(
            f"file must hold an image volume, got {type(data).__name__} without voxels in {path.name}: {_REMEDY}"
        )
    name = array or data.active_scalars_name or data.array_names[0]
    if name not in data.array_names:
        raise InputError(
            f"anatomy.array must be one of {', '.join(data.array_names)}, got {name}: use one of these names"
        )
    by_cell = name in data.cell_data
    shape = tuple(n - 1 if by_cell else n for n in data.dimensions)
    values = np.asarray(data.cell_data[name] if by_cell else data.point_data[name])
    if values.ndim != 1 or values.size != int(np.prod(shape)):
        raise InputError(
            f"file must hold one number per voxel, got an array of shape {values.shape} in {path.name}: {_REMEDY}"
        )
    x, y, z = (float(s) for s in data.spacing)
    return values.reshape(shape, order="F"), (x, y, z)


def _by(numbers: Sequence[float]) -> str:
    return " x ".join(f"{number:g}" for number in numbers)
