"""``tissue compare``."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from tissue.cli.terminal import console, left_out

__all__ = ["compare"]


def compare(
    *folders: Path,
    out: Path | None = None,
    over: Literal["time", "depth"] = "time",
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Compare runs with the first of them: their scenes, figures and forces.

    Parameters
    ----------
    folders
        Folders of two or more runs that `tissue run` wrote.
    out
        Folder for the picture and the table; without it they are only printed.
    over
        Abscissa of the picture: time, or depth of the tool's tip from its first contact.
    overwrite
        Replace the comparison that the folder already holds.
    """
    from rich.table import Table

    from tissue.objects.comparison import FILES, KIND
    from tissue.objects.comparison import compare as compared
    from tissue.system.owned_folder import require_folder

    if out is None:
        left_out("without --out, for nothing is written", "remove it", overwrite=overwrite)
        left_out(
            "without --out, for nothing is drawn",
            "remove it",
            over=over if over != "time" else None,
        )
    if out is not None:
        require_folder(out, KIND, FILES, overwrite=overwrite)
    found = compared(*folders)
    titles, rows = found.texts()
    table = Table(titles[0])
    for title in titles[1:]:
        table.add_column(title, justify="right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    console.print(*found.lines(), sep="\n")
    if out is not None:
        written = found.save(out, over=over, overwrite=overwrite)
        console.print(f"files in {out}: {', '.join(path.name for path in written)}")
