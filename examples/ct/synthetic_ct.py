"""Writer of a synthetic CT of a humerus, a vertebra and density rods.

Run: ``python examples/ct/synthetic_ct.py FOLDER``.

Hounsfield units are computed from the composition. The linear attenuation of a voxel at one energy
is the mean over its materials, weighted with their volume fractions
(``meshes/ct/attenuation.toml``). Bone of every density is a mixture of dense bone and marrow. Noise
and 12-bit quantisation are added. The guide to CT import and the tests use this CT.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK
from nibabel.orientations import (
    apply_orientation,
    axcodes2ornt,
    inv_ornt_aff,
    ornt_transform,
)
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive, require_range
from meshes.ct.calibration import density_of, linear_attenuation
from meshes.ct.labels import Labels
from meshes.images.frame import Image, StoredImage, along_lps

RODS_KG_M3 = (200.0, 400.0, 600.0, 800.0, 1000.0, 1200.0, 1400.0, 1600.0, 1800.0)
"""Apparent density of the rods [kg/m3], labelled rod_200, rod_400 ... from the patient's right
to the left.
"""
HEAD_CENTRE_MM = (35.0, -8.0, 20.0)
HEAD_RADIUS_MM = 22.0
"""Centre and radius of the ball of the humeral head [mm, LPS]."""
_SHAFT_X_MM = 40.0
_SHAFT_MM = 13.0
"""Position of the axis of the shaft, and radius of the shaft [mm]."""
_NECK_MM = -20.0
_RIM_MM = 18.0
_RIM_RADIUS_MM = 28.0
"""Heights of the lower end and of the rim of the metaphysis, and radius of the rim [mm]."""
CORTEX_KG_M3 = 1850.0
SUBCHONDRAL_KG_M3 = 1200.0
TRABECULAR_KG_M3 = 350.0
_VERTEBRA_SHELL_KG_M3 = 1000.0
_VERTEBRA_CORE_KG_M3 = 250.0
_ARCH_KG_M3 = 1100.0
_HALF_MM = (108.0, 80.0, 52.0)
"""Half size of the image [mm]. The lower edge of the image cuts off the shaft.

Sizes and densities of the bones are invented, within the usual range of adults.
"""
_LOWEST_HU = -1024
_HIGHEST_HU = 3071
"""Range of 12-bit values."""
ORIENTATIONS = ("LPS", "RAS", "AIR", "SLP")
"""Axis orientations that the command line offers; `reoriented` accepts all 48."""
_ENDS = (("R", "L"), ("A", "P"), ("I", "S"))
"""Names of the lower and of the upper end of each axis in LPS."""
_CT_CLASS = "1.2.840.10008.5.1.4.1.1.2"

Distance = Callable[[Array], Array]


@dataclass(frozen=True)
class Person:
    """Differences from the tabulated values for one person and one scanner.

    Attributes
    ----------
    attenuation
        Factor of the linear attenuation of adipose, muscle, blood and the cortex of the shaft. It
        is 1 for materials that are not given.
    mineral
        Factor of the difference between the attenuations of bone and of marrow at the same density.
        It does not apply to the cortex of the shaft.
    marrow_fat
        Share of fat in marrow.
    water_HU, scale
        Errors of the scanner: Hounsfield units of water, and a factor of all Hounsfield units.
    """

    attenuation: Mapping[str, float] = field(default_factory=dict)
    mineral: float = 1.0
    marrow_fat: float = 0.6
    water_HU: float = 0.0
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class CtPhantom:
    """Synthetic CT and its true values.

    Attributes
    ----------
    stored
        Hounsfield units on the scanner's grid, 12-bit values, int16.
    labels
        Label number of each voxel on the same grid, uint8.
    names
        Dictionary from label number to name. Names of TotalSegmentator are used where they exist.
    density_kg_m3
        Apparent density of bone [kg/m3] on the same grid, 0 outside bone.
    energy_keV
        Effective energy.
    """

    stored: StoredImage
    labels: StoredImage
    names: dict[int, str]
    density_kg_m3: NDArray[np.float32]
    energy_keV: float

    def image(self) -> Image:
        """CT in LPS."""
        return along_lps(self.stored, "phantom")

    def named_labels(self) -> Labels:
        """Labels in LPS, on the grid of `image`."""
        return Labels(along_lps(self.labels, "phantom labels", labels=True), self.names)

    def rod_means(self) -> dict[float, float]:
        """Mean [HU] of each rod's inner voxels by its density [kg/m3]."""
        from scipy.ndimage import binary_erosion

        number = {name: number for number, name in self.names.items()}
        masks = {rod: self.labels.values == number[f"rod_{rod:g}"] for rod in RODS_KG_M3}
        return {
            rod: float(self.stored.values[binary_erosion(mask, iterations=2)].mean())
            for rod, mask in masks.items()
        }


