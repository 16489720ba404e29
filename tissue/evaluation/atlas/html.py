"""The atlas as one HTML file that needs no other file: pictures embedded, plain style for light and dark."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from tissue.evaluation.atlas.page import Answer, Conduct, Page, Verdict

__all__ = ["Entry", "document"]

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


@dataclass(frozen=True)
class Entry:
    """A page with what was found: verdict, answers, picture as PNG, names of data files, seconds it took."""

    page: Page
    verdict: Verdict
    answers: Sequence[Answer]
    picture: bytes
    files: Sequence[str]
    took_s: float

    @property
    def shown(self) -> bool:
        """Whether the method failed as it should, the engine held, and no answer was silently wrong."""
        silent = any(answer.conduct is Conduct.SILENT for answer in self.answers)
        return self.verdict.fails and self.verdict.holds and not silent


def document(entries: Sequence[Entry], made: Mapping[str, str]) -> str:
    """The whole atlas; ``made`` states when, with what and on what machine."""
    good = sum(entry.shown for entry in entries)
    rows = "".join(
        f'<tr><td><a href="#{escape(e.page.name)}">{escape(e.page.title)}</a></td><td class="what">{_mark(e)}</td></tr>'
        for e in entries
    )
    facts = "; ".join(f"{escape(name)} {escape(value)}" for name, value in made.items())
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Stability atlas</title><style>{STYLE}</style></head><body>\n"
        "<h1>Stability atlas</h1>\n"
        "<p>Every method is taken to where it fails and past it; E1 to E14 number statements of a published haptic"
        " framework that do not hold. Points are measured by running it, lines are theory, "
        "and the background shows what the engine does there. Verdicts and answers are computed from the runs of this"
        " atlas.</p>\n"
        f"<p>{good} of {len(entries)} pages show their boundary, with the engine holding, falling back or refusing.</p>"
        f'\n<p class="soft">{facts}</p>\n<table><tr><th>page</th><th>the engine there</th></tr>{rows}</table>\n'
        + "\n".join(map(_section, entries))
        + "\n</body></html>\n"
    )


def _mark(entry: Entry) -> str:
    """What the engine does on a page, or that the page did not come out."""
    found = {answer.conduct for answer in entry.answers}
    return ", ".join(kind.value for kind in Conduct if kind in found) if entry.shown else "open: not as it should be"


def _section(entry: Entry) -> str:
    """One page."""
    page, image = entry.page, b64encode(entry.picture).decode("ascii")
    answers = "".join(
        f'<tr><td>{escape(a.asked)}</td><td class="what">{escape(a.conduct.value)}</td><td>{escape(a.result)}</td></tr>'
        for a in entry.answers
    )
    files = ", ".join(f'<a href="{escape(name)}">{escape(name)}</a>' for name in entry.files)
    return (
        f'<section id="{escape(page.name)}"><h2>{escape(page.title)}</h2>\n<p>{escape(page.question)}</p>\n'
        f'<img alt="{escape(page.title)}" src="data:image/png;base64,{image}">\n'
        f'<p class="verdict{"" if entry.shown else " open"}">{escape(entry.verdict.sentence)}</p>\n'
        f"<table><tr><th>the engine is asked for</th><th>and</th><th>reports</th></tr>{answers}</table>\n"
        f'<p class="soft">{escape(page.source)}. Data: {files}; {entry.took_s:.1f} s.</p></section>'
    )
