"""The structure of the source in figures: ``python tests/bench/structure.py [--scene NAME] [CHECKOUT]``.

Counts statements and lines outside the tests, modules at the top of ``tissue``, import cycles, lines with ``Any``; and
follows a scene from the command to its first tick: how many modules of ``tissue`` its calls enter, in their order, and
how often a call goes to a module of a higher layer than its caller's (callbacks given by a caller above are such calls).
"""

import argparse
import ast
import os
import subprocess
import sys
import tempfile
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

PACKAGES = ("meshes", "kernels", "tissue")

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


def sources(root: Path) -> dict[str, Path]:
    """Modules of the three packages by name."""
    files = [path for package in PACKAGES for path in sorted((root / package).rglob("*.py"))]
    named = {path.relative_to(root).with_suffix("").as_posix().replace("/", "."): path for path in files}
    return {name.removesuffix(".__init__"): path for name, path in named.items()}


def imports(tree: ast.Module, modules: set[str]) -> set[str]:
    """Own modules that a module imports, but for type checkers alone."""
    hidden = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    found: set[str] = set()
    for node in ast.walk(tree):
        if node in hidden:
            continue
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            inner = {f"{node.module}.{name.name}" for name in node.names}
            found |= (inner & modules) or {node.module}
    return found & modules


def climbs(root: Path, caller: str, called: str) -> bool:
    """Whether a call between modules of ``tissue`` goes to a higher layer."""
    tree = ast.parse((root / "tests" / "test_architecture.py").read_text("utf-8"))
    table = next(
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "LAYERS"
    )
    layer = {name.removeprefix("tissue."): index for index, row in enumerate(table) for name in row}
    return layer.get(called.split(".")[0], 0) > layer.get(caller.split(".")[0], 99)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkout", nargs="?", type=Path, default=Path(__file__).resolve().parents[2])
    parser.add_argument("--scene", default="milling")
    chosen = parser.parse_args()
    root = chosen.checkout.resolve()
    files = sources(root)
    trees = {name: ast.parse(path.read_text("utf-8")) for name, path in files.items()}
    statements = Counter[str]()
    for name, tree in trees.items():
        statements[name.split(".")[0]] += sum(isinstance(node, ast.stmt) for node in ast.walk(tree))
    lines = sum(len(path.read_text("utf-8").splitlines()) for path in files.values())
    any_lines = sum(
        "Any" in line and not line.lstrip().startswith(("from", "import"))
        for path in files.values()
        for line in path.read_text("utf-8").splitlines()
    )
    graph = {name: imports(tree, set(files)) - {name} for name, tree in trees.items() if name != "tissue"}
    cycles = 0
    while True:
        try:
            TopologicalSorter(graph).prepare()
            break
        except CycleError as found:
            circle = found.args[1]
            cycles += 1
            graph[circle[1]] = graph[circle[1]] - {circle[0]}
    print(
        f"modules: {len(files)}, at the top of tissue: {sum(name.count('.') == 1 and path.name != '__init__.py' for name, path in files.items() if name.startswith('tissue.'))}"
    )
    print(
        f"lines: {lines}; statements: {sum(statements.values())} ({', '.join(f'{k} {v}' for k, v in statements.items())})"
    )
    print(f"edges to cut until no import cycle is left: {cycles}; lines with Any: {any_lines}")
    with tempfile.TemporaryDirectory() as folder:
        ended = subprocess.run(
            [sys.executable, "-c", FOLLOW, chosen.scene, str(Path(folder) / "run")],
            cwd=root, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": str(root)},
        )  # fmt: skip
    for line in ended.stdout.splitlines():
        if line.startswith("ENTERED"):
            entered = line.split()[1:]
            print(
                f"{chosen.scene} from the command to the first tick enters {len(entered)} modules: {', '.join(entered)}"
            )
        if line.startswith("CALLS") and (root / "tests" / "test_architecture.py").is_file():
            up = [pair for pair in line.split()[1:] if climbs(root, *pair.split(">"))]
            print(f"calls to a module of a higher layer: {len(up)}: {', '.join(up)}")


if __name__ == "__main__":
    main()
