"""Report of a run as one HTML file to share."""

from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.objects.run import Run

__all__ = ["report"]


def report(
    run: Run | str | Path,
    out: str | Path | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a run as one HTML file that needs no network.

    It shows figures, forces, and the bone or organ in 3D over time.

    Parameters
    ----------
    run
        Run, or the folder that it was saved to.
    out
        HTML file to write; default ``report.html`` in the run's folder.
    overwrite
        Replace an existing file.
    progress
        Called with the present work.

    Returns
    -------
    The file.

    Raises
    ------
    InputError
        If ``out`` is missing for a run that was not saved, the folder holds no run or damaged
        files, or the file exists.
    """
    from tissue.show.report.report import NAME, write_report

    if not isinstance(run, Run):
        return write_report(run, out, overwrite=overwrite, progress=progress)
    if out is None and run.path is None:
        raise InputError(
            "out", "be given for a run that was not saved", "nothing", 'use for example "run.html"'
        )
    out = run.path / NAME if out is None and run.path is not None else out
    return write_report(run._folder(), out, overwrite=overwrite, progress=progress)
