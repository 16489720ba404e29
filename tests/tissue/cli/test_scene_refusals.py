"""Scenes that `tissue run` refuses, with one sentence and exit code 2."""

from types import SimpleNamespace

import pytest
from coarse_run import COARSE

from meshes.base.errors import InputError
from tissue import Loop
from tissue.scene.load import scene_text


@pytest.mark.parametrize(
    ("override", "argument", "value"),
    [
        ("voxels.spacing=0.2", "voxels.spacing", "spacing"),
        ("voxel.spacing_mm=0.2", "voxel", "voxel"),
        ("qqq=1", "qqq", "qqq"),
        ("voxels.spacing_mm=3", "voxels.spacing_mm", "3"),
        ("voxels.spacing_mm=0", "voxels.spacing_mm", "0"),
        ("voxels.spacing_mm=nan", "voxels.spacing_mm", "nan"),
        ("voxels.spacing_mm=-inf", "voxels.spacing_mm", "-inf"),
        ("voxels.spacing_mm=fine", "voxels.spacing_mm", "fine"),
        ('voxels.spacing_mm="1"', "voxels.spacing_mm", '"1"'),
        ("voxels.spacing_mm=true", "voxels.spacing_mm", "true"),
        ("voxels=5", "voxels", "5"),
        ("anatomy=5", "anatomy", "5"),
        ("coupling.force_scale=autos", "device", "coupling.force_scale = autos"),
        ("coupling.force_scale=-1", "device", "coupling.force_scale = -1"),
        ("seed.low=1", "seed.low", "seed,"),
        ("seed=-1", "seed", "-1"),
        ("tool.flutes=2.0", "tool.flutes", "2.0"),
        ("tool.flutes=201", "tool.flutes", "201"),
        ("tool.kind=burr", "tool.kind", "burr"),
        ("motion.kind=paht", "motion.kind", "paht"),
        ("motion.kind=thrust", "motion.thrust_N", "must be given. Add it"),
        ("motion.kind=replay", "motion.file", "must be given. Add it"),
        ("motion={}", "motion.kind", "must be given. Use path, thrust or replay"),
        ("tool={}", "tool.kind", "must be given. Use ball-burr,"),
        ("motion.points_mm=[[0,0,1]]", "motion.points_mm", "[[0, 0, 1]]"),
        ("motion.points_mm=7", "motion.points_mm", "7"),
        ("motion.points_mm=[[0,0],[1,1,1]]", "motion.points_mm", "[[0, 0], [1, 1, 1]]"),
        ("motion.points_mm=[[0,0,nan],[1,1,1]]", "motion.points_mm", "[[0, 0, nan], [1, 1, 1]]"),
        ('motion.points_mm=[[0,0,"a"],[1,1,1]]', "motion.points_mm", "[[0, 0, a], [1, 1, 1]]"),
        ("motion.points_mm=[[1,1,1],[1,1,1]]", "motion.points_mm", "only one"),
        (
            "motion.points_mm=[[0,0,1],[0,0,-1],[0,0,-1],[0,0,1]]",
            "motion.points_mm",
            "(0, 0, -1) as points 2 and 3. Remove one of them. A pause of the tool needs",
        ),
        ("motion.axis=[0,1]", "motion.axis", "[0, 1]"),
        ("motion.axis=[0,0,0]", "motion.axis", "(0, 0, 0)"),
        ("anatomy.size_mm=[0,1,1]", "anatomy.size_mm", "[0, 1, 1]"),
        ("anatomy.normal=5", "anatomy.normal", "left out for a procedural block"),
        ("tool.spin_rpm=0.5", "tool.spin_rpm", "0.5"),
        ("name=A b", "name", "A b"),
        ("description=5", "description", "5"),
        ("tool.diameter_mm=0.15", "voxels.spacing_mm", "0.05"),
        ("tool.peg_diameter_mm=2", "tool.peg_diameter_mm", "left out for a ball-burr"),
        ("spacing", "--set", "spacing"),
        ("=1", "--set", "=1"),
        ("perception=all", "device", "perception = all"),
    ],
)
def test_a_bad_entry_is_refused_by_its_name_and_value(refused, here, override, argument, value):
    message = refused("run", "milling", "--set", override)
    assert message.startswith(f"{argument} ") and value in message
    assert not (here / "runs").exists()


@pytest.mark.filterwarnings("default")
def test_a_note_names_keys_that_an_override_makes_ineffective(command, here):
    options = ("--set", "voxels.spacing_mm=0.5", "--duration-s", 0.01, "--no-pictures")
    options = (*options, "--set", "device=touch", "--seed", 3)
    code, _, problems = command("run", "pedicle", *options)
    assert code == 0 and problems == (
        "note: motion.max_feed_mm_s of the scene has no effect after the changes and was removed\n"
    )


def test_a_motion_without_end_is_refused(refused, here):
    path = here / "slow.toml"
    path.write_text(scene_text("milling").replace("duration_s = 9.0\n", ""))
    slow = ("--set", "motion.feed_mm_s=1e-5", "--set", "motion.points_mm=[[0,0,0.1],[0,0,-3]]")
    message = refused("run", path, *COARSE, *slow)
    assert message.startswith("duration_s ") and "310000 s" in message


