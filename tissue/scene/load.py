"""Read a scene from a built-in name or a TOML file, with overrides, or raise one sentence on what is wrong."""

import tomllib
from collections.abc import Mapping
from copy import deepcopy
from importlib.resources import files
from pathlib import Path

from pydantic import BaseModel, ValidationError

from meshes.base.errors import InputError
from meshes.base.file_version import package_version, require_version
from meshes.base.text_tables import DEEPEST, read_toml, require_shallow
from tissue.scene.messages import sentence
from tissue.scene.named_parts import nearest, shown
from tissue.scene.plugins import refusal
from tissue.scene.registry import PERCEPTIONS, SCENES
from tissue.scene.scene import PARTS_WITH_FILES, Scene, is_file_key
from tissue.scene.unused_keys import refused_keys, require_used

__all__ = ["changed", "library_names", "load_scene", "parse_override", "saved_text", "scene_names", "scene_text"]

FORMAT = 1
"""Version of a scene's file; one that states none is of the first."""
KEPT = {"description", "seed", "voxels", "output", "device", "hand", "renderer"}
"""What every scene that a run kept held before its file stated its version: every default."""
REMOVED = {"organ": {"law_method": "offset", "law_basis_size": 40, "law_sampling_error": 0.02}}
"""Keys of version 0.2 that are gone, with their defaults, by the part of a scene that held them."""


def library_names() -> list[str]:
    """Names of the built-in scenes."""
    return sorted(entry.name[:-5] for entry in files("tissue.scene.library").iterdir() if entry.name.endswith(".toml"))


def scene_names() -> list[str]:
    """Names of the built-in scenes, and of those that were registered or that installed packages offer."""
    return sorted({*library_names(), *SCENES})


def scene_text(name: str) -> str:
    """TOML of a scene that has a name.

    Raises
    ------
    InputError
        If there is no such scene.
    """
    if name in library_names():
        return files("tissue.scene.library").joinpath(f"{name}.toml").read_text("utf-8")
    if name in SCENES:
        return _read(SCENES[name])
    raise InputError(
        refusal(SCENES.group, name)
        or f"scene must be a built-in name ({', '.join(scene_names())}) or a TOML file, got {name}"
        f"{nearest(name, scene_names())}: list them with `tissue scenes`"
    )


def load_scene(source: str | Path, overrides: Mapping[str, object] | None = None, *, live: bool = False) -> Scene:
    """Load and validate a scene.

    Parameters
    ----------
    source
        Name of a scene, see `scene_names`, or path of a TOML file.
    overrides
        Values by dotted key, such as ``{"voxels.spacing_mm": 0.2}``. What one of them makes of no effect is left out.
    live
        Whether a mouse replaces the device of a scene without one.

    Raises
    ------
    InputError
        If a key has no effect in the scene, or the scene is unknown, unreadable or invalid: a sentence on what
        to change.
    """
    path = Path(source)
    if path.suffix == ".toml":
        text, folder = _read(path), path.parent
    else:
        text, folder = scene_text(str(source)), Path.cwd()
        if str(source) in SCENES.known:
            path = SCENES[str(source)]
            folder = path.parent
    try:
        table = read_toml(text)
    except tomllib.TOMLDecodeError as error:
        message = f"{error}"
        raise InputError(
            f"scene must be valid TOML, got {message[:1].lower()}{message[1:]} in {path}: mend it there"
        ) from None
    _require_no_nul(table)
    kept = "tissue" in table or ("format" not in table and table.keys() >= KEPT)
    written = {"format": 1} | {name: table.pop(name) for name in ("format", "tissue") if name in table}
    require_version("scene", written, FORMAT, where=path, remedy="leave format out")
    if kept:
        _drop_removed(table)
        table = _without_defaults(table)
    for part in PARTS_WITH_FILES:
        inner = table.get(part)
        if not isinstance(inner, dict):
            continue
        for name, value in inner.items():
            if is_file_key(name) and isinstance(value, str) and value:
                inner[name] = str((folder / value).resolve())
    clear = table.get("keep_clear")
    if isinstance(clear, dict) and isinstance(files := clear.get("files"), dict):
        clear["files"] = {k: str((folder / v).resolve()) if isinstance(v, str) else v for k, v in files.items()}
    if isinstance(given := table.get("materials"), str) and given:
        table["materials"] = str((folder / given).resolve())
    if isinstance(person := table.get("perception"), str):
        table["perception"] = PERCEPTIONS.with_file_at(person, folder)
    scene = _replaced(table, overrides or {})
    require_used(scene.model_copy(update={"device": "touch"}) if live and scene.device == "none" else scene)
    return scene.with_files_at(Path.cwd())


def saved_text(scene: Scene) -> str:
    """TOML of a scene as a run keeps it, with the versions of its format and of tissue."""
    return f'format = {FORMAT}\ntissue = "{package_version()}"\n{scene.to_toml()}'


def changed(scene: Scene, overrides: Mapping[str, object]) -> Scene:
    """A scene with other values by dotted key; None takes an entry back to its default.

    Raises
    ------
    InputError
        If the changed scene is invalid.
    """
    return _replaced(scene.model_dump(exclude_unset=True), overrides)


