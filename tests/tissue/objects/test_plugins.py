"""Parts that installed packages offer by entry points.

They are found on request and refused one by one; everything else works without them.
"""

import ast
import json
import subprocess
import sys

import pytest
from offered_package import offer, offer_example, searching


def python(code, *folders):
    """Standard output of code in a process that searches some folders, and its standard error."""
    ended = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=searching(*folders),
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout, ended.stderr


def tissue(*words, folders, cwd):
    """Exit code, standard output and standard error of the command."""
    ended = subprocess.run(
        [sys.executable, "-m", "tissue", *words],
        capture_output=True,
        text=True,
        check=False,
        env=searching(*folders),
        cwd=cwd,
    )
    return ended.returncode, ended.stdout, ended.stderr


@pytest.mark.slow
def test_the_example_package_is_listed_drilled_and_judged(tmp_path):
    folders = offer_example(tmp_path / "site")
    listing = """
import json
from tissue import scene_names
from tissue.scene.plugins import offered_names
from tissue.scene.registry import TABLES
from tissue.scene.texts import schema_text
found = {kind: sorted({name for table in tables for name in table} - {n for t in tables for n in t.built_in})
         for kind, tables in TABLES.items()}
schema = schema_text()
print(json.dumps([found, scene_names(), offered_names(), [name for names in found.values() for name in names
      if f'"{name}"' not in schema]]))
"""
    found, scenes, offered, missing = json.loads(python(listing, *folders)[0])
    assert {
        kind: names for kind, names in found.items() if names and kind not in ("probe", "needle")
    } == {
        "tool": ["step-drill"],
        "tissue": ["cushion"],
        "device": ["toy-pen"],
        "predictor": ["damped-line"],
        "material": ["rigid-foam"],
        "scene": ["toy-cushion", "toy-drilling"],
    }
    assert {"toy-cushion", "toy-drilling"} <= set(scenes)
    assert missing == ["toy-cushion", "toy-drilling"]  # scenes are no value of a key
    assert offered["predictor"] == ["damped-line"]
    code, output, error = tissue(
        "run",
        "toy-drilling",
        "--set",
        "voxels.spacing_mm=0.4",
        "--duration-s",
        "0.3",
        "--no-pictures",
        "--out",
        "run",
        folders=folders,
        cwd=tmp_path,
    )
    assert (code, error) == (0, "") and "toy-pen is read and played by ToyPen" in output
    code, output, error = tissue(
        "run",
        "wall",
        "--set",
        "prediction=damped-lin",
        "--set",
        "device=toy-pen",
        folders=folders,
        cwd=tmp_path,
    )
    assert code == 2 and "got damped-lin (did you mean damped-line?)" in error
    code, output, error = tissue("run", "--help", folders=folders, cwd=tmp_path)
    assert (code, error) == (0, "") and "device toy-pen" in output.splitlines()[-1]


SPEAKS = "import sys\nprint('imported', file=sys.stderr)\n"


def test_a_part_is_identified_by_version_and_code(tmp_path):
    (tmp_path / "own").mkdir()
    code = tmp_path / "own" / "__init__.py"
    offer(tmp_path, "own-parts", {"tissue.predictors": {"flat": "own:Flat"}}, version="0.3.0")
    ask = """
from tissue.scene.plugins import package_of
print([package_of("tissue.predictors", name) for name in ("flat", "flat", "hold")])
"""
    found = []
    for text in ("A = 1\n", "A = 2\n"):
        code.write_text(text)
        first, again, missing = ast.literal_eval(python(ask, tmp_path)[0])
        assert first.startswith("own-parts 0.3.0, SHA-256 ") and first == again and not missing
        found.append(first)
    assert found[0] != found[1]


