"""The house: which floor may import which, what modules say of themselves, and how fast the door opens."""

import ast
import importlib
import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("meshes", "kernels", "tissue")
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
MODULES = [
    path.relative_to(ROOT).with_suffix("").as_posix().removesuffix("/__init__").replace("/", ".") for path in FILES
]
QUICK_EXAMPLES = {"06_needle_through_the_capsule", "07_where_methods_fail", "08_where_1_khz_is_not_enough"}
EXAMPLES = [
    pytest.param(path, id=path.stem, marks=() if path.stem in QUICK_EXAMPLES else pytest.mark.slow)
    for path in sorted((ROOT / "examples").glob("*.py"))
]
FLOORS = (
    ("meshes", "kernels"),
    (
        "tissue.materials",
        "tissue.system.outputs",
        "tissue.system.output_lock",
        "tissue.system.process_identity",
        "tissue.system.stopping",
    ),
    ("tissue.system.child", "tissue.system.helper", "tissue.system.workers", "tissue.fem.fields", "tissue.cutters"),
    ("tissue.system.offscreen",),
    ("tissue.models.tissue_model",),
    ("tissue.motion.pose_log",),
    ("tissue.models.bone", "tissue.models.tooth", "tissue.models.organ", "tissue.models.needle", "tissue.models.wall"),
    (
        "tissue.simulation.vibration",
        "tissue.haptics",
        "tissue.prediction",
        "tissue.perception",
        "tissue.motion.motion",
        "tissue.motion.replay",
        "tissue.scene.anatomy",
        "tissue.scene.coupling",
        "tissue.scene.organ",
        "tissue.scene.tool",
        "tissue.scene.scene",
        "tissue.scene.unused_keys",
    ),
    ("tissue.motion.reach", "tissue.scene.key_names"),
    ("tissue.builders.bone_from_file",),
    ("tissue.builders.voxels", "tissue.builders.organ"),
    ("tissue.scene.messages", "tissue.simulation.trace", "tissue.simulation.formats"),
    ("tissue.simulation.vtk_files", "tissue.simulation.file_frame"),
    ("tissue.simulation.series",),
    ("tissue.scene.load", "tissue.simulation.run_summary"),
    ("tissue.builders.parts",),
    ("tissue.builders.probe", "tissue.builders.touchable"),
    ("tissue.builders.loop",),
    ("tissue.builders.cutting", "tissue.builders.organ_scene", "tissue.builders.hand"),
    ("tissue.builders.registry",),
    ("tissue.simulation.run_folder", "tissue.simulation.shortfalls"),
    ("tissue.simulation.run",),
    ("tissue.simulation.tick",),
    ("tissue.simulation.simulate",),
    (
        "tissue.simulation.reference_force",
        "tissue.evaluation.statistics",
        "tissue.evaluation.training",
        "tissue.simulation.live",
    ),
    (
        "tissue.simulation.bone_surface",
        "tissue.simulation.carved_surface",
        "tissue.simulation.carving_series",
        "tissue.simulation.depth_map",
        "tissue.figures.events",
        "tissue.figures.figure",
        "tissue.figures.style",
        "tissue.figures.section",
        "tissue.figures.force_depth",
        "tissue.figures.rendering",
        "tissue.figures.before_after",
        "tissue.figures.report",
        "tissue.cli.summary_table",
        "tissue.figures.press",
        "tissue.figures.held",
        "tissue.figures.insertion",
        "tissue.figures.wall",
        "tissue.figures.played",
        "tissue.evaluation.stability_picture",
        "tissue.evaluation.stability_report",
        "tissue.evaluation.assessment",
        "tissue.evaluation.assessment_picture",
        "tissue.viewer.movie",
        "tissue.viewer.bone",
        "tissue.viewer.carving",
        "tissue.simulation.saved_fields",
        "tissue.viewer.fields",
        "tissue.viewer.layers",
        "tissue.viewer.clip",
        "tissue.viewer.pick",
        "tissue.viewer.list",
        "tissue.viewer.play",
        "tissue.figures.tool_mesh",
        "tissue.viewer.input",
        "tissue.viewer.arrow",
        "tissue.viewer.moment",
        "tissue.viewer.camera",
        "tissue.viewer.run",
        "tissue.viewer.live.pointer",
        "tissue.viewer.live.tissue_shown",
        "tissue.viewer.live.tool_shown",
        "tissue.viewer.live.live_window",
        "tissue.viewer.window",
        "tissue.viewer.show",
        "tissue.viewer.view",
    ),
    ("tissue.evaluation.charts", "tissue.evaluation.atlas"),
    ("tissue.evaluation.study", "tissue.evaluation.calibration"),
    ("tissue.cli",),
    ("tissue.cli.main",),
    ("tissue.__main__",),
)
"""From the ground up; a room imports from its own floor and those below it."""
LAZY = {
    ("tissue.simulation.run", "tissue.simulation.carving_series"),
    ("tissue.simulation.run", "tissue.figures.report"),
    ("tissue.simulation.simulate", "tissue.evaluation.charts"),
    ("tissue.cli.view", "tissue.viewer.view"),
}
"""A run calls what draws it, and only then imports it."""
LONGEST = 300


