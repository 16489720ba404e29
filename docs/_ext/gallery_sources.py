"""Sphinx extension that copies the examples to the folder that sphinx-gallery reads.

The first line of each docstring becomes the title of its page.
"""

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.config import Config

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "build" / "gallery"


def titled(code: str) -> str:
    """Return an example's code with the first line of its docstring underlined as a title.

    The full stop is removed. A line that is underlined already stays.
    """
    found = re.match(r'"""(.+)\n(?![=*#-]{3})', code)
    if found is None:
        return code
    title = found[1].rstrip(".")
    return f'"""{title}\n{"=" * len(title)}\n' + code[found.end() :]


def place_sources(app: Sphinx, config: Config) -> None:
    """Write the folder that sphinx-gallery reads; a file that stays the same keeps its time."""
    SOURCES.mkdir(parents=True, exist_ok=True)
    wanted = {
        path.name: titled(path.read_text("utf-8")) for path in (ROOT / "examples").glob("*.py")
    }
    wanted["GALLERY_HEADER.rst"] = (ROOT / "docs" / "_gallery_header.rst").read_text("utf-8")
    for path in SOURCES.iterdir():
        if path.is_file() and path.name not in wanted:
            path.unlink()
    for name, text in wanted.items():
        path = SOURCES / name
        if not path.is_file() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    # before sphinx-gallery looks for its files
    app.connect("config-inited", place_sources, priority=1)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
