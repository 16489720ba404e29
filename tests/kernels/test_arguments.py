"""Rule for kernel arguments: an argument ends in ``_out`` if and only if the kernel writes it.

Writing through functions that the kernel calls counts.
"""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import kernels

FOLDER = Path(kernels.__file__).parent


@cache
def functions() -> dict[tuple[str, str], ast.FunctionDef]:
    """Kernels and functions by module and name, imported ones under the importing module, too."""
    trees = {path.stem: ast.parse(path.read_text()) for path in sorted(FOLDER.glob("*.py"))}
    found = {
        (module, node.name): node
        for module, tree in trees.items()
        for node in tree.body
        if is_warp(node, "func", "kernel")
    }
    for module, tree in trees.items():
        for node in tree.body:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("kernels."):
                source = node.module.split(".")[1]
                for name in node.names:
                    if (source, name.name) in found:
                        found[module, name.name] = found[source, name.name]
    return found


def is_warp(node: ast.AST, *kinds: str) -> bool:
    return isinstance(node, ast.FunctionDef) and any(
        ast.unparse(each) in {f"wp.{kind}" for kind in kinds} for each in node.decorator_list
    )


def names(node: ast.FunctionDef) -> list[str]:
    return [each.arg for each in node.args.args]


def stored(node: ast.FunctionDef) -> Iterator[str]:
    """Yield names of which an entry is assigned, such as ``a`` in ``a.b[i] = c``.

    A struct's own copy is not an entry.
    """
    for each in ast.walk(node):
        if isinstance(each, ast.Assign | ast.AugAssign):
            for target in each.targets if isinstance(each, ast.Assign) else [each.target]:
                entry = False
                while isinstance(target, ast.Subscript | ast.Attribute):
                    entry = entry or isinstance(target, ast.Subscript)
                    target = target.value
                if entry and isinstance(target, ast.Name):
                    yield target.id


@cache
def written() -> dict[tuple[str, str], set[str]]:
    """Arguments that each function writes, until no call adds another."""
    found = functions()
    result = {key: set(stored(node)) & set(names(node)) for key, node in found.items()}
    grown = True
    while grown:
        grown = False
        for (module, name), node in found.items():
            for call in ast.walk(node):
                callee = (
                    (module, call.func.id)
                    if isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
                    else None
                )
                if callee in found:
                    for argument, given in zip(names(found[callee]), call.args, strict=True):
                        base = given
                        while isinstance(base, ast.Attribute):
                            base = base.value
                        if (
                            argument in result[callee]
                            and isinstance(base, ast.Name)
                            and base.id in names(node)
                        ):
                            grown = grown or base.id not in result[module, name]
                            result[module, name].add(base.id)
    return result


KERNELS = [key for key, node in functions().items() if is_warp(node, "kernel")]


@pytest.mark.parametrize("key", KERNELS, ids=".".join)
def test_what_a_kernel_writes_ends_in_out(key):
    outputs = {name for name in names(functions()[key]) if name.endswith("_out")}
    assert written()[key] == outputs
    assert outputs


@pytest.mark.parametrize(
    "module",
    sorted(
        path.stem for path in FOLDER.glob("[!_]*.py") if path.stem not in ("arrays", "constants")
    ),
)
def test_every_module_of_kernels_has_tests_of_its_own(module):
    assert (Path(__file__).parent / f"test_{module}.py").is_file()
