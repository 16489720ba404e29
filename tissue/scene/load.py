"""Loading of scenes by name or from TOML files, with overrides.

Files of tissue 0.2 have the keys of the table ``device`` at the top level. Such files are
converted.
"""

import tomllib
import warnings
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from meshes.base.errors import PRESENT, InputError, is_file
from meshes.base.hints import nearest, suggests_arguments
from meshes.base.text_tables import DEEPEST, read_text, read_toml, require_shallow, shown
from meshes.base.whole_file import package_version, require_version
from tissue.materials.scene_constants import Materials
from tissue.scene.messages import error_of, idle_keys
from tissue.scene.part import is_file_key, removal_of
from tissue.scene.plugins import refusal
from tissue.scene.registry import PERCEPTIONS, SCENES
from tissue.scene.scene import Scene
from tissue.scene.tool import kept_entries

FORMAT = 2
"""Version of the scene file format.

In a file without the key ``format``, the version is recognised from the other keys.
"""
FIRST_WITHOUT_IDLE_KEYS = 2
"""First file format in which a scene saved by a run contains only keys that have an effect."""
OF_DEVICE = ("hand", "renderer", "prediction", "perception", "coupling", "hardware")
"""Keys of the table ``device`` that were at the top level in tissue 0.2.

In overrides, these keys may be given without ``device.``.
"""
KEPT = {"description", "seed", "voxels", "output", "device", "hand", "renderer"}
"""Keys by which a scene file without a version is recognised as saved by a run.

Such a file contains all keys, including those with default values.
"""
REMOVED = {
    "organ": {
        "law_method": "offset",
        "law_basis_size": 40,
        "law_sampling_error": 0.02,
        "law_edge_ratio": 1.4,
    }
}
"""Keys of tissue 0.2 that no longer exist, with values that had no effect, keyed by table."""


class OldSceneWarning(UserWarning):
    """Warning about a scene file in the format of tissue 0.2."""


class DroppedKeyWarning(UserWarning):
    """Warning about scene keys that have no effect after other keys were overridden."""


def full_key(key: str, value: object = None) -> str:
    """Return the full dotted key for a short key: ``hand`` becomes ``device.hand``.

    ``device`` becomes ``device.kind`` if the value is the name of a device.
    """
    if key == "device" and not isinstance(value, Mapping) and value not in (None, "none"):
        return "device.kind"
    return f"device.{key}" if key.split(".")[0] in OF_DEVICE else key


def converted(table: dict[str, Any], path: Path) -> tuple[dict[str, Any], bool]:
    """Convert the table of a scene file to the current format.

    The second returned value is True if keys without effect are accepted, as in files that a run
    wrote. Only files up to format 1 contain such keys.

    Raises
    ------
    InputError
        If a later version wrote the file.
    """
    was_kept = "tissue" in table or ("format" not in table and table.keys() >= KEPT)
    stated = {name: table[name] for name in ("format", "tissue") if name in table}
    # Files of version 0.2 contain no version. They count as format 1.
    version = require_version(
        "scene", {"format": 1} | stated, FORMAT, where=path, remedy="remove the key format"
    )
    may_be_idle = was_kept and version < FIRST_WITHOUT_IDLE_KEYS
    table = {name: value for name, value in table.items() if name not in stated}
    moved = {name: table.pop(name) for name in OF_DEVICE if name in table}
    name = table.get("device")
    if isinstance(name, str) or moved:
        warnings.warn(
            f"{path.name} has the format of tissue 0.2. Its keys for the device, the hand and the "
            "coupling were read as a table [device]. See `tissue scenes wall` for the new format.",
            OldSceneWarning,
            # Level 4 is the caller of `load_scene`, which has a decorator.
            stacklevel=4,
        )
        held = dict(name) if isinstance(name, Mapping) else {}
        if isinstance(name, str) and name != "none":
            held = {"kind": name}
        table.pop("device", None)
        # A run of version 0.2 saved the hand even for a scene without a device, where it had no
        # effect.
        if held or not may_be_idle:
            held |= moved
        if held:
            table["device"] = held
    if was_kept:
        _drop_removed(table)
    cue = table.get("enhancement")
    output = table.get("output", {})
    if isinstance(cue, dict) and cue.keys() == {"cue_N"} and isinstance(output, dict):
        table["output"] = output | table.pop("enhancement")
    return table, may_be_idle


