"""Teeth, soft organs, toolpaths and structures to keep clear of, imported and run."""

import json

import numpy as np
import pytest
from ct_ball import CENTRE_MM, DENSE_HU, RADIUS_MM, SOFT_HU, ball, ball_mask
from image_writers import write_nrrd
from named_labels import write_named_labels

import tissue
from meshes.base.errors import InputError

TOP = tuple((CENTRE_MM + np.array([0.0, 0.0, RADIUS_MM])).tolist())
BONE = {"density": "line:1.0,500.0", "site": TOP, "pictures": False}


@pytest.fixture(scope="module")
def ct(tmp_path_factory):
    """Return a CT of a ball of bone and its labels.

    They are the bone, and a canal of two pieces next to the tool's path.
    """
    folder, image = tmp_path_factory.mktemp("ct"), ball()
    write_nrrd(folder / "ct.nrrd", image.values, np.diag(image.spacing_mm), image.origin_mm)
    values = np.zeros(image.values.shape)
    values[ball_mask(image)] = 1
    canal = ball_mask(image, centre_mm=CENTRE_MM + np.array([5.0, 0.0, 8.0]), radius_mm=3.0)
    values[canal] = 2
    # larger, far away
    values[ball_mask(image, centre_mm=CENTRE_MM - np.array([0.0, 0.0, 18.0]), radius_mm=4.0)] = 2
    place = {"spacing_mm": image.spacing_mm, "origin_mm": image.origin_mm}
    write_named_labels(folder / "a.seg.nrrd", values, {1: "bone", 2: "facial nerve"}, **place)
    return folder


def test_a_label_to_keep_clear_of_is_measured_on_the_run(ct, tmp_path):
    made = tissue.import_ct(
        ct / "ct.nrrd",
        tmp_path / "out",
        labels=ct / "a.seg.nrrd",
        region="bone",
        keep_clear=["facial nerve"],
        **BONE,
    )
    coarse = {
        "voxels.spacing_mm": 0.6,
        "motion.points_mm": [[0, 0, 1], [0, 0, -2]],
        "motion.feed_mm_s": 40.0,
    }
    assert (
        "facial nerve: 2 pieces of 0.269, 0.116 ml, all of them structures to keep clear of"
        in made.sentences
    )
    run = tissue.simulate(tissue.load_scene(made.scene, coarse))
    tip = run.trace.vectors("tool", "mm")[-1]
    # The burr's ball has a radius of 2 mm; the nerve's, of 3 mm, lies 5 mm aside and 4 mm under the
    # top.
    middle = run.parts.placement.to_scene((CENTRE_MM + np.array([5.0, 0.0, 8.0]))[None])[0]
    exact = np.linalg.norm(tip + np.array([0.0, 0.0, 2.0]) - middle) - 5.0
    assert run.trace["distance_facial_nerve_mm"][-1] == pytest.approx(exact, abs=0.3)
    with pytest.raises(InputError, match=r"got nerv. Use facial nerve"):
        tissue.import_ct(
            ct / "ct.nrrd",
            tmp_path / "b",
            labels=ct / "a.seg.nrrd",
            region="bone",
            keep_clear=["nerv"],
            **BONE,
        )


def test_a_path_is_followed_on_the_bone(ct, tmp_path):
    x, y, z = TOP
    file = tmp_path / "path.csv"
    file.write_text(f"x_mm,y_mm,z_mm\n{x},{y},{z + 2}\n{x},{y},{z - 1}\n{x + 3},{y},{z - 1}\n")
    threshold = 0.5 * (DENSE_HU + SOFT_HU)
    made = tissue.import_ct(
        ct / "ct.nrrd", tmp_path / "out", threshold=threshold, path=file, feed_mm_s=20.0, **BONE
    )
    assert "at most" in next(each for each in made.sentences if each.startswith("path:"))
    scene = tissue.load_scene(made.scene, {"voxels.spacing_mm": 0.6})
    assert scene.motion.kind == "replay"
    run = tissue.simulate(scene)
    ends = run.parts.placement.to_file(run.trace.vectors("tool", "mm"))
    assert np.allclose(ends[-1], (x + 3, y, z - 1), atol=0.05)
    assert run.summary["force_N"]["peak"] > 1.0
    for change, part in (
        ({"site": None}, "site must be given for the path .* Give a point"),
        ({"like": "milling"}, "like must be left out with a path"),
        ({"feed_mm_s": -1.0}, "feed_mm_s must be"),
    ):
        options = BONE | {"threshold": threshold, "path": file, "feed_mm_s": 20.0} | change
        with pytest.raises(InputError, match=part):
            tissue.import_ct(ct / "ct.nrrd", tmp_path / "b", **options)
    file.write_text(f"x_mm,y_mm,z_mm\n{x},{y},{z + 20}\n{x},{y},{z + 10}\n")
    with pytest.raises(InputError, match="path must enter the bone"):
        tissue.import_ct(ct / "ct.nrrd", tmp_path / "b", threshold=threshold, path=file, **BONE)


def tooth(folder):
    """Labels of a block tooth: enamel over dentin around a pulp, a lesion in the enamel."""
    values = np.zeros((50, 40, 64))
    values[4:46, 4:36, 4:60] = 3
    values[4:46, 4:36, 46:60] = 2
    values[20:30, 15:25, 20:40] = 4
    values[20:30, 15:25, 52:60] = 1
    values[8:10, 8:10, 56:60] = 1
    names = {1: "caries", 2: "enamel", 3: "dentin", 4: "pulp"}
    return write_named_labels(
        folder / "tooth.seg.nrrd", values, names, spacing_mm=(0.25,) * 3, origin_mm=(5.0, 6.0, 7.0)
    )


