"""Comparison of trainees' runs with a reference run: `tissue.assess` and `tissue.rank`.

The command `tissue assess` calls these functions.
"""

from pathlib import Path

from meshes.base.hints import suggests_arguments
from tissue.evaluation import assessment as engine
from tissue.evaluation import ranking
from tissue.evaluation.assessment_files import assessment_lines, write_assessment
from tissue.objects.run import Run, assessed_run


@suggests_arguments
class Assessment(engine.Assessment):
    """Comparison of a trainee's run with a reference run; ``print`` shows a readable report."""

    def __str__(self) -> str:
        return "\n".join(assessment_lines(self))

    def save(self, folder: str | Path, *, overwrite: bool = False) -> list[Path]:
        """Write ``assessment.json`` and ``assessment.png``.

        Raises
        ------
        InputError
            If the folder is a file, or if it holds another assessment and `overwrite` is False.
        """
        return write_assessment(self, Path(folder), overwrite=overwrite)


@suggests_arguments
def assess(
    trainee: Run | str | Path,
    reference: Run | str | Path,
    *,
    force_limit_N: float | None = None,
    deviation_limit_mm: float = 1.0,
    overshoot_limit_mm: float = 0.5,
) -> Assessment:
    """Compare a trainee's run with a reference run of the same task.

    Dynamic time warping aligns the two paths of the tool by position, not by time. A pause of the
    trainee therefore does not count as an error. If the scene of the reference run has
    ``keep_clear.margin_mm``, this margin is the smallest allowed distance to each structure.

    Parameters
    ----------
    trainee, reference
        Runs, or folders of runs.
    force_limit_N
        Limit of the force on the tool [N]; default 1.25 times the peak force of the reference run.
    deviation_limit_mm
        Limit of the distance from the path of the reference run [mm]. The limit applies at
        positions where the tool touches the tissue in either run.
    overshoot_limit_mm
        Largest allowed distance of the tip below the deepest point of the reference run [mm].
        Depths are measured from the first contact of the reference run.

    Raises
    ------
    InputError
        If the runs belong to different tasks (their anatomy, tool or material differs), or a run
        has no trace of at least ten ticks. It is also raised if the reference run or the trainee's
        run has no contact, or if both runs touch the tissue at no common place.
    """
    found = engine.assess(
        assessed_run(trainee),
        assessed_run(reference),
        force_limit_N=force_limit_N,
        deviation_limit_mm=deviation_limit_mm,
        overshoot_limit_mm=overshoot_limit_mm,
    )
    return Assessment(**vars(found))


@suggests_arguments
class Ranking(ranking.Ranking):
    """Trainees ordered by rank; ``print`` shows a list. See `rank` for the order."""

    def __str__(self) -> str:
        return "\n".join(ranking.ranking_lines(self))

    def save(self, folder: str | Path, *, overwrite: bool = False) -> list[Path]:
        """Write ``ranking.csv``, with a row for each run, and ``ranking.png``.

        Raises
        ------
        InputError
            If the folder is a file, or if it holds another ranking and `overwrite` is False.
        """
        return ranking.write_ranking(self, Path(folder), overwrite=overwrite)


@suggests_arguments
def rank(
    folder: str | Path,
    reference: Run | str | Path,
    *,
    force_limit_N: float | None = None,
    deviation_limit_mm: float = 1.0,
    overshoot_limit_mm: float = 0.5,
) -> Ranking:
    """Order trainees by the safety and the mean score of their runs of one scene.

    A breach is an entry of the tool into a structure named in the scene's table ``[keep_clear]``.
    Trainees are ordered by the share of their runs with a breach, the smallest share first.
    Trainees with equal shares are ordered by their mean score. The score measures how steady a hand
    is; see `Assessment.steadiness`. A trainee with three or more attempts also has a learning
    curve. Three kinds of runs are left out: runs of another task, runs without a score, and runs
    that touch no place of the tissue that the reference run touches. `Ranking.left_out` lists them.
    ``ranking.csv`` also has rows for the runs without a score. `Ranking.notes` lists differences
    between the scenes of the runs, such as differences in the coupling to the device.

    Parameters
    ----------
    folder
        Folder that contains one folder for each trainee. A trainee's folder is either the folder of
        one run, or contains one run folder for each attempt. The names of these folders give the
        order of the attempts.
    reference
        Reference run, or its folder, with which the runs of all trainees are compared.
    force_limit_N, deviation_limit_mm, overshoot_limit_mm
        Limits for the runs of all trainees; see `assess`.

    Raises
    ------
    InputError
        If the folder of a trainee or of the reference holds no run, or no run can be assessed.
    """
    found = ranking.rank(
        Path(folder),
        assessed_run(reference),
        assessed_run,
        force_limit_N=force_limit_N,
        deviation_limit_mm=deviation_limit_mm,
        overshoot_limit_mm=overshoot_limit_mm,
    )
    return Ranking(**vars(found))
