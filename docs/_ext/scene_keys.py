"""Links from code such as ``tool.flutes`` to the row of the key on the page of scene keys."""

from collections.abc import Iterable
from typing import Any

from docutils import nodes
from scene_tables import anchors
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform

PAGE = "scene_keys"


class LinkedKeys(SphinxPostTransform):
    """Code that names a key of a scene, with or without a value, links to its row."""

    default_priority = 500

    def run(self, **options: Any) -> None:
        """Turn the literals of a page that name a key into links."""
        if self.env.docname == PAGE or PAGE not in self.env.all_docs:
            return
        known = anchors()
        page = self.app.builder.get_relative_uri(self.env.docname, PAGE)
        for literal in list(self.document.findall(nodes.literal)):
            name = literal.astext().partition("=")[0].strip()
            if name in known and not isinstance(literal.parent, nodes.reference | nodes.title):
                link = nodes.reference(
                    "", "", literal.deepcopy(), refuri=f"{page}#{name}", internal=True
                )
                literal.replace_self(link)


def inline(text: str) -> Iterable[nodes.Node]:
    """Text with code in single backticks."""
    for place, piece in enumerate(text.replace("``", "`").split("`")):
        if piece:
            yield nodes.literal("", piece) if place % 2 else nodes.Text(piece)


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_post_transform(LinkedKeys)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
