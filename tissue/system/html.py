"""Self-contained HTML files with embedded pictures and one style for light and dark mode."""

from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from hashlib import sha256
from html import escape

STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #fdfdfb; --soft: #666;
  --line: #ccc; --box: #f3f3ef; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8e6e1; --paper: #181a1b; --soft: #a5a29b; --line: #444; --box: #222526; }
}
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 62rem; margin: 0 auto; padding: 1.5rem; }
h1 { font-size: 1.7rem; }
h2 { font-size: 1.25rem; margin: 3rem 0 .3rem; border-top: 1px solid var(--line);
  padding-top: 1.2rem; }
img { width: 100%; height: auto; background: white; border: 1px solid var(--line); }
table { border-collapse: collapse; width: 100%; font-size: .92rem; }
th { text-align: left; color: var(--soft); }
td, th { padding: .3rem .6rem .3rem 0; vertical-align: top; border-bottom: 1px solid var(--line); }
td { overflow-wrap: anywhere; } .what { white-space: nowrap; font-weight: 600; }
a { color: inherit; }
.verdict { background: var(--box); padding: .6rem .9rem; border-left: .3rem solid #009E73; }
.open { border-left-color: #D55E00; } .soft { color: var(--soft); font-size: .9rem; }
"""


def html_page(
    title: str,
    body: str,
    *,
    style: str = "",
    scripts: Sequence[str] = (),
    modules: Sequence[str] = (),
) -> str:
    """Return a self-contained HTML file.

    The page has a content security policy that lists its own style and scripts by their hashes. A
    browser therefore runs no other script, even if the body contains a text with markup from a
    user. It also loads nothing from the network.

    Parameters
    ----------
    title
        Plain text; this function escapes it.
    body
        HTML. The caller must escape texts in it.
    style
        CSS in addition to the style that all pages share.
    scripts, modules
        Classic scripts and module scripts, in the order in which they run, at the end of the body.
    """
    style = _plain_lines(STYLE + style)
    programs = [
        *(script_element(text) for text in scripts),
        *(script_element(text, module=True) for text in modules),
    ]
    allowed = " ".join(_hash(_plain_lines(text)) for text in (*scripts, *modules)) or "'none'"
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src {_hash(style)}; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><link '
        'rel="icon" href="data:,">'
        f"<title>{escape(title)}</title><style>{style}</style></head><body>\n<h1>{escape(title)}</h1>\n{body}\n"
        + "\n".join(programs)
        + "\n</body></html>\n"
    )


def script_element(text: str, *, module: bool = False) -> str:
    """Return a script element whose text has the hash that `html_page` allows."""
    kind = ' type="module"' if module else ""
    return f"<script{kind}>{_plain_lines(text)}</script>"


def _plain_lines(text: str) -> str:
    """Return a text with only line feeds, as a browser normalises it before it computes a hash."""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _hash(text: str) -> str:
    """Return the source expression with which a content security policy allows an inline text."""
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode('ascii')}'"


def html_picture(title: str, data: bytes, kind: str = "image/png") -> str:
    """Return an image element with the embedded picture of a media type."""
    return (
        f'<img alt="{escape(title)}" src="data:{kind};base64,{b64encode(data).decode("ascii")}">\n'
    )


def html_list(lines: Iterable[str], text: Callable[[str], str] = escape) -> str:
    """Return a list of plain texts; `text` converts each of them to HTML."""
    return "<ul>" + "".join(f"<li>{text(line)}</li>" for line in lines) + "</ul>"
