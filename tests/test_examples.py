"""Examples use public names of tissue and common packages only.

They write pictures and check figures.
"""

import ast
import os
import re
from pathlib import Path

import pytest

import tissue

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("[0-9]*.py"))
COMMON = {
    "collections",
    "dataclasses",
    "gymnasium",
    "math",
    "matplotlib",
    "mujoco",
    "numpy",
    "pandas",
    "pathlib",
    "pyvista",
    "scipy",
    "tempfile",
    "typing",
}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_uses_public_names_alone(path):
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            assert {name.name.split(".")[0] for name in node.names} <= COMMON | {"tissue"}
            assert not any(name.name.startswith("tissue.") for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.module == "tissue" or node.module.split(".")[0] in COMMON, node.module
            assert node.module != "tissue" or {name.name for name in node.names} <= set(
                tissue.__all__
            )
        elif (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id == "tissue"
        ):
            assert node.attr in tissue.__all__
        assert not (isinstance(node, ast.Attribute) and node.attr.startswith("_")), "a private name"


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_a_page_with_a_picture_and_a_check(path):
    text = path.read_text("utf-8")
    title, line = ast.get_docstring(ast.parse(text)).splitlines()[:2]
    assert line == "=" * len(title) and not title.endswith(".")
    assert len(re.findall(r"^# %%$", text, re.MULTILINE)) >= 2 and "assert " in text
    pictures = re.findall(r'FIGURES / "(.+?\.png)"', text)
    assert pictures and all(name.startswith(path.stem[:3]) for name in pictures)


ROOT = Path(__file__).resolve().parents[1]


NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path, monkeypatch):
    nbclient = pytest.importorskip("nbclient", reason="nbclient is in the extra dev")
    pytest.importorskip("ipykernel", reason="ipykernel is in the extra dev")
    import nbformat

    book = nbformat.read(path, as_version=4)
    code = [cell for cell in book.cells if cell.cell_type == "code"]
    assert len(book.cells) <= 10 and not any(cell.outputs or cell.execution_count for cell in code)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    nbclient.NotebookClient(
        book, timeout=240, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    shown = {kind for cell in code for output in cell.outputs for kind in output.get("data", {})}
    assert {"image/png", "text/html"} <= shown
