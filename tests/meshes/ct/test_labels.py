"""Label volumes with their names, as programs write them."""

from dataclasses import replace

import nibabel
import numpy as np
import pytest
from image_writers import nrrd_header
from named_labels import write_named_labels

from meshes.base.errors import InputError
from meshes.ct.label_names import label_sets
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
        ("[labels]\na = 2\nb = 2\n", "a different number from 1 to"),
        ("[labels]\na = 0\n", "from 1 to 2147483647"),
        ("[other]\na = 1\n", "one table [labels]"),
        ("labels", "readable TOML file, got .* with the error"),
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
    with pytest.raises(InputError, match="the same voxel grid, got a different grid in other"):
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


def layered(path, layers, names, *, with_numbers=True):
    """Write layers, shape (n, nx, ny, nz), as 3D Slicer writes segments that overlap."""
    axes = np.diag([2.0, 1.0, 1.5])
    lines = {
        "dimension": "4",
        "sizes": " ".join(map(str, layers.shape)),
        "kinds": "list domain domain domain",
        "space directions": "none (2,0,0) (0,1,0) (0,0,1.5)",
    }
    header = nrrd_header(layers, axes, (0.0, 0.0, 0.0)).splitlines()
    header = [
        f"{key}: {lines[key]}" if (key := line.partition(":")[0]) in lines else line
        for line in header
    ]
    for index, (layer, value, name, side) in enumerate(names):
        header.append(f"Segment{index}_Name:={name}")
        tags = f"TerminologyEntry:list~SCT^1^Structure~SCT^2^Bone~SCT^3^{side}~codes~^^~^^|"
        header.append(f"Segment{index}_Tags:={tags}")
        if with_numbers:
            header += [f"Segment{index}_Layer:={layer}", f"Segment{index}_LabelValue:={value}"]
    path.write_bytes("\n".join([*header, "", ""]).encode() + layers.tobytes(order="F"))
    return path


def two_layers():
    layers = np.zeros((2, 6, 5, 4), dtype=np.uint8)
    layers[0] = volume()
    layers[1, 2:5, 2, 2] = 2
    return layers


NAMES = [(0, 2, "femur", "Left"), (0, 7, "femur", "Right"), (1, 2, "canal", "")]


def test_segments_of_several_layers_overlap(tmp_path):
    labels = read_labels(layered(tmp_path / "a.seg.nrrd", two_layers(), NAMES))
    assert labels.names == {1: "femur_left", 2: "femur_right", 3: "canal"}
    for name, mask in (
        ("femur_left", volume() == 2),
        ("femur_right", volume() == 7),
        ("canal", two_layers()[1] == 2),
    ):
        assert np.array_equal(labels.mask(name), mask)
    assert "2 voxels of a.seg.nrrd lie in several labels" in labels.image.notes[-1]


def test_each_layer_of_slicer_4_is_a_segment(tmp_path):
    layers = np.stack([volume() == 2, two_layers()[1] == 2]).astype(np.uint8)
    path = layered(
        tmp_path / "a.seg.nrrd", layers, [(0, 1, "a", ""), (1, 1, "b", "")], with_numbers=False
    )
    labels = read_labels(path)
    assert labels.mask("a").sum() == 12 and labels.mask("b").sum() == 3


@pytest.mark.parametrize(
    ("kind", "scale", "numbers"),
    [
        (np.int32, 500, {1000, 3500}),
        (np.float32, 0.9995, {2, 7}),
        (np.float64, 1, {2, 7}),
        (np.int16, 1, {2, 7}),
    ],
)
def test_numbers_above_255_and_whole_numbers_as_floats(tmp_path, kind, scale, numbers):
    values = (volume().astype(float) * scale).astype(kind)
    labels = read_labels(write_nifti(tmp_path / "a.nii.gz", values))
    assert set(labels.names) == numbers
    assert labels.mask(str(max(numbers))).sum() == 1
    rounded = any("are rounded" in note for note in labels.image.notes)
    assert rounded == (scale == 0.9995)


@pytest.mark.parametrize("values", [volume() * 0.4, volume() - 1.0, np.arange(6 * 25 * 20)])
def test_images_and_probabilities_are_no_labels(tmp_path, values):
    values = np.asarray(values, dtype=np.float32).reshape(-1, 5, 4)
    with pytest.raises(InputError, match="not the image or a map of probabilities"):
        read_labels(write_nifti(tmp_path / "a.nii.gz", values))


def test_single_teeth_have_the_numbers_of_their_place(tmp_path):
    values = np.zeros((6, 5, 4), dtype=np.uint8)
    values[1], values[3], values[5] = 46, 146, 4
    labels = read_labels(write_nifti(tmp_path / "a.nii.gz", values), names="toothfairy")
    assert labels.names == {
        4: "right_inferior_alveolar_canal",
        46: "lower_right_first_molar_fdi46",
        146: "lower_right_first_molar_pulp_fdi146",
    }
    for names in label_sets().values():
        assert len(set(names.values())) == len(names)
    assert label_sets()["totalsegmentator"][69] == "humerus_left"
    assert label_sets()["verse"][20] == "vertebrae_L1"


def test_masks_that_overlap_keep_their_voxels(tmp_path):
    for name, layer in zip("ab", two_layers() > 0, strict=True):
        write_nifti(tmp_path / f"{name}.nii.gz", layer.astype(np.uint8))
    (tmp_path / "preview.png").write_bytes(b"")
    labels = read_labels(tmp_path)
    assert [int(labels.mask(name).sum()) for name in "ab"] == [13, 3]


def test_labels_outside_the_image_are_reported(tmp_path):
    labels = read_labels(write_nifti(tmp_path / "a.nii.gz", volume()))
    image = replace(labels.image, values=labels.image.values[:, :2])
    assert "of the labels of a.nii.gz lie outside" in on_grid_of(labels, image).image.notes[-1]


@pytest.mark.parametrize("rounding_mm", [-1e-3, 0.0, 1e-3])
def test_labels_of_a_part_of_an_image_keep_all_voxels(tmp_path, rounding_mm):
    """The label fills its volume to the faces, and files round positions."""
    part = np.full((3, 2, 2), 2, dtype=np.uint8)
    labels = read_labels(write_nifti(tmp_path / "a.nii.gz", part))
    x, y, z = labels.image.spacing_mm
    corner = np.array(labels.image.origin_mm) - (2 * x, y, 3 * z) + rounding_mm
    image = replace(
        labels.image, values=np.zeros((8, 6, 7), np.int16), origin_mm=tuple(corner.tolist())
    )
    placed = on_grid_of(labels, image)
    expected = np.zeros((8, 6, 7), dtype=bool)
    expected[2:5, 1:3, 3:5] = True
    assert np.array_equal(placed.mask("label 2"), expected)
    assert placed.image.notes == labels.image.notes


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


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("femur", "use one of femur left, femur right"),
        ("femur left side", "use femur left"),
    ],
)
def test_an_unknown_label_names_the_near_ones(tmp_path, name, remedy):
    values = volume()
    values[5, 0, 0] = 3
    names = {2: "femur left", 3: "femur right", 7: "canal"}
    labels = read_labels(write_named_labels(tmp_path / "a.seg.nrrd", values, names))
    with pytest.raises(InputError, match=f"(?i){remedy}$|{remedy}[.]$"):
        labels.number(name)
