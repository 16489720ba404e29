"""Scene files of version 0.2, whose keys of the device stood at the top, in the form of today."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from meshes.base.file_version import require_version

__all__ = ["FORMAT", "OldSceneWarning", "converted", "full_key"]

FORMAT = 2
"""Version of a scene's file. A file without one is of the version that its form shows."""
OF_DEVICE = ("hand", "renderer", "prediction", "perception", "coupling", "hardware")
"""Keys of the table [device] that stood at the top of a file of version 0.2, and may be given so
as overrides.
"""
KEPT = {"description", "seed", "voxels", "output", "device", "hand", "renderer"}
"""Keys of every scene that a run kept before its file stated its version: it held all defaults."""
REMOVED = {"organ": {"law_method": "offset", "law_basis_size": 40, "law_sampling_error": 0.02}}
"""Keys of version 0.2 that are gone, with the values by which they had no effect, by the table
that held them.
"""


class OldSceneWarning(UserWarning):
    """A scene file has the form of version 0.2."""


def full_key(key: str, value: object = None) -> str:
    """Return a dotted key with the table of the device where it is given without: ``hand`` is
    ``device.hand``.
    """
    if key == "device" and not isinstance(value, Mapping) and value not in (None, "none"):
        return "device.kind"
    return f"device.{key}" if key.split(".")[0] in OF_DEVICE else key


def converted(table: dict[str, Any], path: Path) -> tuple[dict[str, Any], bool]:
    """Return the table of a scene's file in the form of today, and whether a run wrote the file.

    Raises
    ------
    InputError
        If a later version wrote it.
    """
    was_kept = "tissue" in table or ("format" not in table and table.keys() >= KEPT)
    stated = {name: table[name] for name in ("format", "tissue") if name in table}
    require_version("scene", {"format": 1} | stated, FORMAT, where=path, remedy="leave format out")
    table = {name: value for name, value in table.items() if name not in stated}
    moved = {name: table.pop(name) for name in OF_DEVICE if name in table}
    name = table.get("device")
    if isinstance(name, str) or moved:
        warnings.warn(
            f"{path.name} has the form of tissue 0.2. Its device, hand and coupling were "
            "read as a table [device]; see "
            "`tissue scenes wall` for the new form.",
            OldSceneWarning,
            stacklevel=3,
        )
        held = dict(name) if isinstance(name, Mapping) else {}
        if isinstance(name, str) and name != "none":
            held = {"kind": name}
        table.pop("device", None)
        if held or not was_kept:
            held |= moved
        if held:
            table["device"] = held
    if was_kept:
        _drop_removed(table)
    cue = table.get("enhancement")
    output = table.get("output", {})
    if isinstance(cue, dict) and cue.keys() == {"cue_N"} and isinstance(output, dict):
        table["output"] = output | table.pop("enhancement")
    return table, was_kept


def _drop_removed(table: Mapping[str, Any]) -> None:
    """Drop keys that are gone, where they have the value by which they had no effect."""
    for part, keys in REMOVED.items():
        inner = table.get(part)
        if isinstance(inner, dict):
            for name, default in keys.items():
                if inner.get(name) == default:
                    del inner[name]
