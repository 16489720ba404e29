"""Options of commands that have no effect, and what a run reports as left undone."""

import errno
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import tissue
from meshes.base.errors import names_of_caller, require_length
from meshes.organs.liver import Nodule, slab
from meshes.tets.structured import box
from tissue import InputError, load_scene, scene_names, scene_text, simulate
from tissue.scene.organ import LiverFile, Organ, SlabAnatomy
from tissue.simulation.builders.organ import elasticity_of


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ("run", "wall", "--cores", "2"),
            "--cores must be left out for a wall, which no kernel computes, got 2: remove it",
        ),
        (
            ("run", "milling", "--allow-unstable"),
            (
                "--allow-unstable must be left out without a device, got it: set device = touch, "
                "or remove it"
            ),
        ),
        (
            ("run", "milling", "--seed", "3"),
            (
                "seed must be left out without a device, for nothing is drawn at random then, "
                "got 3: set device = touch, or remove it"
            ),
        ),
        (
            ("run", "milling", "--fidelity", "force_error=0.1", "--set", "voxels.removal=binary"),
            (
                "voxels.removal must be left out with fidelity, which chooses it, got binary: "
                "leave fidelity out, or remove it"
            ),
        ),
        (
            ("run", "wall", "--fidelity", "force_error=0.1", "--set", "prediction=hold"),
            (
                "device.prediction must be left out with fidelity, which chooses it, got hold: "
                "leave fidelity out, or remove it"
            ),
        ),
        (
            ("run", "liver-press", "--fidelity", "force_error=0.1", "--set", "organ.order=1"),
            (
                "organ.order must be left out with fidelity, which chooses it, got 1: leave "
                "fidelity out, or remove it"
            ),
        ),
        (
            ("run", "wall", "--slicer"),
            (
                "--slicer must be left out without --live, got it: give --live, or open the "
                "files of a run that has ended"
            ),
        ),
        (
            ("run", "wall", "--live", "--slicer-port", "5"),
            (
                "--slicer-port must be left out without --slicer, got 5: give --live --slicer, "
                "or remove it"
            ),
        ),
        (
            ("run", "wall", "--live", "--slicer-drives"),
            (
                "--slicer-drives must be left out without --slicer, got it: give --live "
                "--slicer, or remove it"
            ),
        ),
        (
            ("run", "wall", "--web"),
            (
                "--web must be left out without --live, got it: give --live, or see a run that "
                "has ended by `tissue view DIR --web`"
            ),
        ),
        (
            ("view", "run", "--web", "--screenshot", "a.png"),
            (
                "web must be left out with a screenshot, which is a file, got a.png: leave one "
                "of them out"
            ),
        ),
        (
            ("view", "run", "--web", "--movie", "a.gif"),
            "web must be left out with a movie, which is a file, got a.gif: leave one of them out",
        ),
        (
            ("run", "wall", "--live", "--web", "--band", "20"),
            "--band must be left out with --live, got 20: run the scene without it",
        ),
        (
            ("chart", "wall", "--trials", "5"),
            (
                "--trials must be left out unless predictors are charted, got 5: add prediction "
                "before the scenes, or remove it"
            ),
        ),
        (
            ("chart", "perception", "--quick"),
            "--quick must be left out with perception, got it: remove it",
        ),
        (
            ("calibrate", "--population", "x", "--trials", "5"),
            (
                "--trials must be left out with --population, which fits sessions that are over, "
                "got 5: remove it"
            ),
        ),
        (
            ("study", "run", "--only", "T1-novice-0001", "--workers", "2"),
            (
                "--workers must be left out with --only, which runs one trial here and keeps "
                "nothing, got 2: remove it"
            ),
        ),
        (
            ("assess", "a", "--against", "b", "--overwrite"),
            "--overwrite must be left out without --out, for nothing is written, got it: remove it",
        ),
        (
            ("stability", "wall", "--overwrite"),
            (
                "--overwrite must be left out with a scene and no --out, for nothing is written, "
                "got it: remove it"
            ),
        ),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, tuple) else "",
)
def test_an_option_without_effect_is_refused(refused, here, arguments, sentence):
    assert refused(*arguments) == sentence


def test_a_cache_that_cannot_be_written_is_named_as_the_cache(refused, here, monkeypatch):
    from tissue.cli.run import run

    monkeypatch.setenv("TISSUE_CACHE", str(here / "cache"))

    def full(*_, **__):
        raise OSError(
            errno.ENOSPC, "No space left on device", str(here / "cache" / "frontiers" / "x.csv")
        )

    monkeypatch.setattr("tissue.scene.load.load_scene", full)
    assert run is not None
    assert refused("run", "milling") == (
        "cache must have space, got no space left on device at "
        f"{here / 'cache' / 'frontiers' / 'x.csv'}: free some "
        "space or choose another folder by TISSUE_CACHE"
    )


