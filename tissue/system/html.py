"""HTML files that need no other file: pictures embedded, one plain style for light and dark."""

from base64 import b64encode
from html import escape

__all__ = ["html_page", "html_picture"]

STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #fdfdfb; --soft: #666; --line: #ccc; --box: #f3f3ef; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8e6e1; --paper: #181a1b; --soft: #a5a29b; --line: #444; --box: #222526; }
}
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 62rem;
  margin: 0 auto; padding: 1.5rem; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.25rem; margin: 3rem 0 .3rem; border-top: 1px solid var(--line);
  padding-top: 1.2rem; }
img { width: 100%; height: auto; background: white; border: 1px solid var(--line); }
table { border-collapse: collapse; width: 100%; font-size: .92rem; } th { text-align: left; color: var(--soft); }
td, th { padding: .3rem .6rem .3rem 0; vertical-align: top; border-bottom: 1px solid var(--line); }
td { overflow-wrap: anywhere; } .what { white-space: nowrap; font-weight: 600; } a { color: inherit; }
.verdict { background: var(--box); padding: .6rem .9rem; border-left: .3rem solid #009E73; }
.open { border-left-color: #D55E00; } .soft { color: var(--soft); font-size: .9rem; }
"""


def html_page(title: str, body: str, *, style: str = "", head: str = "") -> str:
    """A whole file of this title, with more style and elements of its head if need be."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"{head}<title>{title}</title><style>{STYLE}{style}</style></head><body>\n<h1>{title}</h1>\n{body}\n</body></html>\n"
    )


def html_picture(title: str, png: bytes) -> str:
    """A picture within the file."""
    return f'<img alt="{escape(title)}" src="data:image/png;base64,{b64encode(png).decode("ascii")}">\n'
