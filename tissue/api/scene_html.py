"""A scene as a notebook shows it: what it sets, and all of it folded below."""

import json
import tomllib
from collections.abc import Iterator
from html import escape

import tomli_w

from tissue.api.html import folded, table_html
from tissue.scene.scene import Scene

__all__ = ["scene_html"]


def scene_html(scene: Scene) -> str:
    """What a scene sets itself as a table, and each section of its TOML, defaults included, folded below."""
    stated = scene.model_dump(mode="json", exclude_unset=True, exclude={"name", "description"})
    rows = [(key, json.dumps(value)) for key, value in _entries(stated)]  # lists, texts and numbers as in TOML
    whole = tomllib.loads(scene.to_toml())
    plain = {key: value for key, value in whole.items() if not isinstance(value, dict)}
    sections = {"scene": plain} | {key: value for key, value in whole.items() if isinstance(value, dict)}
    texts = [folded(name, f"<pre>{escape(tomli_w.dumps(section))}</pre>") for name, section in sections.items()]
    head = f"<p><b>{escape(scene.name)}</b> {escape(scene.description)}</p>"
    return f"<div>{head}{table_html(rows, titles=('key', 'value'))}{folded('all keys', ''.join(texts))}</div>"


def _entries(table: dict[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Dotted keys and values of nested tables, without those that state nothing."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _entries(value, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", value