@pytest.mark.parametrize("name", scene_names())
def test_a_built_in_scene_holds_no_key_without_effect_and_lasts_as_long_as_its_motion(
    name, tmp_path
):
    scene = load_scene(name)

    if scene.duration_s is not None and scene.motion.kind == "path":
        points = scene.motion.points_mm
        length = sum(
            sum((a - b) ** 2 for a, b in zip(p, q, strict=True)) ** 0.5 for p, q in pairwise(points)
        )
        assert scene.duration_s >= length / scene.motion.feed_mm_s - 1e-9


def test_what_an_override_makes_idle_is_left_out_and_what_a_file_holds_idle_is_refused(tmp_path):
    assert load_scene("wall", {"device": "none"}).device is None
    text = scene_text("wall").replace('kind = "touch" ', "# ")
    (tmp_path / "mine.toml").write_text(
        text.replace("[motion]", "[device.coupling]\nforce_scale = 1.0\n\n[motion]")
    )
    with pytest.raises(InputError, match=r"device must be given for .*coupling\.force_scale = 1"):
        load_scene(tmp_path / "mine.toml")
    assert load_scene(tmp_path / "mine.toml", {"device": "omni"}).held.renderer == "proxy"
    with pytest.raises(InputError, match="force_scale"):
        load_scene(tmp_path / "mine.toml", {"duration_s": 1.0})


MILLING = {"voxels.spacing_mm": 0.5, "voxels.margin_mm": 0.5}


def test_a_run_that_ends_before_its_path_is_reported(tmp_path):
    short = simulate(load_scene("milling", MILLING | {"duration_s": 0.2}))
    assert short.summary["notes"]["path"] == (
        "not finished: the run ends at 0.2 s, the motion at 8.09 s; set duration_s = 8.09 or "
        "leave it out to see all of it"
    )
    rows = [f"{t},0,0,{0.5 - 0.05 * t},0,0,0,1" for t in range(22)]
    head = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw"
    (tmp_path / "poses.csv").write_text("\n".join([head, *rows]) + "\n")
    replay = {
        "motion.kind": "replay",
        "motion.file": str(tmp_path / "poses.csv"),
        "duration_s": 0.1,
    }
    notes = simulate(load_scene("milling", MILLING | replay)).summary["notes"]
    assert "ends at 0.1 s, the motion at 21 s" in notes["path"] and notes["removed"].startswith(
        "nothing: "
    )
    whole = simulate(
        load_scene(
            "milling",
            MILLING | {"motion.points_mm": [[0, 0, 0.1], [0, 0, -0.1]], "duration_s": None},
        )
    )
    assert not {"path", "removed"} & set(whole.summary["notes"])
    stuck = {
        "motion.kind": "thrust",
        "motion.thrust_N": 0.5,
        "motion.start_mm": [0, 0, 0.1],
        "duration_s": 0.1,
    }
    assert (
        "of motion.depth_mm = 2"
        in simulate(load_scene("milling", MILLING | stuck)).summary["notes"]["path"]
    )


def test_a_vessel_that_the_needle_never_reaches_is_reported():
    shallow = {
        "anatomy.interval_ms": 0.0,
        "motion.points_mm": [[0, 0, 1], [0, 0, -20]],
        "duration_s": None,
    }
    run = simulate(load_scene("needle", shallow))
    went_mm, deep_mm = (
        run.trace["insertion_mm"].max(),
        run.scene.anatomy.membrane_depths_mm["vessel wall"],
    )
    assert 0.0 < went_mm < 20.0 < deep_mm
    assert run.summary["notes"]["membranes"] == (
        f"never reached: the needle went {went_mm:.3g} mm in, beyond lies the vessel wall at "
        f"{deep_mm:g} mm; see "
        "anatomy.membrane_depths_mm"
    )


def test_a_lesion_that_the_tool_never_meets_is_reported():
    off_the_lesion = {
        "voxels.spacing_mm": 0.25,
        "stress": None,
        "motion.points_mm": [[3.5, 0, 4.5], [3.5, 0, 0.5]],
    }
    run = simulate(
        load_scene("caries", off_the_lesion | {"motion.feed_mm_s": 20.0, "duration_s": None})
    )
    assert (
        run.summary["removed_mm3"]["enamel"] > 0.0 and run.summary["removed_mm3"]["caries"] == 0.0
    )
    assert run.summary["notes"]["removed"].startswith(
        "nothing of the caries: the tool never met the lesion"
    )


