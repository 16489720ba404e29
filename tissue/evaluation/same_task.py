"""Data of an assessed run, and check that the run has the task of a reference run."""

import filecmp
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.text_tables import shown
from tissue.scene.load import names_file
from tissue.scene.part import entries
from tissue.scene.scene import Scene, without_fields
from tissue.scene.used_constants import used_constants
from tissue.simulation.run_folder import Summary
from tissue.simulation.trace import Table

TASK = ("anatomy", "keep_clear", "organ", "cutting", "tool")
"""Parts of a scene that define the task.

Correct forces and depths of the tool depend on these parts.
"""
MAY_DIFFER = frozenset(
    f"organ.{name}" for name in ("law_interval_ms", "order", "path", "basis_size")
) | {"keep_clear.margin_mm"}
"""Keys in the scene parts of `TASK` that may differ between runs of one task, with a note.

The organ keys belong to the numerical method. The margin of the reference run is a limit for both
runs.
"""
FREE = ("name", "description", "seed", "device", "output", "fidelity")
"""Scene keys that may differ between a trainee's run and the reference run without a note.

These keys describe the run, the user who moves the tool, and the device. Differences of the
coupling are reported by `coupling_notes`.
"""
FREE_TABLES = ("hands", "devices", "tooth")
"""Tables of constants that may differ between runs of the same task.

These are the constants of the user and the device, and constants for stress and heat that do not
change the force on the tool. All other constants of the tissue and the tool must be equal.
"""

EVENTS_OF = {
    "heat": ("K warmer than at the start", "the thermal dose of bone passes"),
    "stress": ("stress", "are cut loose and count as debris", "held as its root"),
    "keep_clear": ("came closer than", "is to be kept clear of", " mm deep, "),
}
"""Phrases of the events of each part of a scene that may be left out, keyed by the scene key.

Runs without the part cannot have these events. `tests/tissue/evaluation/test_assessment.py` checks
that the tissue models report each phrase.
"""


class OtherTaskError(InputError):
    """Error for a run whose task is not the task of the reference run.

    `difference` names the first scene key or constant that differs, with both values.
    """

    def __init__(self, difference: str) -> None:
        super().__init__(
            "run and reference",
            "be runs of the same task",
            difference,
            "run the scene of the reference",
        )
        self.difference = difference


@dataclass(frozen=True)
class AssessedRun:
    """Data of a run that an assessment needs.

    `path` is the folder of the run, or None for a run in memory.
    """

    path: Path | None
    summary: Summary
    trace: Table | None
    complete: bool
    scene: Scene | None


def require_same_task(trainee: AssessedRun, reference: AssessedRun) -> None:
    """Check that two runs have the same tissue, tool and material.

    The names of the scenes are compared only if the scene of a run is not known.
    """
    differences: list[tuple[str, str, str]] = []
    if trainee.scene is None or reference.scene is None:
        first, second = (str(each.summary.get("scene")) for each in (trainee, reference))
        differences += [("scene", first, second)] if first != second else []
    else:
        differences += [
            (key, shown(mine), shown(theirs))
            for key, mine, theirs in _differences(trainee.scene, reference.scene)
            if key.partition(".")[0] in TASK and key not in MAY_DIFFER
        ]
        differences += _different_constants(trainee, reference)
    if differences:
        key, first, second = differences[0]
        raise OtherTaskError(f"{key} = {first} in the run and {second} in the reference")


def _different_constants(
    trainee: AssessedRun, reference: AssessedRun
) -> Iterator[tuple[str, str, str]]:
    """Yield each constant of the task whose value differs between two runs, with both values."""
    first = _task_constants(trainee)
    second = _task_constants(reference)
    for name in dict.fromkeys((*first, *second)):
        if first.get(name) != second.get(name):
            yield name, shown(first.get(name, "nothing")), shown(second.get(name, "nothing"))


def _task_constants(run: AssessedRun) -> dict[str, float]:
    """Return the values of the constants that the tissue and the tool of a run use, by name."""
    if run.scene is None:
        return {}
    return {
        each.full: each.cited.value
        for each in used_constants(without_fields(run.scene), run.summary.get("layers", ()))
        if each.stated is None and each.full.partition(".")[0] not in FREE_TABLES
    }


