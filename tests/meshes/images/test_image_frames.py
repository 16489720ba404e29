"""Values of images in every format, order and direction of axes, at the same place in LPS [mm].

The files are written byte by byte by `image_writers`, and what they must hold is plain arithmetic
here.
"""

from itertools import permutations, product

import image_writers
import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.images.reading import read_image

SHAPE, SPACING, ORIGIN = (5, 4, 3), np.array([0.5, 0.75, 2.0]), np.array([-30.0, 12.0, 101.0])
VALUES = np.arange(60, dtype=np.int16).reshape(SHAPE) + 100
TURNS = list(product(permutations(range(3)), product((1, -1), repeat=3)))
"""The 48 orientations of an image stored along LPS.

Each gives the LPS axis of every array axis, and its direction.
"""
FORMATS = (".nii", ".nii.gz", ".nrrd", "ras.nrrd", "gzip.nrrd", ".mhd", ".mha", "dicom")


def write(folder, kind, values, axes, origin):
    """Write an image in a format and return its path."""
    path = folder / f"image{kind if kind[0] == '.' else '_' + kind}"
    if kind.startswith(".nii"):
        image_writers.write_nifti(path, values, axes, origin)
    elif kind == "ras.nrrd":
        image_writers.write_nrrd(path, values, axes, origin, space="right-anterior-superior")
    elif kind.endswith(".nrrd"):
        image_writers.write_nrrd(
            path, values, axes, origin, encoding="gzip" if "gzip" in kind else "raw"
        )
    elif kind in (".mhd", ".mha"):
        image_writers.write_meta(path, values, axes, origin)
    elif kind == ".vti":
        image_writers.write_vti(path, values, axes, origin)
    else:
        stored = (values.astype(np.int32) + 1024).astype(np.uint16)
        image_writers.write_dicom(path, stored, axes, origin, slope=1.0, intercept=-1024.0)
    return path


def stored(turn):
    """`VALUES` as an array along other axes, with its steps and the centre of its first voxel."""
    order, signs = turn
    array = np.empty([SHAPE[k] for k in order], dtype=VALUES.dtype)
    for index in np.ndindex(*array.shape):
        place = [0, 0, 0]
        for axis, sign, i in zip(order, signs, index, strict=True):
            place[axis] = i if sign > 0 else SHAPE[axis] - 1 - i
        array[index] = VALUES[tuple(place)]
    axes = np.zeros((3, 3))
    origin = ORIGIN.copy()
    for k, (axis, sign) in enumerate(zip(order, signs, strict=True)):
        axes[axis, k] = sign * SPACING[axis]
        origin[axis] += 0.0 if sign > 0 else SPACING[axis] * (SHAPE[axis] - 1)
    return array, axes, origin


@pytest.mark.parametrize("kind", FORMATS)
def test_all_48_orientations_of_a_stored_image_are_one(tmp_path, kind):
    for number, turn in enumerate(TURNS):
        folder = tmp_path / str(number)
        folder.mkdir()
        found = read_image(write(folder, kind, *stored(turn)))
        assert np.array_equal(found.values, VALUES)
        assert found.spacing_mm == pytest.approx(SPACING) and found.origin_mm == pytest.approx(
            ORIGIN
        )
        assert not any("oblique" in note for note in found.notes)


@pytest.mark.usefixtures("parsed_here")
@pytest.mark.parametrize("turn", [TURNS[7], TURNS[44]])
def test_vtk_images_have_origin_and_directions(tmp_path, turn):
    found = read_image(write(tmp_path, ".vti", *stored(turn)))
    assert np.array_equal(found.values, VALUES)
    assert found.spacing_mm == pytest.approx(SPACING) and found.origin_mm == pytest.approx(ORIGIN)


ROUNDED = 0.5 * 1.55**3
"""Error of splines over values stored in whole numbers.

Cubic splines raise an error by at most 1.55 along each axis (de Boor).
"""
FACES = 3.0
"""Voxels from a face at which its effect on splines is below the rounding.

The effect falls by a factor of 0.27 for each voxel farther in.
"""
TURN = np.linalg.qr(np.array([[0.9, 0.3, -0.2], [-0.25, 0.92, 0.3], [0.28, -0.2, 0.93]]))[0]
TURN = TURN * np.sign(np.diag(TURN))  # columns near x, y, z


