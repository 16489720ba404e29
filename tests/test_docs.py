"""The pages name what exists: paths, modules, links, commands, layers, dependencies."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from tissue.cli.main import app
from tissue.environments import IDS
from tissue.scene.load import load_scene, parse_override

ROOT = Path(__file__).resolve().parents[1]
DOCS = sorted(path for pattern in ("*.md", "guide/*.md") for path in (ROOT / "docs").glob(pattern))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS]
NAMES = [path.relative_to(ROOT).as_posix() for path in PAGES]
PACKAGES = ("meshes", "kernels", "tissue")
PLACES = (*PACKAGES, "tests", "examples", "docs", ".ci", ".github")


def code_of(text):
    """Words of a page's code, in lines or in blocks, with what is around a name taken off."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    inline = re.findall(
        r"`([^`]+)`", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    )
    return {word.rstrip(",;:.)") for code in (*blocks, *inline) for word in code.split()}


def exists(word):
    """Return True if a path of this repository exists; a pattern must match something."""
    return any(ROOT.glob(word.rstrip("/"))) if "*" in word else (ROOT / word).exists()


def is_had(name):
    """Return True if a dotted name is a module or an attribute of one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            thing = import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_paths_and_modules_that_a_page_names_exist(page):
    words = code_of(page.read_text("utf-8"))
    paths = {word for word in words if "/" in word and word.split("/")[0] in PLACES}
    dotted = {
        word.split("(")[0] for word in words if re.match(rf"({'|'.join(PACKAGES)})(\.\w+)+", word)
    }
    # environments are named like paths
    assert not {path for path in paths - set(IDS) if not exists(path)}
    assert not {name for name in dotted if not is_had(name)}


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_of_a_page_lead_to_files(page):
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text("utf-8"))
    assert not {link for link in links if "://" not in link and not (page.parent / link).exists()}


def test_names_in_code_of_contributing_are_defined():
    """Classes and constants, which a rename would leave behind."""
    words = code_of((ROOT / "CONTRIBUTING.md").read_text("utf-8"))
    wanted = {
        word.split(".")[0]
        for word in words
        if re.fullmatch(r"[A-Z]\w+(\.\w+)?", word) and not (ROOT / word).exists()
    }
    source = "\n".join(
        path.read_text("utf-8")
        for place in (*PACKAGES, "tests")
        for path in (ROOT / place).rglob("*.py")
    )
    assert len(wanted) > 10
    assert not {
        name
        for name in wanted
        if not re.search(rf"^(class {name}\b|{name}\b.* = )", source, re.MULTILINE)
    }


@pytest.mark.slow
def test_the_python_of_the_readme_runs(tmp_path):
    (code,) = re.findall(
        r"^```python\n(.*?)^```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL | re.MULTILINE
    )
    ended = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert ended.returncode == 0, ended.stderr
    assert {path.name for path in (tmp_path / "runs/coarse").iterdir()} >= {
        "trace.csv",
        "trace.npz",
        "bone.vti",
        "summary.json",
    }


def commands_of(page):
    """Every call of ``tissue`` in a page's blocks and lines of code, as words."""
    text = page.read_text("utf-8")
    blocks = "".join(re.findall(r"^```(?:bash)?\n(.*?)^```", text, re.DOTALL | re.MULTILINE))
    inline = re.findall(
        r"`([^`]+)`", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    )
    for line in (*blocks.splitlines(), *inline):
        line = line.split("  #")[0].split(" > ")[0].strip()
        if line.startswith("tissue ") and "=..." not in line:
            yield shlex.split(line)[1:]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_that_a_page_shows_can_be_read(page):
    """Commands, options and keys of scenes exist, and the built-in scenes take them."""
    for words in commands_of(page):
        if words[0] in ("COMMAND", "--help"):
            continue
        assert words[0] in app
        if len(words) == 1:  # the command's name alone
            continue
        call, bound, _ = app.parse_args(words, exit_on_error=False, print_error=False)
        name = bound.arguments.get("scene")
        if (
            call.__name__ == "run"
            and isinstance(name, str)
            and name in ("glenoid", "milling", "molar", "liver-press", "wall")
        ):
            pairs = [words[place + 1] for place, word in enumerate(words) if word == "--set"]
            # A file of the reader does not exist here.
            known = [
                pair
                for pair in pairs
                if not pair.endswith("=FILE.stl") and "materials=" not in pair
            ]
            load_scene(name, dict(parse_override(pair) for pair in known))


def test_every_dependency_has_its_reasons():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    wanted = {
        name
        for group in (project["dependencies"], *project["optional-dependencies"].values())
        for name in group
    }
    rows = re.findall(
        r"^\| ([^|]+) \|", (ROOT / "docs/decisions.md").read_text("utf-8"), re.MULTILINE
    )
    named = {name for row in rows for name in row.split(", ")}
    assert {re.split(r"[>=<]", name)[0] for name in wanted} == named - {"package"}


def test_the_newest_changes_and_the_citation_are_of_this_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    changes, citation = (
        (ROOT / name).read_text("utf-8") for name in ("CHANGELOG.md", "CITATION.cff")
    )
    version, date = re.search(
        r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d\d-\d\d)$", changes, re.MULTILINE
    ).groups()
    assert version == project["version"]
    assert f"\nversion: {version}\n" in citation and f"\ndate-released: {date}\n" in citation


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_carries_its_types(package):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    assert (ROOT / package / "py.typed").is_file() and "py.typed" in project["tool"]["setuptools"][
        "package-data"
    ]["*"]
