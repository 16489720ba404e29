"""``tissue assess``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tissue.cli.terminal import console, left_out

__all__ = ["assess"]


def assess(
    folder: Path,
    /,
    *,
    against: Path,
    force_limit_n: Annotated[float | None, Parameter(name="--force-limit-N")] = None,
    deviation_limit_mm: float = 1.0,
    overshoot_limit_mm: float = 0.5,
    out: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Assess a trainee's run against a reference run of the same scene.

    Parameters
    ----------
    folder
        Folder of the trainee's run, that `tissue run` wrote.
    against
        Folder of the reference run.
    force_limit_n
        Force that should not be exceeded, in newtons; default 1.25 times the reference's peak.
    deviation_limit_mm
        Distance from the reference's path that should not be exceeded.
    overshoot_limit_mm
        Largest allowed distance of the tip below the reference's deepest point.
    out
        Folder for the picture and the figures; without it they are only printed.
    overwrite
        Replace the assessment that the folder already holds.
    """
    from tissue.evaluation.assessment import require_assessment_folder
    from tissue.objects.assess import assess as compare

    if out is None:
        left_out("without --out, for nothing is written", "remove it", overwrite=overwrite)
    else:
        require_assessment_folder(out, overwrite=overwrite)
    found = compare(
        folder,
        against,
        force_limit_N=force_limit_n,
        deviation_limit_mm=deviation_limit_mm,
        overshoot_limit_mm=overshoot_limit_mm,
    )
    console.print(str(found))
    if out is not None:
        written = found.save(out, overwrite=overwrite)
        console.print(f"files in {out}: {', '.join(path.name for path in written)}")
