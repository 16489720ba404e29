"""DICOM segmentations and structure sets as labels, against the masks that they were written from."""

import numpy as np
import pytest
from dicom_writers import write_segmentation, write_structures
from image_writers import write_dicom, write_nrrd

from meshes.base.errors import InputError
from meshes.ct.labels import on_grid_of, read_labels
from meshes.images.reading import read_image

SHAPE, SPACING, ORIGIN = (16, 14, 12), (0.8, 0.5, 2.0), (-12.0, 7.0, 31.0)


def masks():
    """A bone and a canal in it, shape (2, nx, ny, nz)."""
    found = np.zeros((2, *SHAPE), dtype=bool)
    found[0, 2:12, 3:11, 2:9] = True
    found[1, 5:8, 5:9, 3:11] = True
    return found


def written(tmp_path, **options):
    path = tmp_path / "seg.dcm"
    return write_segmentation(path, masks(), SPACING, ORIGIN, names=["bone", "canal"], **options)


@pytest.mark.parametrize("options", [{}, {"empty": True}, {"kind": "FRACTIONAL"}])
def test_segments_that_overlap_keep_their_voxels(tmp_path, options):
    labels = read_labels(written(tmp_path, **options))
    ct = tmp_path / "ct"
    write_dicom(ct, np.zeros(SHAPE, np.uint16), np.diag(SPACING), ORIGIN)
    placed = on_grid_of(labels, read_image(ct))
    for name, mask in zip(("bone", "canal"), masks(), strict=True):
        assert np.array_equal(placed.mask(name), mask)
    assert any("lie in several labels, and count for each" in each for each in labels.image.notes)
    assert placed.only(["bone", "canal"]).mask("bone").sum() == (masks()[0] & ~masks()[1]).sum()
    fractions = any(
        "has fractions: voxels of at least one half" in each for each in labels.image.notes
    )
    assert fractions == (options.get("kind") == "FRACTIONAL")


def test_frames_may_begin_within_a_byte(tmp_path):
    parts = masks()[:, :11, :7]  # 77 pixels in a plane
    path = write_segmentation(tmp_path / "s.dcm", parts, SPACING, ORIGIN, names=["bone", "canal"])
    labels = read_labels(path)
    for name, mask in zip(("bone", "canal"), parts, strict=True):
        assert np.array_equal(labels.mask(name), mask[:, :, 2:11])


def test_a_label_map_holds_all_segments_in_a_frame(tmp_path):
    apart = masks()
    apart[0] &= ~apart[1]
    bone, canal = apart
    path = tmp_path / "seg.dcm"
    write_segmentation(
        path, (bone + 2 * canal)[None], SPACING, ORIGIN, names=["bone", "canal"], kind="LABELMAP"
    )
    labels = read_labels(path)
    assert labels.mask("bone").sum() == bone.sum() and labels.mask("canal").sum() == canal.sum()
    assert labels.image.origin_mm == pytest.approx((-12.0, 7.0, 35.0))


def test_frames_without_a_voxel_may_be_left_out_between_others(tmp_path):
    parts = masks()[:1]
    parts[:, :, :, 4:7] = False
    path = write_segmentation(tmp_path / "s.dcm", parts, SPACING, ORIGIN, names=["bone"])
    labels = read_labels(path)
    assert labels.image.spacing_mm == pytest.approx(SPACING)
    assert np.array_equal(labels.mask("bone"), parts[0][:, :, 2:9])


def test_segments_of_one_name_are_named_by_their_side(tmp_path):
    path = tmp_path / "seg.dcm"
    parts = masks()
    parts[1] &= ~parts[0]
    write_segmentation(
        path, parts, SPACING, ORIGIN, names=["femur", "femur"], sides=["Left", "Right"]
    )
    assert set(read_labels(path).names.values()) == {"femur_left", "femur_right"}


def test_a_folder_with_one_segmentation_is_that_segmentation(tmp_path):
    (tmp_path / "seg").mkdir()
    written(tmp_path / "seg")
    assert set(read_labels(tmp_path / "seg").names.values()) == {"bone", "canal"}


@pytest.mark.parametrize("position", [[-12, 7, 35.7], [-12, 7.5, 41]])
def test_frames_off_an_even_stack_are_refused(tmp_path, position):
    import pydicom

    path = written(tmp_path)
    dataset = pydicom.dcmread(path)
    frame = dataset.PerFrameFunctionalGroupsSequence[3]
    frame.PlanePositionSequence[0].ImagePositionPatient = position
    dataset.save_as(path)
    with pytest.raises(InputError, match="have its frames in one evenly spaced stack"):
        read_labels(path)


MIRRORED = np.diag([-1.0, 1.0, 1.0])
SAGITTAL = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
OBLIQUE = np.array([[0.96, -0.28, 0.0], [0.168, 0.576, -0.8], [0.224, 0.768, 0.6]])
TILTED = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.28], [0.0, 0.0, 0.96]])
"""Directions of the axes [LPS]. Those of a tilted gantry are not at right angles."""


def ct_and_segmentation(tmp_path, directions):
    """Write the masks of `masks` as a CT, as a label volume, and as a segmentation."""
    parts = masks()
    parts[0] &= ~parts[1]
    axes = directions * SPACING
    numbers = (parts[0] + 2 * parts[1]).astype(np.uint8)
    stored = 100 + 1000 * numbers.astype(np.uint16)
    write_dicom(tmp_path / "ct", stored, axes, ORIGIN)
    write_nrrd(tmp_path / "labels.nrrd", numbers, axes, ORIGIN)
    seg = tmp_path / "seg.dcm"
    names = ["bone", "canal"]
    write_segmentation(seg, parts, SPACING, ORIGIN, names=names, directions=directions)
    ct = read_image(tmp_path / "ct")
    return ct, read_labels(tmp_path / "labels.nrrd", image=ct), read_labels(seg, image=ct)