def test_a_tooth_of_labels_is_drilled_over_its_largest_lesion(tmp_path):
    file = tooth(tmp_path)
    made = tissue.import_ct(file, tmp_path / "out", labels=file, site="tooth:lesion")
    assert "12.5 mm3; the second lesion has 2.0% of its volume" in " ".join(made.sentences)
    scene = tissue.load_scene(
        made.scene, {"voxels.spacing_mm": 0.25, "motion.feed_mm_s": 20.0, "duration_s": 0.15}
    )
    assert scene.anatomy.kind == "molar" and scene.anatomy.site == "caries"
    run = tissue.simulate(scene)
    assert run.summary["removed_mm3"]["caries"] > 0.05 and run.summary["start_mm3"]["pulp"] >= 0.0
    record = json.loads((made.folder / "import.json").read_text())
    assert record["volume_mm3"]["caries"] == pytest.approx((800 + 16) * 0.25**3)
    assert (made.folder / "slices.png").stat().st_size > 10_000
    other = tissue.import_ct(file, tmp_path / "sound", labels=file, site="tooth", pictures=False)
    assert not (other.folder / "slices.png").exists()
    assert tissue.load_scene(other.scene).anatomy.site == "enamel"


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"site": "tooth:lesion"}, "labels must be given for site tooth:lesion"),
        (
            {"site": "tooth:lesion", "labels": True, "region": "enamel"},
            "region must be left out for a tooth",
        ),
        (
            {"site": "tooth:lesion", "labels": True, "threshold": 3.0},
            "threshold must be left out for a tooth",
        ),
        (
            {"site": "tooth", "labels": True, "series": 2},
            "series must be left out if the labels are the source",
        ),
        ({"site": "tooth", "labels": True, "coordinates": "RAS"}, "coordinates must be left out"),
    ],
)
def test_what_has_no_effect_on_a_tooth_is_refused(tmp_path, options, part):
    file = tooth(tmp_path)
    given = options | ({"labels": file} if options.get("labels") else {})
    with pytest.raises(InputError, match=part):
        tissue.import_ct(file, tmp_path / "out", **given)


TUMOUR_MM3 = 1088.0
"""Voxels of a ball of 6 mm at 2 mm; the ball has 905."""


def organ(folder):
    """Labels of an ellipsoid of liver with a ball of a tumour in it."""
    count, spacing = (36, 30, 26), (2.0, 2.0, 2.0)
    origin = tuple(-0.5 * s * (n - 1) for s, n in zip(spacing, count, strict=True))
    x, y, z = (o + s * np.arange(n) for o, s, n in zip(origin, spacing, count, strict=True))
    x, y, z = x[:, None, None], y[None, :, None], z[None, None, :]
    values = np.zeros(count)
    values[(x / 30) ** 2 + (y / 24) ** 2 + (z / 20) ** 2 < 1.0] = 5
    values[x**2 + (y + 12) ** 2 + z**2 < 36.0] = 7
    assert 8.0 * np.count_nonzero(values == 7) == TUMOUR_MM3
    write_nrrd(
        folder / "ct.nrrd",
        np.where(values > 0, 60, -100).astype(np.int16),
        np.diag(spacing),
        origin,
    )
    return write_named_labels(
        folder / "a.seg.nrrd",
        values,
        {5: "liver", 7: "tumour"},
        spacing_mm=spacing,
        origin_mm=origin,
    )


@pytest.mark.slow
def test_a_soft_organ_is_meshed_with_its_parts_and_pressed(tmp_path):
    file = organ(tmp_path)
    options = {"labels": file, "region": "liver", "site": (0.0, -24.0, 0.0)}
    made = tissue.import_ct(
        tmp_path / "ct.nrrd", tmp_path / "out", parts={"tumour": 60.0}, **options
    )
    coarse = {"organ.order": 1, "motion.feed_mm_s": 40.0, "anatomy.touch_edge_mm": 5.0}
    scene = tissue.load_scene(made.scene, coarse)
    assert scene.anatomy.kind == "liver" and dict(scene.organ.parts) == {"tumour": 60.0}
    record = json.loads((made.folder / "import.json").read_text())
    assert record["volume_ml"]["tumour"] == pytest.approx(1e-3 * TUMOUR_MM3, rel=0.03)
    force = tissue.simulate(scene).summary["force_N"]["peak"]
    soft = tissue.load_scene(made.scene, coarse | {"organ.parts": {"tumour": 5.0}})
    assert force > 1.1 * tissue.simulate(soft).summary["force_N"]["peak"]
    assert (made.folder / "slices.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"parts": {"tumor": 60.0}}, "parts must be a label of a.seg.nrrd, got tumor"),
        ({"parts": {"tumour": -1.0}}, "parts must have a modulus above 0"),
        ({"density": "internal"}, "density must be left out for a soft organ"),
        ({"site": "glenoid"}, "site must be a point for a soft organ"),
    ],
)
def test_what_has_no_effect_on_an_organ_is_refused(tmp_path, options, part):
    file = organ(tmp_path)
    with pytest.raises(InputError, match=part):
        tissue.import_ct(
            tmp_path / "ct.nrrd", tmp_path / "out", labels=file, region="liver", **options
        )
