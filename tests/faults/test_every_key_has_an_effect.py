"""Every key of every kind of scene.

Another value changes the results of a run, or the key is refused with one that does.
"""

import hashlib
import json
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
import pytest
import tomli_w
from annotated_types import Ge, Gt, Le, Lt
from scene_kinds import kinds, write_files

from tissue import InputError, load_scene, simulate
from tissue.scene.anatomy import Part
from tissue.scene.coupling import Fidelity
from tissue.scene.load import saved_text
from tissue.scene.messages import choices_of
from tissue.scene.scene import KeepClear, Scene, Stress

VALUES = {
    "device.coupling.force_scale": 0.5,
    "device.coupling.stiffness_N_m": 300.0,
    "name": "needle",
    "voxels.spacing_mm": 0.2,
    "voxels.margin_mm": 4.0,
    "device.perception": "population",
    "anatomy.centre_mm": [13.0, 8.0, 6.0],
    "tool.spin_rpm": 900.0,
    "tool.peg_diameter_mm": 2.0,
    "organ.friction": 0.05,
    "anatomy.along": [0.6, 0.8, 0.0],
    "stress.cell_mm": 1.0,
    "anatomy.membrane_depths_mm": {"vessel wall": 5.0, "far wall": 9.0},
    "anatomy.membrane_punctures_N": {"far wall": 0.9},
    "anatomy.membrane_holds_N": {"far wall": 0.4},
}
"""Values that fit every kind and reach something there."""


OPTIONAL = {"stress": Stress, "fidelity": Fidelity, "keep_clear": KeepClear}


LAYERS = ("enamel", "dentin", "pulp", "ligament")


def keys_of(table: dict[str, Any]) -> list[str]:
    """Every dotted key that a scene of this kind can be given, kinds of its parts left out."""
    return _keys(Scene.model_validate(table))


def _keys(part: Part, prefix: str = "") -> list[str]:
    """Dotted keys of a table and of those inside of it."""
    found = []
    for name in type(part).model_fields:
        value, key = getattr(part, name), f"{prefix}{name}"
        if isinstance(value, Part):
            found += _keys(value, f"{key}.")
        elif key in OPTIONAL:
            found += [f"{key}.{each}" for each in OPTIONAL[key].model_fields]
        elif name != "kind":
            found.append(key)
    return found + ["device"] * (prefix == "")


def changes(table: dict[str, Any], key: str, files: dict[str, str]) -> dict[str, Any]:
    """Return another valid value of a key, and the changes that a file of its kind needs."""
    part, _, name = key.partition(".")
    if key in ("anatomy.density_file", "anatomy.core_file"):
        return {key: files[f"other {name.removesuffix('_file')}"]}
    if part == "anatomy" and name.endswith("_file"):
        layers = {f"anatomy.{layer}_file": files[layer] for layer in LAYERS}
        return layers | {key: files[f"other {name.removesuffix('_file')}"]}
    if key == "anatomy.file":
        # Labels name neither ligament nor bone, so that no stress could be computed.
        return _other_anatomy(table["anatomy"], files) | (
            {"stress": None} if "stress" in table else {}
        )
    if key == "anatomy.nodule_diameter_mm":
        liver = table["anatomy"]["kind"] == "liver"
        diameter, centre = (37.0, [-15.0, -5.0, -60.0]) if liver else (13.0, [0.0, 0.0, -13.0])
        return {key: diameter, "anatomy.nodule_centre_mm": centre}  # a centre alone has no effect
    if key == "keep_clear.margin_mm":
        return {key: 0.3, "keep_clear.files": {"canal": files["finger"]}}  # a margin needs one
    named: dict[str, Any] = {
        "device": "omni" if "device" in table else "touch",  # a tool that stands still needs one
        "keep_clear.names": ["pulp" if table["anatomy"]["kind"] == "molar" else "canal"],
        "keep_clear.files": {"canal": files["finger"]},
        "tool.file": files["other finger"],
        "motion.file": files["other poses"],
        "device.coupling.predictor_file": files["other predictor"],
        "materials": files["materials"],
        "anatomy.held_part": "2",
        "organ.law": "linear" if "law" in table.get("organ", {}) else "neo-hookean",
        "organ.parts": {part_of(table["anatomy"]): 70.0},
        "anatomy.spacing_mm": 0.3 if table["anatomy"]["kind"] == "molar" else 0.9,
        "anatomy.edge_mm": 0.85 * table["anatomy"].get("edge_mm", 20.0),
    }
    if "density_file" in table["anatomy"]:
        named["anatomy.scale_mm"] = 1.02  # the density has to go on fitting
    if table["anatomy"]["kind"] == "liver":
        named["anatomy.centre_mm"] = [6.0, 3.0, 30.0]
    if "stress" in table:
        named["voxels.spacing_mm"] = 0.125
    return {key: named[key] if key in named else another(table, key)}


def part_of(anatomy: dict[str, Any]) -> str:
    """Name of a part that an organ has, or of the ball that it could have."""
    file = anatomy.get("file", "")
    return "1" if file.endswith(".vtu") else "body" if file else "nodule"


