"""Slices in folders: their order, foreign files, colours, and inverted grey values."""

import numpy as np
import pytest
import tifffile
from image_writers import write_dicom
from PIL import Image

from meshes.base.errors import InputError
from meshes.ct.labels import read_labels
from meshes.images.reading import read_image

COUNT, SIDE, SPACING_MM = 12, 16, 0.5
BONE, AIR_HU, BONE_HU = 1500, -1000, 700


def steps(count=COUNT):
    """Return planes, shape (count, rows, columns), plane k with k + 1 voxels of bone.

    The order of the planes can be read from the counts.
    """
    planes = np.zeros((count, SIDE, SIDE), dtype=np.uint16)
    for k in range(count):
        planes[k].flat[: k + 1] = BONE
    return planes


def written(folder, planes, name="slice_{}.tif", **options):
    for k, plane in enumerate(planes):
        tifffile.imwrite(folder / name.format(k), plane, **{"photometric": "minisblack", **options})
    return folder


@pytest.mark.parametrize("name", ["slice_{}.tif", "{}.TIFF", "a7_{}_v2.tif", "slice_{:03d}.tif"])
@pytest.mark.parametrize("pattern", ["", "*"])
def test_slices_follow_the_numbers_in_their_names(tmp_path, name, pattern):
    found = read_image(written(tmp_path, steps(), name) / pattern, spacing_mm=SPACING_MM)
    assert (found.values > 0).sum(axis=(0, 1)).tolist() == list(range(1, COUNT + 1))
    assert found.values[1, 0, 1] == BONE and found.values[0, 1, -1] == 0  # along rows first


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda f: [(f / f"slice_{k}.tif").unlink() for k in (5, 6)],
            "slice_7.tif after slice_4.tif .*, 2 slices missing",
        ),
        (
            lambda f: (f / "slice_3.tif").rename(f / "thumbnail.tif"),
            "named alike, got thumbnail.tif among",
        ),
        (
            lambda f: tifffile.imwrite(f / "slice_12.tif", np.zeros((4, 5), np.uint16)),
            "same size, got 5 x 4 pixels in slice",
        ),
        (
            lambda f: (
                tifffile.imwrite(f / "slice_012.tif", steps()[0])
                or (f / "slice_12.tif").write_bytes((f / "slice_012.tif").read_bytes())
            ),
            "different numbers, got the number of slice_12.tif twice",
        ),
        (
            lambda f: tifffile.imwrite(f / "slice_12.tif", steps()[0].astype(np.uint8)),
            "same type of values",
        ),
    ],
)
def test_missing_and_foreign_slices_are_refused(tmp_path, change, message):
    change(written(tmp_path, steps()))
    with pytest.raises(InputError, match=message):
        read_image(tmp_path, spacing_mm=SPACING_MM)


OPAQUE = {"extrasamples": ["unassalpha"]}


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    ("samples", "options"),
    [
        (3, {"photometric": "rgb"}),
        (4, {"photometric": "rgb", **OPAQUE}),
        (2, {"photometric": "minisblack", "planarconfig": "contig", **OPAQUE}),
        (3, {"photometric": "rgb", "planarconfig": "separate"}),
    ],
)
def test_grey_values_stored_as_colours_are_grey(tmp_path, samples, options, dtype):
    planes = []
    for plane in (steps() > 0).astype(dtype) * 200:
        colours = np.repeat(plane[..., None], samples, axis=-1)
        if samples % 2 == 0:
            colours[..., -1] = 255  # opaque
        planes.append(
            np.moveaxis(colours, -1, 0) if options.get("planarconfig") == "separate" else colours
        )
    found = read_image(written(tmp_path, planes, **options), spacing_mm=SPACING_MM)
    assert np.array_equal(found.values, 200 * (steps() > 0).T) and found.values.dtype == dtype
    assert found.notes == (
        f"{tmp_path.name} stores grey values as colours: they are taken as grey.",
    )


def test_channels_are_refused_by_name(tmp_path):
    planes = [np.full((3, SIDE, SIDE), 9, dtype=np.uint8)] * 3
    written(tmp_path, planes, imagej=True, metadata={"axes": "CYX"})
    with pytest.raises(
        InputError, match=r"one grey value or colour per pixel, got 3 channels in slice_0\.tif"
    ):
        read_image(tmp_path, spacing_mm=SPACING_MM)


@pytest.mark.parametrize("name", ["plane00{}.png", "{}.PNG", "s_{:03d}.bmp", "img_{}"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, bool])
def test_pictures_are_planes(tmp_path, name, dtype):
    if name.endswith("bmp") and dtype == np.uint16:
        return  # the format has none
    for k, plane in enumerate(steps() > 0):
        high = {np.uint8: 200, np.uint16: 50_000, bool: 1}[dtype]
        Image.fromarray((plane * high).astype(dtype)).save(
            tmp_path / name.format(k), None if name.endswith(("png", "PNG", "bmp")) else "png"
        )
    found = read_image(tmp_path, spacing_mm=SPACING_MM)
    assert (found.values > 0).sum(axis=(0, 1)).tolist() == list(range(1, COUNT + 1))
    assert found.values.max() == high


@pytest.mark.parametrize(
    "options", [{"byteorder": ">"}, {"bigtiff": True}, {"compression": "zlib"}]
)
@pytest.mark.parametrize("name", ["slice_{}.tif", "slice_{}"])
def test_forms_of_tiff_are_read(tmp_path, options, name):
    written(tmp_path, steps(), name, **options)
    found = read_image(tmp_path, spacing_mm=SPACING_MM)
    assert np.array_equal(found.values, steps().T)