def _replaced(table: dict[str, object], overrides: Mapping[str, object]) -> Scene:
    """The scene of a table with other values by dotted key, without what only they make of no effect.

    A file's own key that has no effect even without them stays, and so does one of theirs: both are faults.
    """
    try:
        require_shallow(dict(overrides))
    except RecursionError:
        raise InputError(f"values must not nest more than {DEEPEST} lists, got more: write the value plainly") from None
    _require_no_nul(overrides)
    faults = _table_faults(table) if overrides else None
    placed = deepcopy(table)
    # A new kind starts its part afresh, so kinds go first, in whatever order they were given.
    for key, value in sorted(overrides.items(), key=lambda item: not item[0].endswith(".kind")):
        _place(placed, key, value)
    scene = _validated(placed)
    if faults is None:
        return scene
    for key in set(refused_keys(scene)) - faults:
        if not any(key == asked or key.startswith(f"{asked}.") or asked.startswith(f"{key}.") for asked in overrides):
            _drop(placed, key)
    return _validated(placed)


def _table_faults(table: Mapping[str, object]) -> set[str] | None:
    """Keys of a table by itself that have no effect; None where it is no scene yet, so that nothing is known."""
    try:
        return set(refused_keys(_validated(table)))
    except InputError:
        return None


def _require_no_nul(value: object, key: str = "") -> None:
    """Refuse texts with the character NUL, which no name of a file can hold."""
    if isinstance(value, str) and "\0" in value:
        raise InputError(f"{key} must be a text without the character NUL, got {shown(value)}: leave it out")
    if isinstance(value, Mapping):
        for name, inner in value.items():
            _require_no_nul(inner, f"{key}.{name}" if key else str(name))
    if isinstance(value, list | tuple):
        for inner in value:
            _require_no_nul(inner, key)


def _drop(table: dict[str, object], key: str) -> None:
    """Take a dotted key out of nested tables."""
    part, _, name = key.partition(".")
    inner = table.get(part)
    if name and isinstance(inner, dict):
        inner.pop(name, None)
    else:
        table.pop(part, None)


def _drop_removed(table: Mapping[str, object]) -> None:
    """Drop keys that version 0.2 had and wrote, where they have the value by which they had no effect."""
    for part, keys in REMOVED.items():
        inner = table.get(part)
        if isinstance(inner, dict):
            for name, default in keys.items():
                if inner.get(name) == default:
                    del inner[name]


def _without_defaults(table: dict[str, object]) -> dict[str, object]:
    """A scene's table without entries at their defaults: a run keeps all, but nobody asked for those without effect."""
    try:
        scene = _validated(table)
    except InputError:
        return table  # its fault is raised when the scene is made
    return _chosen_entries(table, scene)


def _chosen_entries(table: Mapping[str, object], model: BaseModel) -> dict[str, object]:
    """Entries of a part other than its defaults, and its kind."""
    found: dict[str, object] = {}
    for name, entry in table.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel) and isinstance(entry, dict):
            found[name] = _chosen_entries(entry, value)
        elif name == "kind" or value != type(model).model_fields[name].default:
            found[name] = entry
    return found


def _without_nothing(table: Mapping[str, object]) -> dict[str, object]:
    """A table without entries that are None."""
    inner = {k: _without_nothing(v) if isinstance(v, dict) else v for k, v in table.items()}
    return {k: v for k, v in inner.items() if v is not None}


def _read(path: Path) -> str:
    """Text of a scene file."""
    if not path.is_file():
        raise InputError(f"scene must be an existing file, got {path}: check the path or list `tissue scenes`")
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"scene must be TOML in UTF-8, got other bytes in {path}: save it as text") from None
    except OSError as error:
        message = (error.strerror or "an error").lower()
        raise InputError(f"scene must be readable, got {message} at {path}: check who may read it") from None


def parse_override(text: str, *, option: str = "--set", example: str = "voxels.spacing_mm=0.2") -> tuple[str, object]:
    """Key and value of ``key=value``, as an option is given it; the value is TOML, or a string where it is not.

    Raises
    ------
    InputError
        If there is no ``=``.
    """
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise InputError(f"{option} must be key=value, got {text}: use for example {example}")
    try:
        return key.strip(), read_toml(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value


def _place(table: dict[str, object], key: str, value: object) -> None:
    """Set a dotted key in nested tables; a new kind of a part starts that part afresh."""
    *parents, last = key.split(".")
    if len(parents) > DEEPEST:
        raise InputError(
            f"{shown(key)} must name an entry of a part, got {len(parents)} dots: see `tissue scenes NAME`"
        )
    for parent in parents:
        inner = table.setdefault(parent, {})
        if not isinstance(inner, dict):
            raise InputError(
                f"{key} must name an entry of a part, got {parent}, which is a value: see `tissue scenes NAME`"
            )
        table = inner
    if last == "kind" and table.get("kind", value) != value:
        table.clear()
    table[last] = value


def _validated(table: Mapping[str, object]) -> Scene:
    """The scene a table describes, or an InputError for its first fault."""
    table = _without_nothing(table)
    try:
        return Scene.model_validate(table)
    except ValidationError as error:
        raise InputError(sentence(error.errors(include_url=False)[0], table)) from None
