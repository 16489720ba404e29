"""DICOM as exporters write it: folders, headers, frames and positions."""

import numpy as np
import pydicom
import pytest
from dicom_writers import item, write_enhanced, write_segmentation
from image_writers import dicom_bytes, write_dicom

from meshes.base.errors import InputError
from meshes.images.reading import read_image

SPACING, ORIGIN = (0.8, 0.5, 2.0), (-12.0, 7.0, 31.0)
AXES = np.diag(SPACING)


def ball_HU(shape=(14, 12, 6)):
    """Bone of 27 voxels in air [HU], shape (nx, ny, nz)."""
    values = np.full(shape, -1000)
    values[4:7, 5:8, 2:5] = 700
    return values


def series(folder, values=None, **options):
    values = ball_HU() if values is None else values
    stored = (values + 1024).astype(np.uint16)
    write_dicom(folder, stored, AXES, ORIGIN, **options)
    return folder


def notes_of_ball(path, **options):
    """Read an image, check that it is the ball at its place, and return its notes."""
    found = read_image(path, **options)
    assert np.array_equal(found.values, ball_HU())
    assert found.spacing_mm == pytest.approx(SPACING)
    assert found.origin_mm == pytest.approx(ORIGIN)
    return found.notes


def test_a_series_in_nested_folders_is_found(tmp_path):
    (tmp_path / "cd" / "PAT0" / "ST0").mkdir(parents=True)
    series(tmp_path / "cd" / "PAT0" / "ST0" / "SE0", name="IM{:04d}")
    (tmp_path / "cd" / "DICOMDIR").write_bytes(b"index")
    (tmp_path / "cd" / "viewer.exe").write_bytes(b"MZ" * 100)
    (tmp_path / "cd" / "VERSION").write_bytes(b"1")
    notes = notes_of_ball(tmp_path / "cd")
    assert notes == ("Left out 2 files of cd of another kind than DICOM.",)
    assert notes_of_ball(tmp_path / "cd" / "DICOMDIR") == notes


def test_several_series_in_nested_folders_are_listed(tmp_path):
    for number in (3, 4):
        fields = {"series": f"1.2.{number}", "series_number": number}
        (tmp_path / "cd").mkdir(exist_ok=True)
        series(tmp_path / "cd" / f"SE{number}", **fields)
    with pytest.raises(InputError, match=r"number 3 with 6 slices and number 4 with 6 slices"):
        read_image(tmp_path / "cd")
    assert notes_of_ball(tmp_path / "cd", series=4) == ()


def test_scouts_reports_segmentations_and_copies_are_left_out(tmp_path):
    folder = series(tmp_path / "series")
    plane = ball_HU()[:, :, 0].astype(np.uint16)
    report = dicom_bytes(
        plane, ORIGIN, (1, 0, 0), (0, 1, 0), SPACING[:2], series="1.9", series_number=999
    )
    (folder / "report.dcm").write_bytes(report)
    (folder / "copy.dcm").write_bytes((folder / "slice002.dcm").read_bytes())
    mask = ball_HU()[None] > 0
    write_segmentation(folder / "seg.dcm", mask, SPACING, ORIGIN, names=["bone"])
    assert notes_of_ball(folder) == (
        "Left out 1 duplicate of slices of series.",
        "Left out 1 series of one slice in series.",
    )


def test_a_localiser_of_the_same_series_is_left_out(tmp_path):
    folder = series(tmp_path / "series")
    plane = ball_HU()[:, 0, :].astype(np.uint16)
    kind = [(0x08, 0x08, "CS", "ORIGINAL\\PRIMARY\\LOCALIZER")]
    data = dicom_bytes(plane, ORIGIN, (1, 0, 0), (0, 0, -1), (1.0, 1.0), number=99, patient=kind)
    (folder / "scout.dcm").write_bytes(data)
    assert notes_of_ball(folder) == ("Left out 1 localiser of series.",)


def test_files_without_a_preamble_are_read(tmp_path):
    folder = series(tmp_path / "series")
    for file in folder.iterdir():
        file.write_bytes(file.read_bytes()[132:])
    assert notes_of_ball(folder) == ()


def test_files_without_a_group_of_meta_information_are_read(tmp_path):
    folder = series(tmp_path / "series")
    for file in folder.iterdir():
        data = file.read_bytes()
        file.write_bytes(data[data.index(b"\x08\0\x16\0") :])
    assert notes_of_ball(folder) == ()


