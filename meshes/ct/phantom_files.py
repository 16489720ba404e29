"""A CT and its labels written as DICOM series, NIfTI, NRRD or MetaImage, stored along any axes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.ct.phantom import HEAD_CENTRE_MM, HEAD_RADIUS_MM, CtPhantom
from meshes.images.frame import StoredImage

__all__ = ["ORIENTATIONS", "reoriented", "write_phantom", "write_stored"]

ORIENTATIONS = ("LPS", "RAS", "AIR", "SLP")
"""What the axes of an array may point to; any of the 48 will do."""
_AXES = {
    "L": (0, 1.0),
    "R": (0, -1.0),
    "P": (1, 1.0),
    "A": (1, -1.0),
    "S": (2, 1.0),
    "I": (2, -1.0),
}
_TO_RAS = np.diag([-1.0, -1.0, 1.0])
_CT_CLASS = "1.2.840.10008.5.1.4.1.1.2"


def reoriented(stored: StoredImage, axes: str) -> StoredImage:
    """The same voxels in the same places with the array's axes along `axes`, such as RAS: right, anterior, superior.

    Raises
    ------
    InputError
        If the axes are not one of each pair L or R, P or A, S or I.
    """
    found = [_AXES.get(letter.upper(), (3, 1.0)) for letter in axes]
    if sorted(axis for axis, _ in found) != [0, 1, 2]:
        raise InputError(f"axes must name each direction once, got {axes!r}: use LPS or RAS")
    order = [axis for axis, _ in found]
    signs = np.array([sign for _, sign in found])
    steps = (stored.directions * stored.spacing_mm)[:, order]
    flipped = np.flatnonzero(signs < 0.0)
    values = np.flip(np.transpose(stored.values, order), tuple(flipped.tolist()))
    origin = stored.origin_mm + sum((steps[:, axis] * (values.shape[axis] - 1) for axis in flipped), start=np.zeros(3))
    spacing = tuple(stored.spacing_mm[axis] for axis in order)
    x, y, z = spacing
    return StoredImage(values, (x, y, z), stored.directions[:, order] * signs, origin)


def write_stored(path: str | Path, stored: StoredImage, *, tilt_deg: float = 0.0) -> Path:
    """Write an image in the format of its name: .nii, .nii.gz, .nrrd, .mha, .mhd, or none for a DICOM folder.

    Raises
    ------
    InputError
        If the name ends otherwise.
    """
    path = Path(path)
    if path.name.endswith((".nii", ".nii.gz")):
        _write_nifti(path, stored)
    elif path.suffix in (".nrrd", ".mha", ".mhd"):
        _write_itk(path, stored)
    elif path.suffix == "":
        _write_dicom(path, stored, tilt_deg)
    else:
        raise InputError(f"file must end in .nii.gz, .nrrd, .mha or be a folder, got {path.name}: use ct.nii.gz")
    return path


def write_phantom(folder: str | Path, phantom: CtPhantom) -> Path:
    """Write a phantom in four formats along four orders of axes, its labels and what is true of it.

    ``dicom`` (LPS), ``ct.nii.gz`` (RAS), ``ct.nrrd`` (AIR) and ``ct.mha`` (SLP); ``labels.nii.gz`` with the names in
    ``labels.toml``; ``truth.json``: effective energy, density and mean of each rod, and the ball of the humerus's head.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name, axes in zip(("dicom", "ct.nii.gz", "ct.nrrd", "ct.mha"), ORIENTATIONS, strict=True):
        write_stored(folder / name, reoriented(phantom.stored, axes))
    write_stored(folder / "labels.nii.gz", phantom.labels)
    names = "".join(f"{name} = {number}\n" for number, name in phantom.names.items())
    (folder / "labels.toml").write_text(f"[labels]\n{names}", "utf-8")
    truth = {
        "effective_energy_keV": phantom.energy_keV,
        "rods": [{"density_kg_m3": density, "mean_HU": mean} for density, mean in phantom.rod_means().items()],
        "head_centre_mm_lps": list(HEAD_CENTRE_MM),
        "head_radius_mm": HEAD_RADIUS_MM,
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=2), "utf-8")
    return folder