def coupling_notes(run: AssessedRun, other: AssessedRun, name: str) -> Iterator[str]:
    """Yield a note if the motion scale or the force scale of the coupling differs between two runs.

    These scales change the motion and the force at the device; the score is computed from both. A
    run without a device has no coupling and gives no note. `name` is the name for `other` in the
    notes.
    """
    if run.scene is None or other.scene is None:
        return
    if run.scene.device is None or other.scene.device is None:
        return
    mine = run.scene.device.coupling
    theirs = other.scene.device.coupling
    scales = {
        "motion_scale": (mine.motion_scale, theirs.motion_scale),
        "force_scale": (mine.force_scale, theirs.force_scale),
    }
    # A scene may leave the choice of the force scale to the run. Runs of earlier versions do not
    # record their choice.
    if "force_scale" in run.summary and "force_scale" in other.summary:
        scales["force_scale"] = (run.summary["force_scale"], other.summary["force_scale"])
    for key, (first, second) in scales.items():
        if first != second:
            yield (
                f"coupling.{key} is {shown(first)}, and {shown(second)} in {name}: the scores of "
                "these runs are not comparable"
            )


def scene_notes(trainee: Scene | None, reference: Scene | None) -> Iterator[str]:
    """Yield a sentence for each key that differs between the scenes, except `TASK` and `FREE`."""
    if trainee is None or reference is None:
        yield "a run has no scene.toml, so tissue and tool of the runs cannot be compared"
        return
    # Another name may stand for another exercise on the same tissue, although it is no physics.
    if trainee.name != reference.name:
        yield f"the scenes have different names: trainee {trainee.name}, reference {reference.name}"
    for key, mine, theirs in _differences(trainee, reference):
        part = key.partition(".")[0]
        if part not in FREE and part != "materials" and (part not in TASK or key in MAY_DIFFER):
            yield f"the scenes differ in {key}: trainee {shown(mine)}, reference {shown(theirs)}"


def uncommon_parts(scenes: Iterable[Scene]) -> tuple[str, ...]:
    """Return the keys of `EVENTS_OF` whose part some of the scenes have, but not all."""
    found = []
    scenes = tuple(scenes)
    for key in EVENTS_OF:
        has_part = {bool(getattr(scene, key)) for scene in scenes}
        if len(has_part) > 1:
            found.append(key)
    return tuple(found)


def is_event_of(what: str, parts: Iterable[str]) -> bool:
    """Return whether an event belongs to one of the parts, which are keys of `EVENTS_OF`."""
    return any(phrase in what for part in parts for phrase in EVENTS_OF[part])


def scene_differences(*scenes: Scene) -> dict[str, tuple[object, ...]]:
    """Return the dotted keys whose values differ between scenes, with the value in each scene.

    Keys with default values are included. The value of a missing key is None.
    """
    tables = [dict(entries(tomllib.loads(scene.to_toml()))) for scene in scenes]
    keys = dict.fromkeys(key for table in tables for key in table)
    found = {key: tuple(table.get(key) for table in tables) for key in keys}
    return {key: values for key, values in found.items() if values != values[:1] * len(values)}


def _differences(one: Scene, other: Scene) -> Iterator[tuple[str, object, object]]:
    """Yield each key whose value differs between two scenes, with both values.

    Files of the same content count as equal. The times of saved fields are ignored. The value of a
    missing key is "nothing".
    """
    for key, values in scene_differences(without_fields(one), without_fields(other)).items():
        if not _same_file(key, *values):
            first, second = ("nothing" if value is None else value for value in values)
            yield key, first, second


def _same_file(key: str, one: object, other: object) -> bool:
    """Return whether the two values of a key are files with equal names and contents.

    If one of the files is not on this machine, only the names are compared. A trainee's run may
    come from another machine, on which the path of the anatomy file differs.
    """
    if not names_file(key) or not isinstance(one, str) or not isinstance(other, str):
        return False
    first = Path(one)
    second = Path(other)
    if first.name != second.name:
        return False
    return not (first.is_file() and second.is_file()) or filecmp.cmp(first, second, shallow=False)
