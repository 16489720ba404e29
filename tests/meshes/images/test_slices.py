"""Slices in folders: their order, foreign files, colours, and inverted grey values."""

import numpy as np
import pytest
import tifffile
from image_writers import write_dicom

from meshes.base.errors import InputError
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


def refused(path, pattern):
    with pytest.raises(InputError, match=pattern):
        read_image(path, spacing_mm=SPACING_MM)


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
            "slice_7.tif after slice_4.tif .*, 2 missing",
        ),
        (
            lambda f: (f / "slice_3.tif").rename(f / "thumbnail.tif"),
            "named alike, got thumbnail.tif among",
        ),
        (
            lambda f: tifffile.imwrite(f / "slice_12.tif", np.zeros((4, 5), np.uint16)),
            "same size, got 5 x 4 in slice",
        ),
        (
            lambda f: (
                tifffile.imwrite(f / "slice_012.tif", steps()[0])
                or (f / "slice_12.tif").write_bytes((f / "slice_012.tif").read_bytes())
            ),
            "numbers that differ, got that of slice_12.tif twice",
        ),
        (
            lambda f: tifffile.imwrite(f / "slice_12.tif", steps()[0].astype(np.uint8)),
            "same type of values",
        ),
    ],
)
def test_missing_and_foreign_slices_are_refused(tmp_path, change, message):
    change(written(tmp_path, steps()))
    refused(tmp_path, message)


@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((SIDE, SIDE, 3), {"photometric": "rgb"}),
        ((SIDE, SIDE, 4), {"photometric": "rgb", "extrasamples": ["unassalpha"]}),
        (
            (SIDE, SIDE, 2),
            {"photometric": "minisblack", "extrasamples": ["unassalpha"], "planarconfig": "contig"},
        ),
        ((3, SIDE, SIDE), {"photometric": "rgb", "planarconfig": "separate"}),
        ((3, SIDE, SIDE), {"imagej": True, "metadata": {"axes": "CYX"}}),
    ],
)
def test_colours_are_refused_by_name(tmp_path, shape, options):
    written(tmp_path, [np.full(shape, 9, dtype=np.uint8)] * 3, **options)
    refused(tmp_path, "one grey value per pixel, got several .* in slice_0.tif")


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
            "rescale leads to grey values",
        ),
        (lambda hu: 65535 - (hu + 1024), {"slope": 1.0, "intercept": -1024.0}, "inverted back"),
        (
            lambda hu: hu + 1024,
            {"slope": 1.0, "intercept": -1024.0},
            "rescale leads to grey values",
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