@pytest.mark.parametrize("gap", [0.625, 1.25, 0.3])
def test_positions_rounded_to_a_tenth_of_a_millimetre_are_even(tmp_path, gap):
    values = ball_HU((6, 5, 40))
    places = np.round(31.0 + gap * np.arange(40), 1)
    assert np.ptp(np.diff(places)) > 0.05 or gap == 0.3
    series(tmp_path / "a", values, each=lambda k: {"position": (-12.0, 7.0, places[k])})
    found = read_image(tmp_path / "a")
    assert found.spacing_mm[2] == pytest.approx(gap, abs=1e-3)
    assert np.array_equal(found.values, values)
    (tmp_path / "a" / "slice017.dcm").unlink()
    with pytest.raises(
        InputError, match=r"follow each other without a gap, .* \(1 slice missing\)"
    ):
        read_image(tmp_path / "a")


@pytest.mark.parametrize("suffix", ["e.dcm", "IM000001", "cbct.IMA"])
def test_frames_of_one_file_are_placed_and_scaled_each(tmp_path, suffix):
    slopes = [1.0, 2.0, 4.0, 1.0, 2.0, 4.0]
    file = write_enhanced(
        tmp_path / suffix, ball_HU(), SPACING, ORIGIN, order=[2, 0, 1, 5, 4, 3], slopes=slopes
    )
    assert notes_of_ball(file) == ()
    assert notes_of_ball(tmp_path) == ()


def test_compressed_frames_of_one_file_are_scaled_each(tmp_path):
    slopes = [1.0, 2.0, 4.0, 1.0, 2.0, 4.0]
    file = write_enhanced(tmp_path / "e.dcm", ball_HU(), SPACING, ORIGIN, slopes=slopes)
    dataset = pydicom.dcmread(file)
    dataset.compress(pydicom.uid.RLELossless)
    dataset.save_as(file)
    assert notes_of_ball(file) == ()


def test_frames_without_places_follow_the_first(tmp_path):
    file = write_enhanced(
        tmp_path / "cbct.dcm",
        ball_HU(),
        SPACING,
        ORIGIN,
        SharedFunctionalGroupsSequence=[],
        PerFrameFunctionalGroupsSequence=[],
        ImagePositionPatient=list(ORIGIN),
        ImageOrientationPatient=[1, 0, 0, 0, 1, 0],
        PixelSpacing=[SPACING[1], SPACING[0]],
        SliceThickness=SPACING[2],
        RescaleSlope=1,
        RescaleIntercept=-1024,
    )
    (note,) = notes_of_ball(file)
    assert "2 mm apart along their normal" in note


@pytest.mark.parametrize(("thickness", "count"), [(2.0, 0), (2.5, 0), (5.0, 1)])
def test_slices_thicker_than_their_distance_are_noted(tmp_path, thickness, count):
    file = write_enhanced(tmp_path / "e.dcm", ball_HU(), SPACING, ORIGIN, thickness=thickness)
    notes = notes_of_ball(file)
    assert [f"{thickness:g} mm thick and 2 mm apart" in note for note in notes] == [True] * count


def test_phases_at_one_place_are_refused(tmp_path):
    values = np.concatenate([ball_HU(), ball_HU()], axis=2)
    file = write_enhanced(tmp_path / "4d.dcm", values, (0.8, 0.5, 0.0), ORIGIN)
    with pytest.raises(InputError, match="one phase, echo or reconstruction"):
        read_image(file)


def test_a_segmentation_is_no_image(tmp_path):
    mask = ball_HU()[None] > 0
    file = write_segmentation(tmp_path / "seg.dcm", mask, SPACING, ORIGIN, names=["bone"])
    with pytest.raises(
        InputError, match=r"got only SEG in seg\.dcm\. Give .* SEG or RTSTRUCT files as"
    ):
        read_image(file)


def test_stored_bits_above_the_values_do_not_count(tmp_path):
    """Old scanners write graphics into the four bits above the twelve of a value."""
    file = write_enhanced(tmp_path / "e.dcm", ball_HU(), SPACING, ORIGIN)
    dataset = pydicom.dcmread(file)
    stored = np.frombuffer(dataset.PixelData, np.uint16) | 0x1000
    dataset.update(item(BitsStored=12, HighBit=11))
    dataset.PixelData = stored.tobytes()
    dataset.save_as(file)
    assert notes_of_ball(file) == ()