@pytest.mark.parametrize("directions", [MIRRORED, -MIRRORED, -np.eye(3), SAGITTAL])
def test_a_turned_or_mirrored_segmentation_lies_on_its_ct(tmp_path, directions):
    ct, _, segments = ct_and_segmentation(tmp_path, directions)
    placed = on_grid_of(segments, ct)
    grey = ct.values - ct.values.min()
    assert np.array_equal(placed.mask("bone"), grey == 1000)
    assert np.array_equal(placed.mask("canal"), grey == 2000)


@pytest.mark.parametrize("directions", [OBLIQUE, TILTED])
def test_a_segmentation_of_an_oblique_ct_equals_the_label_volume(tmp_path, directions):
    """Both files are resampled once, at the voxel centres of the CT.

    The NRRD file states the directions of all three axes, so it holds no normal to derive.
    """
    ct, volume, segments = ct_and_segmentation(tmp_path, directions)
    placed_volume = on_grid_of(volume, ct)
    placed = on_grid_of(segments, ct)
    assert np.array_equal(placed.mask("bone"), placed_volume.mask("1"))
    assert np.array_equal(placed.mask("canal"), placed_volume.mask("2"))


@pytest.mark.parametrize(("gap", "count"), [(1 / 3, 120), (2 / 3, 200), (0.625, 300)])
def test_many_planes_at_a_distance_that_decimals_round_are_even(tmp_path, gap, count):
    mask = np.zeros((8, 7, count), dtype=bool)
    mask[2:5, 2:6, :] = True
    path = tmp_path / "seg.dcm"
    write_segmentation(path, mask[None], (1.0, 1.0, gap), (3.0, 4.0, -57.3), names=["bone"])
    labels = read_labels(path)
    # Positions are written with 6 digits, to 1e-4 mm here.
    assert labels.image.spacing_mm[2] == pytest.approx(gap, abs=1e-4)
    assert np.array_equal(labels.mask("bone"), mask)


def box(low, high, z):
    """A rectangle between two corners [mm, LPS], shape (4, 3)."""
    (a, b), (c, d) = low, high
    return np.array([(a, b, z), (c, b, z), (c, d, z), (a, d, z)])


def outlines(step=2.0):
    """A prism of 16 x 12 mm with a hole of 4 x 4 mm, in planes from z = 35 to 45 mm."""
    heights = np.arange(35.0, 45.1, step)
    whole = [box((-20.0, -10.0), (-4.0, 2.0), z) for z in heights]
    holes = [box((-14.0, -6.0), (-10.0, -2.0), z) for z in heights]
    return {"bone": whole + holes, "marrow": holes, "empty": []}


def image(tmp_path, spacing=(0.5, 0.5, 1.0)):
    """A CT around the prism; voxel centres lie a quarter of a voxel off the outlines."""
    axes = np.diag(spacing)
    write_dicom(tmp_path / "ct", np.zeros((60, 50, 30), np.uint16), axes, (-25.12, -15.12, 30.0))
    return read_image(tmp_path / "ct")


@pytest.mark.parametrize("step", [1.0, 2.0, 5.0])
def test_outlines_are_drawn_on_the_voxels_of_the_ct(tmp_path, step):
    ct = image(tmp_path)
    labels = read_labels(write_structures(tmp_path / "rs.dcm", outlines(step)), image=ct)
    assert set(labels.names.values()) == {"bone", "marrow"}
    assert labels.image.values.shape == ct.values.shape and on_grid_of(labels, ct) is labels
    voxel_mm3 = 0.5 * 0.5 * 1.0
    planes = np.flatnonzero(labels.mask("bone").any(axis=(0, 1)))
    area = voxel_mm3 * labels.mask("bone")[:, :, planes].sum() / len(planes)
    assert area == pytest.approx(16 * 12 - 4 * 4)
    assert voxel_mm3 * labels.mask("marrow").sum() == pytest.approx(16 * len(planes))
    assert (planes[0], planes[-1]) == (5 - int(step // 2), 15 + int(step // 2))
    assert np.diff(planes).max() == 1


@pytest.mark.parametrize("apart_mm", [0.0, 0.01])
@pytest.mark.parametrize("start_mm", [35.02, 35.045])
def test_rounded_heights_of_outlines_are_one_plane(tmp_path, start_mm, apart_mm):
    ct = image(tmp_path)
    heights = start_mm + np.arange(10.0)
    whole = [box((-20.0, -10.0), (-4.0, 2.0), z) for z in heights]
    holes = [box((-14.0, -6.0), (-10.0, -2.0), z + apart_mm) for z in heights]
    labels = read_labels(write_structures(tmp_path / "rs.dcm", {"bone": whole + holes}), image=ct)
    areas = 0.5 * 0.5 * labels.mask("bone").sum(axis=(0, 1))
    assert areas[areas > 0] == pytest.approx(16 * 12 - 4 * 4)
    assert np.count_nonzero(areas) == len(heights)


def test_outlines_need_their_ct(tmp_path):
    path = write_structures(tmp_path / "rs.dcm", outlines())
    with pytest.raises(InputError, match="Also give the CT image on which the outlines were drawn"):
        read_labels(path)


def test_outlines_across_the_planes_are_refused(tmp_path):
    tilted = {
        "bone": [each @ np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0]]) for each in outlines()["bone"]]
    }
    path = write_structures(tmp_path / "rs.dcm", tilted)
    with pytest.raises(InputError, match="lie in planes perpendicular to the patient's long axis"):
        read_labels(path, image=image(tmp_path))