@pytest.mark.parametrize("kind", [".nii", "dicom"])
def test_oblique_images_are_resampled_where_they_lie(tmp_path, kind):
    """Oblique images are resampled at their true place.

    Splines are exact on a linear field away from its faces, where they continue as in a mirror; see
    `ROUNDED`.
    """
    axes, origin, shape = TURN * (0.8, 0.6, 1.5), np.array([5.0, -7.0, 40.0]), (24, 22, 12)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1)
    places = index @ axes.T + origin

    def field(p):
        return 500.0 + 20.0 * p[..., 0] - 13.0 * p[..., 1] + 7.0 * p[..., 2]

    found = read_image(write(tmp_path, kind, np.rint(field(places)).astype(np.int16), axes, origin))
    assert (
        len(found.notes) >= 1
        and "are oblique: resampled by cubic splines along LPS" in found.notes[-1]
    )
    grid = np.stack(
        np.meshgrid(*[np.arange(n) for n in found.values.shape], indexing="ij"), axis=-1
    )
    at = grid * found.spacing_mm + found.origin_mm
    back = (at - origin) @ np.linalg.inv(axes).T
    inside = ((back > FACES) & (back < np.array(shape) - 1 - FACES)).all(axis=-1)
    assert inside.sum() > 800
    assert np.abs(found.values - field(at))[inside].max() <= ROUNDED
    assert (at.reshape(-1, 3).min(axis=0) <= places.reshape(-1, 3).min(axis=0) + 1e-4).all()
    assert (at.reshape(-1, 3).max(axis=0) >= places.reshape(-1, 3).max(axis=0) - 1e-4).all()


def test_interpolation_stays_within_the_voxels_around(tmp_path):
    """Interpolation stays within the range of the surrounding voxels.

    The case is metal of 3,000 in air of -1,000: splines alone would overshoot next to it.
    """
    values = np.full((16, 16, 16), -1000, dtype=np.int16)
    values[5:11, 5:11, 5:11] = 3000
    image_writers.write_nrrd(tmp_path / "metal.nrrd", values, TURN * 0.7, np.zeros(3))
    found = read_image(tmp_path / "metal.nrrd")
    assert found.values.min() == -1000 and found.values.max() == 3000
    at = np.argwhere(np.ones(found.values.shape)) * found.spacing_mm + found.origin_mm
    back = (at @ np.linalg.inv(TURN * 0.7).T).reshape(*found.values.shape, 3)
    assert (found.values[((back < 3.99) | (back > 11.01)).any(axis=-1)] == -1000).all()
    assert (found.values[((back > 5.01) & (back < 9.99)).all(axis=-1)] == 3000).all()
    assert (found.values[((back < 0) | (back > 15)).any(axis=-1)] == -1000).all()


def test_labels_of_an_oblique_image_are_those_of_the_nearest_voxel(tmp_path):
    axes, origin, shape = TURN * 0.5, np.array([1.0, 2.0, 3.0]), (20, 21, 22)
    labels = np.random.default_rng(4).integers(1, 4, shape).astype(np.uint8)
    image_writers.write_nrrd(tmp_path / "l.nrrd", labels, axes, origin)
    found = read_image(tmp_path / "l.nrrd", labels=True)
    assert found.values.dtype == np.uint8 and "resampled to the nearest label" in found.notes[-1]
    grid = np.argwhere(found.values > 0)
    back = (grid * found.spacing_mm + found.origin_mm - origin) @ np.linalg.inv(axes).T
    clear = (np.abs(back - np.rint(back)).max(axis=1) < 0.499) & (back > 0).all(axis=1)
    clear &= (back < np.array(shape) - 1).all(axis=1)
    assert clear.sum() > 5000
    at = np.rint(back[clear]).astype(int)
    assert np.array_equal(found.values[tuple(grid[clear].T)], labels[tuple(at.T)])