def _drop_removed(table: Mapping[str, Any]) -> None:
    """Remove keys that no longer exist, if their values had no effect."""
    for part, keys in REMOVED.items():
        inner = table.get(part)
        if isinstance(inner, dict):
            for name, default in keys.items():
                if inner.get(name) == default:
                    del inner[name]


PARTS_WITH_FILES = ("anatomy", "motion", "tool", "device")
"""Tables of a scene with keys that name files."""
RECORDED = "recorded"
"""Name of the device that replays a recording; its address is the path of a file."""
REPLACED_DEVICE = "touch"
"""Device of a live run if the scene names no device; the mouse replaces the real device."""


def library_names() -> list[str]:
    """Return the names of the built-in scenes."""
    return sorted(
        entry.name[:-5]
        for entry in files("tissue.scene.library").iterdir()
        if entry.name.endswith(".toml")
    )


@suggests_arguments
def scene_names() -> list[str]:
    """Return the names of all scenes: built-in, registered, and from installed packages."""
    return sorted({*library_names(), *SCENES})


@suggests_arguments
def scene_text(name: str) -> str:
    """Return the TOML text of a scene, given its name.

    Raises
    ------
    InputError
        If the scene is unknown.
    """
    if name in library_names():
        return files("tissue.scene.library").joinpath(f"{name}.toml").read_text("utf-8")
    if name in SCENES:
        return _read(SCENES[name])
    if why := refusal(SCENES.group, name):
        raise InputError(why)
    names = scene_names()
    inside = Path(name) / "scene.toml"
    remedy = f"use {inside}" if is_file(inside) else "list the names with `tissue scenes`"
    raise InputError(
        "scene",
        f"be a built-in name ({', '.join(names)}) or a TOML file",
        f"{name}{nearest(name, names)}",
        remedy,
    )


@suggests_arguments
def load_scene(
    source: str | Path, overrides: Mapping[str, object] | None = None, *, live: bool = False
) -> Scene:
    """Load and validate a scene.

    Parameters
    ----------
    source
        Name of a scene (see `scene_names`), or path of a TOML file.
    overrides
        Values that replace values of the scene, keyed by dotted key, such as
        ``{"voxels.spacing_mm": 0.2}``. Keys of the table ``device`` may be given without the name
        of the table: ``hand``, ``coupling.delay_ms``. If an override makes another scene key
        ineffective, the other key is removed and named in a warning.
    live
        True for a live run, in which the mouse moves the tool if the scene names no device.

    Raises
    ------
    InputError
        If the scene is unknown, unreadable or invalid, or if one of its keys has no effect. The
        message explains the necessary change.
    """
    path = Path(source)
    if path.suffix == ".toml":
        text = _read(path)
        folder = path.parent
    else:
        text = scene_text(str(source))
        folder = Path.cwd()
        if str(source) in SCENES.known:
            path = SCENES[str(source)]
            folder = path.parent
    table = _parsed(text, path)
    _require_no_nul(table)
    was_saved = "tissue" in table
    table, may_be_idle = converted(table, path)
    table = _absolute(table, folder)
    if may_be_idle:
        for key in _settled(table)[1]:
            _drop(table, key)
    scene, dropped = _replaced(table, overrides or {}, live=live)
    if dropped:
        # Level 3 is the caller of `load_scene`, which has a decorator.
        warnings.warn(removal_of(dropped), DroppedKeyWarning, stacklevel=3)
    # A file that cannot be used is refused here, not when the run reads its constants. The scene of
    # a saved run is loaded without this check, because its file may no longer exist.
    if scene.materials and not was_saved and not may_be_idle:
        Materials.read(scene.materials)
    return scene


def _parsed(text: str, path: Path) -> dict[str, Any]:
    try:
        return read_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            "scene", "be valid TOML", f"{path} with the error '{error}'", "fix the file"
        ) from None


def scene_table(path: Path) -> dict[str, Any]:
    """Return the content of a scene file as a table, without validation.

    Raises
    ------
    InputError
        If the file cannot be read or is not valid TOML.
    """
    return _parsed(_read(path), path)


def saved_text(scene: Scene) -> str:
    """Return a scene as TOML text, with the versions of the file format and of the package."""
    return f'format = {FORMAT}\ntissue = "{package_version()}"\n{scene.to_toml()}'


def changed(scene: Scene, overrides: Mapping[str, object]) -> Scene:
    """Return a copy of a scene with some values replaced, as `changed_scene` does."""
    return changed_scene(scene, overrides)[0]


