"""Print the structure of the source.

Run: `python tests/bench/structure.py [--scene NAME] [CHECKOUT]`.

The figures match the table in `CONTRIBUTING.md`: tokens without comments and docstrings,
statements, files, packages, import cycles, names in strings, parameters, packed assignments. A
scene is followed from the command to its first tick. Listed are the modules of `tissue` that its
calls enter, and the calls to a module of a higher layer than the caller's.
"""

import argparse
import ast
import io
import os
import subprocess
import sys
import tempfile
import tokenize
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "fixtures"))
from own_imports import PACKAGES, imports, modules_in_strings, sources

__all__ = ["imports", "sources"]

MANY = 7
"""Parameters of a function above which it is counted."""
SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}

FOLLOW = r"""
import sys, os, threading
root = os.getcwd() + os.sep + "tissue" + os.sep
entered, calls = [], []
def module_of(frame):
    file = frame.f_code.co_filename
    return file[len(root):-3].replace(os.sep, ".") if file.startswith(root) else None
def being_imported(frame):
    while frame is not None:
        if frame.f_code.co_name == "<module>" and module_of(frame) is not None:
            return True
        frame = frame.f_back
    return False
def trace(frame, event, argument):
    if event != "call" or frame.f_code.co_name == "<module>":
        return
    name = module_of(frame)
    if name is None or being_imported(frame):
        return
    if name.endswith("bone.model") and frame.f_code.co_name == "advance":
        sys.setprofile(None)
    if name not in entered:
        entered.append(name)
    back = frame.f_back
    while back is not None and module_of(back) is None:
        back = back.f_back
    if back is not None and (pair := (module_of(back), name)) not in calls and pair[0] != name:
        calls.append(pair)
sys.argv = ["tissue", "run", sys.argv[1], "--duration-s", "0.02", "--no-pictures", "--out", sys.argv[2]]
try:
    from tissue.cli.main import main
except ImportError:
    from tissue.cli import main
sys.setprofile(trace)
try:
    main()
except SystemExit:
    pass
sys.setprofile(None)
print("ENTERED", *entered)
print("CALLS", *(f"{a}>{b}" for a, b in calls))
"""


def layer_of(module: str, layers: tuple[tuple[str, ...], ...]) -> int | None:
    """Return the layer of a module, or None for one without."""
    for number, packages in enumerate(layers):
        if any(module == package or module.startswith(package + ".") for package in packages):
            return number
    return None


def layers_in(root: Path) -> tuple[tuple[str, ...], ...]:
    """Return the table of layers that the architecture test holds."""
    tree = ast.parse((root / "tests" / "test_architecture.py").read_text("utf-8"))
    return next(
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "LAYERS"
    )


def tokens(source: str, tree: ast.AST) -> int:
    """Return the number of tokens without comments, docstrings and layout."""
    docstrings = {
        (node.value.lineno, node.value.col_offset)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    }
    found = tokenize.generate_tokens(io.StringIO(source).readline)
    return sum(each.type not in SILENT and each.start not in docstrings for each in found)


def statements(tree: ast.AST) -> int:
    """Return the number of statements without docstrings."""
    return sum(
        isinstance(node, ast.stmt)
        and not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        for node in ast.walk(tree)
    )


def is_packed(node: ast.AST) -> bool:
    """Return whether a node assigns several values to several names at once."""
    return (
        isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Tuple)
        and isinstance(node.targets[0], ast.Tuple)
    )


def parameter_count(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the number of parameters, `self` and `cls` excepted."""
    given = function.args
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


def cycles(graph: dict[str, set[str]]) -> int:
    """Return the number of edges that have to be cut until no cycle is left."""
    graph = {name: set(found) for name, found in graph.items()}
    cut = 0
    while True:
        try:
            TopologicalSorter(graph).prepare()
            return cut
        except CycleError as found:
            circle = found.args[1]
            graph[circle[1]].discard(circle[0])
            cut += 1


def print_followed(root: Path, scene: str, layers: tuple[tuple[str, ...], ...]) -> None:
    """Print the modules that a run enters up to its first tick."""
    with tempfile.TemporaryDirectory() as folder:
        ended = subprocess.run(
            [sys.executable, "-c", FOLLOW, scene, str(Path(folder) / "run")],
            cwd=root,
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {"PYTHONPATH": str(root)},
        )
    for line in ended.stdout.splitlines():
        if line.startswith("ENTERED"):
            entered = line.split()[1:]
            print(f"{scene}, from the command to the first tick: {len(entered)} modules")
            print(f"  {', '.join(entered)}")
        if line.startswith("CALLS"):
            pairs = [
                tuple(f"tissue.{name}" for name in pair.split(">")) for pair in line.split()[1:]
            ]
            up = [
                f"{caller} > {called}"
                for caller, called in pairs
                if (layer_of(called, layers) or 0) > (layer_of(caller, layers) or 0)
            ]
            print(f"{scene}, calls to a higher layer: {len(up)}: {', '.join(up)}")


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "checkout", nargs="?", type=Path, default=Path(__file__).resolve().parents[2]
    )
    parser.add_argument("--scene", default="milling")
    chosen = parser.parse_args()
    root = chosen.checkout.resolve()
    layers = layers_in(root)
    files = sources(root)
    text = {name: path.read_text("utf-8") for name, path in files.items()}
    trees = {name: ast.parse(source) for name, source in text.items()}
    counted = {name: tokens(text[name], tree) for name, tree in trees.items()}
    for package in PACKAGES:
        of = sum(count for name, count in counted.items() if name.split(".")[0] == package)
        print(f"tokens in {package}: {of}")
    print(f"tokens: {sum(counted.values())}")
    tests = [ast.parse(path.read_text("utf-8")) for path in (root / "tests").rglob("*.py")]
    print(
        f"statements: {sum(map(statements, trees.values()))}; in tests: "
        f"{sum(map(statements, tests))}"
    )
    outside = len(files) + len(list((root / "examples").rglob("*.py")))
    print(f"Python files: {len(files)}; with examples: {outside}")
    packages = [path.parent for path in (root / "tissue").glob("*/__init__.py")]
    print(f"packages of tissue: {len(packages)}")

    named = {
        name: modules_in_strings(code, set(files))
        for name, code in text.items()
        if name != "tissue"
    }
    graph = {
        name: (imports(trees[name], set(files)) | found) - {name, "tissue"}
        for name, found in named.items()
    }
    upward = [
        f"{name} > {other}"
        for name, found in named.items()
        for other in found
        if (layer_of(other, layers) or 0) > (layer_of(name, layers) or 0)
    ]
    print(f"import cycles: {cycles(graph)}; upward names in strings: {len(upward)}")
    for each in upward:
        print(f"  {each}")

    functions = [
        (parameter_count(node), f"{name}.{node.name}")
        for name, tree in trees.items()
        if not name.startswith("kernels")
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    long = sorted((each for each in functions if each[0] > MANY), reverse=True)
    print(f"functions with more than {MANY} parameters: {len(long)}")
    for each in long[:20]:
        print(f"  {each[0]} {each[1]}")
    lines = sum(source.count("\n") for source in text.values())
    packed = sum(is_packed(node) for tree in trees.values() for node in ast.walk(tree))
    print(f"lines: {lines}; packed assignments per 1,000 lines: {1e3 * packed / lines:.1f}")
    print_followed(root, chosen.scene, layers)


if __name__ == "__main__":
    main()