def _write_nifti(path: Path, stored: StoredImage) -> None:
    import nibabel

    affine = np.eye(4)
    affine[:3, :3] = _TO_RAS @ (stored.directions * stored.spacing_mm)
    affine[:3, 3] = _TO_RAS @ stored.origin_mm
    image = nibabel.nifti1.Nifti1Image(np.ascontiguousarray(stored.values), affine)
    image.header.set_xyzt_units("mm")
    nibabel.loadsave.save(image, path)


def _write_itk(path: Path, stored: StoredImage) -> None:
    import SimpleITK

    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(stored.values.transpose(2, 1, 0)))
    image.SetSpacing(stored.spacing_mm)
    image.SetOrigin(stored.origin_mm.tolist())
    image.SetDirection(stored.directions.ravel().tolist())
    SimpleITK.WriteImage(image, str(path), useCompression=path.suffix == ".nrrd")


def _write_dicom(folder: Path, stored: StoredImage, tilt_deg: float) -> None:
    """A series of uncompressed slices, a file each along the array's last axis."""
    import pydicom
    from pydicom.uid import UID, ExplicitVRLittleEndian, generate_uid

    folder.mkdir(parents=True, exist_ok=True)
    study, series = (generate_uid(entropy_srcs=[folder.name, part]) for part in ("study", "series"))
    steps = stored.directions * stored.spacing_mm
    for k in range(stored.values.shape[2]):
        slice_ = pydicom.Dataset()
        slice_.file_meta = pydicom.dataset.FileMetaDataset()
        slice_.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        slice_.file_meta.MediaStorageSOPClassUID = slice_.SOPClassUID = UID(_CT_CLASS)
        slice_.SOPInstanceUID = generate_uid(entropy_srcs=[folder.name, str(k)])
        slice_.file_meta.MediaStorageSOPInstanceUID = slice_.SOPInstanceUID
        slice_.StudyInstanceUID, slice_.SeriesInstanceUID = study, series
        slice_.Modality, slice_.PatientName, slice_.PatientID = "CT", "Phantom^Synthetic", "phantom"
        slice_.SeriesNumber, slice_.InstanceNumber = 1, k + 1
        slice_.ImagePositionPatient = _decimals(stored.origin_mm + k * steps[:, 2])
        slice_.ImageOrientationPatient = _decimals(stored.directions[:, :2].T.ravel())
        slice_.PixelSpacing = _decimals(np.array([stored.spacing_mm[1], stored.spacing_mm[0]]))
        slice_.SliceThickness, slice_.GantryDetectorTilt = f"{stored.spacing_mm[2]:g}", f"{tilt_deg:g}"
        slice_.RescaleSlope, slice_.RescaleIntercept, slice_.RescaleType = "1", "-1024", "HU"
        _set_pixels(slice_, stored.values[:, :, k])
        slice_.save_as(folder / f"slice{k:04d}.dcm", enforce_file_format=True)


def _set_pixels(slice_: Any, values: NDArray[np.number]) -> None:
    slice_.Rows, slice_.Columns = values.shape[1], values.shape[0]
    slice_.SamplesPerPixel, slice_.PhotometricInterpretation = 1, "MONOCHROME2"
    slice_.BitsAllocated, slice_.BitsStored, slice_.HighBit, slice_.PixelRepresentation = 16, 12, 11, 0
    slice_.PixelData = (values + 1024).astype("<u2").tobytes(order="F")


def _decimals(numbers: NDArray[np.float64]) -> list[str]:
    """Numbers as DICOM writes them, 16 characters at most."""
    return [f"{number:.9g}" for number in numbers.tolist()]
