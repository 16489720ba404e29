"""Every key of every kind of scene.

Another value changes the results of a run, or the key is refused with one that does.
"""

import hashlib
import json

import numpy as np
import pytest
import tomli_w
from scene_kinds import kinds, write_files
from scene_values import changes, keys_of

from tissue import InputError, load_scene, simulate
from tissue.scene.load import saved_text

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
    "tool.spin_rpm": "motion.feed_mm_s must leave a tooth chips thinner than",
    "anatomy.site": "anatomy.site must not be caries for a tooth without a lesion, got caries: ",
    "materials": "materials must hold a constant that the scene rests on, got ",
}
"""Refusals of keys that only the contents of files leave without effect.

Other keys are refused with "must be left out".
"""
CLOCK = ("tick_us", "missed_deadlines", "events", "machine", "tissue", "scheduling", "machine_gaps")
"""Entries of a summary that a clock or a machine decides."""
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


def without_effect(kind, files, folder):
    """Return the keys of a kind whose other value changes nothing.

    A key refused for another reason than having no effect counts too.
    """
    table, base = kinds(files)[kind], folder / "base.toml"
    base.write_text(tomli_w.dumps(table))
    plain, found = fingerprint(load_scene(base)), []
    assert fingerprint(load_scene(base)) == plain, "a run repeats itself"
    for key in keys_of(table):
        if key in EXEMPT:
            continue
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
    keys, must, rest = message.partition(" must be left out ")
    named = keys.replace(",", " ").split()
    well_formed = must and "\n" not in message and ", got " in rest and ": " in rest
    by_data = key in BY_DATA and message.startswith(BY_DATA[key])
    return by_data or (bool(well_formed) and (key in named or key.split(".")[0] in named))


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[] if kind in QUICK else pytest.mark.slow) for kind in NAMES]
)
@pytest.mark.timeout(900)
def test_another_value_of_every_key_changes_the_run_or_is_refused(kind, files, tmp_path):
    assert without_effect(kind, files, tmp_path) == []


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
    assert motions == {"path", "thrust", "replay"} and len(anatomies) == 9 and len(tools) == 10


@pytest.mark.parametrize("kind", NAMES)
def test_a_saved_scene_is_the_same_scene_and_is_not_refused(kind, files, tmp_path):
    base = tmp_path / "base.toml"
    base.write_text(tomli_w.dumps(kinds(files)[kind]))
    scene = load_scene(base)
    (tmp_path / "saved.toml").write_text(saved_text(scene))
    assert load_scene(tmp_path / "saved.toml") == scene


def test_a_key_that_the_file_leaves_without_effect_is_refused_unless_it_is_a_default(
    files, tmp_path
):
    from tissue.simulation.builders.organ import held_mesh

    base, kept = tmp_path / "base.toml", tmp_path / "kept.toml"
    base.write_text(tomli_w.dumps(kinds(files)["liver, tetrahedra"]))
    asked = load_scene(base, {"anatomy.edge_mm": 12.0})
    kept.write_text(saved_text(load_scene(base)))
    assert "edge_mm = 20" in kept.read_text()
    place = {"path_m": np.zeros((2, 3)), "touch_edge_m": 0.02, "report": lambda what, share: None}
    with pytest.raises(
        InputError, match="edge_mm must be left out for tetrahedra from a file, got 12: "
    ):
        held_mesh(asked.anatomy, **place)
    assert held_mesh(load_scene(kept).anatomy, **place).mesh.cells.size
