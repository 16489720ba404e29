"""Checks that two runs are of one task, so that an assessment between them is meaningful."""

import filecmp
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

from meshes.base.errors import InputError
from tissue.scene.named_parts import shown
from tissue.scene.part import is_file_key
from tissue.scene.scene import Scene
from tissue.simulation.run_folder import Summary

__all__ = ["path_note", "require_same_task", "scene_notes"]

TASK = ("anatomy", "keep_clear", "organ", "cutting", "tool")
"""Parts of a scene that make the task: in another tissue or with another tool, other forces and
depths are right.
"""
NUMERICAL = frozenset(
    f"organ.{name}"
    for name in ("law_interval_ms", "law_edge_ratio", "order", "path", "basis_size", "interval_ms")
)
"""Keys of these parts that change the computation and not the task."""
FREE = ("name", "description", "seed", "device", "output", "fidelity")
"""Keys that may differ between a trainee and a reference without a note.

They describe the user who moves the tool, and the device.
"""


def require_same_task(trainee: Scene | None, reference: Scene | None) -> None:
    """Check that two scenes have the same tissue and the same tool.

    Raises
    ------
    InputError
        If they differ. The message names the first different key.
    """
    if trainee is None or reference is None:
        return
    for key, mine, theirs in _differences(trainee, reference):
        if key.partition(".")[0] in TASK and key not in NUMERICAL:
            raise InputError(
                "run and reference",
                "be of one task",
                f"{key} = {shown(mine)} and {shown(theirs)}",
                "run the reference's scene",
            )
    if trainee.constants.key != reference.constants.key:
        raise InputError(
            "run and reference",
            "be of one material",
            (
                f"constants of {trainee.materials or 'the library'} and "
                f"{reference.materials or 'the library'}"
            ),
            "run the reference's scene",
        )


def scene_notes(trainee: Scene | None, reference: Scene | None) -> Iterator[str]:
    """Yield sentences on further differences between the two scenes."""
    if trainee is None or reference is None:
        yield "a run has no scene.toml: whether both are of one tissue and tool is not known"
        return
    for key, mine, theirs in _differences(trainee, reference):
        part = key.partition(".")[0]
        if part not in FREE and part != "materials" and (part not in TASK or key in NUMERICAL):
            yield f"the scenes differ in {key}: trainee {shown(mine)}, reference {shown(theirs)}"


def path_note(summary: Summary) -> str:
    """Return the reason why a run did not finish its path, empty for a finished path."""
    notes = summary.get("notes")
    text = str(notes.get("path", "")) if isinstance(notes, Mapping) else ""
    return text if text.startswith("not finished") else ""


def _differences(one: Scene, other: Scene) -> Iterator[tuple[str, object, object]]:
    """Yield keys of two scenes with their values where these differ, defaults included."""
    first, second = (dict(_flat(tomllib.loads(each.to_toml()))) for each in (one, other))
    for key in dict.fromkeys((*first, *second)):
        if first.get(key) != second.get(key) and not _same_file(
            key, first.get(key), second.get(key)
        ):
            yield key, first.get(key, "nothing"), second.get(key, "nothing")


def _same_file(key: str, one: object, other: object) -> bool:
    """Return whether a key names files of one name and content.

    A file that is not on this machine is compared by its name. A trainee's run may come from
    another machine with another path to the anatomy.
    """
    names_file = is_file_key(key.rpartition(".")[2]) or key.startswith("keep_clear.files.")
    if not names_file or not isinstance(one, str) or not isinstance(other, str):
        return False
    first = Path(one)
    second = Path(other)
    if first.name != second.name:
        return False
    return not (first.is_file() and second.is_file()) or filecmp.cmp(first, second, shallow=False)


def _flat(table: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