@pytest.mark.slow
def test_nothing_is_imported_before_it_is_asked_for(tmp_path):
    (tmp_path / "loud.py").write_text(SPEAKS + "def make(loop):\n    return loop\n")
    groups = (
        "renderer",
        "tool",
        "probe",
        "needle",
        "motion",
        "tissue",
        "hand",
        "predictor",
        "perception",
        "material",
        "scene",
    )
    offer(tmp_path, "loud", {f"tissue.{kind}s": {"loud": "loud:make"} for kind in groups})
    quiet = (
        (
            "import sys; sys.argv = ['tissue', 'run', '--help']; from tissue.cli.main import "
            "main; main()"
        ),
        (
            "from tissue import load_scene, simulate; load_scene('wall', {'renderer': "
            "'passivity', 'device': 'touch'}); simulate(load_scene('wall', {'duration_s': 0.02})); "
            "from tissue.scene.registry import DEVICES; list(DEVICES)"
        ),
    )
    for code in quiet:
        assert python(code, tmp_path)[1] == "", code
    for code in (
        "from tissue.scene.registry import RENDERERS; print(*RENDERERS)",
        "from tissue import load_scene; print(load_scene('wall', {'renderer': 'loud'}).held.renderer)",
    ):
        output, error = python(code, tmp_path)
        assert output.split()[-1] == "loud" and error == "imported\n"


def test_a_package_that_was_built_without_its_scene_says_so(tmp_path):
    (tmp_path / "bare.py").write_text("SCENE = 'soft-wall.toml'\n")
    offer(tmp_path, "bare-parts", {"tissue.scenes": {"soft-wall": "bare:SCENE"}})
    code, _, error = tissue("run", "soft-wall", folders=[tmp_path], cwd=tmp_path)
    assert (
        code == 2
        and (
            "scene soft-wall of the package bare-parts 0.1.0 cannot be used (the package was built "
            "without the file soft-wall.toml; its author lists the file in package-data)"
        )
        in error
    )


@pytest.mark.slow
def test_a_package_that_cannot_be_imported_stops_nothing_but_its_part(tmp_path):
    (tmp_path / "broken.py").write_text("import nothing_of_that_name\n")
    (tmp_path / "whole.py").write_text("def make(loop):\n    return loop\n")
    offer(tmp_path, "broken-parts", {"tissue.renderers": {"mine": "broken:make"}})
    offer(tmp_path, "whole-parts", {"tissue.renderers": {"whole": "whole:make"}})
    sentence = (
        "renderer mine of the package broken-parts 0.1.0 cannot be used "
        "(ModuleNotFoundError: No module named "
        "'nothing_of_that_name'). Update or uninstall that package"
    )
    short = ("--no-pictures", "--duration-s", "0.02", "--set", "device=touch")
    code, output, error = tissue("run", "wall", *short, folders=[tmp_path], cwd=tmp_path)
    assert (code, error) == (0, "")
    code, output, error = tissue(
        "run", "wall", "--set", "renderer=mine", *short, folders=[tmp_path], cwd=tmp_path
    )
    assert code == 2 and error.splitlines() == [f"warning: {sentence}", f"error: {sentence}"]
    output, error = python(
        "from tissue.scene.registry import RENDERERS; print(*RENDERERS)", tmp_path
    )
    assert output.split()[-2:] == ["proxy", "whole"] and f"PluginWarning: {sentence}" in error


REFUSED = {
    "proxy": ("parts:make", "built-in renderer"),
    "lacking": ("parts:Lacking", "without render and pause"),
    "absent": ("parts:nothing", "AttributeError"),
    "ending": ("ends:make", "SystemExit: 3"),
}
"""Entry points by name, and the reason for which each is left out."""


def test_a_part_that_does_not_fit_is_left_out_with_the_reason(tmp_path):
    (tmp_path / "parts.py").write_text(
        "number = 3\nclass Lacking:\n    pass\ndef make(loop):\n    return loop\n"
    )
    (tmp_path / "ends.py").write_text("raise SystemExit(3)\n")
    points = {name: point for name, (point, _) in REFUSED.items()}
    offer(tmp_path, "odd-parts", {"tissue.renderers": points})
    output, error = python(
        "from tissue.scene.registry import RENDERERS; print(*RENDERERS)", tmp_path
    )
    assert output.split() == ["penalty", "passivity", "proxy"]
    for name, (_, reason) in REFUSED.items():
        (line,) = (each for each in error.splitlines() if f"PluginWarning: renderer {name}" in each)
        assert "odd-parts 0.1.0" in line and reason in line