def _other_anatomy(anatomy: dict[str, Any], files: dict[str, str]) -> dict[str, Any]:
    """Return another file of the kind that an anatomy has or could have.

    The result includes its placement where it needs one.
    """
    kind = {
        "block": "bone",
        "bone": "bone",
        "vertebra": "bone",
        "glenoid": "bone",
        "molar": "labels",
        "liver": "organ",
    }[anatomy["kind"]]
    if kind == "bone" and anatomy.get("file", "").endswith(".vti"):
        kind = "image"
    if kind == "organ" and anatomy.get("file", "").endswith(".vtu"):
        kind = "tets"
    found: dict[str, Any] = {"anatomy.file": files[f"other {kind}"]}
    if kind == "bone" and "file" not in anatomy:
        found |= {"anatomy.centre_mm": [0.0, 0.0, 7.0], "anatomy.normal": [0.0, 0.0, 1.0]}
    return found


def another(table: dict[str, Any], key: str) -> Any:
    """Another valid value of a key, from its type, its bounds and the value that it has."""
    if key in VALUES:
        return VALUES[key]
    *parents, name = key.split(".")
    scene = Scene.model_validate(table)
    part: Any = scene
    for parent in parents:
        part = getattr(part, parent)
    if part is None:
        part = {"stress": Stress(), "fidelity": Fidelity(force_error=0.05)}[parents[0]]
    field, value = type(part).model_fields[name], getattr(part, name)
    kind = _plain(field.annotation)
    if value is None:
        value = field.examples[0] if field.examples else None
        if kind is not float and value is not None and kind is not int:
            return _listed(value)
    if choices := choices_of(field):
        other = next(choice for choice in choices if choice != str(value))
        return int(other) if isinstance(value, int) else other
    if kind is bool:
        return not value
    if kind in (float, int):
        return _moved(value, kind, field.metadata)
    if name == "points_mm":
        return [[1.1 * each for each in point] for point in value]
    if isinstance(value, tuple):
        return [1.1 * each + 0.1 * (i + 1) for i, each in enumerate(value)]
    return f"{value}-other"


def _moved(value: Any, kind: type, metadata: list[Any]) -> Any:
    """A number that differs from a value and keeps its bounds."""
    low = max(
        [each.ge for each in metadata if isinstance(each, Ge)]
        + [each.gt for each in metadata if isinstance(each, Gt)],
        default=-1e9,
    )
    high = min(
        [each.le for each in metadata if isinstance(each, Le)]
        + [each.lt for each in metadata if isinstance(each, Lt)],
        default=1e9,
    )
    number = value if value is not None else 0.5 * (low + high)
    for moved in (1.5 * number, 0.7 * number, number + 0.3, number + 1, low + 0.4 * (high - low)):
        moved = round(moved) if kind is int else float(moved)
        if low < moved < high and moved != value:
            return moved
    raise AssertionError(f"no other value between {low} and {high}")