def test_a_tilted_gantry_is_undone(tmp_path):
    """Slices pushed along y by tan(15 degrees) of their distance, the stack straight along z."""
    tilt = np.radians(15.0)
    axes = np.array([[0.5, 0.0, 0.0], [0.0, 0.5, 2.0 * np.tan(tilt)], [0.0, 0.0, 2.0]])
    index = np.stack(
        np.meshgrid(np.arange(20), np.arange(20), np.arange(12), indexing="ij"), axis=-1
    )
    values = np.rint((index @ axes.T) @ (30.0, 40.0, 50.0)).astype(np.uint16)
    image_writers.write_dicom(tmp_path / "ct", values, axes, (0, 0, 0), tilt=15.0, intercept=0.0)
    found = read_image(tmp_path / "ct")
    assert (
        found.notes[0]
        == "The slices of ct are sheared by 15 degrees, as a tilted gantry leaves them."
    )
    grid = np.stack(
        np.meshgrid(*[np.arange(n) for n in found.values.shape], indexing="ij"), axis=-1
    )
    at = grid * found.spacing_mm + found.origin_mm
    back = at @ np.linalg.inv(axes).T
    inside = ((back > FACES) & (back < np.array([19, 19, 11]) - FACES)).all(axis=-1)
    assert inside.sum() > 1000
    assert np.abs(found.values - at @ (30.0, 40.0, 50.0))[inside].max() <= ROUNDED


