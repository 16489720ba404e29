"""Tests of import layers, of the documentation of modules, and of what starting a command loads."""

import ast
import importlib
import inspect
import os
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from own_imports import imports, modules_in_strings, sources, statements

ROOT = Path(__file__).resolve().parents[1]
MODULES = list(sources(ROOT))
FILES = list(sources(ROOT).values())
LAYERS = (
    ("meshes", "kernels"),
    ("tissue.system", "tissue.materials", "tissue.cutters"),
    ("tissue.scene",),
    ("tissue.fem", "tissue.prediction", "tissue.perception"),
    ("tissue.models",),
    ("tissue.motion",),
    ("tissue.haptics",),
    ("tissue.simulation",),
    ("tissue.show",),
    ("tissue.evaluation", "tissue.fitting", "tissue.links"),
    ("tissue.ct",),
    ("tissue.objects",),
    ("tissue.cli", "tissue.environments"),
    ("tissue.__main__",),
)
"""From the ground up; a module imports from its own package and from layers below."""
LONGEST = 550
"""Lines of a module; 100 to 400 are aimed at."""


def package_of(module):
    """Return the package of `LAYERS` that a module lies in, and its layer.

    A module at the top of ``tissue`` is a package of its own.
    """
    for layer, packages in enumerate(LAYERS):
        for package in packages:
            if module == package or module.startswith(package + "."):
                return package, layer
    return module, None


@cache
def tree_of(path):
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text("utf-8"))


@cache
def imports_of(path):
    """Return this project's modules that a file imports, for type checkers included."""
    return imports(tree_of(path), set(MODULES))


def test_imports_only_go_down():
    wrong = []
    for path, module in zip(FILES, MODULES, strict=True):
        if module == "tissue":  # it hands out names of all layers, each when it is asked for
            continue
        mine, layer = package_of(module)
        assert layer is not None, f"{module} lies in no layer: give its package one in LAYERS"
        named = modules_in_strings(path.read_text("utf-8"), set(MODULES))
        for wanted in (imports_of(path) | named) - {"tissue"}:
            theirs, below = package_of(wanted)
            if theirs != mine and (below is None or below >= layer):
                wrong.append(f"{module} imports {wanted} from above")
    assert not wrong, "\n".join(wrong)


def test_no_modules_import_each_other_in_a_circle():
    """Modules one by one, and the packages of every folder; imports for type checkers count."""
    wanted_by = {module: imports_of(path) for path, module in zip(FILES, MODULES, strict=True)}
    depth, circles = max(module.count(".") for module in MODULES) + 1, []
    for level in range(1, depth + 1):
        cut = lambda module: ".".join(module.split(".")[:level])  # noqa: B023, E731
        graph = {cut(module): set() for module in MODULES if module != "tissue"}
        for module, wanted in wanted_by.items():
            if module != "tissue":
                graph[cut(module)] |= {
                    cut(each) for each in wanted if cut(each) != cut(module)
                } & set(graph)
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as found:
            circles.append(found.args[1])
    assert not circles


def test_contributing_draws_the_layers_that_are_held():
    table = re.findall(
        r"^\|\s*(\d*)\s*\|\s*`([\w.]+)`\s*\|",
        (ROOT / "CONTRIBUTING.md").read_text("utf-8"),
        re.MULTILINE,
    )
    drawn, layer = {}, 0
    for number, package in table:
        layer = int(number or layer)
        drawn.setdefault(layer, set()).add(package)
    assert drawn == {layer: set(packages) for layer, packages in enumerate(LAYERS, 1)}


def test_the_ground_layer_knows_no_physics_and_no_warp():
    for path, module in zip(FILES, MODULES, strict=True):
        if module.split(".")[0] == "meshes":
            nodes = list(statements(tree_of(path)))
            names = {
                name.name for node in nodes if isinstance(node, ast.Import) for name in node.names
            }
            names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
            assert not {
                name for name in names if name.split(".")[0] in ("warp", "kernels", "tissue")
            }, module


