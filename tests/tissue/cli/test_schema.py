"""`tissue schema`, and the line by which an editor finds it."""

import json
import tomllib
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest

from tissue.scene.load import load_scene, saved_text, scene_names, scene_text


def part_of(entry, table, defs):
    """The part of the schema that an entry leads to; of several the one of the table's kind."""
    if "properties" in entry:
        return entry
    links = [
        each["$ref"]
        for each in (entry, *entry.get("anyOf", ()), *entry.get("oneOf", ()))
        if "$ref" in each
    ]
    parts = [defs[link.split("/")[-1]] for link in links]
    kinds = [part["properties"].get("kind", {}) for part in parts]
    fitting = [
        part
        for part, kind in zip(parts, kinds, strict=True)
        if table.get("kind") in kind.get("enum", [kind.get("const")])
    ]
    fitting = [part for part in fitting if table.keys() <= part["properties"].keys()]
    assert fitting, (entry, table.get("kind"))
    return fitting[0]


def is_free(entry):
    """Return True if a table takes names that a user chooses."""
    return "patternProperties" in entry or isinstance(entry.get("additionalProperties"), dict)


def stated(table, entry, defs, where):
    """Check that all entries of a table are described in its part of the schema.

    No other entries may be there.
    """
    part = part_of(entry, table, defs)
    assert part["additionalProperties"] is False and part["description"], where
    for name, value in table.items():
        inner = part["properties"][name]
        free = any(is_free(each) for each in (inner, *inner.get("anyOf", ())))
        if isinstance(value, dict) and not free:
            stated(value, inner, defs, f"{where}.{name}")
        else:
            assert inner["description"], f"{where}.{name}"


def test_the_schema_states_every_key_of_the_scenes(command):
    code, output, _ = command("schema")
    schema = json.loads(output)
    assert code == 0 and schema["additionalProperties"] is False
    for name in scene_names():
        for text in (scene_text(name), saved_text(load_scene(name))):
            stated(tomllib.loads(text), schema, schema["$defs"], name)


def test_the_schema_is_written_to_a_file_and_kept_unless_it_may_be_replaced(
    command, refused, tmp_path
):
    path = tmp_path / "scene.json"
    assert command("schema", "--out", path) == (0, f"wrote {path}\n", "")
    assert path.read_text("utf-8") == command("schema")[1]
    assert refused("schema", "--out", path) == (
        f"out must not exist yet, got {path}. Pass --overwrite or choose another --out"
    )
    path.write_text("{}")
    assert command("schema", "--out", path, "--overwrite")[0] == 0
    assert json.loads(path.read_text("utf-8"))["title"] == "Scene"


@pytest.mark.parametrize("name", scene_names())
def test_a_printed_scene_names_a_schema_that_is_there_and_loads_unchanged(
    command, monkeypatch, tmp_path, name
):
    cache = tmp_path / "a cache, with ü"
    monkeypatch.setenv("TISSUE_CACHE", str(cache))
    _, output, _ = command("scenes", name)
    first, rest = output.split("\n", 1)
    keyword, url = first.split(" ", 1)
    assert keyword == "#:schema" and " " not in url and urlsplit(url).scheme == "file"
    with open(url2pathname(urlsplit(url).path), encoding="utf-8") as schema:
        assert schema.read() == command("schema")[1]
    assert rest == scene_text(name)
    (tmp_path / "mine.toml").write_text(output, "utf-8")
    assert load_scene(tmp_path / "mine.toml") == load_scene(name)


def test_a_scene_is_printed_without_the_line_where_the_cache_cannot_be_written(
    command, monkeypatch, tmp_path
):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path / "file"))
    assert command("scenes", "milling") == (0, scene_text("milling"), "")
