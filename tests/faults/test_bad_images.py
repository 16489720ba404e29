"""Images with wrong content.

Each is refused in one sentence that names the error, and none is run.
"""

import re

import image_writers as write
import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.images.reading import read_image

SHAPE = (7, 5, 4)
VALUES = np.random.default_rng(0).integers(0, 3000, SHAPE).astype(np.int16)
AXES, ORIGIN = np.diag([0.8, 0.5, 2.0]), (10.0, 20.0, -30.0)
UNSPACED = {"space": None, "space_directions": None, "space_origin": None}
HUGE = "1.8e19"


def cut(path, share):
    """Leave the first part of a file."""
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


def nifti(folder, *, suffix=".nii", left=1.0, **options):
    path = folder / f"image{suffix}"
    write.write_nifti(path, VALUES, AXES, ORIGIN, **options)
    cut(path, left)
    return path


def nrrd(folder, *, left=1.0, **options):
    path = folder / "image.nrrd"
    write.write_nrrd(path, VALUES, AXES, ORIGIN, **options)
    cut(path, left)
    return path


def meta(folder, *, suffix=".mhd", left=1.0, **options):
    path = folder / f"image{suffix}"
    write.write_meta(path, VALUES, AXES, ORIGIN, **options)
    cut(path if suffix == ".mha" else path.with_suffix(".raw"), left)
    return path


def dicom(folder, *, change=None, values=VALUES, axes=AXES, **options):
    path = folder / "series"
    write.write_dicom(path, values.astype(np.uint16), axes, ORIGIN, **options)
    if change:
        change(path)
    return path


def slice_2(folder):
    return folder / "slice002.dcm"


def detached(folder, missing):
    path = folder / "image.nhdr"
    write.write_nrrd(path, VALUES, AXES, ORIGIN, data_file="voxels.raw")
    if missing:
        (folder / "voxels.raw").unlink()
    else:
        cut(folder / "voxels.raw", 0.3)
    return path


def text(folder, name):
    path = folder / name
    path.write_text("This is no image.\n" * 100)
    return path


def flipped_bit(folder, kind):
    """Compressed voxels with one bit wrong; what it inflates to is as long as before."""
    path = folder / f"image.{kind}"
    values = np.random.default_rng(1).integers(0, 256, (20, 20, 20)).astype(np.uint8)
    if kind == "nii.gz":
        write.write_nifti(path, values, AXES, ORIGIN)
    elif kind == "nrrd":
        write.write_nrrd(path, values, AXES, ORIGIN, encoding="gzip")
    else:
        write.write_meta(path, values, AXES, ORIGIN, compressed=True)
    data = bytearray(path.read_bytes())
    data[-3000] ^= 4
    path.write_bytes(data)
    return path


