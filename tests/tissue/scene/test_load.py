"""Scenes: where they come from, what overrides do, and that what is written reads back."""

import pytest
import tomli_w

import tissue.scene.scene
from tissue import InputError, load_scene, scene_names, scene_text
from tissue.scene.load import (
    DroppedKeyWarning,
    OldSceneWarning,
    changed,
    parse_override,
    parse_overrides,
    saved_text,
)
from tissue.scene.part import removal_of


@pytest.mark.parametrize("name", scene_names())
def test_a_built_in_scene_writes_and_reads_back_equal(name, tmp_path):
    scene = load_scene(name)
    assert scene.name == name and scene.description
    (tmp_path / "whole.toml").write_text(scene.to_toml())
    assert load_scene(tmp_path / "whole.toml") == scene
    (tmp_path / "printed.toml").write_text(scene_text(name))
    assert load_scene(str(tmp_path / "printed.toml")) == scene


def test_overrides_replace_single_entries():
    scene = load_scene("milling", {"voxels.spacing_mm": 0.2, "duration_s": 7, "tool.flutes": 4})
    plain = load_scene("milling")
    assert (scene.voxels.spacing_mm, scene.duration_s, scene.tool.flutes) == (0.2, 7, 4)
    assert scene.motion == plain.motion
    assert scene.tool.model_copy(update={"flutes": plain.tool.flutes}) == plain.tool


def test_the_warning_on_a_removed_key_names_the_line_that_loads_the_scene():
    about = "^motion.max_feed_mm_s of the scene has no effect after the changes and was removed$"
    with pytest.warns(DroppedKeyWarning, match=about) as warned:
        load_scene("pedicle", {"device": "touch"})
    assert [each.filename for each in warned] == [__file__]
    assert removal_of({"b.d", "a.c"}) == (
        "a.c, b.d of the scene have no effect after the changes and were removed"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a.b=0.2", ("a.b", 0.2)),
        ("a=1", ("a", 1)),
        ("a=[[0, 1], [2, 3]]", ("a", [[0, 1], [2, 3]])),
        ("a=ball-burr", ("a", "ball-burr")),
        ('a="0.2"', ("a", "0.2")),
        ("a=x=y", ("a", "x=y")),
        ("a=", ("a", "")),
        (" a =true", ("a", True)),
    ],
)
def test_the_value_of_an_override_is_toml_or_text(text, expected):
    assert parse_override(text) == expected


def test_an_override_mends_a_scene_file(tmp_path):
    (tmp_path / "broken.toml").write_text(
        scene_text("milling").replace("spacing_mm = 0.05\n", "spacing_mm = 7.0\n")
    )
    with pytest.raises(InputError, match=r"voxels\.spacing_mm must be"):
        load_scene(tmp_path / "broken.toml")
    assert load_scene(tmp_path / "broken.toml", {"voxels.spacing_mm": 0.05}) == load_scene(
        "milling"
    )


@pytest.mark.parametrize("turned", [False, True], ids=["kind first", "kind last"])
def test_a_new_kind_starts_its_part_afresh(turned):
    changes = [("motion.kind", "thrust"), ("motion.thrust_N", 30)]
    scene = load_scene("milling", dict(reversed(changes) if turned else changes))
    assert scene.motion.kind == "thrust"
    assert scene.motion.thrust_N == 30.0
    assert not hasattr(scene.motion, "points_mm")
    block = load_scene("glenoid", {"anatomy.kind": "block", "tool.peg_diameter_mm": 0.0})
    assert block.anatomy == tissue.scene.scene.BlockAnatomy()
    assert load_scene("milling", {"motion.kind": "path"}) == load_scene("milling")


def test_a_new_kind_of_cutter_keeps_the_keys_that_it_has():
    """The distance between cutting elements belongs to a shape, and a burr has no peg."""
    before = load_scene("milling")
    tool = load_scene("milling", {"tool.kind": "cylinder"}).tool
    assert tool.diameter_mm == before.tool.diameter_mm
    assert (tool.flutes, tool.spin_rpm) == (before.tool.flutes, before.tool.spin_rpm)
    assert tool.shell_spacing_mm is None and before.tool.shell_spacing_mm is not None
    reamer = load_scene("glenoid").tool
    flat = load_scene("glenoid", {"tool.kind": "flat-reamer"}).tool
    assert (flat.peg_mm, flat.diameter_mm) == (reamer.peg_mm, reamer.diameter_mm)
    burr = load_scene("glenoid", {"tool.kind": "ball-burr", "tool.diameter_mm": 4.0}).tool
    assert (burr.peg_mm, burr.diameter_mm) == ((0.0, 0.0), 4.0)


