"""Label volumes with their names, as programs write them."""

from dataclasses import replace

import nibabel
import numpy as np
import pytest
from named_labels import write_named_labels

from meshes.base.errors import InputError
from meshes.ct.labels import on_grid_of, read_labels
from meshes.images.reading import read_image


def volume():
    values = np.zeros((6, 5, 4), dtype=np.uint8)
    values[1:3, 1:4, 1:3] = 2
    values[4, 2, 2] = 7
    return values


def write_nifti(path, values, affine=None, extension=None):
    image = nibabel.Nifti1Image(values, np.diag([2.0, 1.0, 1.5, 1.0]) if affine is None else affine)
    image.header.set_xyzt_units("mm")
    if extension is not None:
        image.header.extensions.append(nibabel.nifti1.Nifti1Extension(0, extension))
    nibabel.save(image, path)
    return path


def test_a_slicer_segmentation_names_its_segments(tmp_path):
    labels = read_labels(
        write_named_labels(tmp_path / "a.seg.nrrd", volume(), {2: "femur", 7: "canal"})
    )
    assert labels.names == {2: "femur", 7: "canal"}
    assert labels.mask("femur").sum() == 12 and labels.mask("canal").sum() == 1


def test_a_table_in_a_nifti_header_names_the_labels(tmp_path):
    table = (
        b'<LabelTable><Label Key="2" Red="0"><![CDATA[liver]]></Label><Label '
        b'Key="9"><![CDATA[x]]></Label></LabelTable>'
    )
    labels = read_labels(write_nifti(tmp_path / "a.nii.gz", volume(), extension=table))
    assert labels.names == {2: "liver", 7: "label 7"}


def test_a_table_of_ones_own_names_the_numbers(tmp_path):
    names = tmp_path / "names.toml"
    names.write_text("[labels]\ncortical = 2\ncanal = 7\n")
    file = write_nifti(tmp_path / "a.nii.gz", volume())
    assert read_labels(file, names=names).names == {2: "cortical", 7: "canal"}
    for text, part in (
        ("[labels]\ncortical = 2\n", "must name every label"),
        ("[labels]\na = 2\nb = 2\n", "a number of its own"),
        ("[labels]\na = 0\n", "from 1 to 65535"),
        ("[other]\na = 1\n", "one table [labels]"),
        ("labels", "readable TOML"),
    ):
        names.write_text(text)
        with pytest.raises(InputError, match=part.replace("[", r"\[")):
            read_labels(file, names=names)


def test_masks_of_a_folder_are_one_volume_and_named_by_their_files(tmp_path):
    write_nifti(tmp_path / "femur_left.nii.gz", (volume() == 2).astype(np.uint8))
    write_nifti(tmp_path / "canal.nii.gz", (volume() == 7).astype(np.uint8))
    write_nifti(tmp_path / "empty.nii.gz", np.zeros((6, 5, 4), dtype=np.uint8))
    labels = read_labels(tmp_path)
    assert set(labels.names.values()) == {"femur_left", "canal"}
    assert labels.mask("femur_left").sum() == 12 and labels.mask("canal").sum() == 1
    write_nifti(tmp_path / "other.nii.gz", np.ones((3, 3, 3), dtype=np.uint8))
    with pytest.raises(InputError, match="one grid"):
        read_labels(tmp_path)


def test_labels_of_one_name_are_taken_as_one_with_a_note(tmp_path):
    names = {2: "femur", 7: "femur"}
    labels = read_labels(write_named_labels(tmp_path / "a.seg.nrrd", volume(), names))
    assert labels.mask("femur").sum() == 13
    note = "a.seg.nrrd has 2 labels named femur (2, 7): they are taken as one."
    assert labels.image.notes[-1] == note
    folder = tmp_path / "masks"
    folder.mkdir()
    for number, ending in ((2, ".nii"), (7, ".nii.gz")):
        write_nifti(folder / f"femur{ending}", (volume() == number).astype(np.uint8))
    masks = read_labels(folder)
    assert masks.image.notes[-1].startswith("masks has 2 labels named femur (1, 2)")
    assert masks.mask("femur").sum() == 13


def test_labels_of_another_grid_go_to_the_nearest_voxels(tmp_path):
    fine = np.kron(volume(), np.ones((2, 2, 2), dtype=np.uint8))
    affine = np.diag([-1.0, -0.5, 0.75, 1.0])
    coarse_affine = np.diag([-2.0, -1.0, 1.5, 1.0])
    coarse_affine[:3, 3] = affine[:3, :3] @ [0.5, 0.5, 0.5]
    labels = read_labels(write_nifti(tmp_path / "fine.nii.gz", fine, affine))
    image = read_image(
        write_nifti(tmp_path / "ct.nii.gz", volume().astype(np.int16), coarse_affine)
    )
    placed = on_grid_of(labels, image)
    assert (
        np.array_equal(placed.image.values, image.values)
        and "nearest label" in placed.image.notes[-1]
    )
    assert on_grid_of(placed, image) is placed
    with pytest.raises(InputError, match="outside"):
        on_grid_of(labels, replace(image, origin_mm=(500.0, 0.0, 0.0)))
