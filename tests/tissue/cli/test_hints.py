"""Suggestions for unknown keys, options and attributes, by spelling and by meaning."""

import inspect
import pickle
import pydoc
import re
from pathlib import Path
from types import ModuleType

import pytest

import tissue
from meshes.base.hints import closest
from tissue import InputError
from tissue.scene.coupling import Coupling
from tissue.scene.tool import Tool

ROOT = Path(tissue.__file__).parent


def refusal(scene, key, value=1.0):
    """Return the message for a key of a scene."""
    with pytest.raises(InputError) as refused:
        tissue.load_scene(scene, {key: value})
    return str(refused.value)


@pytest.mark.parametrize(
    ("call", "given", "meant"),
    [
        (tissue.simulate, "overwite", "overwrite"),
        (tissue.load_scene, "override", "overrides"),
        (tissue.feed_along, "feed", "feed_mm_s"),
        (tissue.cutters.ball_burr, "flute", "flutes"),
    ],
)
def test_an_unknown_argument_is_refused_with_a_suggestion(call, given, meant):
    with pytest.raises(TypeError, match=rf"{given!r} \(did you mean {meant}\?\)\. It takes"):
        call(**{given: 1})


def public_callables():
    """Yield the name of each public function and method that takes named arguments, and itself."""
    for title in tissue.__all__:
        value = getattr(tissue, title)
        held = {title: value}
        if isinstance(value, ModuleType):
            held = {f"{title}.{name}": getattr(value, name) for name in value.__all__}
        for name, each in held.items():
            members = {name: each}
            if isinstance(each, type):
                members = {
                    f"{name}.{member}": getattr(each, member)
                    for member in dir(each)
                    if not member.startswith("_")
                }
            for member, function in members.items():
                origin = getattr(function, "__module__", None) or ""
                if inspect.isroutine(function) and origin.startswith(("tissue", "meshes")):
                    kinds = {one.kind for one in inspect.signature(function).parameters.values()}
                    if inspect.Parameter.VAR_KEYWORD not in kinds:
                        yield member, function


def test_all_public_functions_and_methods_refuse_unknown_arguments_with_their_own():
    seen = dict(public_callables())
    assert {"fit", "Bone.cut", "Run.save", "Organ.press", "register.tool", "study.run"} <= {*seen}
    for name, function in seen.items():
        with pytest.raises(TypeError, match=r"unexpected keyword argument 'misspelt'.* It takes"):
            function(misspelt=1)
        assert function.__name__ in name
    with pytest.raises(TypeError, match="did you mean diameter_mm"):
        tissue.ball(diamter_mm=3)
    assert pickle.loads(pickle.dumps(tissue.fit)) is tissue.fit


@pytest.mark.parametrize(
    ("scene", "key", "meant"),
    [
        ("glenoid", "spin_rpm", "tool.spin_rpm"),
        ("glenoid", "tool.rpm", "spin_rpm"),
        ("glenoid", "tool.radius_mm", "diameter_mm"),
        ("glenoid", "voxels.size_mm", "spacing_mm"),
        ("glenoid", "voxel_mm", "voxels.spacing_mm"),
        ("glenoid", "resolution_mm", "voxels.spacing_mm"),
        ("glenoid", "motion.speed", "feed_mm_s"),
        ("milling", "feed_mm_s", "motion.feed_mm_s"),
        ("liver-press", "organ.stiffness_kPa", "young_kPa"),
        ("wall", "latency_ms", "device.coupling.delay_ms"),
        ("wall", "method", "device.prediction"),
        ("wall", "coupling.stifness", "stiffness_N_m or stiffness_Nm_rad"),
        ("wall", "coupling.stifness_N_m", "stiffness_N_m"),
        ("wall", "coupling.stifness_Nm_rad", "stiffness_Nm_rad"),
        ("wall", "anatomy.stiffness", "stiffness_kN_m"),
        ("incision", "motion.feed_mms", "feed_mm_s"),
    ],
)
def test_keys_are_suggested_by_meaning(scene, key, meant):
    assert f"(did you mean {meant}?)" in refusal(scene, key)


