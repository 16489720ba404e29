"""Check the links of a built site without a network: python .ci/links.py docs/_build/html

Every internal link leads to a file of the site and to an id in it, no id stands twice in a page,
addresses elsewhere have a host, and nothing that a page loads lies elsewhere. Prints what does not
hold, and then ends with 1.
"""

import sys
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {
    ("script", "src"),
    ("img", "src"),
    ("link", "href"),
    ("iframe", "src"),
    ("source", "src"),
    ("video", "src"),
}
"""Tags and attributes of files that a browser loads with a page, except links in `RELATIONS`."""
RELATIONS = {"canonical", "next", "prev", "search", "index", "author", "copyright"}


class Page(HTMLParser):
    """Ids, links and loaded files of one page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.ids: Counter[str] = Counter()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep the id of a tag, what it links to and what it loads."""
        values = {name: value or "" for name, value in attrs}
        self.ids.update(filter(None, [values.get("id")]))
        for name in ("href", "src"):
            if name in values:
                self.links.add(values[name])
                if (tag, name) in LOADED and values.get("rel") not in RELATIONS:
                    self.loaded.add(values[name])


def problems(site: Path) -> list[str]:
    """A sentence for each thing that is wrong in a site."""
    pages = {
        path: Page(path) for path in sorted(site.rglob("*.html")) if "_static" not in path.parts
    }
    found = [] if pages else [f"{site} must hold a built site, got no page"]
    for path, page in pages.items():
        name = path.relative_to(site)
        found += [
            f"{name}: the id {each} stands {count} times"
            for each, count in page.ids.items()
            if count > 1
        ]
        found += [
            f"{name}: {link} is fetched from elsewhere" for link in page.loaded if "//" in link[:8]
        ]
        for link in sorted(page.links):
            parts = urlsplit(link)
            if parts.scheme in ("http", "https"):
                found += (
                    []
                    if "." in parts.netloc and " " not in link
                    else [f"{name}: {link} has no host"]
                )
            elif not parts.scheme:
                target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
                target = target / "index.html" if target.is_dir() else target
                if not target.exists():
                    found.append(f"{name}: {link} leads to no file")
                elif (
                    parts.fragment
                    and target in pages
                    and unquote(parts.fragment) not in pages[target].ids
                ):
                    found.append(f"{name}: {link} leads to no such place")
    return found


if __name__ == "__main__":
    wrong = problems(Path(sys.argv[1]).resolve())
    print("\n".join(wrong) or "all links of the site lead somewhere")
    sys.exit(bool(wrong))
