"""Sphinx directive ``package-table``.

It lists the modules of a package with the first line of each docstring.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

from docutils import nodes
from scene_keys import inline
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]


def modules_of(package: str) -> Iterator[tuple[str, str]]:
    """Dotted names of a package's modules and what each is, read without importing them."""
    for path in sorted((ROOT / package.replace(".", "/")).rglob("*.py")):
        text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
        name = (
            path.relative_to(ROOT)
            .with_suffix("")
            .as_posix()
            .removesuffix("/__init__")
            .replace("/", ".")
        )
        if text:
            yield name, text.splitlines()[0]


class PackageTable(SphinxDirective):
    """Two columns: module, and what it is."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The table of the package that the directive names."""
        body = nodes.tbody()
        for name, text in modules_of(self.arguments[0]):
            cells = (f"`{name}`", text)
            body += nodes.row(
                "", *(nodes.entry("", nodes.paragraph("", "", *inline(cell))) for cell in cells)
            )
        columns = [nodes.colspec(colwidth=width) for width in (35, 65)]
        return [nodes.table("", nodes.tgroup("", *columns, body, cols=2))]


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("package-table", PackageTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