@dataclass(frozen=True)
class _Part:
    """Body with its label, distance [mm, negative inside] and bone density [kg/m3].

    If the density is None, the body consists of a soft tissue.
    """

    label: str
    distance: Distance
    density_kg_m3: float | None = None
    tissue: str = "cortex"


def ct_phantom(
    rng: np.random.Generator,
    *,
    energy_keV: float = 70.0,
    noise_HU: float = 20.0,
    spacing_mm: tuple[float, float, float] = (0.9, 0.9, 1.5),
    tilt_deg: float = 0.0,
    person: Person | None = None,
) -> CtPhantom:
    """CT of the phantom.

    Parameters
    ----------
    rng
        Random generator for the noise.
    energy_keV
        Effective energy of the X-rays.
    noise_HU
        Standard deviation of a voxel.
    spacing_mm
        Distance of the columns, rows and slices [mm].
    tilt_deg
        Tilt of the gantry about x [degrees]. Slices are tilted, and their centres stay on a line
        along z.
    person
        Differences from the tabulated values.

    Raises
    ------
    InputError
        If an option is out of range.
    """
    # range of the energies in the attenuation tables
    energy = require_range("energy_keV", energy_keV, 30.0, 150.0, "use 70")
    noise = require_range("noise_HU", noise_HU, 0.0, 500.0, "use 20")
    # range of the tilt of a scanner's gantry
    tilt = math.radians(require_range("tilt_deg", tilt_deg, -30.0, 30.0, "use 0"))
    spacing = np.array([require_positive("spacing_mm", each, "use 0.9") for each in spacing_mm])
    directions = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(tilt), 0.0], [0.0, math.sin(tilt), 1.0]])
    shape = tuple(int(2.0 * half // size) for half, size in zip(_HALF_MM, spacing_mm, strict=True))
    steps = directions * spacing
    origin = -0.5 * steps @ (np.array(shape) - 1.0)
    person = person or Person()
    parts = _parts()
    names = list(dict.fromkeys(part.label for part in parts))
    attenuation = np.empty(shape, np.float32)
    density = np.empty(shape, np.float32)
    labels = np.empty(shape, np.uint8)
    plane = (
        np.stack(np.meshgrid(*map(np.arange, shape[:2]), [0], indexing="ij"), axis=-1)[:, :, 0]
        @ steps.T
        + origin
    )
    for k in range(shape[2]):
        at = plane + k * steps[:, 2]
        attenuation[:, :, k], density[:, :, k], labels[:, :, k] = _painted(
            parts, names, at, energy, person, spacing
        )
    # definition of the Hounsfield unit
    true = 1000.0 * (attenuation / linear_attenuation("water", energy) - 1.0)
    values = person.scale * true + person.water_HU + rng.normal(0.0, noise, shape)
    values = np.clip(np.rint(values), _LOWEST_HU, _HIGHEST_HU).astype(np.int16)
    frame = (spacing_mm, directions, origin)
    numbers = {number: name for number, name in enumerate(names, 1) if name != "pad"}
    return CtPhantom(
        StoredImage(values, *frame), StoredImage(labels, *frame), numbers, density, energy
    )


def _painted(
    parts: list[_Part],
    names: list[str],
    at: Array,
    energy_keV: float,
    person: Person,
    spacing: Array,
) -> tuple[Array, Array, NDArray[np.uint8]]:
    """Return linear attenuation [1/m], bone density [kg/m3] and label at points.

    Edges are as wide as a voxel.
    """
    total = np.full(at.shape[:-1], linear_attenuation("air", energy_keV))
    density = np.zeros_like(total)
    labels = np.zeros(total.shape, np.uint8)
    width = float(np.mean(spacing))
    for part in parts:
        distance = part.distance(at)
        # a voxel on the surface holds half of each material
        share = np.clip(0.5 - distance / width, 0.0, 1.0)
        total += share * (_attenuation(part, energy_keV, person) - total)
        density += share * ((part.density_kg_m3 or 0.0) - density)
        # the pad lies under the patient and has no label
        labels[distance < 0.0] = 0 if part.label == "pad" else names.index(part.label) + 1
    return total, density, labels


def _attenuation(part: _Part, energy_keV: float, person: Person) -> float:
    """Linear attenuation [1/m] of a part's material."""
    factor = person.attenuation.get(part.tissue, 1.0)
    # soft tissue and water
    if part.density_kg_m3 is None:
        return factor * linear_attenuation(part.tissue, energy_keV)
    fat = person.marrow_fat
    marrow = fat * linear_attenuation("adipose", energy_keV) + (1.0 - fat) * linear_attenuation(
        "muscle", energy_keV
    )
    share = part.density_kg_m3 / density_of("cortex")
    over_marrow = share * (linear_attenuation("cortex", energy_keV) - marrow)
    # the cortex of the shaft has a separate factor, see `Person.attenuation`
    is_shaft = part.density_kg_m3 == CORTEX_KG_M3
    return factor * (marrow + over_marrow) if is_shaft else marrow + person.mineral * over_marrow


def _parts() -> list[_Part]:
    """Return the bodies. A later body replaces earlier bodies where they overlap."""
    head = HEAD_CENTRE_MM
    shaft = (_SHAFT_X_MM, HEAD_CENTRE_MM[1])
    # sizes and positions in mm are invented, see `_HALF_MM`
    spine = (-40.0, -8.0)
    canal = (spine[0], 21.5)
    rods = [
        # rods 22 mm apart from right to left, 13 mm thick, in the pad below the body
        _Part(f"rod_{rod:g}", partial(_cylinder, centre=(22.0 * (k - 4), 70.0), radius=6.5), rod)
        for k, rod in enumerate(RODS_KG_M3)
    ]
    return [
        _Part(
            "subcutaneous_fat",
            partial(_ellipse, centre=(0.0, -8.0), radii=(100.0, 62.0)),
            tissue="adipose",
        ),
        _Part("muscle", partial(_ellipse, centre=(0.0, -8.0), radii=(88.0, 52.0)), tissue="muscle"),
        _Part("aorta", partial(_cylinder, centre=(0.0, -12.0), radius=9.0), tissue="blood"),
        _Part(
            "humerus_left",
            partial(_cylinder, centre=shaft, radius=_SHAFT_MM, top=-18.0),
            CORTEX_KG_M3,
        ),
        _Part(
            "humerus_left",
            partial(_cylinder, centre=shaft, radius=_SHAFT_MM - 5.0, top=-18.0),
            60.0,
        ),
        _Part("humerus_left", partial(_metaphysis, inside=0.0), SUBCHONDRAL_KG_M3),
        _Part(
            "humerus_left", partial(_ball, centre=head, radius=HEAD_RADIUS_MM), SUBCHONDRAL_KG_M3
        ),
        _Part("humerus_left", partial(_metaphysis, inside=2.0), TRABECULAR_KG_M3),
        _Part(
            "humerus_left",
            partial(_ball, centre=head, radius=HEAD_RADIUS_MM - 2.0),
            TRABECULAR_KG_M3,
        ),
        _Part("vertebrae_L1", partial(_arch, spine_x=spine[0]), _ARCH_KG_M3),
        _Part(
            "vertebrae_L1",
            partial(_cylinder, centre=spine, radius=20.0, top=14.0, bottom=-14.0),
            _VERTEBRA_SHELL_KG_M3,
        ),
        _Part(
            "vertebrae_L1",
            partial(_cylinder, centre=spine, radius=18.0, top=12.0, bottom=-12.0),
            _VERTEBRA_CORE_KG_M3,
        ),
        _Part("spinal_canal", partial(_cylinder, centre=canal, radius=7.0), tissue="muscle"),
        _Part("pad", _pad, tissue="water"),
        *rods,
    ]


def _ellipse(at: Array, *, centre: tuple[float, float], radii: tuple[float, float]) -> Array:
    """Return the approximate distance from an elliptic cylinder along z.

    The distance is the level function divided by its slope.
    """
    x, y = ((at[..., k] - centre[k]) / radii[k] for k in (0, 1))
    level = np.hypot(x, y)
    return np.asarray(
        # the axis of the cylinder, where the slope is zero
        (level - 1.0) * level / np.maximum(np.hypot(x / radii[0], y / radii[1]), 1e-9)
    )


def _cylinder(
    at: Array,
    *,
    centre: tuple[float, float],
    radius: float,
    top: float = math.inf,
    bottom: float = -math.inf,
) -> Array:
    around = np.hypot(at[..., 0] - centre[0], at[..., 1] - centre[1]) - radius
    return np.asarray(np.maximum(around, np.maximum(at[..., 2] - top, bottom - at[..., 2])))


def _metaphysis(at: Array, *, inside: float) -> Array:
    """Return a cone that widens from the shaft to a rim around the lower half of the head.

    The surface of the cone lies `inside` [mm] below the outer surface.
    """
    up = np.clip((at[..., 2] - _NECK_MM) / (_RIM_MM - _NECK_MM), 0.0, 1.0)
    radius = _SHAFT_MM + up * (_RIM_RADIUS_MM - _SHAFT_MM) - inside
    around = np.hypot(at[..., 0] - _SHAFT_X_MM, at[..., 1] - HEAD_CENTRE_MM[1]) - radius
    return np.asarray(
        np.maximum(
            around, np.maximum(at[..., 2] + inside - _RIM_MM, _NECK_MM + inside - at[..., 2])
        )
    )


def _ball(at: Array, *, centre: tuple[float, float, float], radius: float) -> Array:
    return np.asarray(np.linalg.norm(at - np.array(centre), axis=-1) - radius)


def _arch(at: Array, *, spine_x: float) -> Array:
    """Return the arch: two pedicles backward from the body, laminae and a spinous process.

    The laminae join the pedicles behind the canal.
    """
    across = np.abs(at[..., 0] - spine_x)
    y = at[..., 1]
    z = at[..., 2]
    # centre and half width of the boxes [mm], invented, see `_HALF_MM`
    pedicle = np.maximum(
        np.maximum(np.abs(across - 12.0) - 4.0, np.abs(y - 16.0) - 14.0), np.abs(z - 5.0) - 6.5
    )
    lamina = np.maximum(np.maximum(across - 16.0, np.abs(y - 31.5) - 3.0), np.abs(z) - 11.0)
    spinous = np.maximum(np.maximum(across - 3.0, np.abs(y - 36.0) - 5.0), np.abs(z + 3.0) - 7.0)
    return np.asarray(np.minimum(np.minimum(pedicle, lamina), spinous))


def _pad(at: Array) -> Array:
    """Return the distance from a pad of water below the body."""
    # as wide as the body, and 2 mm thicker than the rods on both sides [mm]
    return np.asarray(np.maximum(np.abs(at[..., 0]) - 100.0, np.abs(at[..., 1] - 70.0) - 8.5))


def reoriented(stored: StoredImage, axes: str) -> StoredImage:
    """Return the same voxels at the same positions, with the axes of the array along `axes`.

    For example, `axes` is RAS: right, anterior, superior.

    Raises
    ------
    InputError
        If the axes are not one of each pair L or R, P or A, S or I.
    """
    try:
        wanted = axcodes2ornt(axes.upper(), _ENDS)
        turn = ornt_transform(axcodes2ornt("LPS", _ENDS), wanted)
        if len(np.unique(wanted[:, 0])) < 3:
            raise ValueError("an axis is named twice")
    except ValueError:
        raise InputError(
            f"axes must name each direction once, got {axes!r}: use LPS or RAS"
        ) from None
    affine = np.eye(4)
    affine[:3, :3] = stored.directions * stored.spacing_mm
    affine[:3, 3] = stored.origin_mm
    affine = affine @ inv_ornt_aff(turn, stored.values.shape)
    x, y, z = (stored.spacing_mm[axis] for axis in np.argsort(turn[:, 0]))
    values = apply_orientation(stored.values, turn)
    return StoredImage(values, (x, y, z), affine[:3, :3] / (x, y, z), affine[:3, 3])


def write_stored(path: str | Path, stored: StoredImage, *, tilt_deg: float = 0.0) -> Path:
    """Write an image in the format that the ending of its name gives.

    The endings are .nii, .nii.gz, .nrrd, .mha and .mhd. A name without an ending makes a DICOM
    folder.

    Raises
    ------
    InputError
        If the name has another ending.
    """
    path = Path(path)
    if path.name.endswith((".nii", ".nii.gz", ".nrrd", ".mha", ".mhd")):
        image = SimpleITK.GetImageFromArray(np.ascontiguousarray(stored.values.transpose(2, 1, 0)))
        image.SetSpacing(stored.spacing_mm)
        image.SetOrigin(stored.origin_mm.tolist())
        image.SetDirection(stored.directions.ravel().tolist())
        SimpleITK.WriteImage(image, str(path), useCompression=path.suffix in (".nrrd", ".gz"))
    elif path.suffix == "":
        _write_dicom(path, stored, tilt_deg)
    else:
        raise InputError(
            f"file must end in .nii.gz, .nrrd, .mha or be a folder, got {path.name}: use ct.nii.gz"
        )
    return path


def write_phantom(folder: str | Path, phantom: CtPhantom) -> Path:
    """Write a phantom in four formats with different axis orders, its labels and its true values.

    The images are ``dicom`` (LPS), ``ct.nii.gz`` (RAS), ``ct.nrrd`` (AIR) and ``ct.mha`` (SLP). The
    labels are in ``labels.nii.gz``, and their names in ``labels.toml``. ``truth.json`` holds the
    effective energy, the density and mean of each rod, and the ball of the humeral head.
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
        "rods": [
            {"density_kg_m3": density, "mean_HU": mean}
            for density, mean in phantom.rod_means().items()
        ],
        "head_centre_mm_lps": list(HEAD_CENTRE_MM),
        "head_radius_mm": HEAD_RADIUS_MM,
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=2), "utf-8")
    return folder


def _write_dicom(folder: Path, stored: StoredImage, tilt_deg: float) -> None:
    """Write a series of uncompressed slices along the last axis of the array, one file each."""
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
        slice_.StudyInstanceUID = study
        slice_.SeriesInstanceUID = series
        slice_.Modality = "CT"
        slice_.PatientName = "Phantom^Synthetic"
        slice_.PatientID = "phantom"
        slice_.SeriesNumber = 1
        slice_.InstanceNumber = k + 1
        slice_.ImagePositionPatient = _decimals(stored.origin_mm + k * steps[:, 2])
        slice_.ImageOrientationPatient = _decimals(stored.directions[:, :2].T.ravel())
        slice_.PixelSpacing = _decimals(np.array([stored.spacing_mm[1], stored.spacing_mm[0]]))
        slice_.SliceThickness = f"{stored.spacing_mm[2]:g}"
        slice_.GantryDetectorTilt = f"{tilt_deg:g}"
        slice_.RescaleSlope = "1"
        slice_.RescaleIntercept = "-1024"
        slice_.RescaleType = "HU"
        _set_pixels(slice_, stored.values[:, :, k])
        slice_.save_as(folder / f"slice{k:04d}.dcm", enforce_file_format=True)


def _set_pixels(slice_: Any, values: NDArray[np.number]) -> None:
    slice_.Rows = values.shape[1]
    slice_.Columns = values.shape[0]
    slice_.SamplesPerPixel = 1
    slice_.PhotometricInterpretation = "MONOCHROME2"
    slice_.BitsAllocated = 16
    # 12 of 16 bits, as scanners store them; 1024 moves the lowest value to 0 (RescaleIntercept)
    slice_.BitsStored = 12
    slice_.HighBit = 11
    slice_.PixelRepresentation = 0
    slice_.PixelData = (values + 1024).astype("<u2").tobytes(order="F")


def _decimals(numbers: Array) -> list[str]:
    """Return numbers as DICOM decimal strings of at most 16 characters."""
    return [f"{number:.9g}" for number in numbers.tolist()]


def main(words: list[str] | None = None) -> int:
    """Write the synthetic CT with the options of the command line and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "folder",
        help="output folder for dicom/, dicom_tilted/, ct.nii.gz, ct.nrrd, ct.mha and labels",
    )
    parser.add_argument(
        "--energy-keV", type=float, default=70.0, help="effective energy, 70 by default"
    )
    parser.add_argument(
        "--noise-HU", type=float, default=20.0, help="standard deviation of a voxel, 20 by default"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument(
        "--tilt-deg", type=float, default=12.0, help="tilt of the gantry in dicom_tilted"
    )
    asked = parser.parse_args(words)
    rng = np.random.default_rng(asked.seed)
    try:
        straight, tilted = (
            ct_phantom(rng, energy_keV=asked.energy_keV, noise_HU=asked.noise_HU, tilt_deg=tilt)
            for tilt in (0.0, asked.tilt_deg)
        )
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    folder = write_phantom(asked.folder, straight)
    write_stored(folder / "dicom_tilted", tilted.stored, tilt_deg=asked.tilt_deg)
    print(
        f"{folder}: a CT of {straight.stored.values.shape} voxels in four formats, its "
        "labels and truth.json"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