def test_parts_of_a_file_have_moduli_by_name_or_number():
    """One that is not there is refused with those that are."""
    whole = box((0.02, 0.02, 0.02), (2, 2, 2))
    part = (np.arange(len(whole.cells)) % 3).astype(whole.part.dtype)
    names = ("part 1", "tumour", "nodule")
    mesh, liver = replace(whole, part=part, part_names=names), LiverFile(file="organ.vtu")
    plain, message = elasticity_of(mesh, liver, Organ())
    # in a file it is a name as any other
    assert np.ptp(plain, axis=0).max() == 0.0 and "nodule" not in message
    for named, number in (("tumour", 1), ("part 1", 0), ("1", 0)):
        found, message = elasticity_of(mesh, liver, Organ(parts={named: 300.0}))
        np.testing.assert_array_equal((found != plain).any(axis=1), part == number)
        assert f"{names[number]} 300 kPa" in message
    both, message = elasticity_of(mesh, liver, Organ(parts={"tumour": 40.0, "nodule": 300.0}))
    assert len(np.unique(both, axis=0)) == 3 and "; tumour 40 kPa; nodule 300 kPa" in message
    for parts, wrong, text in (
        (
            {"tumor": 300.0},
            mesh,
            r"name parts of the mesh, got 'tumor' \(did you mean tumour\?\): it has part 1, tumour",
        ),
        ({"nodule": 300.0}, whole, "name parts of the mesh, got 'nodule': it has"),
        ({"1": 3.0, "part 1": 4.0}, mesh, "name each part once, got part 1 twice: remove one"),
    ):
        with pytest.raises(InputError, match=f"^organ.parts must {text}"):
            elasticity_of(wrong, liver, Organ(parts=parts))


def test_the_ball_of_a_procedural_organ_is_a_part():
    mesh = slab(size_m=(0.06, 0.06, 0.04), spacing_m=8e-3, nodule=Nodule(9e-3, (0.0, 0.0, -0.018)))
    anatomy = SlabAnatomy(nodule_diameter_mm=18.0)
    assert "; nodule 50 kPa" in elasticity_of(mesh, anatomy, Organ())[1]
    assert "; nodule 12 kPa" in elasticity_of(mesh, anatomy, Organ(parts={"nodule": 12.0}))[1]
    with pytest.raises(
        InputError,
        match=r"organ\.parts must be left out without a nodule, got a table: set anatomy\.nod",
    ):
        load_scene("palpation", {"anatomy.nodule_diameter_mm": 0, "organ.parts.nodule": 80.0})
    assert load_scene("palpation", {"anatomy.nodule_diameter_mm": 0}).organ.parts is None
    assert load_scene("palpation", {"organ.parts": {}}).organ.parts is None
    for value, sentence in (
        (-1.0, "organ.parts.nodule must be at least 0.1 and at most 100000, got -1.0: use 80"),
        (
            "soft",
            "organ.parts.nodule must be a number at least 0.1 and at most 100000, got soft: use 80",
        ),
    ):
        with pytest.raises(InputError, match=f"^{re.escape(sentence)}$"):
            load_scene("palpation", {"organ.parts.nodule": value})
    with pytest.raises(
        InputError, match=r"^organ\.parts must be a table of names and numbers at least 0\.1 and"
    ):
        load_scene("palpation", {"organ.parts": 80.0})


def test_lengths_in_messages_have_the_unit_of_the_argument_the_user_wrote():
    with pytest.raises(InputError) as refused, names_of_caller({"edge_m": "anatomy.edge_mm"}):
        require_length("edge_m", 0.2, 1e-3, 0.05, 0.01)
    assert (
        str(refused.value)
        == "anatomy.edge_mm must be from 1 mm to 50 mm, got 200 mm: use about 10 mm"
    )
    for value in (0.0, -0.004, float("nan"), float("inf")):
        with pytest.raises(InputError, match=f"got {1e3 * value:g} mm"):
            require_length("edge_m", value, 0.0, float("inf"), 0.01)


def test_counts_in_messages_are_not_scaled_with_lengths():
    with pytest.raises(InputError, match=r"edge_mm .* 20000000 tetrahedra, got 0\.1 mm") as refused:
        tissue.Organ.liver(edge_mm=0.1)
    advised = float(re.search(r"use ([\d.]+) mm", str(refused.value))[1])
    assert 0.5 < advised < 5.0
    with pytest.raises(InputError, match=r"edge_mm .* 6 mm, got 50 mm"):
        tissue.Organ.block(size_mm=(30, 20, 6), modulus_kPa=5.0, poisson_ratio=0.45, edge_mm=50)


def test_names_of_arguments_are_replaced_by_those_of_the_caller():
    for argument, named in (("file", "anatomy.file"), ("filed", "filed")):
        with pytest.raises(InputError) as refused, names_of_caller({"file": "anatomy.file"}):
            raise InputError(argument, "exist", "file.stl", "check")
        assert str(refused.value) == f"{named} must exist, got file.stl: check"
