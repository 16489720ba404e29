"""Assessment of a trainee's run against a reference run of the same scene: `tissue.assess`.

The command `tissue assess` does the same.
"""

from contextlib import suppress
from pathlib import Path

from meshes.base.errors import InputError
from tissue.evaluation import assessment as engine
from tissue.evaluation.assessment import write_assessment
from tissue.objects.run import Run

__all__ = ["Assessment", "assess"]


class Assessment(engine.Assessment):
    """Comparison of a trainee's run with the reference; ``print`` shows a readable report."""

    def __str__(self) -> str:
        return "\n".join(engine.assessment_lines(self))

    def save(self, folder: str | Path, *, overwrite: bool = False) -> list[Path]:
        """Write ``assessment.json`` and ``assessment.png``.

        Raises
        ------
        InputError
            If the folder is a file, or holds another assessment and `overwrite` is not given.
        """
        return write_assessment(self, Path(folder), overwrite=overwrite)


def assess(
    trainee: Run | str | Path,
    reference: Run | str | Path,
    *,
    force_limit_N: float | None = None,
    deviation_limit_mm: float = 1.0,
    overshoot_limit_mm: float = 0.5,
) -> Assessment:
    """Compare a trainee's run with a reference run of the same scene.

    The runs are aligned by position, so a pause is no error.

    Parameters
    ----------
    trainee, reference
        Runs, or folders of runs.
    force_limit_N
        Force on the tool that should not be exceeded [N]; default 1.25 times the reference's peak.
    deviation_limit_mm
        Distance from the reference's path that should not be exceeded [mm].
    overshoot_limit_mm
        Largest allowed distance of the tip below the reference's deepest point [mm].

    Raises
    ------
    InputError
        If the runs are of two tasks (different anatomy, tool or material), have no trace, or never
        touch.
    """
    found = engine.assess(
        _held(trainee),
        _held(reference),
        force_limit_N=force_limit_N,
        deviation_limit_mm=deviation_limit_mm,
        overshoot_limit_mm=overshoot_limit_mm,
    )
    return Assessment(**vars(found))


def _held(run: Run | str | Path) -> engine.AssessedRun:
    """Return the parts of a run that an assessment reads."""
    run = run if isinstance(run, Run) else Run.load(run)
    scene = None
    with suppress(InputError):  # a run without scene.toml can be assessed too
        scene = run.scene
    return engine.AssessedRun(run.path, run.summary, run.trace, run.status == "complete", scene)
