"""Images and labels of everyday life through the doors of the package: import and objects."""

import numpy as np
import pytest
from ct_ball import ball, ball_mask
from dicom_writers import write_enhanced, write_segmentation, write_structures
from image_writers import write_dicom, write_nrrd
from PIL import Image

import tissue
from meshes.base.errors import InputError
from meshes.ct.inspection import bone_label_note, inspect
from meshes.ct.labels import read_labels

OPTIONS = {"density": "line:1.0,500.0", "pictures": False}


def series(folder, image, **options):
    """Write a CT as a series in a folder within folders."""
    (folder / "cd" / "ST0").mkdir(parents=True, exist_ok=True)
    stored = (image.values.astype(int) + 1024).astype(np.uint16)
    axes = np.diag(image.spacing_mm)
    write_dicom(folder / "cd" / "ST0" / "SE0", stored, axes, image.origin_mm, **options)
    return folder / "cd"


def outlines_of(image, mask):
    """Return the outlines of a mask in each plane [mm, LPS], between its voxels."""
    from skimage.measure import find_contours

    found = []
    for k in np.flatnonzero(mask.any(axis=(0, 1))):
        for contour in find_contours(mask[:, :, k].astype(float), 0.5):
            place = np.column_stack([contour, np.full(len(contour), k)])
            found.append(place * image.spacing_mm + image.origin_mm)
    return found


@pytest.mark.parametrize("kind", ["SEG", "RTSTRUCT", "same folder"])
def test_dicom_labels_give_the_bone_of_their_mask(tmp_path, kind):
    image = ball((1.0, 1.0, 1.5))
    mask = ball_mask(image)
    source = series(tmp_path, image)
    path = tmp_path / "labels.dcm" if kind != "same folder" else source / "labels.dcm"
    if kind == "RTSTRUCT":
        labels = write_structures(path, {"humerus": outlines_of(image, mask)})
    else:
        labels = write_segmentation(
            path, mask[None], image.spacing_mm, image.origin_mm, names=["humerus"]
        )
    labels = source if kind == "same folder" else labels
    made = tissue.import_ct(source, tmp_path / "out", labels=labels, region="humerus", **OPTIONS)
    millilitres = 1e-3 * mask.sum() * np.prod(image.spacing_mm)
    (stated,) = (each for each in made.sentences if "against" in each)
    assert f"against {millilitres:.4g} ml of the label" in stated


def test_a_file_of_many_frames_is_imported(tmp_path):
    image = ball()
    file = write_enhanced(
        tmp_path / "cbct.dcm", image.values.astype(int), image.spacing_mm, image.origin_mm
    )
    made = tissue.import_ct(file, tmp_path / "out", threshold=475.0, **OPTIONS)
    whole = tissue.import_ct(series(tmp_path, image), tmp_path / "b", threshold=475.0, **OPTIONS)
    (bone,) = (each for each in made.sentences if each.startswith("bone of"))
    assert bone in whole.sentences


def planes(folder):
    """Write a ball of bone in 8 bits as PNG planes of 0.5 x 0.5 x 1 mm."""
    folder.mkdir()
    values = ball_mask(ball((0.5, 0.5, 1.0), half_mm=13.0)).astype(np.uint8) * 200
    for k in range(values.shape[2]):
        Image.fromarray(values[:, :, k].T).save(folder / f"plane00{k}.png")
    return values


def test_planes_take_their_spacing_at_every_door(tmp_path, command, monkeypatch):
    monkeypatch.setattr("tissue.ct.bone._BoneImport._pictures", lambda *_: {})
    values = planes(tmp_path / "png")
    millilitres = 1e-3 * 0.25 * (values > 100).sum()
    bone = tissue.Bone.from_image(tmp_path / "png", threshold=100, spacing_mm=(0.5, 0.5, 1.0))
    assert 1e-3 * bone.surface().volume == pytest.approx(millilitres, rel=0.02)
    code, out, error = command(
        "import",
        str(tmp_path / "png"),
        "--spacing-mm",
        "0.5,0.5,1",
        "--threshold",
        "100",
        "--out",
        str(tmp_path / "out"),
    )
    assert code == 0, error
    found = float(out.split("bone of ")[1].split(" ml")[0])
    assert found == pytest.approx(millilitres, rel=0.02)
    with pytest.raises(
        InputError,
        match="spacing_mm must be given for the slices png, because their files do not state it",
    ):
        tissue.Bone.from_image(tmp_path / "png", threshold=100)


def test_the_notes_of_a_bone_state_where_the_image_cuts_it_off(tmp_path):
    image = ball(half_mm=14.0)
    axes = np.diag(image.spacing_mm)
    write_nrrd(tmp_path / "whole.nrrd", image.values, axes, image.origin_mm)
    write_nrrd(tmp_path / "half.nrrd", image.values[:, :, :14], axes, image.origin_mm)
    whole = tissue.Bone.from_image(tmp_path / "whole.nrrd", threshold=475)
    assert "cut off" not in whole.notes.get("image", "")
    half = tissue.Bone.from_image(tmp_path / "half.nrrd", threshold=475)
    assert "cut off at 1 place by the edge of the image" in half.notes["image"]


@pytest.mark.parametrize(
    ("axis", "words"), [(0, "left to right"), (1, "front to back"), (2, "head to feet")]
)
def test_a_flipped_label_is_named_by_its_axis(axis, words):
    image = ball(centre_mm=np.array([7.0, 7.0, 7.0]))
    mask = ball_mask(image, centre_mm=np.array([7.0, 7.0, 7.0]))
    note = bone_label_note(image, np.flip(mask, axis), "humerus")
    assert f"100% if it were flipped {words}" in note


def test_padding_below_air_is_stated(tmp_path):
    image = ball()
    values = image.values.copy()
    assert not any("padding" in each for each in inspect(image).sentences())
    values[:4] = -3024
    padded = type(image)(values, image.spacing_mm, "ball", ())
    share = 4 / len(values)
    (stated,) = (each for each in inspect(padded).sentences() if each.startswith("padding"))
    assert f"{share:.1%} of the voxels have the value -3024" in stated


@pytest.mark.parametrize(("gap", "is_coarse"), [(2.5, False), (3.0, True)])
def test_slices_of_three_millimetres_are_coarse(gap, is_coarse):
    found = inspect(ball((1.0, 1.0, gap))).sentences()
    assert any("are coarse" in each for each in found) == is_coarse


def test_an_import_of_labels_that_overlap_keeps_them(tmp_path):
    """The smaller label is drawn over the larger one in the labels that are written."""
    image = ball((1.0, 1.0, 1.5))
    bone, core = ball_mask(image), ball_mask(image, radius_mm=6.0)
    labels = write_segmentation(
        tmp_path / "labels.dcm",
        np.stack([core, bone]),
        image.spacing_mm,
        image.origin_mm,
        names=["core", "humerus"],
    )
    made = tissue.import_ct(
        series(tmp_path, image), tmp_path / "out", labels=labels, region="humerus", **OPTIONS
    )
    millilitres = 1e-3 * bone.sum() * np.prod(image.spacing_mm)
    assert any(f"against {millilitres:.4g} ml of the label" in each for each in made.sentences)
    kept = read_labels(made.folder / "labels.seg.nrrd")
    assert kept.mask("core").sum() == core.sum()
    assert kept.mask("humerus").sum() == (bone & ~core).sum()
