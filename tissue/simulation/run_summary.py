"""Summary of a saved run: its version, and the entries that other code uses."""

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from meshes.base.errors import InputError, is_file
from meshes.base.file_limits import require_regular
from meshes.base.text_tables import read_json
from meshes.base.whole_file import require_version

__all__ = ["FORMAT", "Summary", "read_summary", "summary_of"]

Summary = dict[str, Any]
"""Contents of ``summary.json``, see docs/files.md."""
FORMAT = 1
"""Version of the run folder."""
STATUS = ("running", "complete", "interrupted", "failed")
AGAIN = "run the scene again"


def summary_of(folder: Path) -> Summary:
    """Return the summary of a folder unchecked; empty if it is missing or no table."""
    return _table_of(folder) or {}


def read_summary(folder: Path) -> Summary:
    """Read the summary of a run, and check its version and entries.

    Raises
    ------
    InputError
        If the folder holds no run, or the summary is damaged or of another version.
    """
    path = folder / "summary.json"
    if not is_file(path):
        raise InputError(
            "run", "be a folder that `tissue run` wrote", folder, "give for example runs/glenoid"
        )
    held = _table_of(folder)
    if not held:
        got = "something else" if held is None else "an empty one"
        raise InputError("summary.json", "be a table in JSON", f"{got} in {path}", AGAIN)
    require_version("summary.json", held, FORMAT, where=path, remedy=AGAIN)
    wanted: dict[str, bool] = {
        "scene": _is_text(held.get("scene")),
        "status": held.get("status") in STATUS,
    }
    layers = held.get("layers", [])
    wanted["layers"] = (
        isinstance(layers, list) and all(map(_is_text, layers)) and len(set(layers)) == len(layers)
    )
    events = held.get("events", [])
    wanted["events"] = isinstance(events, list) and all(
        isinstance(each, Mapping) and _is_number(each.get("time_s")) and _is_text(each.get("what"))
        for each in events
    )
    if held.get("status") == "complete":
        wanted["simulated_s"] = _is_number(held.get("simulated_s"))
        for name in ("force_N", "torque_Nm"):
            wanted[name] = isinstance(held.get(name), Mapping) and _is_number(
                held[name].get("peak")
            )
    for name, is_good in wanted.items():
        if not is_good:
            raise InputError(
                "summary.json",
                f"hold {name} as `tissue run` writes it",
                f"{str(held.get(name))[:60]} in {path}",
                AGAIN,
            )
    return held


def _table_of(folder: Path) -> Summary | None:
    """Return the summary of a folder unchecked; None if it is missing or no table."""
    try:
        held = read_json(require_regular(folder / "summary.json").read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return held if isinstance(held, dict) else None


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
