"""Self-contained HTML files with embedded pictures, for light and dark mode."""

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

    The page has a content security policy with the hashes of its style and scripts. A browser
    therefore runs no other script, even if a text in the body contains one, and loads nothing from
    the network.

    Parameters
    ----------
    title
        Plain text; this function escapes it.
    body
        HTML of the body. The caller must escape the texts in it.
    style
        CSS in addition to the style that all pages share.
    scripts, modules
        Classic scripts and module scripts, in the order in which they run. They are placed at the
        end of the body.
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
    """Return a script element that the content security policy of `html_page` allows."""
    kind = ' type="module"' if module else ""
    return f"<script{kind}>{_plain_lines(text)}</script>"


def _plain_lines(text: str) -> str:
    """Replace line ends by line feeds, as a browser does before it computes a hash."""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _hash(text: str) -> str:
    """Return the hash expression of a content security policy for an inline script or style."""
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode('ascii')}'"


def html_picture(title: str, data: bytes, kind: str = "image/png") -> str:
    """Return an image element with an embedded picture; `kind` is its media type."""
    return (
        f'<img alt="{escape(title)}" src="data:{kind};base64,{b64encode(data).decode("ascii")}">\n'
    )


def html_list(lines: Iterable[str], text: Callable[[str], str] = escape) -> str:
    """Return an HTML list of texts; `text` is the function that converts each text to HTML."""
    return "<ul>" + "".join(f"<li>{text(line)}</li>" for line in lines) + "</ul>"
