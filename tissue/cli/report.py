"""``tissue report``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tissue.cli.terminal import console, progress

__all__ = ["report"]


def report(
    folder: Path,
    /,
    *,
    out: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write a run as one HTML file to share, which needs no network.

    Parameters
    ----------
    folder
        Folder that `tissue run` wrote.
    out
        HTML file to write; default report.html in the folder.
    overwrite
        Replace an existing file.
    """
    from tissue.show.report.report import write_report

    with progress() as shown:
        written = write_report(folder, out, overwrite=overwrite, progress=shown)
    console.print(f"{written}: {written.stat().st_size / 1e6:.1f} MB")