def test_files_are_taken_from_the_scene_file_and_overrides_from_the_working_directory(
    tmp_path, monkeypatch
):
    home, work = tmp_path / "home", tmp_path / "work"
    home.mkdir()
    work.mkdir()
    monkeypatch.chdir(work)
    text = scene_text("milling").replace("size_mm = [20, 12, 6]", 'file = "../bones/a.stl"')
    (home / "x.toml").write_text(text)
    assert load_scene(home / "x.toml").anatomy.file == str(tmp_path / "bones" / "a.stl")
    assert load_scene("../home/x.toml", {"duration_s": 3}).anatomy.file == str(
        tmp_path / "bones" / "a.stl"
    )
    assert load_scene(home / "x.toml", {"anatomy.file": "b.stl"}).anatomy.file == str(
        work / "b.stl"
    )
    assert load_scene("milling", {"anatomy.file": "b.stl"}).anatomy.file == str(work / "b.stl")
    assert load_scene(home / "x.toml", {"anatomy.file": ""}).anatomy.from_file is None
    replay = {"motion.kind": "replay", "motion.file": "t.csv"}
    assert load_scene(home / "x.toml", replay).motion.file == str(work / "t.csv")


def test_the_axis_of_a_path_is_kept_for_a_thrust():
    oblique = changed(load_scene("needle"), {"motion.axis": (-0.5, 0.0, 0.75**0.5)})
    thrust = {"motion.kind": "thrust", "motion.thrust_N": 3.0}
    pushed = changed(oblique, thrust)
    assert pushed.motion.axis == oblique.motion.axis
    path = {"motion.kind": "path", "motion.points_mm": [[0, 0, 1], [0, 0, -1]]}
    assert changed(pushed, path | {"motion.feed_mm_s": 1.0}).motion.axis == oblique.motion.axis
    up = {"motion.axis": (0.0, 0.0, 1.0)}
    assert changed(oblique, thrust | up).motion.axis == (0.0, 0.0, 1.0)


OLD_DEVICE = {
    "hand": "novice",
    "renderer": "proxy",
    "prediction": "none",
    "perception": "none",
    "coupling": {"delay_ms": 4, "prediction_gain": 1.0, "predictor_file": ""},
    "hardware": {"address": "", "ramp_ms": 500.0},
}
"""Keys of the device as version 0.2 wrote them, with defaults that have no effect."""


@pytest.mark.parametrize("name", scene_names())
def test_a_scene_that_version_02_kept_is_read_without_its_idle_defaults(name, tmp_path):
    path = tmp_path / "scene.toml"
    scene = load_scene(name, {"device": "none"})
    table = scene.model_dump(mode="json", exclude_none=True)
    for device, read in (
        ("none", scene),
        ("touch", load_scene(name, {"device": "touch", "hand": "novice", "coupling.delay_ms": 4})),
    ):
        path.write_text(tomli_w.dumps(table | OLD_DEVICE | {"device": device}))
        with pytest.warns(OldSceneWarning, match="format of tissue 0.2"):
            assert load_scene(path) == read


def test_a_kept_scene_with_the_default_of_a_removed_key_is_read(tmp_path):
    scene = load_scene("palpation", {"organ.law": "neo-hookean"})
    text = saved_text(scene)
    for method, is_read in (("offset", True), ("reduced", False)):
        path = tmp_path / f"{method}.toml"
        path.write_text(text.replace("[organ]\n", f'[organ]\nlaw_method = "{method}"\n'), "utf-8")
        if is_read:
            assert load_scene(path) == scene
        else:
            with pytest.raises(InputError, match=r"organ\.law_method"):
                load_scene(path)


def test_a_file_in_the_form_of_version_02_is_read_with_a_note_and_still_refuses_idle_keys(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'device = "omni"\nhand = "novice"\n'
        + scene_text("milling")
        + "\n[coupling]\ndelay_ms = 3\n"
    )
    with pytest.warns(OldSceneWarning):
        held = load_scene(path).held
    assert (held.kind, held.hand, held.coupling.delay_ms) == ("omni", "novice", 3)
    path.write_text('hand = "expert"\n' + scene_text("milling"))
    with (
        pytest.warns(OldSceneWarning),
        pytest.raises(InputError, match="device must be given for hand = expert"),
    ):
        load_scene(path)
    later = tmp_path / "later.toml"
    later.write_text("format = 3\n" + scene_text("milling"))
    with pytest.raises(InputError, match="format"):
        load_scene(later)


def test_the_file_of_a_recorded_device_lies_beside_its_scene(tmp_path, monkeypatch):
    recorded = scene_text("wall").replace('kind = "touch"', 'kind = "recorded"')
    assert recorded != scene_text("wall")
    (tmp_path / "home").mkdir()
    file = tmp_path / "home" / "x.toml"
    file.write_text(f'{recorded}\n[device.hardware]\naddress = "poses.csv"\n')
    monkeypatch.chdir(tmp_path)
    assert load_scene(file).held.hardware.address == str(tmp_path / "home" / "poses.csv")
    elsewhere = load_scene(file, {"hardware.address": "other.csv"})
    assert elsewhere.held.hardware.address == str(tmp_path / "other.csv")


