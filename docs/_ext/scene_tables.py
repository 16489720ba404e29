"""Page of the scene keys, from the JSON schema of scenes.

Run: python docs/_ext/scene_tables.py

The script writes the tables of docs/scene_keys.md after the mark in that file. A test fails if the
tables are not up to date.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from tissue.scene.texts import schema_text

__all__ = ["PAGE", "Group", "Key", "Part", "anchors", "page", "parts", "unit_of"]

PAGE = Path(__file__).resolve().parents[1] / "scene_keys.md"
MARK = "<!-- Tables by docs/_ext/scene_tables.py -->\n"
"""Line of the page after which the tables begin."""
HEAD = "| key | unit | values | default | meaning |\n|---|---|---|---|---|\n"
Schema = dict[str, Any]
UNITS = {
    **{each: each for each in ("N", "kN", "kPa", "kg", "mm", "m", "ms", "rad", "rpm", "s")},
    **{"Nm": "N·m", "deg": "°", "m3": "m³", "mm2": "mm²"},
}
"""Units: spelling in the names of keys, and usual spelling."""


class Key(NamedTuple):
    """One row of a table: a key of a scene. A text is empty if there is nothing to state."""

    name: str
    unit: str
    takes: str
    default: str
    text: str


class Group(NamedTuple):
    """One table: the keys that some kinds of a part share. A part without kinds has one group."""

    kinds: tuple[str, ...]
    text: str
    keys: tuple[Key, ...]


class Part(NamedTuple):
    """A part of a scene, with the name of its TOML table. The name is empty for the top of the
    file.
    """

    name: str
    text: str
    kinds: tuple[str, ...]
    groups: tuple[Group, ...]


def parts() -> Iterator[Part]:
    """Yield every part of a scene in the order of the schema. The top of the file comes first."""
    schema = json.loads(schema_text())
    tables = {name: entry for name, entry in schema["properties"].items() if _models(schema, entry)}
    plain = {name: entry for name, entry in schema["properties"].items() if name not in tables}
    required = schema["required"]
    top = tuple(_key(name, entry, required=name in required) for name, entry in plain.items())
    yield Part("", schema["description"], (), (Group((), "", top),))
    for name, entry in tables.items():
        yield from _part(schema, name, entry)


def _part(schema: Schema, name: str, entry: Schema) -> Iterator[Part]:
    """Yield a table, and then the tables inside this table."""
    models = _models(schema, entry)
    text = entry.get("description") or models[0]["description"]
    left_out = " This table is optional." if entry.get("default", {}) is None else ""
    by_model = [_kinds(model) if len(models) > 1 else () for model in models]
    kinds = tuple(dict.fromkeys(kind for each in by_model for kind in each))
    yield Part(name, text + left_out, kinds, tuple(_groups(schema, models, by_model)))
    for model in models:
        for inner, each in model["properties"].items():
            if _models(schema, each):
                yield from _part(schema, f"{name}.{inner}", each)


def unit_of(name: str) -> str:
    """Return the unit at the end of a key's name, such as ``N/mm²`` for ``chip_N_mm2``.

    A count or a ratio has no unit, and gives an empty text.

    If a name has several units, the last unit is the denominator. This holds for all names of keys.
    """
    words, found = name.split("_"), []
    while len(words) > 1 and words[-1] in UNITS:
        found.insert(0, UNITS[words.pop()])
    return "/".join(("·".join(found[:-1]), found[-1])) if len(found) > 1 else "".join(found)


def _models(schema: Schema, entry: Schema) -> list[Schema]:
    """Return the tables that a key of the scene can be, or an empty list for a plain value."""
    choices = (entry, *entry.get("oneOf", ()), *entry.get("anyOf", ()))
    return [schema["$defs"][each["$ref"].rpartition("/")[2]] for each in choices if "$ref" in each]


def _kinds(model: Schema) -> tuple[str, ...]:
    """Return the kinds that a table describes."""
    kind = model["properties"].get("kind", {})
    return tuple(kind.get("enum") or [kind["const"]]) if "enum" in kind or "const" in kind else ()


def _groups(schema: Schema, models: list[Schema], kinds: list[tuple[str, ...]]) -> Iterator[Group]:
    """Yield the keys, grouped by the tables that have them.

    Keys that several tables share come first, at the place of the first of these tables.

    A kind has a table for each source of its shape (procedural or a file). The keys of the kind are
    the keys of all of these tables.
    """
    found: dict[Key, dict[tuple[str, ...], None]] = {}
    texts: dict[tuple[str, ...], str] = {}
    for number, model in enumerate(models):
        texts.setdefault(kinds[number], model.get("description", ""))
        for name, entry in model["properties"].items():
            is_table = bool(_models(schema, entry))
            if not is_table and (name != "kind" or not kinds[number]):
                required = name in model.get("required", ()) and name != "file"
                found.setdefault(_key(name, entry, required=required), {})[kinds[number]] = None
    for of_kinds in dict.fromkeys(tuple(each) for each in found.values()):
        every = tuple(kind for each in of_kinds for kind in each)
        text = texts[of_kinds[0]] if len(of_kinds) == 1 and every else ""
        keys = tuple(key for key, its in found.items() if tuple(its) == of_kinds)
        yield Group(every, text, keys)


def _key(name: str, entry: Schema, *, required: bool) -> Key:
    default = "required" if required else _shown(entry.get("default"))
    return Key(name, unit_of(name), _takes(entry), default, entry.get("description", ""))


def _takes(entry: Schema) -> str:
    """Return the values that a key takes: its choices, a range or the kind of value."""
    if "anyOf" in entry:
        return " or ".join(
            _takes(choice) for choice in entry["anyOf"] if choice.get("type") != "null"
        )
    if "enum" in entry or "const" in entry:
        return ", ".join(f"`{value}`" for value in entry.get("enum") or [entry["const"]])
    if entry["type"] == "array":
        items = entry.get("prefixItems")
        if not items:
            return f"{entry.get('minItems', 0)} or more times {_takes(entry['items'])}"
        limits = {_range(item) for item in items} - {""}
        return f"{len(items)} numbers" + "".join(f", each {limit}" for limit in limits)
    if entry["type"] == "object":
        values = entry.get("additionalProperties") or next(
            iter(entry["patternProperties"].values())
        )
        return f"names, each with {_takes(values)}"
    if entry["type"] == "string":
        return _text(entry.get("pattern", ""))
    return "`true`, `false`" if entry["type"] == "boolean" else _range(entry) or "number"


def _text(pattern: str) -> str:
    """Return "text", or the choices of a pattern such as ``^(none|observer:.+)$``."""
    choices = re.fullmatch(r"\^\((.*)\)\$", pattern)
    return (
        ", ".join(f"`{each.replace('.+', 'FILE')}`" for each in choices[1].split("|"))
        if choices
        else "text"
    )


def _range(entry: Schema) -> str:
    """Return the range of a number.

    A bracket marks an end that belongs to the range, and a parenthesis marks an end that does not.
    """
    low, high = entry.get("minimum"), entry.get("maximum")
    above, below = entry.get("exclusiveMinimum"), entry.get("exclusiveMaximum")
    if all(each is None for each in (low, high, above, below)):
        return ""
    start = (
        f"[{_number(low)}"
        if low is not None
        else f"({_number(above)}"
        if above is not None
        else "(−∞"
    )
    end = (
        f"{_number(high)}]"
        if high is not None
        else f"{_number(below)})"
        if below is not None
        else "∞)"
    )
    return f"{start}, {end}" + (" whole" if entry.get("type") == "integer" else "")


def _number(value: float) -> str:
    """Return a number with a true minus sign and with digits in groups of three. 2⁶³ is written as
    a power.
    """
    text = f"{value:,.0f}".replace(",", "\N{NO-BREAK SPACE}") if abs(value) >= 1e4 else f"{value:g}"
    return "2⁶³" if value == 2**63 else text.replace("-", "−")


def _shown(value: object) -> str:
    """Return a default as TOML spells it, or an empty text without a default."""
    if value is None or value == "":
        return ""
    return f"`{json.dumps(value)}`" if isinstance(value, bool | list) else f"`{value}`"


def anchors() -> set[str]:
    """Return the names of all keys with their table. Each name is the anchor of a row."""
    return {_anchor(part, key) for part in parts() if part.name for key in _keys(part)}


def page() -> str:
    """Return the whole page. The text before the mark is unchanged."""
    text = PAGE.read_text("utf-8").partition(MARK)[0]
    return text + MARK + "".join(_section(part) for part in parts())


def _section(part: Part) -> str:
    """Return the heading, the text and the tables of a part."""
    name = part.name or "top"
    title = f"`[{part.name}]`" if part.name else "Top of the file"
    text = f"\n## {title}\n\n{_plain(part.text)}\n"
    if part.kinds:
        kinds = ", ".join(f"`{kind}`" for kind in part.kinds)
        text += f'\n<span id="{name}.kind"></span>`kind` is one of {kinds}.\n'
    seen: set[str] = set()
    for group in part.groups:
        if len(part.groups) > 1:
            text += "\n### " + ", ".join(f"`{kind}`" for kind in group.kinds) + "\n"
            text += f"\n{_plain(group.text)}\n" if group.text else ""
        text += "\n" + HEAD + "".join(_row(part, key, seen) for key in group.keys)
    return text


def _row(part: Part, key: Key, seen: set[str]) -> str:
    """Return a row. The first row of a name has the anchor."""
    anchor = _anchor(part, key)
    mark = "" if anchor in seen else f'<span id="{anchor}"></span>'
    seen.add(anchor)
    cells = (f"{mark}`{key.name}`", key.unit, key.takes, key.default, key.text)
    return "| " + " | ".join(_plain(cell).replace("|", "\\|") for cell in cells) + " |\n"


def _plain(text: str) -> str:
    """Return a docstring's text as one line of Markdown."""
    return " ".join(text.replace("``", "`").split())


def _keys(part: Part) -> Iterator[Key]:
    """Yield the keys of all groups of a part."""
    for group in part.groups:
        yield from group.keys


def _anchor(part: Part, key: Key) -> str:
    return f"{part.name}.{key.name}" if part.name else key.name


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