def test_a_pattern_fits_letters_of_either_case(tmp_path):
    (tmp_path / "a").mkdir()
    written(tmp_path / "a", steps(), "s{}.TIF")
    found = read_image(tmp_path / "a" / "*.tif", spacing_mm=SPACING_MM)
    assert np.array_equal(found.values, steps().T)
    within = read_image(tmp_path, spacing_mm=SPACING_MM)  # the only folder in it
    assert np.array_equal(within.values, steps().T)


def test_jpeg_slices_are_read_with_a_note(tmp_path):
    for k, plane in enumerate(steps()):
        Image.fromarray((plane > 0).astype(np.uint8) * 200).save(tmp_path / f"s{k}.jpg", quality=95)
    found = read_image(tmp_path, spacing_mm=SPACING_MM)
    assert np.abs(found.values.astype(int) - 200 * (steps().T > 0)).mean() < 4.0
    assert "JPEG changes the values" in found.notes[0]


def test_tiff_compressed_by_lzw_is_read(tmp_path):
    for k, plane in enumerate(steps()):
        Image.fromarray(plane).save(tmp_path / f"s{k}.tif", compression="tiff_lzw")
    assert np.array_equal(read_image(tmp_path, spacing_mm=SPACING_MM).values, steps().T)


def test_previews_next_to_slices_and_volumes_are_no_slices(tmp_path):
    (tmp_path / "a").mkdir()
    written(tmp_path / "a", steps())
    Image.fromarray(steps()[0]).save(tmp_path / "a" / "preview.png")
    assert read_image(tmp_path / "a", spacing_mm=SPACING_MM).values.shape[2] == COUNT
    stored = (ball_HU() + 1024).astype(np.uint16)
    write_dicom(tmp_path / "s", stored, np.diag([0.8, 0.8, 2.0]), (0.0, 0.0, 0.0))
    Image.fromarray(steps()[0]).save(tmp_path / "s" / "preview.png")
    tifffile.imwrite(tmp_path / "s" / "preview.tif", steps()[0])
    assert np.array_equal(read_image(tmp_path / "s").values, ball_HU())


COLOURS = np.array([[0, 0, 0, 0], [255, 249, 219, 255], [110, 184, 209, 255]], dtype=np.uint8)
"""Nothing, bone and other tissue, as the planes of volumetric_drilling have them."""


def test_colours_are_brightness_or_labels(tmp_path):
    planes = np.zeros((COUNT, SIDE, SIDE), dtype=int)
    planes[:, 4:9, 5:10] = 1
    planes[:, 9:12, 5:10] = 2
    for k, plane in enumerate(planes):
        Image.fromarray(COLOURS[plane]).save(tmp_path / f"plane00{k}.png")
    image = read_image(tmp_path, spacing_mm=SPACING_MM)
    brightness = np.array([0, 248, 170])  # 0.2126 R + 0.7152 G + 0.0722 B
    assert np.array_equal(image.values, brightness[planes.T])
    assert "colours" in image.notes[0]
    labels = read_labels(tmp_path, spacing_mm=SPACING_MM)
    assert set(labels.names.values()) == {"colour_255_249_219", "colour_110_184_209"}
    assert np.array_equal(labels.mask("colour_255_249_219"), planes.T == 1)


def test_each_axis_may_have_its_spacing(tmp_path):
    found = read_image(written(tmp_path, steps()), spacing_mm=(0.5, 0.6, 2.0))
    assert found.spacing_mm == (0.5, 0.6, 2.0)
    with pytest.raises(InputError, match="be one number or three"):
        read_image(tmp_path, spacing_mm=(0.5, 2.0))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, bool])
def test_inverted_grey_values_are_inverted_back(tmp_path, dtype):
    planes = (steps() > 0).astype(dtype)
    highest = {np.uint8: 255, np.uint16: 65535, bool: 1}[dtype]
    stored = ~planes if dtype is bool else (highest - planes.astype(np.int64) * 100).astype(dtype)
    written(tmp_path, stored, photometric="miniswhite")
    found = read_image(tmp_path, spacing_mm=SPACING_MM)
    assert np.array_equal(found.values, (planes.astype(int) * (1 if dtype is bool else 100)).T)
    assert "inverted back" in found.notes[0]
    labels = read_image(tmp_path, spacing_mm=SPACING_MM, labels=True)
    assert (
        np.array_equal(labels.values, stored.T.astype(int))
        and "as they are stored" in labels.notes[0]
    )


def ball_HU():
    """Bone of 125 voxels in air [HU], shape (nx, ny, nz)."""
    values = np.full((SIDE, SIDE, COUNT), AIR_HU)
    values[4:9, 5:10, 3:8] = BONE_HU
    return values


@pytest.mark.parametrize(
    ("stored", "fields", "note"),
    [  # the modality LUT inverts; it does not; there is none
        (
            lambda hu: 3071 - hu,
            {"slope": -1.0, "intercept": 3071.0},
            "rescale slope and intercept already give grey values",
        ),
        (lambda hu: 65535 - (hu + 1024), {"slope": 1.0, "intercept": -1024.0}, "inverted back"),
        (
            lambda hu: hu + 1024,
            {"slope": 1.0, "intercept": -1024.0},
            "rescale slope and intercept already give grey values",
        ),
    ],
)
def test_monochrome1_of_a_ct_has_bone_above_air(tmp_path, stored, fields, note):
    values = stored(ball_HU()).astype(np.uint16)
    write_dicom(
        tmp_path / "s",
        values,
        np.diag([0.8, 0.8, 2.0]),
        (0.0, 0.0, 0.0),
        photometric="MONOCHROME1",
        **fields,
    )
    found = read_image(tmp_path / "s")
    assert np.array_equal(found.values, ball_HU())
    assert any(note in sentence for sentence in found.notes)