def _plain(annotation: Any) -> Any:
    """Return the type that an annotation allows in addition to None."""
    if get_origin(annotation) is Annotated:
        return _plain(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return _plain(next(each for each in get_args(annotation) if each is not type(None)))
    return annotation


def _listed(value: Any) -> Any:
    """A value as TOML has it."""
    return [_listed(each) for each in value] if isinstance(value, tuple) else value


FILES = (
    "bone",
    "density",
    "core",
    "image",
    "enamel",
    "dentin",
    "pulp",
    "ligament",
    "labels",
    "tets",
    "organ",
    "finger",
    "poses",
)
NAMES = sorted(kinds(dict.fromkeys(FILES, "")))
EXEMPT = {
    "description": "it describes the scene to people, and is kept in scene.toml",
    "fidelity.force_error": "it is measured on the machine, in minutes: tests/tissue/evaluation/test_charts.py",
    "fidelity.tick_ms": "the same",
}
BY_DATA = {
    "tool.spin_rpm": "motion.feed_mm_s must keep the chips of each tooth thinner than",
    "anatomy.site": "anatomy.site must not be caries for a tooth without a lesion, got caries. ",
    "keep_clear.names": "keep_clear.names must be left out, because the anatomy has no structures",
    "materials": "materials must contain a constant that the scene uses, got only ",
}
"""Refusals of keys that only the contents of files leave without effect.

Other keys are refused with "must be left out" or "must not be combined".
"""
CLOCK = ("tick_us", "missed_deadlines", "events", "machine", "tissue", "scheduling", "machine_gaps")
"""Entries of a summary that a clock or a machine decides."""
CLOCK_OF_LAW = ("solve_ms", "offset_older_than_interval")
"""Entries of a hyperelastic law that a clock decides."""
REPEATED = ("wall", "wall by hand", "block", "molar, stress", "slab, law", "needle", "incision")
"""Kinds of which two equal runs are compared: one for each kind of tissue."""
QUICK = ("wall",)
"""Kinds that the plain run walks through; the others take seconds each, and go to the slow set."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_files(tmp_path_factory.mktemp("files"))


@pytest.fixture(autouse=True)
def stress_in_this_process(monkeypatch):
    """A process of its own takes seconds to start and computes the same."""
    from tissue.models.tooth import stress_process

    monkeypatch.setattr(stress_process, "StressProcess", stress_process.InlineStressSolver)


def fingerprint(scene):
    """Return a digest of all results of a run.

    Times, events, which contain times, and the machine are left out.
    """
    from tissue.show.figures.tool_mesh import tool_surface

    run = simulate(scene)
    figures_of_run = {k: v for k, v in run.summary.items() if k not in CLOCK}
    if law := figures_of_run.get("law"):
        figures_of_run["law"] = {k: v for k, v in law.items() if k not in CLOCK_OF_LAW}
    digest = hashlib.blake2b(json.dumps(figures_of_run, sort_keys=True, default=str).encode())
    arrays = [run.trace.rows, tool_surface(scene.tool).points]
    if (volume := run.parts.volume) is not None:
        arrays += [
            volume.origin_m,
            np.float64(volume.spacing_m),
            volume.fraction,
            volume.layer,
            volume.density_kg_m3,
        ]
    series = getattr(run.parts.tissue, "fields", None)
    for frame in series.frames if series is not None else ():
        arrays += [frame.points[name] for name in sorted(frame.points)]
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()


def signature(table, key):
    """Return what decides the effect of a key: the kind of its part and of what the part acts on.

    Kinds of scenes that agree in the signature of a key share one check of it.
    """
    part, anatomy = key.split(".")[0], table["anatomy"]
    files = {name: file for name, file in anatomy.items() if name.endswith("file")}
    source = sorted(f"{name} {Path(file).suffix}" for name, file in files.items())
    section = table.get(part) if isinstance(table.get(part), dict) else {}
    by_hand = "device" in table
    if part in ("anatomy", "voxels", "stress", "organ", "keep_clear"):
        return key, anatomy["kind"], *source, "stress" in table, section.get("law")
    return key, section.get("kind"), by_hand


def checked_keys(files):
    """Return the keys that each kind of scene checks: those no kind before it has checked.

    The walls come first: their runs are the cheapest.
    """
    tables = kinds(files)
    seen, found = set(), {}
    for kind in sorted(tables, key=lambda kind: not kind.startswith("wall")):
        table = tables[kind]
        fresh = {key: signature(table, key) for key in keys_of(table) if key not in EXEMPT}
        found[kind] = [key for key, each in fresh.items() if each not in seen]
        seen |= set(fresh.values())
    return found


@pytest.fixture(scope="module")
def checked(files):
    """Keys that each kind of scene checks."""
    return checked_keys(files)


def without_effect(kind, keys, files, folder):
    """Return the keys that a kind checks whose other value changes nothing.

    A key refused for another reason than having no effect counts too.
    """
    table, base = kinds(files)[kind], folder / "base.toml"
    base.write_text(tomli_w.dumps(table))
    if not keys:
        return []
    plain, found = fingerprint(load_scene(base)), []
    if kind in REPEATED:
        assert fingerprint(load_scene(base)) == plain, "a run repeats itself"
    for key in keys:
        values = changes(table, key, files)
        try:
            if fingerprint(load_scene(base, values)) == plain:
                found.append(f"{values} changes nothing")
        except InputError as refusal:
            if not is_refused(key, str(refusal)):
                found.append(f"{values}: {refusal}")
    return found


def is_refused(key, message):
    """Return True if a refusal reports that a key, or its whole table, has no effect."""
    combined = " must not be combined, got "
    keys, must, rest = message.partition(combined if combined in message else " must be left out ")
    named = keys.replace(",", " ").split()
    well_formed = must and "\n" not in message and ". " in rest
    by_data = key in BY_DATA and message.startswith(BY_DATA[key])
    return by_data or (bool(well_formed) and (key in named or key.split(".")[0] in named))


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[] if kind in QUICK else pytest.mark.slow) for kind in NAMES]
)
@pytest.mark.timeout(900)
def test_another_value_of_every_key_changes_the_run_or_is_refused(kind, checked, files, tmp_path):
    assert without_effect(kind, checked[kind], files, tmp_path) == []


def test_every_kind_of_scene_is_walked_through():
    from tissue import scene_names

    made = kinds(dict.fromkeys(FILES, "x.stl"))
    anatomies = {table["anatomy"]["kind"] for table in made.values()}
    tools = {table["tool"]["kind"] for table in made.values()}
    motions = {table["motion"]["kind"] for table in made.values()}
    for name in scene_names():
        scene = load_scene(name)
        assert (
            scene.anatomy.kind in anatomies
            and scene.tool.kind in tools
            and scene.motion.kind in motions
        )
    assert motions == {"path", "thrust", "replay"} and len(anatomies) == 10 and len(tools) == 11


@pytest.mark.parametrize("kind", NAMES)
def test_a_saved_scene_is_the_same_scene_and_is_not_refused(kind, files, tmp_path):
    base = tmp_path / "base.toml"
    base.write_text(tomli_w.dumps(kinds(files)[kind]))
    scene = load_scene(base)
    (tmp_path / "saved.toml").write_text(saved_text(scene))
    assert load_scene(tmp_path / "saved.toml") == scene