@pytest.mark.parametrize(
    "key", ["motion.feed_mm_s", "motion.feed", "feed_mm_s", "motion.speed_mm_s"]
)
def test_a_feed_is_no_key_of_a_scene_that_is_driven_by_thrust(key):
    message = refusal("pedicle", key)
    assert "Use motion.thrust_N instead, or set motion.kind = path, or" in message
    assert "max_feed_mm_s" not in message
    assert "Use motion.feed_mm_s instead, or set" in refusal("glenoid", "motion.force_N")


def test_a_misspelt_key_of_another_tool_names_the_keys_of_the_tool():
    message = refusal("incision", "tool.lenght_mm")
    assert message == (
        "tool.lenght_mm is not a known key. The table [tool] of kind blade has the keys kind, "
        "width_mm, thickness_mm and edge_deg. Rename or remove tool.lenght_mm"
    )
    assert "(did you mean width_mm?)" in refusal("incision", "tool.widht_mm")
    message = refusal("incision", "tool.length_mm")
    assert (
        "Use a key of a blade (width_mm, thickness_mm or edge_deg), or remove tool.length_mm"
        in message
    )
    assert "Set tool.kind = cylinder-probe" in refusal("liver-press", "tool.length_mm")


def test_the_densities_of_a_vertebra_are_suggested():
    message = refusal("pedicle", "anatomy.density_kg_m3", 900.0)
    for name in ("trabecular", "pedicle", "cortical"):
        assert f"anatomy.{name}_density_kg_m3" in message
    assert "anatomy.kind" not in message


@pytest.mark.parametrize("key", ["noise", "output.colour", "cutting.energy"])
def test_no_key_is_suggested_for_another_meaning(key):
    assert "did you mean" not in refusal("glenoid", key)


@pytest.mark.parametrize("table", [Coupling, Tool])
def test_a_key_without_one_of_its_letters_is_suggested(table):
    keys = list(table.model_fields)
    for key in keys:
        for at in range(len(key)):
            assert key in closest(key[:at] + key[at + 1 :], keys)


def test_words_of_different_meaning_are_not_close():
    known = ["--out", "--compute", "--overwrite"]
    assert closest("--format", known) == [] and closest("--output", known) == ["--out"]
    assert closest("max_feed_mm_s", ["thrust_N"]) == []


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (("run", "wall", "--output", "x"), "(did you mean --out?)"),
        (("run", "wall", "--gpu"), "(did you mean --compute?)"),
        (("view", "x", "--format", "mat"), "(an option of `tissue run`"),
        (("run", "wall", "--spin-rpm", "800"), "(keys of the scene are set by --set KEY=VALUE)"),
        (("show", "x"), "(did you mean view?)"),
    ],
)
def test_options_and_commands_are_suggested_by_meaning(refused, words, hint):
    assert hint in refused(*words)


def test_attributes_are_suggested():
    with pytest.raises(AttributeError, match=r"'load' \(did you mean load_scene\?\)"):
        _ = tissue.load
    with pytest.raises(AttributeError, match=r"'__wrapped__'$"):
        _ = tissue.__wrapped__


NAMED = re.compile(r"(?:`|\b(?:use|see) )(tissue(?:\.[a-z]\w*)*\.(?:[A-Z]\w+|[a-z_]+(?=\()))")


def test_attributes_that_texts_name_exist():
    """Every ``tissue.Class`` and ``tissue.function(`` in a text of the package can be imported."""
    named = dict[str, Path]()
    for path in ROOT.rglob("*.py"):
        named |= dict.fromkeys(NAMED.findall(path.read_text("utf-8")), path.relative_to(ROOT))
    missing = {name: path for name, path in named.items() if pydoc.locate(name) is None}
    assert len(named) > 20 and missing == {}


@pytest.mark.parametrize("words", [("calibrate", "--ask", "--device"), ("devices", "--test")])
def test_commands_name_their_option_of_a_device_address(refused, words):
    message = refused(*words, "haply", "--address", "COM3")
    assert message.startswith("--address must be ws://HOST:PORT")
