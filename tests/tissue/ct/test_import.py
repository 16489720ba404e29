"""A CT to a scene that runs, from every format and orientation, by label and by threshold."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from ct_ball import CENTRE_MM, DENSE_HU, RADIUS_MM, SOFT_HU, ball, ball_mask
from image_writers import write_dicom, write_nrrd
from named_labels import write_named_labels

import tissue
from meshes.base.errors import InputError
from meshes.ct.labels import read_labels
from meshes.images.reading import read_image
from meshes.surfaces.surface import surface_from_triangles
from tissue.ct.draft import scene_name
from tissue.ct.request import ImportRequest, placed
from tissue.materials.constants import cutting_coefficients

TOP = tuple((CENTRE_MM + np.array([0.0, 0.0, RADIUS_MM])).tolist())
LINE = "line:1.0,500.0"
HALF_HU = 0.5 * (DENSE_HU + SOFT_HU)
COARSE = {
    "voxels.spacing_mm": 0.4,
    "motion.points_mm": [[0, 0, 1], [0, 0, -1]],
    "motion.feed_mm_s": 10.0,
}


def axes_of(image):
    """Return values, axes and origin of an image as its file holds them."""
    return image.values, np.diag(image.spacing_mm), image.origin_mm


def imported(source, out, **options):
    given = {"density": LINE, "site": TOP, "pictures": False} | options
    return tissue.import_ct(
        source, out, **({} if "region" in options else {"threshold": HALF_HU}) | given
    )


def force_N(made):
    run = tissue.simulate(tissue.load_scene(made.scene, COARSE))
    return run.trace["force_z_N"], run.summary


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reference")
    write_nrrd(folder / "ct.nrrd", *axes_of(ball()))
    made = imported(folder / "ct.nrrd", folder / "out")
    return made, *force_N(made)


def test_a_scene_is_ready_to_run(reference):
    made, force, summary = reference
    assert made.has_site and sorted(each.name for each in made.folder.iterdir()) == [
        ".tissue.json",
        "bone.ply",
        "density.nrrd",
        "import.json",
        "scene.toml",
    ]
    scene = tissue.load_scene(made.scene)
    assert scene.anatomy.kind == "bone" and scene.name == "out"
    assert np.allclose(scene.anatomy.centre_mm, TOP, atol=0.15)
    assert np.allclose(scene.anatomy.normal, (0.0, 0.0, 1.0), atol=0.02)
    assert force.max() > 1.0
    notes = summary["notes"]
    # a line has no uncertainty, and a voxel below the surface is not corrected
    law = r"line:1,500,apparent: median \d+ kg/m3; voxels below the surface from \d+ to \d+"
    assert re.fullmatch(law, notes["density law"])
    highest = int(notes["density law"].split()[-1])
    assert highest == round(read_image(made.folder.parent / "ct.nrrd").values.max() + 500.0)


def test_the_density_reaches_the_cutting_force(reference, tmp_path):
    made, force, _ = reference
    other = tmp_path / "denser"
    image = made.folder.parent / "ct.nrrd"
    denser = imported(image, other, density="line:1.25,625.0")
    exponent = cutting_coefficients("bone").density_exponent
    ratio = force_N(denser)[0].max() / force.max()
    assert ratio == pytest.approx(1.25**exponent, rel=0.01)
    volume = read_image(made.folder / "density.nrrd").values
    assert np.median(volume[volume > 1200]) == pytest.approx(DENSE_HU + 500.0, rel=0.02)


def test_a_bone_without_cortical_bone_is_noted(reference, tmp_path):
    made, _, summary = reference
    assert "cortical bone" not in summary["notes"]
    porous = imported(made.folder.parent / "ct.nrrd", tmp_path / "out", density="line:1.0,-100.0")
    notes = force_N(porous)[1]["notes"]
    assert notes["cortical bone"].startswith("less than 0.1 % of the bone in the region")


def test_a_path_in_metres_is_noted(reference):
    path = {"motion.points_mm": [[0, 0, 0.003], [0, 0, 0.001]], "duration_s": 0.01}
    run = tissue.simulate(tissue.load_scene(reference[0].scene, COARSE | path))
    assert run.summary["notes"]["length of the path"].startswith("only 0.002 mm, which")


def test_a_site_may_be_given_in_ras(reference, tmp_path):
    made, *_ = reference
    x, y, z = TOP
    other = imported(
        made.folder.parent / "ct.nrrd", tmp_path / "out", site=(-x, -y, z), coordinates="RAS"
    )
    assert (other.folder / "scene.toml").read_text() == (made.folder / "scene.toml").read_text()


def test_the_move_of_a_site_to_the_surface_is_reported(reference, tmp_path):
    made, *_ = reference
    x, y, z = TOP
    options = {"site": (-x, -y, z + 9.0), "coordinates": "RAS"}
    other = imported(made.folder.parent / "ct.nrrd", tmp_path / "out", **options)
    sentence = next(each for each in other.sentences if each.startswith("site:"))
    now = r"moved 9\.\d mm to the surface, now at \(-0\.\d+, 0\.\d+, 1[12][.\d]*\) RAS$"
    assert re.search(now, sentence), sentence


def test_the_nearest_corner_is_a_site_in_the_same_coordinates(reference, tmp_path):
    image = reference[0].folder.parent / "ct.nrrd"
    with pytest.raises(InputError, match="nearest corner is") as refused:
        imported(image, tmp_path / "out", site=(9.0, 20.0, 15.0), coordinates="RAS")
    corner = tuple(map(float, str(refused.value).rsplit("(")[-1].split(")")[0].split(",")))
    assert imported(image, tmp_path / "out", site=corner, coordinates="RAS").has_site


@pytest.mark.parametrize(("given", "other"), [("LPS", "RAS"), ("RAS", "LPS")])
def test_a_site_in_the_other_coordinates_is_recognised(given, other):
    """A ball at (60, 40, 0) mm in LPS; the site is stated with the signs of the other system."""
    ball = trimesh.creation.icosphere(radius=10.0)
    vertices = np.asarray(ball.vertices) + np.array([60.0, 40.0, 0.0])
    surface = surface_from_triangles(vertices, np.asarray(ball.faces), scale_mm=1.0)
    sign = 1.0 if given == "RAS" else -1.0
    request = ImportRequest(
        Path("ct.nrrd"), site=(sign * 60.0, sign * 40.0, 10.0), coordinates=given
    )
    with pytest.raises(InputError, match=f"Give --coordinates {other} if the point is in {other}"):
        placed(request, surface)


def test_the_corners_of_the_image_are_printed(reference):
    size = next(each for each in reference[0].sentences if "mm in all" in each)
    assert re.search(r", from \(-?[\d., -]+\) to \([\d., -]+\) mm in LPS$", size), size


def test_a_refused_site_comes_after_the_bone_that_was_found(reference, command, tmp_path):
    image = reference[0].folder.parent / "ct.nrrd"
    site = ("--site", "0,0,500", "--density", LINE, "--out", tmp_path / "out")
    code, printed, message = command("import", image, *site)
    assert code == 2 and "threshold" in printed and "bone of" in printed
    assert message.startswith("error: --site must lie within 10 mm") and message.count("\n") == 1


def test_the_duration_of_the_scene_that_is_followed_is_not_copied_for_a_path(reference, tmp_path):
    image = reference[0].folder.parent / "ct.nrrd"
    path = imported(image, tmp_path / "path", like="glenoid")
    assert tissue.load_scene("glenoid").duration_s is not None
    assert tissue.load_scene(path.scene).duration_s is None
    thrust = imported(image, tmp_path / "thrust", like="pedicle")
    assert tissue.load_scene(thrust.scene).duration_s == tissue.load_scene("pedicle").duration_s


def test_a_label_is_the_bone_and_its_names_are_kept(tmp_path):
    image = ball()
    write_nrrd(tmp_path / "ct.nrrd", *axes_of(image))
    names = {1: "humerus", 2: "canal"}
    values = ball_mask(image).astype(np.uint8) + ball_mask(image, radius_mm=3.0)
    place = {"spacing_mm": image.spacing_mm, "origin_mm": image.origin_mm}
    labels = write_named_labels(tmp_path / "a.seg.nrrd", values, names, **place)
    made = imported(tmp_path / "ct.nrrd", tmp_path / "out", labels=labels, region="humerus")
    kept = read_labels(made.folder / "labels.seg.nrrd")
    assert kept.names == names
    assert kept.mask("humerus").sum() == (ball_mask(image) & ~ball_mask(image, radius_mm=3.0)).sum()
    record = json.loads((made.folder / "import.json").read_text())
    assert record["threshold"] is None and record["density_law"]["slope_kg_m3"] == 1.0
    assert record["bone_mm3"] == pytest.approx(kept.mask("humerus").sum(), rel=0.02)


def test_a_folder_of_several_series_is_listed_and_one_taken(tmp_path):
    folder, image = tmp_path / "dicom", ball()
    write_dicom(folder, *axes_of(image), intercept=0.0, series="1.2.3", series_number=3)
    write_dicom(
        folder,
        *axes_of(image),
        intercept=0.0,
        series="1.2.4",
        series_number=4,
        name="other{:03d}.dcm",
    )
    count = image.values.shape[2]
    with pytest.raises(
        InputError, match=rf"number 3 with {count} slices and number 4 with {count} slices"
    ):
        imported(folder, tmp_path / "out")
    assert imported(folder, tmp_path / "out", series=4).has_site
    with pytest.raises(
        InputError, match=r"series must be the number of a series in dicom, got 7\. Choose"
    ):
        imported(folder, tmp_path / "out", series=7, overwrite=True)


def test_nothing_of_a_person_leaves_the_files(tmp_path):
    folder = tmp_path / "dicom"
    write_dicom(folder, *axes_of(ball()), intercept=0.0, name="DOE-JANE-{:03d}.dcm")
    made = imported(folder, tmp_path / "out")
    for file in made.folder.iterdir():
        assert b"DOE" not in file.read_bytes()
    assert "DOE" not in " ".join(made.sentences)


def test_without_a_site_the_scene_asks_for_one(reference, tmp_path):
    made, *_ = reference
    other = tissue.import_ct(
        made.folder.parent / "ct.nrrd", tmp_path / "My bone 2", density=LINE, pictures=False
    )
    assert not other.has_site and "pick one" in other.sentences[-1]
    assert (
        other.scene.read_text().startswith("# No site yet")
        and scene_name(tmp_path / "My bone 2") == "my-bone-2"
    )
    with pytest.raises(InputError, match=r"anatomy\.centre_mm must be given"):
        tissue.simulate(tissue.load_scene(other.scene))


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (
            {"region": "humerus"},
            "region must be left out if no labels are given. Give the labels by",
        ),
        ({"site": "glenoyd"}, r"did you mean glenoid\?"),
        (
            {"site": (0.0, -1.0, 500.0), "coordinates": "RAS"},
            r"site must lie within 10 mm .* got \(0, -1, 500\) RAS in ct.nrrd.* nearest corner is "
            r"\(.*\) RAS\b",
        ),
        ({"site": (0.0, float("nan"), 0.0)}, "site must consist of three finite numbers"),
        (
            {"coordinates": "RAS", "site": None},
            "coordinates must be left out unless a box, a site or a path",
        ),
        (
            {"coordinates": "RAS", "site": "glenoid"},
            "coordinates must be left out unless a box, a site or a path",
        ),
        ({"coordinates": "ras"}, "coordinates must be LPS or RAS, got ras"),
        (
            {"normal": (0.0, 0.0, 1.0), "site": None},
            "normal must be left out unless site is a point",
        ),
        ({"threshold": 9000.0}, "threshold must leave bone"),
        (
            {"crop_mm": ((5.0, 0.0, 0.0), (1.0, 2.0, 3.0))},
            "crop_mm must have a first corner below the second corner",
        ),
        (
            {"crop_mm": ((500.0, 0.0, 0.0), (600.0, 2.0, 3.0))},
            "crop_mm must leave at least two voxels",
        ),
        ({"density": "unheard"}, "density must"),
        ({"like": "liver-press"}, "like must be a scene in which a tool cuts"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_sentence(reference, tmp_path, options, part):
    made, *_ = reference
    given = {"density": LINE, "site": TOP, "pictures": False} | options
    with pytest.raises(InputError, match=part) as refused:
        tissue.import_ct(made.folder.parent / "ct.nrrd", tmp_path / "out", **given)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").iterdir())


def test_a_surface_is_not_imported(tmp_path):
    with pytest.raises(InputError, match=r"got bone.stl. To use a surface, set anatomy.f"):
        tissue.import_ct(tmp_path / "bone.stl", tmp_path / "out")


def test_names_are_suggested_for_labels_without_names(reference, tmp_path):
    made, *_ = reference
    image = ball()
    write_nrrd(tmp_path / "a.nrrd", ball_mask(image).astype(np.uint8), *axes_of(image)[1:])
    options = {"labels": tmp_path / "a.nrrd", "region": "femur_right"}
    with pytest.raises(InputError, match=r"Use label 1, or name the labels by --label-n"):
        imported(made.folder.parent / "ct.nrrd", tmp_path / "out", **options)


def test_an_image_of_other_units_gets_a_shell(tmp_path):
    image = ball()
    values, axes, origin = axes_of(image)
    write_nrrd(tmp_path / "ct.nrrd", (100 + values // 20).astype(np.int16), axes, origin)
    made = tissue.import_ct(
        tmp_path / "ct.nrrd", tmp_path / "out", threshold=125.0, site=TOP, pictures=False
    )
    assert not (made.folder / "density.nrrd").exists() and "unknown" in " ".join(made.sentences)
    assert tissue.load_scene(made.scene).anatomy.density_file is None


@pytest.mark.slow
def test_pictures_are_drawn(reference, tmp_path):
    made, *_ = reference
    other = tissue.import_ct(
        made.folder.parent / "ct.nrrd", tmp_path / "out", density=LINE, site=TOP
    )
    for name in ("slices.png", "histogram.png", "bone.png"):
        assert (other.folder / name).stat().st_size > 10_000, Path(name)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--part", "tumour=40"],
            "--part must be left out if no labels are given. Give the labels by",
        ),
        (["--part", "tumour"], "--part must be NAME=KPA, got tumour"),
        (["--feed-mm-s", "3"], "--feed-mm-s must be left out if no path is given. Give --path"),
        (["--crop", "5,0,0,1,2,3"], "--crop must have a first corner below the second corner"),
        (["--crop", "5,0,0"], "--crop must be 6 numbers"),
        (
            ["--site", "tooth", "--labels", "a.nrrd", "--crop", "0,0,0,1,2,3"],
            "--crop must be left out for a tooth",
        ),
    ],
)
def test_options_are_named_as_on_the_command_line(refused, tmp_path, options, message):
    found = refused("import", "ct.nrrd", "--out", str(tmp_path / "out"), *options)
    assert found.startswith(message)