@pytest.mark.parametrize(
    ("points", "places"),
    [
        (
            "[[100,0,-1],[110,0,-1]]",
            ("(94, -5.995, -4) and (116, 5.998, 8)", "(-10, -6, -6) and (10, 6, 0)"),
        ),
        ("[[-2,0,1],[2,0,1]]", ("(-9.6, -6, -3.2) and (9.6, 6, 0)",)),
    ],
    ids=["beside", "above"],
)
def test_a_tool_that_never_touches_is_refused(refused, here, points, places):
    message = refused("run", "milling", *COARSE, "--set", f"motion.points_mm={points}")
    assert message.startswith("motion ") and all(place in message for place in places)
    assert not (here / "runs").exists()


def test_voxels_that_do_not_fit_the_memory_are_refused_with_what_would_fit(
    refused, command, here, monkeypatch
):
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=1e9))
    message = refused("run", "milling", "--set", "voxels.spacing_mm=0.02", "--no-pictures")
    assert all(
        word in message
        for word in ("voxels.spacing_mm", "1.0 GB", "0.02", "2.0 GB", "Use a spacing such as 0.03")
    )
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=2e6))
    fits = refused("run", "milling", "--set", "voxels.spacing_mm=0.1", "--no-pictures").rsplit(
        " ", 1
    )[1]
    code, _, error = command(
        "run",
        "milling",
        "--set",
        f"voxels.spacing_mm={fits}",
        "--no-pictures",
        "--duration-s",
        0.01,
    )
    assert (code, error) == (0, "")


@pytest.mark.parametrize(
    ("scene", "remedy"),
    [
        (
            "needle",
            "anatomy.file must be left out for a needle. A needle needs anatomy.kind = layers. Remove ",
        ),
        (
            "incision",
            "anatomy.file must be left out for a blade. A blade needs anatomy.kind = soft-tissue. Remove ",
        ),
        (
            "palpation",
            "anatomy.file must be left out for a slab. Set anatomy.kind = liver, or remove anatomy.file",
        ),
    ],
)
def test_a_shape_is_proposed_only_for_a_tool_that_can_enter_it(refused, here, scene, remedy):
    message = refused("run", scene, "--set", "anatomy.file=cut.stl")
    assert remedy in message.replace(f"{here}/", "") and "glenoid" not in message
    assert ("anatomy.kind = liver and tool.kind = sphere-probe" in message) == ("Remove" in message)


def test_a_tool_for_another_tissue_is_refused_with_its_tissue(refused, here):
    message = refused("run", "needle", "--set", "anatomy.kind=liver")
    assert 'got needle. Choose one of these, or set anatomy.kind = "layers" for a needle' in message


@pytest.mark.parametrize("value", ["", "none"])
def test_a_value_that_should_unset_a_key_is_refused_with_the_way_to_unset_it(refused, here, value):
    message = refused("run", "liver-press", "--set", f"organ.young_kPa={value}")
    assert "or remove the key from the scene file to use its default" in message


def test_a_refused_key_of_a_needle_names_the_needle_and_its_constants(refused):
    changes = ("--set", "anatomy.kind=soft-tissue", "--set", "anatomy.file=cut.stl")
    message = refused("run", "needle", *changes)
    assert (
        "anatomy.file must be left out for a needle. A" in message
        and "needs anatomy.kind = layers" in message
    )
    message = refused("run", "needle", "--set", "organ.young_kPa=15")
    assert (
        "organ.young_kPa must be left out for a needle. Give constants of the tissue, such as "
        "needle.liver.linear_N_mm, in the file that materials names, or remove organ.young_kPa"
    ) in message
    assert "anatomy.kind" not in message


def test_structures_of_a_needle_are_refused_with_the_way_to_their_distances(refused, here):
    message = refused("run", "needle", "--set", "keep_clear.files.vessel=vessel.stl")
    assert message.startswith("keep_clear.files must be left out for a needle, which cuts neither")
    assert "deflection_mm" in message and "anatomy.kind" not in message
    with pytest.raises(InputError, match=r"^keep_clear must be left out for a needle"):
        Loop("needle", keep_clear={"vessel": "vessel.stl"})


def test_a_constant_as_a_key_is_refused_with_the_place_of_constants(refused):
    message = refused("run", "needle", "--set", "needle.liver.linear_N_mm=0.2")
    assert message.startswith("needle.liver.linear_N_mm is not a known key of a scene. Write")


def test_a_constant_that_does_not_fit_a_built_in_constant_is_refused_with_both(refused, here):
    entry = 'value = 20\nrange = [15, 25]\nsource = "own"\nconfidence = "M"\n'
    (here / "own.toml").write_text(f"[needle.liver.sliding_in_N_m]\n{entry}")
    message = refused("run", "needle", "--set", "materials=own.toml")
    assert message.startswith(
        "static_in_N_m (built-in value) must be at least sliding_in_N_m (20), got 18.45."
    )
