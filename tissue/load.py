"""Read a scene from a built-in name or a TOML file, with overrides, or say in one sentence what is wrong."""

import difflib
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from meshes.errors import InputError
from tissue.scene import Scene

__all__ = ["load_scene", "parse_override", "scene_names", "scene_text"]


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
            f"{_nearest(name, scene_names())}: list them with `tissue scenes`"
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
        if not path.is_file():
            raise InputError(f"scene must be an existing file, got {path}: check the path or list `tissue scenes`")
        text, folder = path.read_text("utf-8"), path.parent
    else:
        text, folder = scene_text(str(source)), Path.cwd()
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"scene must be valid TOML, got {path}: {error}") from None
    scene = _validated(table).with_files_at(folder) if not overrides else None
    if scene is not None:
        return scene
    if path.suffix == ".toml":
        table = _validated(table).with_files_at(folder).model_dump(mode="json", exclude_unset=True, exclude_none=True)
    for key, value in (overrides or {}).items():
        _place(table, key, value)
    return _validated(table).with_files_at(Path.cwd())


def parse_override(text: str) -> tuple[str, Any]:
    """Key and value of ``key=value``; the value is TOML, or a string where it is not.

    Raises
    ------
    InputError
        If there is no ``=``.
    """
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise InputError(f"--set must be key=value, got {text}: for example voxels.spacing_mm=0.2")
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
            raise InputError(f"{key} must name a part's entry, got {parent} which is a value: see `tissue scenes NAME`")
        table = inner
    if last == "kind" and table.get("kind", value) != value:
        table.clear()
    table[last] = value


def _validated(table: Mapping[str, Any]) -> Scene:
    """The scene a table describes, or an InputError for its first fault."""
    try:
        return Scene.model_validate(table)
    except ValidationError as error:
        raise InputError(_sentence(error.errors(include_url=False)[0], table)) from None


def _sentence(fault: Mapping[str, Any], table: Mapping[str, Any]) -> str:
    """One sentence for one fault found by pydantic."""
    where = _without_tags(fault["loc"], table)
    key, context, got = ".".join(where), fault.get("ctx", {}), _shown(fault["input"])
    match fault["type"]:
        case "value_error":
            return str(context["error"])
        case "extra_forbidden":
            known = _known_keys(where[:-1], table)
            return f"{key} must be one of {', '.join(known)}, got {where[-1]}{_nearest(where[-1], known)}"
        case "missing":
            return f"{key} must be given, got nothing: add {where[-1]}{_example(where, table)} to the scene"
        case "literal_error" | "union_tag_invalid":
            expected = context.get("expected") or context["expected_tags"]
            choices = [c.strip("'") for c in expected.replace(" or ", ", ").split(", ")]
            value = got if fault["type"] == "literal_error" else context["tag"]
            name = key if fault["type"] == "literal_error" else f"{key}.kind"
            return f"{name} must be one of {', '.join(choices)}, got {value}{_nearest(str(value), choices)}"
        case "union_tag_not_found":
            return f"{key}.kind must be given, got nothing: see `tissue scenes NAME`"
        case _:
            requirement = fault["msg"].removeprefix("Input should be ").removeprefix("Value should ")
            return f"{key} must be {requirement}, got {got}{_remedy(where, table)}"


def _model_at(where: tuple[str, ...], table: Mapping[str, Any]) -> type[BaseModel] | None:
    """The part of a scene that holds the keys under ``where``."""
    model: type[BaseModel] = Scene
    for name in where:
        field = model.model_fields.get(name)
        if field is None:
            return None
        kinds = [k for k in getattr(field.annotation, "__args__", (field.annotation,)) if isinstance(k, type)]
        parts = [k for k in kinds if issubclass(k, BaseModel)]
        if not parts:
            return None
        inner = table.get(name, {})
        kind = inner.get("kind") if isinstance(inner, Mapping) else None
        model = next((p for p in parts if "kind" in p.model_fields and p.model_fields["kind"].default == kind), parts[0])
        table = inner if isinstance(inner, Mapping) else {}
    return model


def _known_keys(where: tuple[str, ...], table: Mapping[str, Any]) -> list[str]:
    model = _model_at(where, table)
    return list(model.model_fields) if model else []


def _without_tags(location: tuple[Any, ...], table: Mapping[str, Any]) -> tuple[str, ...]:
    """A fault's location without the names of the kinds that pydantic adds after a part."""
    kept: list[str] = []
    for index, step in enumerate(location):
        if index == 1 and kept and isinstance(table.get(kept[0]), Mapping) and table[kept[0]].get("kind") == step:
            continue
        kept.append(str(step))
    return tuple(kept)


def _field_at(where: tuple[str, ...], table: Mapping[str, Any]) -> Any:
    model = _model_at(where[:-1], table) if where else None
    return model.model_fields.get(where[-1]) if model else None


def _example(where: tuple[str, ...], table: Mapping[str, Any]) -> str:
    field = _field_at(where, table)
    return f" = {field.examples[0]:g}" if field is not None and field.examples else ""


def _remedy(where: tuple[str, ...], table: Mapping[str, Any]) -> str:
    """A value that would do: the field's example or default."""
    field = _field_at(where, table)
    if field is None:
        return ""
    value = field.examples[0] if field.examples else field.default
    return f": use {_shown(value)}" if isinstance(value, int | float | str | tuple) else ""


def _nearest(word: str, known: list[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def _shown(value: Any) -> str:
    """A value as a scene file shows it."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_shown(item) for item in value) + "]"
    return str(value)