BAD = {
    # NIfTI
    "nifti cut": (
        lambda f: nifti(f, left=0.8),
        "must contain the 280 bytes of voxels that its header states, got 153 bytes",
    ),
    "nifti cut in its header": (
        lambda f: nifti(f, left=0.3),
        "must be a NIfTI image, got image.nii",
    ),
    "gzip cut": (
        lambda f: nifti(f, suffix=".nii.gz", left=0.95),
        "compressed data are damaged or cut off",
    ),
    "gzip cut to 30 %": (lambda f: nifti(f, suffix=".nii.gz", left=0.3), "file must "),
    "nifti larger than its data": (
        lambda f: nifti(f, dim=(3, 700, 500, 400)),
        "must contain the 280000000 bytes",
    ),
    "nifti smaller than its data": (
        lambda f: nifti(f, dim=(3, 7, 5, 3)),
        "must contain the 210 bytes .* got more bytes",
    ),
    "nifti of absurd size": (
        lambda f: nifti(f, suffix=".nii.gz", dim=(3, 32767, 32767, 32767)),
        "must contain the 70",
    ),
    "nifti spacing 0": (
        lambda f: nifti(f, pixdim=(1, 0, 0.5, 2)),
        "pixdim in the header must be positive, got 0 x 0.5 x 2",
    ),
    "nifti spacing below 0": (
        lambda f: nifti(f, code=0, pixdim=(1, -0.8, 0.5, 2)),
        "pixdim in the header must be positive",
    ),
    "nifti spacing nan": (
        lambda f: nifti(f, pixdim=(1, np.nan, 0.5, 2)),
        "pixdim in the header must be positive",
    ),
    "nifti spacing 1.8e19": (
        lambda f: nifti(f, code=0, pixdim=(1, 1.8e19, 0.5, 2)),
        r"spacing must be in \[1e-05, 1",
    ),
    "nifti sform nan": (
        lambda f: nifti(f, sform=np.full((3, 4), np.nan)),
        "sform in the header must be finite",
    ),
    "nifti slope infinite": (
        lambda f: nifti(f, slope=np.inf),
        "scl_slope and scl_inter in the header must be finite",
    ),
    "nifti intercept nan": (
        lambda f: nifti(f, intercept=np.nan),
        "scl_slope and scl_inter in the header must be finite",
    ),
    "nifti offset": (
        lambda f: nifti(f, vox_offset=-8.0),
        "vox_offset in the header must be at least 352",
    ),
    "nifti 4-D": (
        lambda f: nifti(f, dim=(4, 7, 5, 2, 2)),
        "the sizes of exactly three axes.*got 7 x 5 x 2 x 2",
    ),
    "nifti 2-D": (
        lambda f: nifti(f, dim=(2, 35, 4)),
        "dim in the header must be the sizes of exactly three axes",
    ),
    "nifti colours": (lambda f: nifti(f, datatype=128, bitpix=24), "one real number per voxel"),
    "nifti complex": (lambda f: nifti(f, datatype=32, bitpix=64), "one real number per voxel"),
    "nifti unknown type": (
        lambda f: nifti(f, datatype=77),
        "datatype in the header must be a NIfTI code",
    ),
    "nifti bits": (
        lambda f: nifti(f, bitpix=8),
        "bitpix in the header must match the data type int16",
    ),
    "nifti unit": (lambda f: nifti(f, units=5), "xyzt_units in the header must be"),
    "text as nifti": (lambda f: text(f, "image.nii"), "must be a NIfTI image"),
    "text as gzip": (lambda f: text(f, "image.nii.gz"), "must be a NIfTI image"),
    "bit of a gzip": (lambda f: flipped_bit(f, "nii.gz"), "compressed data are damaged"),
    # NRRD
    "nrrd cut": (lambda f: nrrd(f, left=0.7), "must contain the 280 bytes"),
    "nrrd cut in its header": (lambda f: nrrd(f, left=0.2), " must "),
    "nrrd gzip cut": (lambda f: nrrd(f, encoding="gzip", left=0.9), "damaged or cut off"),
    "nrrd larger than its data": (
        lambda f: nrrd(f, sizes="70 50 40"),
        "must contain the 280000 bytes",
    ),
    "nrrd smaller than its data": (lambda f: nrrd(f, sizes="7 5 3"), "must contain the 210 bytes"),
    "nrrd spacing 0": (
        lambda f: nrrd(f, **UNSPACED, spacings="0 0.5 2"),
        "spacings must be above 0",
    ),
    "nrrd spacing below 0": (
        lambda f: nrrd(f, **UNSPACED, spacings="-1 0.5 2"),
        "spacings must be above 0",
    ),
    "nrrd spacing nan": (
        lambda f: nrrd(f, **UNSPACED, spacings="nan 0.5 2"),
        "spacings must be finite",
    ),
    "nrrd spacing 1.8e19": (
        lambda f: nrrd(f, space_directions=f"({HUGE},0,0) (0,1,0) (0,0,1)"),
        "spacing must be in",
    ),
    "nrrd axes in a plane": (
        lambda f: nrrd(f, space_directions="(1,0,0) (0,1,0) (1,1,0)"),
        "file must|must not lie in one plane",
    ),
    "nrrd axis without direction": (
        lambda f: nrrd(f, space_directions="none (0,1,0) (0,0,1)"),
        "must be finite",
    ),
    "nrrd origin nan": (lambda f: nrrd(f, space_origin="(nan,0,0)"), "space origin must be finite"),
    "nrrd origin far": (
        lambda f: nrrd(f, space_origin="(1e12,0,0)"),
        "the origin must be finite and within",
    ),
    "nrrd over time": (lambda f: nrrd(f, kinds="domain domain time"), "three axes in space"),
    "nrrd of vectors": (lambda f: nrrd(f, dimension="4", sizes="2 7 5 2"), "three axes in space"),
    "nrrd space without directions": (
        lambda f: nrrd(f, space="RAS", space_directions=None),
        "space directions must be stated with space ras",
    ),
    "nrrd space with spacings alone": (
        lambda f: nrrd(f, space_directions=None, spacings="0.8 0.5 2"),
        "space directions must be stated with space left-posterior-superior",
    ),
    "nrrd spacings against directions": (
        lambda f: nrrd(f, spacings="0.8 0.5 1"),
        "spacings must agree with the lengths of space directions, got 0.8 0.5 1 and",
    ),
    "nrrd directions without space": (
        lambda f: nrrd(f, space=None),
        "space must be stated with space directions, got none",
    ),
    "nrrd origin without space": (
        lambda f: nrrd(f, space=None, space_directions=None),
        "space must be stated with space origin, got none",
    ),
    "nrrd left-handed": (lambda f: nrrd(f, space="3D-left-handed"), "space must be one of"),
    "nrrd quantised": (lambda f: nrrd(f, old_min="-1024"), "unscaled values"),
    "nrrd quantised from 0": (
        lambda f: nrrd(f, old_max="0"),
        "unscaled values, got the key old max",
    ),
    "nrrd axis mins": (
        lambda f: nrrd(f, **UNSPACED, spacings="0.8 0.5 2", axis_mins="0"),
        "axis mins must be replaced by space origin, got 0",
    ),
    "nrrd line skip": (lambda f: nrrd(f, line_skip="2"), "line skip must be 0, got 2"),
    "nrrd without byte order": (lambda f: nrrd(f, endian=None), "endian must be little or big"),
    "nrrd of another byte order": (
        lambda f: nrrd(f, endian="middle"),
        "endian must be little or big, got middle",
    ),
    "nrrd units": (
        lambda f: nrrd(f, space_units='"mm" "mm" "inch"'),
        "the unit of the axes must be",
    ),
    "nrrd data missing": (lambda f: detached(f, True), "voxels.raw, which does not exist"),
    "nrrd data cut": (lambda f: detached(f, False), "must contain the 280 bytes"),
    "text as nrrd": (lambda f: text(f, "image.nrrd"), "must be a NRRD image"),
    "bit of a nrrd": (lambda f: flipped_bit(f, "nrrd"), "compressed data are damaged|do not fit"),
    # MetaImage
    "meta cut": (
        lambda f: meta(f, left=0.3),
        "must contain the 280 bytes of voxels that its header states, got a file of 84 bytes",
    ),
    "mha cut": (lambda f: meta(f, suffix=".mha", left=0.7), "file must "),
    "meta data missing": (
        lambda f: meta(f, ElementDataFile="gone.raw"),
        "must be in one file next to the header, got gone.raw",
    ),
    "meta larger than its data": (
        lambda f: meta(f, DimSize="70 50 40"),
        "must contain the 280000 bytes",
    ),
    "meta smaller than its data": (
        lambda f: meta(f, DimSize="7 5 3"),
        "must contain the 210 bytes",
    ),
    "meta size below 0": (
        lambda f: meta(f, DimSize="-7 5 4"),
        "DimSize must be three positive whole numbers",
    ),
    "meta size 0": (
        lambda f: meta(f, DimSize="0 5 4"),
        "DimSize must be three positive whole numbers",
    ),
    "meta spacing 0": (
        lambda f: meta(f, ElementSpacing="0 0.5 2"),
        "elementspacing must be above 0",
    ),
    "meta spacing below 0": (
        lambda f: meta(f, ElementSpacing="-0.8 0.5 2"),
        "elementspacing must be above 0",
    ),
    "meta spacing nan": (
        lambda f: meta(f, ElementSpacing="nan 0.5 2"),
        "elementspacing must be finite",
    ),
    "meta spacing 1.8e19": (
        lambda f: meta(f, ElementSpacing=f"{HUGE} 0.5 2"),
        "spacing must be in",
    ),
    "meta offset nan": (lambda f: meta(f, Offset="nan 0 0"), "offset must be finite"),
    "meta axes not of length 1": (
        lambda f: meta(f, TransformMatrix="2 0 0 0 1 0 0 0 1"),
        "must be of length 1",
    ),
    "meta axes in a plane": (
        lambda f: meta(f, TransformMatrix="1 0 0 0 1 0 1 0 0"),
        "file must|must ",
    ),
    "meta 4-D": (lambda f: meta(f, NDims="4", DimSize="7 5 2 2"), "three axes, got NDims 4"),
    "meta channels": (
        lambda f: meta(f, ElementNumberOfChannels="2", DimSize="7 5 2"),
        "and 2 channels",
    ),
    "meta compressed in name only": (
        lambda f: meta(f, CompressedData="True"),
        "compressed data are damaged",
    ),
    "meta compressed and cut": (
        lambda f: meta(f, compressed=True, left=0.8),
        "compressed data are damaged or cut off",
    ),
    "meta header size": (lambda f: meta(f, HeaderSize="-7"), "HeaderSize must be -1 or more"),
    "meta directions in words": (
        lambda f: meta(f, TransformMatrix=None, AnatomicalOrientation="LPS"),
        "directions must be given as TransformMatrix",
    ),
    "meta unit": (lambda f: meta(f, DistanceUnits="inch"), "the unit of the axes must be"),
    "meta key twice": (
        lambda f: meta(f, tail={"Offset ": "1 2 3"}),
        "every key once, got offset twice",
    ),
    "text as meta": (lambda f: text(f, "image.mhd"), "must be a MetaImage"),
    "bit of a meta": (lambda f: flipped_bit(f, "mha"), "compressed data are damaged"),
    # DICOM
    "slice missing": (
        lambda f: dicom(f, change=lambda p: slice_2(p).unlink()),
        r"got a step of 4 mm among steps of 2 mm .* \(1 slice missing",
    ),
    "slice cut": (
        lambda f: dicom(f, change=lambda p: cut(slice_2(p), 0.97)),
        "70 bytes of pixels .* file 3 of 4",
    ),
    "slice cut to 30 %": (
        lambda f: dicom(f, change=lambda p: cut(slice_2(p), 0.3)),
        "a damaged slice: file 3 of 4",
    ),
    "slice empty": (
        lambda f: dicom(f, change=lambda p: slice_2(p).write_bytes(b"")),
        "other data in file 3 of 4",
    ),
    "rows against pixels": (
        lambda f: dicom(f, rows=50),
        "must contain the 700 bytes of pixels that its header states, got",
    ),
    "two series": (
        lambda f: dicom(f, each=lambda k: {"series": f"1.2.{k % 2}", "series_number": 3 + k % 2}),
        "got 2 in series: number 3 with 2 slices and number 4 with 2 slices. Choose",
    ),
    "tilt not shown": (
        lambda f: dicom(f, tilt=15.0),
        "gantry tilt of 15 degrees in the header, got a tilt of 0 degrees",
    ),
    "slices uneven": (
        lambda f: dicom(f, each=lambda k: {"position": (10.0, 20.0, (0.0, 2.0, 4.7, 6.0)[k])}),
        "evenly spaced, got distances of 1.3 to 2.7 mm",
    ),
    "two slices in a place": (
        lambda f: dicom(f, each=lambda k: {"position": (10.0, 20.0, 2.0 * (k // 2))}),
        "two slices at the same position",
    ),
    "slice pushed aside": (
        lambda f: dicom(f, each=lambda k: {"position": (10.0 + 3.0 * (k == 1), 20.0, 2.0 * k)}),
        "must lie on a straight line",
    ),
    "localiser among them": (
        lambda f: dicom(f, each=lambda k: {"orientation": "1\\0\\0\\0\\0\\-1"} if k == 3 else {}),
        "the same size, pixel spacing and orientation",
    ),
    "pixels of 0 mm": (lambda f: dicom(f, spacing="0\\0.8"), "spacing must be in"),
    "pixels below 0 mm": (lambda f: dicom(f, spacing="-0.5\\0.8"), "spacing must be in"),
    "pixels of nan": (
        lambda f: dicom(f, spacing="nan\\0.8"),
        "PixelSpacing must be 2 finite numbers|damaged",
    ),
    "pixels of 1.8e19 mm": (lambda f: dicom(f, spacing=f"{HUGE}\\0.8"), "spacing must be in"),
    "no pixel spacing": (
        lambda f: dicom(f, leave_out=[(0x28, 0x30)]),
        "PixelSpacing must be 2 finite numbers",
    ),
    "no position": (
        lambda f: dicom(f, leave_out=[(0x20, 0x32)]),
        "ImagePositionPatient must be 3 finite numbers",
    ),
    "no orientation": (
        lambda f: dicom(f, leave_out=[(0x20, 0x37)]),
        "ImageOrientationPatient must be 6",
    ),
    "no right angle": (
        lambda f: dicom(f, orientation="1\\0\\0\\1\\0\\0"),
        "two unit vectors at a right angle",
    ),
    "colour table": (lambda f: dicom(f, photometric="PALETTE COLOR"), "must contain grey values"),
    "three colours": (
        lambda f: dicom(f, photometric="RGB", samples=3, columns=2),
        "must contain|damaged",
    ),
    "inverted grey without air": (
        lambda f: dicom(f, values=VALUES % 100 + 1000, photometric="MONOCHROME1"),
        "an image of type MONOCHROME1 must contain air",
    ),
    "syntax of other pixels": (
        lambda f: dicom(f, syntax="1.2.840.10008.1.2.4.90"),
        "a damaged slice: file 1 of 4",
    ),
    "unknown syntax": (lambda f: dicom(f, syntax="1.2.3.4.5"), "a damaged slice"),
    "text among slices": (
        lambda f: dicom(f, change=lambda p: text(p, "z.dcm")),
        "other data in file 5 of 5",
    ),
    "one slice": (lambda f: dicom(f, values=VALUES[:, :, :1]), "at least two slices"),
    # others
    "folder": (lambda f: f, "without DICOM files and without TIFF or PNG slices"),
    "unknown": (lambda f: text(f, "image.gif"), "must be an image volume of a known format"),
}


def refusal(path):
    """The sentence that refuses an image."""
    with pytest.raises(InputError) as caught:
        read_image(path)
    return str(caught.value)


@pytest.mark.parametrize("name", BAD)
def test_known_bad_image_is_refused(tmp_path, name, capfd):
    make, expected = BAD[name]
    message = refusal(make(tmp_path))
    assert re.search(expected, message), message
    assert message.count("\n") == 0 and ". " in message
    assert capfd.readouterr().err == ""


def test_tiff_slices_that_are_cut_are_refused(tmp_path):
    from skimage.io import imsave

    for k in range(3):
        imsave(
            tmp_path / f"{k}.tif",
            np.arange(6400, dtype=np.uint16).reshape(80, 80),
            check_contrast=False,
        )
    cut(tmp_path / "1.tif", 0.3)
    with pytest.raises(InputError, match=r"file must be a readable slice, got 1.tif"):
        read_image(tmp_path, spacing_mm=0.02)
