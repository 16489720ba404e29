"""Make the atlas: run every page's sweep, judge it, ask the engine, and write pictures, data and one HTML file."""

import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.evaluation.atlas.drawing import picture
from tissue.evaluation.atlas.entry import Entry, document
from tissue.evaluation.atlas.page import Data, Page
from tissue.system.outputs import require_free_folder, write_columns

__all__ = ["chosen_pages", "write_atlas"]

INDEX = "index.html"


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
    require_free_folder(folder, [INDEX], "atlas", overwrite=overwrite)
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for number, page in enumerate(pages):
        progress(page.title, number / len(pages))
        entry, data = _made(page)
        (folder / f"{page.name}.png").write_bytes(entry.picture)
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