def changed_scene(scene: Scene, overrides: Mapping[str, object]) -> tuple[Scene, set[str]]:
    """Return a copy of a scene with some values replaced, and the keys that had to be removed.

    `overrides` has the new values, keyed by dotted key. The value None resets a key to its default.

    Raises
    ------
    InputError
        If the changed scene is invalid.
    """
    return _replaced(scene.model_dump(exclude_unset=True), overrides)


def _replaced(
    table: dict[str, Any], overrides: Mapping[str, object], *, live: bool = False
) -> tuple[Scene, set[str]]:
    """Return the scene of a table after some values are replaced, and the removed keys.

    Keys of the table that an override makes ineffective are removed. An error is raised for keys
    that had no effect before, and for overrides that have no effect.
    """
    try:
        require_shallow(dict(overrides))
    except RecursionError:
        raise InputError(
            "values",
            f"not contain lists nested more than {DEEPEST} deep",
            PRESENT,
            "use fewer levels of lists",
        ) from None
    _require_no_nul(overrides)
    if not overrides:
        return _scene(table)
    before, already_idle = _settled(table)
    placed = deepcopy(table)
    full: dict[str, object] = {}
    for key, value in overrides.items():
        whole = full_key(key, value)
        if whole in full:
            other = next(each for each in overrides if full_key(each, overrides[each]) == whole)
            raise InputError(whole, "be given once", f"{other} and {key}", "remove one of the two")
        full[whole] = None if (key, value) == ("device", "none") else value
    # A new kind resets its part, so kinds are set first, whatever the order of the overrides.
    for key, value in sorted(
        full.items(), key=lambda item: item[0] != "device" and not item[0].endswith(".kind")
    ):
        _place(placed, key, _absolute(value, Path.cwd(), key))
    if (
        live
        and "device" not in table
        and full.keys() & {"seed", *(key for key in full if key.startswith("device."))}
    ):
        # The mouse replaces a device. Keys of the device need a device in the scene.
        placed["device"] = {"kind": REPLACED_DEVICE} | (placed.get("device") or {})
    if "device.hardware.address" in full:
        placed["device"] = _with_absolute_record(placed["device"], Path.cwd())
    asked = placed.get("device")
    if isinstance(asked, dict) and asked and all(value == "none" for value in asked.values()):
        del placed["device"]  # values of none alone request no device
    # If the table is invalid, the keys without effect are not known. Its own fault is raised.
    if isinstance(before, InputError):
        return _scene(placed)

    def stays(key: str) -> bool:
        return key in already_idle or any(
            key == asked or key.startswith(f"{asked}.") or asked.startswith(f"{key}.")
            for asked in full
        )

    return _scene(placed, keep=stays)


def _scene(
    table: Mapping[str, Any], keep: Callable[[str], bool] = lambda key: True
) -> tuple[Scene, set[str]]:
    """Return the scene of a table, and the removed keys.

    Keys without effect that `keep` does not accept are removed. If the table is invalid, the error
    for the first fault is raised.
    """
    found, dropped = _settled(table, keep)
    if isinstance(found, InputError):
        raise found
    return found, dropped


def _settled(
    table: Mapping[str, Any], keep: Callable[[str], bool] = lambda key: False
) -> tuple[Scene | InputError, set[str]]:
    """Remove keys that have no effect from a table; return its scene and the removed keys.

    After the removal of a key, other keys may have no effect. The table is therefore validated
    again until no key is removed. Keys that `keep` accepts are not removed. If the table is
    invalid, the error for the first fault is returned instead of a scene.
    """
    left = _without_nothing(table)
    found = set[str]()
    while True:
        try:
            return Scene.model_validate(left), found
        except ValidationError as error:
            faults = error.errors(include_url=False)
        idle = {key for fault in faults for key in idle_keys(fault, left) if not keep(key)}
        if idle <= found:
            # A misspelt required key causes two faults. The fault that names the misspelt key is
            # reported.
            first = min(faults, key=lambda fault: fault["type"] != "extra_forbidden")
            return error_of(first, left), found
        for key in idle:
            _drop(left, key)
        found |= idle


def _absolute(value: Any, folder: Path, key: str = "") -> Any:
    """Return a copy of a value or a table in which all file paths are absolute."""
    if isinstance(value, Mapping):
        found = {
            name: _absolute(each, folder, f"{key}.{name}" if key else name)
            for name, each in value.items()
        }
        return _with_absolute_record(found, folder) if key == "device" else found
    if not isinstance(value, str) or not value:
        return value
    if key == "device.perception":
        return PERCEPTIONS.with_file_at(value, folder)
    return _absolute_path(folder, value) if names_file(key) else value


