"""Inputs of the site: tables of scene keys, examples as pages, code of its pages, link checks."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import tissue
from tissue.scene.texts import schema_text

ROOT = Path(__file__).resolve().parents[1]
LESSONS = [ROOT / "docs/start.md", *sorted((ROOT / "docs/guide").glob("*.md"))]
COARSER = {
    "bone": {"spacing_mm=0.2": "spacing_mm=0.5"},
    "ct": {
        "scene.toml --out": "scene.toml --set voxels.spacing_mm=0.6 --duration-s 0.5 --out",
        "--no-pictures": "--no-pictures --set voxels.spacing_mm=0.6 --duration-s 0.5",
        "load_scene(made.scene)": (
            'load_scene(made.scene, {"voxels.spacing_mm": 0.6, "duration_s": 0.5})'
        ),
    },
    "fit": {
        '"voxels.spacing_mm": 0.4, "duration_s": 1.5': '"voxels.spacing_mm": 0.5, "duration_s": 0.8'
    },
    "organ": {
        "    modulus_kPa=10,\n    poisson_ratio=0.49,\n    inclusions": (
            "    edge_mm=14,\n    modulus_kPa=10,\n    poisson_ratio=0.49,\n    inclusions"
        ),
        "edge_mm=4": "edge_mm=8",
        "edge_mm=8,\n)": "edge_mm=14,\n)",
        "hold_s=2)": "hold_s=0.3)",
    },
    "run": {'"voxels.spacing_mm": 0.2': '"voxels.spacing_mm": 0.3'},
}
"""Texts that make the code of a page slow, and the faster texts that the test runs instead."""


def part_of_the_site(path):
    """A module that lies outside of the packages."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


tables, links, page_code = (
    part_of_the_site(ROOT / name)
    for name in ("docs/_ext/scene_tables.py", ".ci/links.py", "docs/_ext/page_code.py")
)


def test_the_page_of_scene_keys_is_up_to_date():
    assert tables.PAGE.read_text("utf-8") == tables.page(), "python docs/_ext/scene_tables.py"


def keys_of(defs, name, entry):
    """Yield table, kind and name of every key under an entry of the schema.

    Keys of inner tables have dotted names.
    """
    links = [
        each["$ref"]
        for each in (entry, *entry.get("anyOf", ()), *entry.get("oneOf", ()))
        if "$ref" in each
    ]
    for model in (defs[link.rpartition("/")[2]] for link in links):
        kind = model["properties"].get("kind", {})
        kinds = kind.get("enum") or [kind["const"]] if len(links) > 1 else [""]
        for key, inner in model["properties"].items():
            below = list(keys_of(defs, f"{name}.{key}", inner))
            yield from below or [(name, each, key) for each in kinds if key != "kind" or each == ""]


def test_the_tables_hold_every_key_of_the_schema_once_for_each_kind():
    schema = json.loads(schema_text())
    rows = [
        (part.name, kind, key.name)
        for part in tables.parts()
        for group in part.groups
        for kind in group.kinds or ("",)
        for key in group.keys
    ]
    wanted = set()
    for name, entry in schema["properties"].items():
        optional = {
            "anyOf": [each for each in entry.get("anyOf", ()) if each.get("type") != "null"]
        }
        wanted |= set(keys_of(schema["$defs"], name, entry | optional)) or {("", "", name)}
    assert set(rows) == wanted and len(rows) > 150


def test_every_public_name_is_on_the_page_of_the_reference():
    page = (ROOT / "docs/api/index.rst").read_text("utf-8")
    missing = [
        name
        for name in tissue.__all__
        if not re.search(rf"^   {name}(\.\w+)?$", page, re.MULTILINE)
    ]
    assert not missing, (
        f"docs/api/index.rst must list each public name, got none of {', '.join(missing)}: add them"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [path for path in LESSONS if any(page_code.blocks_of(path.read_text("utf-8")))],
    ids=lambda path: path.stem,
)
def test_the_code_of_a_page_runs_in_order(page, tmp_path):
    """Run the Python code of a page, and the commands of its bash blocks, on coarse grids."""
    text = page.read_text("utf-8")
    for shown, coarser in COARSER.get(page.stem, {}).items():
        assert shown in text
        text = text.replace(shown, coarser)
    code = "from page_code import run_commands\n" + "\n".join(
        f"run_commands({code!r})" if language == "bash" else code
        for language, code in page_code.blocks_of(text)
    )
    (tmp_path / "examples").symlink_to(ROOT / "examples")  # a page is read in a checkout
    ended = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ
        | {
            "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "docs/_ext")]),
            "MPLBACKEND": "Agg",
            "PYVISTA_OFF_SCREEN": "true",
        },
    )
    assert ended.returncode == 0, ended.stderr


def test_the_check_of_links_finds_what_leads_nowhere(tmp_path):
    good = (
        '<h1 id="top">a</h1><a href="b.html#there">b</a><a href="#top">up</a><a '
        'href="https://host.org/x">out</a>'
    )
    (tmp_path / "a.html").write_text(good)
    (tmp_path / "b.html").write_text(
        '<p id="there">b</p><img src="a.html"><link rel="next" href="a.html">'
    )
    assert links.problems(tmp_path) == []
    bad = (
        '<a href="c.html">c</a><a href="b.html#gone">b</a><script '
        'src="https://host.org/x.js"></script><a href="http://x">x</a>'
    )
    (tmp_path / "a.html").write_text(bad + '<p id="twice"><p id="twice">')
    assert [each.split(": ", 1)[1] for each in links.problems(tmp_path)] == [
        "the id twice stands 2 times",
        "https://host.org/x.js is fetched from elsewhere",
        "b.html#gone leads to no such place",
        "c.html leads to no file",
        "http://x has no host",
    ]
    assert links.problems(tmp_path / "empty") != []