@pytest.mark.parametrize(
    ("quaternion", "factor", "columns"),
    [
        ((0.0, 0.0, 0.0), 1.0, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        ((0.0, 0.0, np.sqrt(0.5)), 1.0, [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),  # 90 degrees about z
        ((0.0, 1.0, 0.0), 1.0, [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]),  # 180 degrees about y
        ((0.0, 0.0, 0.0), -1.0, [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),  # left-handed
    ],
)
def test_nifti_by_its_quaternion(tmp_path, quaternion, factor, columns):
    """NIfTI is placed by its quaternion.

    Steps and offset are in RAS, from the standard's formula by hand; LPS turns the signs of x and
    y.
    """
    data = bytearray(
        image_writers.nifti_bytes(
            VALUES, np.diag(SPACING), ORIGIN, code=0, pixdim=(factor, *SPACING)
        )
    )
    image_writers.set_qform(data, quaternion, (10.0, 20.0, 30.0))
    (tmp_path / "q.nii").write_bytes(data)
    found = read_image(tmp_path / "q.nii")
    axes = np.diag([-1.0, -1.0, 1.0]) @ np.array(columns, float) * SPACING
    for index in [(0, 0, 0), (4, 0, 0), (0, 3, 0), (0, 0, 2), (1, 2, 1)]:
        place = np.array([-10.0, -20.0, 30.0]) + axes @ index
        at = np.rint((place - found.origin_mm) / found.spacing_mm).astype(int)
        assert np.allclose(at * found.spacing_mm + found.origin_mm, place, atol=1e-5)
        assert found.values[tuple(at)] == VALUES[index]


def test_nifti_slope_intercept_and_units(tmp_path):
    axes = np.diag(SPACING)
    image_writers.write_nifti(
        tmp_path / "s.nii", VALUES, axes, ORIGIN, slope=2.0, intercept=-1024.0
    )
    assert np.array_equal(read_image(tmp_path / "s.nii").values, 2.0 * VALUES - 1024.0)
    image_writers.write_nifti(tmp_path / "m.nii", VALUES, 1e-3 * axes, 1e-3 * ORIGIN, units=1)
    found = read_image(tmp_path / "m.nii")
    assert found.spacing_mm == pytest.approx(SPACING) and found.origin_mm == pytest.approx(ORIGIN)
    image_writers.write_nifti(tmp_path / "u.nii", VALUES, axes, ORIGIN, units=0)
    assert read_image(tmp_path / "u.nii").notes == ("u.nii states no unit of length: taken as mm.",)


def test_other_scales_and_units(tmp_path):
    axes = np.diag(SPACING)
    image_writers.write_meta(
        tmp_path / "s.mha",
        VALUES,
        axes,
        ORIGIN,
        ElementToIntensityFunctionSlope="2",
        ElementToIntensityFunctionOffset="-1024",
        DistanceUnits="um",
    )
    found = read_image(tmp_path / "s.mha")
    assert np.array_equal(
        found.values, 2.0 * VALUES - 1024.0
    ) and found.spacing_mm == pytest.approx(1e-3 * SPACING)
    image_writers.write_nrrd(
        tmp_path / "m.nrrd", VALUES, axes, ORIGIN, space_units='"cm" "cm" "cm"'
    )
    assert read_image(tmp_path / "m.nrrd").origin_mm == pytest.approx(10.0 * ORIGIN)


@pytest.mark.parametrize("suffix", [".mha", ".mhd"])
def test_metaimage_voxels_compressed_and_in_either_byte_order(tmp_path, suffix):
    path = tmp_path / f"image{suffix}"
    image_writers.write_meta(path, VALUES, np.diag(SPACING), ORIGIN, compressed=True)
    assert np.array_equal(read_image(path).values, VALUES)
    swapped = VALUES.byteswap()
    image_writers.write_meta(
        path, swapped, np.diag(SPACING), ORIGIN, BinaryDataByteOrderMSB="True", HeaderSize="-1"
    )
    assert np.array_equal(read_image(path).values, VALUES)


def test_each_dicom_slice_has_its_own_scale(tmp_path):
    values = np.abs(VALUES).astype(np.uint16)
    image_writers.write_dicom(
        tmp_path / "ct",
        values,
        np.diag(SPACING),
        ORIGIN,
        each=lambda k: {"slope": 1.0 + k, "intercept": -10.0 * k},
    )
    expected = values * np.array([1.0, 2.0, 3.0]) - np.array([0.0, 10.0, 20.0])
    assert np.array_equal(read_image(tmp_path / "ct").values, expected)


def test_padding_of_dicom_is_no_bone(tmp_path):
    values = (VALUES + 924).astype(np.uint16)  # HU 0 to 59 at an intercept of -1024
    values[0, 0, :] = 63536
    image_writers.write_dicom(tmp_path / "ct", values, np.diag(SPACING), ORIGIN, padding=63536)
    found = read_image(tmp_path / "ct")
    assert found.values.max() == 59 and found.values[0, 0, 0] == found.values[:, :, 0].min() == 3
    assert found.notes == (
        "3 voxels of ct are padding: they take the lowest value of their slice.",
    )


def test_nrrd_directions_in_a_space_without_a_name_are_read_with_a_note(tmp_path):
    path = tmp_path / "image.nrrd"
    fields = {"space": None, "space_dimension": "3", "spacings": "0.5 0.75 2"}
    image_writers.write_nrrd(path, VALUES, np.diag(SPACING), ORIGIN, **fields)
    found = read_image(path)
    assert found.spacing_mm == pytest.approx(SPACING) and found.origin_mm == pytest.approx(ORIGIN)
    assert "states no frame of a patient" in found.notes[0]


@pytest.mark.parametrize("pixdim", [(1.0, 1.0, 1.0), (2.0, 2.0, 5.0)])
def test_a_stale_pixdim_next_to_an_sform_is_noted(tmp_path, pixdim):
    axes = np.diag(SPACING)
    image_writers.write_nifti(tmp_path / "s.nii", VALUES, axes, ORIGIN, pixdim=(1.0, *pixdim))
    found = read_image(tmp_path / "s.nii")
    assert found.spacing_mm == pytest.approx(SPACING) and np.array_equal(found.values, VALUES)
    assert "the sform is used" in found.notes[0]


def test_a_header_in_metres_without_a_unit_is_noted(tmp_path):
    axes = np.diag(SPACING)
    image_writers.write_nrrd(tmp_path / "m.nrrd", VALUES, 1e-3 * axes, 1e-3 * ORIGIN)
    assert "as if its header were in metres" in read_image(tmp_path / "m.nrrd").notes[-1]
    image_writers.write_nrrd(
        tmp_path / "u.nrrd", VALUES, 1e-3 * axes, 1e-3 * ORIGIN, space_units='"m" "m" "m"'
    )
    found = read_image(tmp_path / "u.nrrd")
    assert found.spacing_mm == pytest.approx(SPACING) and found.notes == ()
    given = read_image(tmp_path / "m.nrrd", spacing_mm=SPACING)
    assert given.spacing_mm == pytest.approx(SPACING) and not any(
        "metres" in note for note in given.notes
    )


@pytest.mark.parametrize("labels", [False, True])
def test_voxels_that_are_not_a_number_are_outside_of_the_scan(tmp_path, labels):
    values = np.where(VALUES.min() < VALUES, VALUES, np.nan).astype(np.float32)
    image_writers.write_nifti(tmp_path / "n.nii", values, np.diag(SPACING), ORIGIN)
    found = read_image(tmp_path / "n.nii", labels=labels)
    lowest = 0 if labels else np.nanmin(values)
    assert np.array_equal(found.values, np.where(np.isnan(values), lowest, values))
    assert "of the voxels of n.nii are not a number" in found.notes[0]
    values[0] = np.inf
    image_writers.write_nifti(tmp_path / "i.nii", values, np.diag(SPACING), ORIGIN)
    with pytest.raises(InputError, match="voxels must be finite"):
        read_image(tmp_path / "i.nii", labels=labels)
