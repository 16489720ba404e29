"""Make the atlas: run every page's sweep, judge it, ask the engine, and write pictures, data and one HTML file."""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.evaluation.atlas.drawing import picture
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict
from tissue.system.html import html_page, html_picture
from tissue.system.outputs import write_columns
from tissue.system.owned_folder import owned_folder

__all__ = ["chosen_pages", "write_atlas"]

INDEX = "index.html"


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
    return html_page(
        "Stability atlas",
        "<p>Every method is taken to where it fails and past it; E1 to E14 number statements of a published haptic"
        " framework that do not hold. Points are measured by running it, lines are theory, "
        "and the background shows what the engine does there. Verdicts and answers are computed from the runs of this"
        " atlas.</p>\n"
        f"<p>{good} of {len(entries)} pages show their boundary, with the engine holding, falling back or refusing.</p>"
        f'\n<p class="soft">{facts}</p>\n<table><tr><th>page</th><th>the engine there</th></tr>{rows}</table>\n'
        + "\n".join(map(_section, entries)),
    )


def _mark(entry: Entry) -> str:
    """What the engine does on a page, or that the page did not come out."""
    found = {answer.conduct for answer in entry.answers}
    return ", ".join(kind.value for kind in Conduct if kind in found) if entry.shown else "open: not as it should be"


def _section(entry: Entry) -> str:
    """One page."""
    page = entry.page
    answers = "".join(
        f'<tr><td>{escape(a.asked)}</td><td class="what">{escape(a.conduct.value)}</td><td>{escape(a.result)}</td></tr>'
        for a in entry.answers
    )
    files = ", ".join(f'<a href="{escape(name)}">{escape(name)}</a>' for name in entry.files)
    return (
        f'<section id="{escape(page.name)}"><h2>{escape(page.title)}</h2>\n<p>{escape(page.question)}</p>\n'
        f"{html_picture(page.title, entry.picture)}"
        f'<p class="verdict{"" if entry.shown else " open"}">{escape(entry.verdict.sentence)}</p>\n'
        f"<table><tr><th>the engine is asked for</th><th>and</th><th>reports</th></tr>{answers}</table>\n"
        f'<p class="soft">{escape(page.source)}. Data: {files}; {entry.took_s:.1f} s.</p></section>'
    )


def chosen_pages(pages: Sequence[Page], only: Sequence[str]) -> tuple[Page, ...]:
    """Pages of these names, or all where none is named.

    Raises
    ------
    InputError
        If a name is not one of a page.
    """
    names = [page.name for page in pages]
    if unknown := [name for name in only if name not in names]:
        raise InputError(f"only must be one of {', '.join(names)}, got {unknown[0]}: choose one of these")
    return tuple(page for page in pages if not only or page.name in only)


def _made(page: Page) -> tuple[Entry, Data]:
    """Run a page's sweep, judge it, ask the engine and draw."""
    started = perf_counter()
    data = page.measure(False)
    verdict, answers, drawn = page.judge(data), page.ask(), picture(page, data)
    files = [f"{page.name}.png", *(f"{page.name}_{table}.csv" for table in data)]
    return Entry(page, verdict, answers, drawn, files, perf_counter() - started), data


def write_atlas(
    folder: Path, pages: Sequence[Page], *, overwrite: bool = False, progress: Progress = silent
) -> list[Entry]:
    """Make these pages and write ``index.html`` with a picture and the data (CSV) of each beside it.

    Raises
    ------
    InputError
        If the folder is a file, or holds an atlas that is not to be replaced.
    """
    names = [INDEX, *(f"{page.name}{end}" for page in pages for end in (".png", "_*.csv"))]
    with owned_folder(folder, "atlas", names, overwrite=overwrite):
        return _write_pages(folder, pages, progress)


def _write_pages(folder: Path, pages: Sequence[Page], progress: Progress) -> list[Entry]:
    """Make pages and write their files into a folder that is held."""
    entries = []
    for number, page in enumerate(pages):
        progress(page.title, number / len(pages))
        entry, data = _made(page)
        with whole_file(folder / f"{page.name}.png") as temporary:
            temporary.write_bytes(entry.picture)
        for table, columns in data.items():
            write_columns(folder / f"{page.name}_{table}.csv", columns)
        entries.append(entry)
    made = {
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": f"{platform.machine()}, {platform.system()}",
        "Python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "warp-lang")},
    }
    with whole_file(folder / INDEX) as temporary:
        temporary.write_text(document(entries, made), "utf-8")
    return entries
