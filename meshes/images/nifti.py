"""NIfTI images, with the header read by nibabel.

Every number that places or scales the voxels is checked or applied.
"""

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, by
from meshes.images.data import first_bytes, is_gzip, read_voxels, scaled
from meshes.images.frame import StoredImage

__all__ = ["read_nifti"]

Header = Any
"""A header of nibabel, a mapping of its fields."""

_TO_LPS = np.array([-1.0, -1.0, 1.0])
"""NIfTI counts +x to the right and +y to the front."""
_UNITS_MM = {0: 1.0, 1: 1000.0, 2: 1.0, 3: 1e-3}
_AGREE = 1e-3
_SINGLE_FILE = (b"n+1", b"n+2")


def read_nifti(path: Path) -> StoredImage:
    """Read a NIfTI-1 or -2 image (`.nii`, `.nii.gz`) with its slope, intercept, units and place.

    The place is from the sform if its code is above 0, else from the qform. If neither states a
    place, the axes are taken as LPS from (0, 0, 0).

    Raises
    ------
    InputError
        If the file is cut off, holds other than one real number a voxel in three dimensions, or its
        header contradicts itself.
    """
    header = _header(path)
    dim = [int(n) for n in header["dim"]]
    sizes = dim[1 : dim[0] + 1]
    if not 3 <= dim[0] <= 7 or min(sizes) < 1 or any(n != 1 for n in sizes[3:]):
        raise _fault(path, "dim", "count three axes, with no zero and no further axis", by(sizes))
    dtype = _dtype(header, path)
    offset = float(header["vox_offset"])
    least = int(header["sizeof_hdr"]) + 4
    if not (offset >= least and offset == int(offset)):
        raise _fault(path, "vox_offset", f"be at least {least}", offset)
    shape = (sizes[0], sizes[1], sizes[2])
    values = read_voxels(path, dtype, shape, skip=int(offset), compressed=is_gzip(path))
    notes: list[str] = []
    affine = _affine(header, path, notes)
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
    """Return the header, a mapping of its fields."""
    from io import BytesIO

    from nibabel import Nifti1Header, Nifti2Header
    from nibabel.spatialimages import HeaderDataError
    from nibabel.wrapstruct import WrapStructError

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
        f"{path.name} which does not start as one does",
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
        raise _fault(path, "datatype", "be known", int(header["datatype"])) from problem
    if dtype.kind not in "iuf" or not 0 < dtype.itemsize <= 8:
        raise _fault(path, "datatype", "be one real number per voxel", dtype)
    if int(header["bitpix"]) != 8 * dtype.itemsize:
        raise _fault(path, "bitpix", f"be that of {dtype}", int(header["bitpix"]))
    return dtype


def _affine(header: Header, path: Path, notes: list[str]) -> Array:
    """Return the matrix from voxel numbers to coordinates, in the header's unit and frame (RAS)."""
    from nibabel.spatialimages import HeaderDataError

    spacing = np.array(header["pixdim"][1:4], dtype=np.float64)
    if not (np.isfinite(spacing).all() and (spacing > 0.0).all()):
        raise _fault(path, "pixdim", "be positive", by(spacing))
    qform: Array | None = None
    if int(header["qform_code"]) > 0:
        try:
            qform = np.asarray(header.get_qform(), dtype=np.float64)
        except (HeaderDataError, ValueError) as problem:
            raise _fault(path, "the quaternion", "have a norm of 1", "another") from problem
    if int(header["sform_code"]) <= 0:
        if qform is not None:
            return qform
        notes.append(
            f"{path.name} states no place or directions: its axes are taken as left, back and head."
        )
        return np.diag([*(spacing * _TO_LPS), 1.0])
    sform: Array = np.asarray(header.get_sform(), dtype=np.float64)
    stated = np.linalg.norm(sform[:3, :3], axis=0)
    if not np.allclose(stated, spacing, rtol=_AGREE, atol=0.0):
        found = f"{by(spacing)} and {by(stated)}"
        raise _fault(path, "pixdim and sform", "state the same spacing", found)
    if qform is not None:
        corner = np.array([*(int(n) for n in header["dim"][1:4]), 0.0])
        apart = np.abs((sform - qform) @ corner)[:3].max() + np.abs(sform - qform)[:3, 3].max()
        if apart > 0.5 * stated.min():
            notes.append(
                f"The sform and the qform of {path.name} place it differently: the sform is taken."
            )
    return sform