def names_file(key: str) -> bool:
    """Return whether the value of a dotted key is the path of a file."""
    is_file = key.split(".")[0] in PARTS_WITH_FILES and is_file_key(key.rpartition(".")[2])
    return is_file or key == "materials" or key.startswith("keep_clear.files.")


def _with_absolute_record(device: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the table of a device; the file of a ``recorded`` device gets an absolute path."""
    hardware = device.get("hardware")
    if device.get("kind") != RECORDED or not isinstance(hardware, Mapping):
        return device
    address = hardware.get("address")
    if not isinstance(address, str) or not address:
        return device
    return device | {"hardware": {**hardware, "address": _absolute_path(folder, address)}}


def _absolute_path(folder: Path, name: str) -> str:
    """Return the absolute path of a file.

    A loop of symbolic links is not resolved; opening the file raises an error later.
    """
    try:
        return str((folder / name).resolve())
    except RuntimeError:
        return str(folder / name)


def _require_no_nul(value: object, key: str = "") -> None:
    """Raise an error if a text contains the character NUL, which file names must not contain."""
    if isinstance(value, str) and "\0" in value:
        raise InputError(
            key, "be text without the character NUL", shown(value), "remove this character"
        )
    if isinstance(value, Mapping):
        for name, inner in value.items():
            _require_no_nul(inner, f"{key}.{name}" if key else str(name))
    if isinstance(value, list | tuple):
        for inner in value:
            _require_no_nul(inner, key)


def _drop(table: dict[str, Any], key: str) -> None:
    """Remove a dotted key from nested tables."""
    *parents, last = key.split(".")
    for parent in parents:
        table = table.get(parent, {})
    table.pop(last, None)


def _without_nothing(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table without the entries that are None."""
    inner = {k: _without_nothing(v) if isinstance(v, dict) else v for k, v in table.items()}
    return {k: v for k, v in inner.items() if v is not None}


def _read(path: Path) -> str:
    """Read the text of a scene file."""
    if not is_file(path):
        raise InputError(
            "scene",
            "be an existing file",
            path,
            "check the path, or see the built-in scenes by `tissue scenes`",
        )
    try:
        return read_text(path)
    except UnicodeDecodeError:
        raise InputError(
            "scene", "be TOML in UTF-8", f"{path} with other bytes", "save the file as UTF-8 text"
        ) from None
    except OSError as error:
        message = (error.strerror or "an error").lower()
        raise InputError(
            "scene", "be readable", f"{path} ({message})", "check the permissions of the file"
        ) from None


def parse_override(
    text: str, *, option: str = "--set", example: str = "voxels.spacing_mm=0.2"
) -> tuple[str, object]:
    """Return the key and the value of a text ``key=value``.

    The value is read as TOML. If it is not valid TOML, it is used as a string.

    Raises
    ------
    InputError
        If the text contains no ``=``.
    """
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise InputError(option, "have the form key=value", text, f"use for example {example}")
    try:
        return key.strip(), read_toml(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value


def parse_overrides(texts: Iterable[str]) -> dict[str, object]:
    """Return the values of texts such as ``voxels.spacing_mm=0.2``, keyed by dotted key.

    Raises
    ------
    InputError
        If a text contains no ``=``, or two texts have the same key.
    """
    found: dict[str, object] = {}
    for text in texts:
        key, value = parse_override(text)
        if key in found:
            raise InputError("--set", "name each key once", f"{key} twice", "remove one of the two")
        found[key] = value
    return found


def _place(table: dict[str, object], key: str, value: object) -> None:
    """Set the value of a dotted key.

    A new ``kind`` removes the other keys of its table, except the keys of a cutter or a motion that
    the new kind has, too.
    """
    *parents, last = key.split(".")
    if len(parents) > DEEPEST:
        raise InputError(
            shown(key),
            "be a key of a scene",
            f"a key with {len(parents)} dots",
            "see `tissue scenes NAME`",
        )
    for parent in parents:
        inner = table[parent] = {} if table.get(parent) is None else table[parent]
        if not isinstance(inner, dict):
            raise InputError(
                key,
                "be a key of a table",
                f"the name {parent}, which is not a table",
                "see `tissue scenes NAME`",
            )
        table = inner
    # Devices of all kinds have the same keys, so a new kind of device keeps the other keys.
    if last == "kind" and parents != ["device"] and table.get("kind", value) != value:
        kept = {} if len(parents) != 1 else kept_entries(parents[0], table, value)
        table.clear()
        table.update(kept)
    table[last] = value