def test_running_a_scene_loads_nothing_of_its_evaluation(tmp_path):
    code = (
        "import sys; from tissue.scene.load import load_scene; from "
        "tissue.simulation.simulate import simulate; "
        "run = simulate(load_scene('milling', {'voxels.spacing_mm': 0.8, 'duration_s': 0.02})); "
        f"run.save({str(tmp_path / 'run')!r}); "
        "print([name for name in sys.modules if name.startswith(('tissue.evaluation', "
        "'tissue.show.figures', 'tissue.show.viewer'))])"
    )
    ended = fresh(code)
    assert (ended.returncode, ended.stdout) == (0, "[]\n"), ended.stderr


def test_modules_and_what_they_offer_have_docstrings():
    missing = [each for module in MODULES for each in without_docstring(module)]
    assert not missing, f"no docstring: {', '.join(missing)}"


def without_docstring(module):
    """Yield the names in a module that have no docstring.

    Checked are the module, and its classes, functions and methods without a leading underscore.
    """
    loaded = importlib.import_module(module)
    if module == "tissue.scene.library":  # data alone
        return
    if not (loaded.__doc__ or "").strip():
        yield module
    for name in vars(loaded):
        if name.startswith("_"):
            continue
        thing = getattr(loaded, name)
        code = getattr(thing, "func", thing)  # of a Warp function or kernel
        is_ours = getattr(code, "__module__", "") == module
        if (
            is_ours
            and (inspect.isclass(code) or inspect.isfunction(code))
            and not (code.__doc__ or "").strip()
        ):
            yield f"{module}.{name}"
        if inspect.isclass(thing) and thing.__module__ == module:
            for method, code in vars(thing).items():
                is_public = (
                    inspect.isfunction(code)
                    and not method.startswith("_")
                    and code.__module__ == module
                )
                if is_public and not (code.__doc__ or "").strip():
                    yield f"{module}.{name}.{method}"


def test_files_are_short():
    lengths = {
        module: path.read_text("utf-8").count("\n")
        for path, module in zip(FILES, MODULES, strict=True)
    }
    assert not {module: length for module, length in lengths.items() if length > LONGEST}


def fresh(code, **environment):
    """Run code in a fresh interpreter."""
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | environment,
    )


HEAVY = ("kernels", "matplotlib", "pydantic", "pyvista", "scipy", "vtk", "vtkmodules", "warp")
"""Packages that take long to load, which what starts often does without."""


@pytest.mark.parametrize(
    "code",
    [
        "import tissue",
        "import sys; sys.argv = ['tissue', '--help']; from tissue.cli.main import main; main()",
    ],
    ids=["import", "help"],
)
def test_heavy_packages_are_loaded_where_they_are_used(code):
    ended = fresh(
        f"import atexit, sys; atexit.register(lambda: print([n for n in {HEAVY} if n in "
        "sys.modules], "
        f"file=sys.stderr)); {code}"
    )
    assert (ended.returncode, ended.stderr) == (0, "[]\n")


def test_every_name_of_tissue_can_be_had():
    import tissue

    assert set(tissue.__all__) <= set(dir(tissue))
    for name in tissue.__all__:
        assert getattr(tissue, name).__name__.rpartition(".")[2] == name
    with pytest.raises(AttributeError, match="module 'tissue' has no attribute 'simulator'"):
        tissue.simulator  # noqa: B018


@pytest.mark.parametrize("name", ["kernels", "meshes"])
@pytest.mark.parametrize("module", [True, False], ids=["package", "file"])
def test_a_foreign_package_of_the_same_name_is_reported(tmp_path, name, module):
    if module:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('it was imported')")
    else:
        (tmp_path / f"{name}.py").write_text("raise SystemExit('it was imported')")
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); sys.path.insert(0, {str(tmp_path)!r}); "
        "import tissue"
    )
    message = fresh(code).stderr.splitlines()[-1]
    found = tmp_path / name if module else tmp_path
    assert message == (
        f"ImportError: tissue needs its own package {name} at {ROOT / name}, got {found}. "
        f"Uninstall the other {name} "
        "or reinstall tissue-sim in a fresh environment"
    )
