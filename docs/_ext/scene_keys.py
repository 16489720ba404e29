"""Sphinx directive ``scene-keys``.

It draws a table for each part of a scene, and code such as ``tool.flutes`` links there.
"""

from collections.abc import Iterable
from typing import Any

from docutils import nodes
from scene_tables import Group, Key, Part, parts
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.docutils import SphinxDirective

PAGE = "scene_keys"
TITLES = ("key", "unit", "takes", "default", "what")
WIDTHS = (22, 8, 22, 12, 36)


class SceneKeys(SphinxDirective):
    """Sections of the scene keys' page, one a part."""

    def run(self) -> list[nodes.Node]:
        """The sections; the page is read anew for every build, since scenes define its content."""
        self.env.note_dependency(__file__)
        self.env.note_reread()
        return [_section(part) for part in parts()]


class LinkedKeys(SphinxPostTransform):
    """Code that names a key of a scene, with or without a value, links to its row."""

    default_priority = 500

    def run(self, **options: Any) -> None:
        """Turn the literals of a page that name a key into links."""
        if self.env.docname == PAGE or PAGE not in self.env.all_docs:
            return
        known = {
            _anchor(part, key)
            for part in parts()
            for group in part.groups
            for key in group.keys
            if part.name
        }
        page = self.app.builder.get_relative_uri(self.env.docname, PAGE)
        for literal in list(self.document.findall(nodes.literal)):
            name = literal.astext().partition("=")[0].strip()
            if name in known and not isinstance(literal.parent, nodes.reference | nodes.title):
                link = nodes.reference(
                    "", "", literal.deepcopy(), refuri=f"{page}#{name}", internal=True
                )
                literal.replace_self(link)


def _section(part: Part) -> nodes.section:
    name = part.name or "top"
    title = (
        nodes.title("", "", nodes.literal("", f"[{name}]"))
        if part.name
        else nodes.title("", "Top of the file")
    )
    section = nodes.section(
        "", title, nodes.paragraph("", "", *inline(part.text)), ids=[f"part-{name}"], names=[name]
    )
    if part.kinds:
        kinds = ", ".join(f"`{kind}`" for kind in part.kinds)
        section += nodes.paragraph(
            "", "", *inline(f"`kind` is one of {kinds}."), ids=[f"{name}.kind"]
        )
    seen: set[str] = set()
    for group in part.groups:
        if len(part.groups) == 1:
            section += _table(part, group, seen)
            continue
        heading = ", ".join(f"`{kind}`" for kind in group.kinds)
        inner = nodes.section(
            "", nodes.title("", "", *inline(heading)), ids=[f"{name}-{'-'.join(group.kinds)}"]
        )
        if group.text:
            inner += nodes.paragraph("", "", *inline(group.text))
        inner += _table(part, group, seen)
        section += inner
    return section


def _table(part: Part, group: Group, seen: set[str]) -> nodes.table:
    columns = [nodes.colspec(colwidth=width) for width in WIDTHS]
    head = nodes.thead(
        "", nodes.row("", *(nodes.entry("", nodes.paragraph("", title)) for title in TITLES))
    )
    body = nodes.tbody("", *(_row(part, key, seen) for key in group.keys))
    return nodes.table(
        "", nodes.tgroup("", *columns, head, body, cols=len(TITLES)), classes=["scene-keys"]
    )


def _row(part: Part, key: Key, seen: set[str]) -> nodes.row:
    """A row; the first of its name carries the anchor."""
    cells = (f"`{key.name}`", key.unit, key.takes, key.default, key.text)
    row = nodes.row(
        "", *(nodes.entry("", nodes.paragraph("", "", *inline(cell))) for cell in cells)
    )
    anchor = _anchor(part, key)
    if anchor not in seen:
        row["ids"].append(anchor)
        seen.add(anchor)
    return row


def _anchor(part: Part, key: Key) -> str:
    return f"{part.name}.{key.name}" if part.name else key.name


def inline(text: str) -> Iterable[nodes.Node]:
    """Text with code in single backticks."""
    for place, piece in enumerate(text.replace("``", "`").split("`")):
        if piece:
            yield nodes.literal("", piece) if place % 2 else nodes.Text(piece)


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("scene-keys", SceneKeys)
    app.add_post_transform(LinkedKeys)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
