"""Checks of labels.

They cover the image under the labels, shared names, laws without Hounsfield units, and volumes that
are kept.
"""

import re

import numpy as np
import pytest
import trimesh
from ct_ball import CENTRE_MM, RADIUS_MM, ball, ball_mask
from image_writers import write_nrrd
from named_labels import write_named_labels

import tissue
from meshes.base.errors import InputError
from meshes.ct.inspection import bone_label_note, soft_label_note


@pytest.fixture(scope="module")
def ct():
    return ball()


def moved(image, distance_mm):
    return ball_mask(image, centre_mm=CENTRE_MM + np.array([distance_mm, 0.0, 0.0]))


@pytest.mark.parametrize("distance_mm", [0.0, 6.0, 10.0, 12.0])
def test_the_share_of_bone_is_that_of_two_balls(ct, distance_mm):
    """Overlap of two balls of radius r at distance d, over one of them: (1 - d/2r)^2 (1 + d/4r)."""
    ratio = distance_mm / RADIUS_MM
    share = (1.0 - 0.5 * ratio) ** 2 * (1.0 + 0.25 * ratio)
    note = bone_label_note(ct, moved(ct, distance_mm), "humerus")
    if share > 0.55:
        assert note == ""
        return
    stated = float(re.search(r"(\d+)% of its voxels above 150 HU", note)[1])
    # voxels that hold an eighth of bone are above 150 HU
    assert stated == pytest.approx(100.0 * share, abs=5.0)


def test_a_soft_organ_lies_on_soft_tissue(ct):
    around = ball_mask(ct, radius_mm=17.0) & ~ball_mask(ct, radius_mm=14.0)
    assert soft_label_note(ct, around, "liver") == ""
    assert "median is 900 HU" in soft_label_note(
        ct, ball_mask(ct) & ~ball_mask(ct, radius_mm=10.0), "liver"
    )
    assert "median is -1000 HU" in soft_label_note(ct, ~ball_mask(ct, radius_mm=20.0), "liver")


def files(folder, image, mask):
    """The CT and its label as files."""
    write_nrrd(folder / "ct.nrrd", image.values, np.diag(image.spacing_mm), image.origin_mm)
    place = {"spacing_mm": image.spacing_mm, "origin_mm": image.origin_mm}
    labels = write_named_labels(folder / "a.seg.nrrd", mask, {1: "humerus"}, **place)
    return folder / "ct.nrrd", {"labels": labels, "region": "humerus", "pictures": False}


def test_a_moved_label_is_reported_by_the_import(ct, tmp_path):
    source, options = files(tmp_path, ct, moved(ct, 12.0))
    made = tissue.import_ct(source, tmp_path / "out", density="line:1.0,500.0", **options)
    assert any(
        sentence.startswith("warning: most of humerus is not bone") for sentence in made.sentences
    )
    source, options = files(tmp_path, ct, moved(ct, 20.0))
    with pytest.raises(InputError, match="region must be a label on bone"):
        tissue.import_ct(source, tmp_path / "other", density="line:1.0,500.0", **options)


@pytest.mark.parametrize("law", ["ct", "dragomir-daescu", "internal", " CT "])
def test_a_named_law_needs_hounsfield_units(ct, tmp_path, law):
    micro = (100 + ct.values // 20).astype(np.int16)
    write_nrrd(tmp_path / "ct.nrrd", micro, np.diag(ct.spacing_mm), ct.origin_mm)
    with pytest.raises(
        InputError, match="density must be line:SLOPE,OFFSET for an image that is not in Hounsfield"
    ):
        tissue.import_ct(
            tmp_path / "ct.nrrd", tmp_path / "out", threshold=125.0, density=law, pictures=False
        )


@pytest.mark.parametrize("spacing_mm", [(0.6, 0.6, 0.6), (1.0, 1.0, 6.0)])
def test_the_change_of_a_labels_volume_is_reported(tmp_path, spacing_mm):
    image = ball(spacing_mm, half_mm=21.0)
    mask = ball_mask(image)
    source, options = files(tmp_path, image, mask)
    made = tissue.import_ct(source, tmp_path / "out", density="line:1.0,500.0", **options)
    change = trimesh.load(made.folder / "bone.ply").volume / (mask.sum() * np.prod(spacing_mm)) - 1
    assert any(f"volume {change:+.1%} against" in each for each in made.sentences)
    assert any("are coarse" in each for each in made.sentences) == (max(spacing_mm) > 5.0)
