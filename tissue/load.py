"""Read a scene from a built-in name or a TOML file, with overrides, or say in one sentence what is wrong."""

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from meshes.errors import InputError
from tissue.faults import nearest, sentence
from tissue.scene import Scene

__all__ = ["changed", "load_scene", "parse_override", "scene_names", "scene_text"]


def scene_names() -> list[str]:
    """Names of the built-in scenes."""
    return sorted(entry.name[:-5] for entry in files("tissue.scenes").iterdir() if entry.name.endswith(".toml"))


def scene_text(name: str) -> str:
    """TOML of a built-in scene.

    Raises
    ------
    InputError
        If there is no such scene.
    """
    if name not in scene_names():
        raise InputError(
            f"scene must be a built-in name ({', '.join(scene_names())}) or a TOML file, got {name}"
            f"{nearest(name, scene_names())}: list them with `tissue scenes`"
        )
    return files("tissue.scenes").joinpath(f"{name}.toml").read_text("utf-8")


def load_scene(source: str | Path, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Load and validate a scene.

    Parameters
    ----------
    source
        Name of a built-in scene or path of a TOML file.
    overrides
        Values by dotted key, such as ``{"voxels.spacing_mm": 0.2}``.

    Raises
    ------
    InputError
        If the scene is unknown, unreadable or invalid: one sentence that says what to change.
    """
    path = Path(source)
    if path.suffix == ".toml":
        text, folder = _read(path), path.parent
    else:
        text, folder = scene_text(str(source)), Path.cwd()
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        said = f"{error}"
        raise InputError(
            f"scene must be valid TOML, got {said[:1].lower()}{said[1:]} in {path}: mend it there"
        ) from None
    for part, name in (("anatomy", "file"), ("motion", "file"), ("tool", "file"), ("coupling", "predictor_file")):
        inner = table.get(part)
        if isinstance(inner, dict) and isinstance(inner.get(name), str) and inner[name]:
            inner[name] = str((folder / inner[name]).resolve())
    if isinstance(person := table.get("perception"), str) and person.startswith("observer:"):
        table["perception"] = f"observer:{(folder / person.removeprefix('observer:')).resolve()}"
    # A new kind starts its part afresh, so kinds go first, in whatever order they were given.
    for key, value in sorted((overrides or {}).items(), key=lambda item: not item[0].endswith(".kind")):
        _place(table, key, value)
    return _validated(table).with_files_at(Path.cwd())


def changed(scene: Scene, overrides: Mapping[str, Any]) -> Scene:
    """A scene with other values by dotted key; None takes an entry back to its default.

    Raises
    ------
    InputError
        If the changed scene is invalid.
    """
    table = scene.model_dump(exclude_unset=True)
    for key, value in overrides.items():
        _place(table, key, value)
    return _validated(_without_nothing(table))


def _without_nothing(table: Mapping[str, Any]) -> dict[str, Any]:
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
        said = (error.strerror or "an error").lower()
        raise InputError(f"scene must be readable, got {said} at {path}: check who may read it") from None


def parse_override(text: str, *, option: str = "--set", example: str = "voxels.spacing_mm=0.2") -> tuple[str, Any]:
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
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value


def _place(table: dict[str, Any], key: str, value: Any) -> None:
    """Set a dotted key in nested tables; a new kind of a part starts that part afresh."""
    *parents, last = key.split(".")
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


def _validated(table: Mapping[str, Any]) -> Scene:
    """The scene a table describes, or an InputError for its first fault."""
    try:
        return Scene.model_validate(table)
    except ValidationError as error:
        raise InputError(sentence(error.errors(include_url=False)[0], table)) from None
