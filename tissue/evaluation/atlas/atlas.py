"""Stability atlas: run every page, judge it, ask the engine, and write pictures, data and one
HTML file.
"""

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
from tissue.evaluation.atlas.bone_tooth import Contrast, CutCells, ExplicitCutting
from tissue.evaluation.atlas.organs import BadTetrahedra, LargeRotation, Locking
from tissue.evaluation.atlas.page import Answer, Conduct, Page, Verdict, picture
from tissue.evaluation.atlas.prediction import Horizon, TrainedElsewhere
from tissue.evaluation.atlas.samples import LostSamples, WildInput
from tissue.evaluation.atlas.walls import Quantisation, ThinWalls, WallMap
from tissue.system.html import html_page, html_picture
from tissue.system.outputs import write_columns
from tissue.system.owned_folder import owned_folder

__all__ = ["PAGES", "chosen_pages", "write_atlas"]

INDEX = "index.html"
PAGES: tuple[Page, ...] = (
    WallMap(),
    Quantisation(),
    ExplicitCutting(),
    ThinWalls(),
    Locking(),
    LargeRotation(),
    BadTetrahedra(),
    CutCells(),
    Contrast(),
    TrainedElsewhere(),
    Horizon(),
    LostSamples(),
    WildInput(),
)
"""Pages in the order of the atlas."""


@dataclass(frozen=True)
class Entry:
    """A page with its results: verdict, answers, picture as PNG, names of data files, duration
    [s].
    """

    page: Page
    verdict: Verdict
    answers: Sequence[Answer]
    picture: bytes
    files: Sequence[str]
    took_s: float

    @property
    def shown(self) -> bool:
        """True if the questioned method failed, the engine held, and no answer was silent.

        A silent answer is a wrong answer without a message.
        """
        silent = any(answer.conduct is Conduct.SILENT for answer in self.answers)
        return self.verdict.fails and self.verdict.holds and not silent


def chosen_pages(only: Sequence[str]) -> tuple[Page, ...]:
    """Return the pages of these names, or all pages if there are no names.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    names = [page.name for page in PAGES]
    if unknown := [name for name in only if name not in names]:
        raise InputError("only", f"be one of {', '.join(names)}", unknown[0], "choose one of these")
    return tuple(page for page in PAGES if not only or page.name in only)


def write_atlas(
    folder: Path,
    pages: Sequence[Page] = PAGES,
    *,
    overwrite: bool = False,
    progress: Progress = silent,
) -> list[Entry]:
    """Run pages and write ``index.html``, with a picture and the data (CSV) of each page.

    Raises
    ------
    InputError
        If the folder is a file, or holds an atlas and `overwrite` is false.
    """
    names = [INDEX, *(f"{page.name}{end}" for page in pages for end in (".png", "_*.csv"))]
    entries = []
    with owned_folder(folder, "atlas", names, overwrite=overwrite):
        for number, page in enumerate(pages):
            progress(page.title, number / len(pages))
            entries.append(_written(page, folder))
        with whole_file(folder / INDEX) as temporary:
            temporary.write_text(_document(entries), "utf-8")
    return entries


def _written(page: Page, folder: Path) -> Entry:
    """Run a page and write its picture and data."""
    started = perf_counter()
    data = page.measure()
    verdict = page.judge(data)
    answers = page.ask()
    drawn = picture(page, data)
    took_s = perf_counter() - started
    with whole_file(folder / f"{page.name}.png") as temporary:
        temporary.write_bytes(drawn)
    for table, columns in data.items():
        write_columns(folder / f"{page.name}_{table}.csv", columns)
    files = [f"{page.name}.png", *(f"{page.name}_{table}.csv" for table in data)]
    return Entry(page, verdict, answers, drawn, files, took_s)


def _document(entries: Sequence[Entry]) -> str:
    """Return the whole atlas as HTML."""
    good = sum(entry.shown for entry in entries)
    rows = "".join(
        (
            f'<tr><td><a href="#{escape(e.page.name)}">{escape(e.page.title)}</a></td><td '
            f'class="what">{_mark(e)}</td></tr>'
        )
        for e in entries
    )
    facts: Mapping[str, str] = {
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": f"{platform.machine()}, {platform.system()}",
        "Python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "warp-lang")},
    }
    made = "; ".join(f"{escape(name)} {escape(value)}" for name, value in facts.items())
    return html_page(
        "Stability atlas",
        "<p>Each page takes a method past its region of failure. Points are measured, lines "
        "are theory, and the "
        "background shows the behaviour of the engine. Verdicts and answers are computed "
        "from the runs of this atlas."
        f"</p>\n<p>{good} of {len(entries)} pages show their boundary, with the engine "
        "holding, falling back or "
        f'refusing.</p>\n<p class="soft">{made}</p>\n<table><tr><th>page</th><th>behaviour '
        "of the engine</th></tr>"
        f"{rows}</table>\n" + "\n".join(map(_section, entries)),
    )


def _mark(entry: Entry) -> str:
    """Return the behaviour of the engine on a page, or that the page is open."""
    found = {answer.conduct for answer in entry.answers}
    return (
        ", ".join(kind.value for kind in Conduct if kind in found)
        if entry.shown
        else "open: not as it should be"
    )


def _section(entry: Entry) -> str:
    """Return one page as HTML."""
    page = entry.page
    answers = "".join(
        (
            f"<tr><td>{escape(a.asked)}</td><td "
            f'class="what">{escape(a.conduct.value)}</td><td>{escape(a.result)}</td></tr>'
        )
        for a in entry.answers
    )
    files = ", ".join(f'<a href="{escape(name)}">{escape(name)}</a>' for name in entry.files)
    return (
        "<section "
        f'id="{escape(page.name)}"><h2>{escape(page.title)}</h2>\n<p>{escape(page.question)}</p>\n'
        f"{html_picture(page.title, entry.picture)}"
        f'<p class="verdict{"" if entry.shown else " open"}">{escape(entry.verdict.sentence)}</p>\n'
        f"<table><tr><th>request</th><th>the engine</th><th>report</th></tr>{answers}</table>\n"
        f'<p class="soft">{escape(page.source)}. Data: {files}; {entry.took_s:.1f} s.</p></section>'
    )