@pytest.mark.parametrize("device", ["5", "[1]", "true"])
def test_a_device_that_is_no_table_is_refused_with_and_without_overrides(tmp_path, device):
    text = "\n".join(
        line for line in scene_text("milling").splitlines() if not line.startswith("device")
    )
    (tmp_path / "x.toml").write_text(f"device = {device}\n{text}")
    for overrides in ({}, {"duration_s": 1.0}):
        with pytest.raises(InputError, match=r"^device "):
            load_scene(tmp_path / "x.toml", overrides)


def test_a_live_run_without_a_device_keeps_its_seed_for_the_mouse():
    scene = load_scene("milling", {"device": "none", "seed": 3}, live=True)
    assert scene.held.kind == "touch" and scene.seed == 3


def test_one_key_in_two_forms_is_refused():
    with pytest.raises(
        InputError, match=r"^device\.hand must be given once, got hand and device\.hand"
    ):
        load_scene("wall", {"hand": "novice", "device.hand": "expert"})


def test_a_key_given_twice_on_the_command_line_is_refused():
    assert parse_overrides(["a=1", "b=x"]) == {"a": 1, "b": "x"}
    with pytest.raises(InputError, match=r"^--set must name each key once, got a twice"):
        parse_overrides(["a=1", "a=2"])


def test_the_text_none_leaves_stress_out(tmp_path):
    assert load_scene("molar", {"stress": "none"}) == load_scene("molar", {"stress": None})
    file = tmp_path / "molar.toml"
    text = scene_text("molar")
    file.write_text(f'stress = "none"\n{text[: text.index("[stress]")]}')
    assert load_scene(file).stress is None
    with pytest.raises(InputError, match=r"stress must be none or a table with .*, got off"):
        load_scene("molar", {"stress": "off"})


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"name": "Hip d0.8"}, 'Use "hip-d0-8"'),
        ({"tool.diameter_mm": "22mm"}, "Use 22, because the key states the unit"),
        ({"motion.feed_mm_s": "0.5 mm/s"}, "Use 0.5, because the key states the unit"),
        ({"tool.diameter_mm": "22 inches"}, "Use a value such as 6"),
        ({"tool.diameter_mm": "2..5mm"}, "Use a value such as 6"),
        ({"tool.diameter_mm": "--5mm"}, "Use a value such as 6"),
        ({"anatomy.size_mm": "8mm"}, "Use a value such as [20, 12, 8]"),
        ({"motion.axis": "0.5 0 1"}, "Use a value such as [0, 0, 1]"),
        ({"device": "touch", "coupling.delay_ms": 4000}, "Use 200 or less"),
        ({"tool.diameter_mm": 0.022}, "Use a value in this range, such as 6, in mm"),
    ],
)
def test_the_remedy_follows_from_the_value_of_the_user(changes, remedy):
    with pytest.raises(InputError) as refused:
        load_scene("milling", changes)
    assert str(refused.value).endswith(f". {remedy}")


def test_the_scene_in_a_given_folder_is_suggested(tmp_path):
    (tmp_path / "scene.toml").write_text(scene_text("milling"))
    with pytest.raises(InputError, match=r"Use .*scene.toml$"):
        load_scene(tmp_path)


@pytest.mark.parametrize("key", ["density_scale", "density_kg_m3"])
def test_the_density_of_an_image_is_scaled_by_another_import(key):
    anatomy = {"kind": "bone", "file": "bone.ply", "density_file": "density.nrrd"}
    with pytest.raises(InputError, match="Import the CT again with --density line:SLOPE,OFFSET"):
        load_scene("milling", {"anatomy": anatomy | {key: 1.2}})


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        (
            "molar",
            "centre_mm = [1.0, 2.0, 3.0]",
            r"anatomy\.centre_mm must be left out for a molar\. Remove anatomy\.centre_mm$",
        ),
        (
            "molar",
            "curvature_radius_mm = 40.0",
            r"anatomy\.curvature_radius_mm must be left out for a molar\. Remove anatomy\.curv",
        ),
        ("molar", "caries_diameter_mm = 4.0", "without anatomy.caries_depth_mm"),
        (
            "glenoid",
            "pulp_roof_mm = 4.0",
            "Set anatomy.kind = molar, or remove anatomy.pulp_roof_mm$",
        ),
    ],
)
def test_a_key_added_to_the_scene_of_a_run_is_refused_if_it_has_no_effect(
    name, line, message, tmp_path
):
    scene = load_scene(name)
    path = tmp_path / "scene.toml"
    path.write_text(saved_text(scene).replace("[anatomy]\n", f"[anatomy]\n{line}\n"), "utf-8")
    with pytest.raises(InputError, match=message):
        load_scene(path)
    # Runs of format 1 saved such keys themselves.
    path.write_text(path.read_text("utf-8").replace("format = 2", "format = 1"), "utf-8")
    assert load_scene(path) == scene