def room_of(module):
    """The room of the house that a module lies in."""
    rooms = [room for floor in FLOORS for room in floor if module == room or module.startswith(room + ".")]
    return max(rooms, key=len, default=None)


def floor_of(module):
    room = room_of(module)
    return next((level for level, floor in enumerate(FLOORS) if room in floor), None)


def imports_of(path):
    """Modules of the house that a file imports, anywhere in it but for type checkers alone."""
    tree = ast.parse(path.read_text("utf-8"))
    hidden = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    found = set()
    for node in ast.walk(tree):
        if node in hidden:
            continue
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            inner = {f"{node.module}.{name.name}" for name in node.names}
            found |= {name for name in inner if name in MODULES} or {node.module}
    return {name for name in found if name.split(".")[0] in PACKAGES}


@pytest.mark.parametrize(("path", "module"), list(zip(FILES, MODULES, strict=True)), ids=MODULES)
def test_imports_only_go_down(path, module):
    for wanted in imports_of(path) - {module}:
        if wanted == "tissue" or module in ("tissue", "tissue.scene.library") or (module, wanted) in LAZY:
            continue
        mine, theirs = floor_of(module), floor_of(wanted)
        assert mine is not None, f"{module} lies on no floor: give it one in FLOORS"
        assert theirs is not None and theirs <= mine, f"{module} imports {wanted} from above"


def test_the_ground_floor_knows_nothing_above_or_beside_it():
    for path, module in zip(FILES, MODULES, strict=True):
        package = module.split(".")[0]
        if package == "meshes":
            tree = ast.parse(path.read_text("utf-8"))
            names = {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
            names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
            assert not {name for name in names if name.split(".")[0] in ("warp", "kernels", "tissue")}, module
        if package == "kernels":
            assert not {name for name in imports_of(path) if not name.startswith("kernels")}, module


@pytest.mark.parametrize("module", MODULES)
def test_a_module_says_what_it_holds(module):
    loaded = importlib.import_module(module)
    if module == "tissue.scene.library":
        return
    assert (loaded.__doc__ or "").strip(), "no docstring"
    if module == "kernels":
        return
    assert loaded.__all__ and len(set(loaded.__all__)) == len(loaded.__all__)
    for name in loaded.__all__:
        thing = getattr(loaded, name)
        code = getattr(thing, "func", thing)  # of a Warp function or kernel
        own = getattr(code, "__module__", "").split(".")[0] in PACKAGES
        if own and (inspect.isclass(code) or inspect.isfunction(code)):
            assert (code.__doc__ or "").strip(), f"{name} has no docstring"
        if inspect.isclass(thing) and thing.__module__ == module:
            for method, code in vars(thing).items():
                if inspect.isfunction(code) and not method.startswith("_") and code.__module__ == module:
                    assert (code.__doc__ or "").strip(), f"{name}.{method} has no docstring"


@pytest.mark.parametrize("path", FILES, ids=MODULES)
def test_a_file_is_short(path):
    assert len(path.read_text("utf-8").splitlines()) <= LONGEST


def fresh(code, **environment):
    """Run code in a fresh interpreter."""
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=os.environ | environment
    )


HEAVY = ("kernels", "matplotlib", "pydantic", "pyvista", "scipy", "vtk", "vtkmodules", "warp")
"""Packages that take long to load, which what starts often does without."""


@pytest.mark.parametrize(
    "code",
    ["import tissue", "import sys; sys.argv = ['tissue', '--help']; from tissue.cli.main import main; main()"],
    ids=["import", "help"],
)
def test_heavy_packages_are_loaded_where_they_are_used(code):
    ended = fresh(
        f"import atexit, sys; atexit.register(lambda: print([n for n in {HEAVY} if n in sys.modules], "
        f"file=sys.stderr)); {code}"
    )
    assert (ended.returncode, ended.stderr) == (0, "[]\n")


def test_every_name_of_tissue_can_be_had():
    import tissue

    assert set(tissue.__all__) <= set(dir(tissue))
    for name in tissue.__all__:
        assert getattr(tissue, name).__name__ == name
    with pytest.raises(AttributeError, match="module 'tissue' has no attribute 'simulator'"):
        tissue.simulator  # noqa: B018


@pytest.mark.parametrize("name", ["kernels", "meshes"])
@pytest.mark.parametrize("module", [True, False], ids=["package", "file"])
def test_a_foreign_package_of_the_same_name_is_told(tmp_path, name, module):
    if module:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('it was imported')")
    else:
        (tmp_path / f"{name}.py").write_text("raise SystemExit('it was imported')")
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); sys.path.insert(0, {str(tmp_path)!r}); import tissue"
    said = fresh(code).stderr.splitlines()[-1]
    found = tmp_path / name if module else tmp_path
    assert said == (
        f"ImportError: tissue needs its own package {name} at {ROOT / name}, got {found}: uninstall the other {name} "
        "or reinstall tissue-sim in a fresh environment"
    )


@pytest.mark.parametrize("path", EXAMPLES)
def test_an_example_runs_and_gives_its_number(path, tmp_path):
    """An example checks its own number and fails where it is another."""
    quick = ["--quick"] if "--quick" in path.read_text("utf-8") else []
    ended = subprocess.run(
        [sys.executable, str(path), *quick],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert ended.returncode == 0, ended.stderr
    assert any(letter.isdigit() for letter in ended.stdout)
